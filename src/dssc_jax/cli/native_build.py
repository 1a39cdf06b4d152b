"""Builds a shared object from a user's C files with the first compiler found."""

import subprocess
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_code.fmu import COMPILERS, compiler
from dssc_jax.flight_code.template_files import FOLDER

FLAGS = (
    *("-O2", "-ffp-contract=off", "-shared", "-fPIC", "-DDSSC_JAX_LIBRARY"),
    *("-Wall", "-Werror=implicit-function-declaration"),
)
"""Without contraction the bits are the same on every machine. The macro includes the description."""


def build_library(sources: Sequence[Path], include: Sequence[Path]) -> bytes:
    """The content of a shared object of some C files.

    Raises:
        ConfigError: There is no compiler, or it fails; the first line of its complaint.
    """
    program = compiler()
    if program is None:
        raise ConfigError("library", f"needs a C compiler, and none is found ({', '.join(COMPILERS)})")
    for source in sources:
        if not source.is_file():
            raise ConfigError(str(source), "is not a file")
    folders = [f"-I{folder}" for folder in (*include, FOLDER)]
    with TemporaryDirectory(prefix="dssc-jax-library-") as folder:
        library = Path(folder) / "library.so"
        command = [program, *FLAGS, *folders, *(str(source.resolve()) for source in sources), "-o", str(library), "-lm"]
        compilation = subprocess.run(command, capture_output=True, text=True, check=False)
        if compilation.returncode != 0:
            output = compilation.stderr
            complaint = next((line for line in output.splitlines() if "error:" in line), output[:200])
            raise ConfigError(str(sources[0]), f"does not compile: {complaint.strip()}")
        return files.read_bytes(library)
