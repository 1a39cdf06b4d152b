"""Builds the library of an FMU with the compiler that is found."""

import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from dssc_jax.core import files
from dssc_jax.flight_code.fmu import LIBRARY_FLAGS, ControllerFmu, compiler, no_library_reason


def built_library(fmu: ControllerFmu) -> tuple[bytes | None, str | None]:
    """The library of an FMU for this machine, or why there is none."""
    reason, program = no_library_reason(), compiler()
    if reason is not None or program is None:
        return None, reason
    with TemporaryDirectory(prefix="dssc-jax-fmu-") as folder:
        place = Path(folder)
        for name, text in fmu.sources.items():
            files.write_text(place / name, text, durable=False)
        command = [program, *LIBRARY_FLAGS, *fmu.c_files, "-o", "library.so", "-lm"]
        compilation = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
        if compilation.returncode != 0:
            output = compilation.stderr
            complaint = next((line for line in output.splitlines() if "error" in line), output[:200])
            return None, f"{program} fails: {complaint.strip()}"
        return files.read_bytes(place / "library.so"), None
