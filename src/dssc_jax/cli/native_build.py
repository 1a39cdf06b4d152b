"""Build shared objects from a user's C files or for an FMU, with the first C compiler that is found."""

import subprocess
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_code.fmu import COMPILERS, LIBRARY_FLAGS, ControllerFmu, compiler, no_library_reason
from dssc_jax.flight_code.template_files import FOLDER

FLAGS = (
    "-O2",
    "-ffp-contract=off",  # the bits of a result are then the same on every machine
    "-shared",
    "-fPIC",
    "-DDSSC_JAX_LIBRARY",  # includes the controllers' description in the headers
    "-Wall",
    "-Werror=implicit-function-declaration",
)
"""Flags of the compiler for a user's C files."""
LIBRARY = "library.so"
"""File name of a built library in its temporary folder."""


def build_library(sources: Sequence[Path], include: Sequence[Path]) -> bytes:
    """Build a shared object from C files, and return its content.

    Args:
        sources: The C files.
        include: Folders of headers.

    Raises:
        ConfigError: There is no compiler, a source is not a file, or the compiler fails.
    """
    program = compiler()
    if program is None:
        raise ConfigError("library", f"needs a C compiler, and none is found ({', '.join(COMPILERS)})")
    for source in sources:
        if not source.is_file():
            raise ConfigError(str(source), "is not a file")
    headers = [f"-I{folder.resolve()}" for folder in (*include, FOLDER)]
    names = [str(source.resolve()) for source in sources]
    with TemporaryDirectory(prefix="dssc-jax-library-") as folder:
        complaint = compile_library([program, *FLAGS, *headers, *names], Path(folder))
        if complaint:
            raise ConfigError(str(sources[0]), f"does not compile: {complaint}")
        return files.read_bytes(Path(folder) / LIBRARY)


def build_fmu_library(fmu: ControllerFmu) -> tuple[bytes | None, str | None]:
    """Build the library of an FMU for this machine.

    Args:
        fmu: The FMU, with its sources.

    Returns:
        The library's content, and None; or None, and the reason why there is no library.
    """
    reason = no_library_reason()
    if reason is not None:
        return None, reason
    program = compiler()
    assert program is not None  # else this is the reason
    with TemporaryDirectory(prefix="dssc-jax-fmu-") as name:
        folder = Path(name)
        for file, text in fmu.sources.items():
            files.write_text(folder / file, text, durable=False)
        complaint = compile_library([program, *LIBRARY_FLAGS, *fmu.c_files], folder)
        if complaint:
            return None, f"{program} fails: {complaint}"
        return files.read_bytes(folder / LIBRARY), None


def compile_library(command: list[str], folder: Path) -> str:
    """Compile :data:`LIBRARY` in a folder.

    Args:
        command: The compiler with flags and sources.
        folder: Folder in which the compiler runs.

    Returns:
        The compiler's first error; empty if it succeeds.
    """
    command = [*command, "-o", LIBRARY, "-lm"]
    compilation = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if compilation.returncode == 0:
        return ""
    for line in compilation.stderr.splitlines():
        if "error:" in line:
            return line.strip()
    return compilation.stderr[:200].strip() or f"exit code {compilation.returncode}"
