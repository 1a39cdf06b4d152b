"""NVIDIA's assembler, which needs no GPU: ``ptxas`` of the package nvidia-cuda-nvcc, or of a CUDA toolkit."""

import re
import shutil
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

ARCHITECTURES = ("sm_80", "sm_90", "sm_100")
"""Ampere (A100), Hopper (H100), Blackwell (B200)."""
REGISTERS = 65536
"""32-bit registers of a multiprocessor, in all three."""
WARP, MOST_THREADS = 32, 2048


class Usage(NamedTuple):
    """What a kernel takes.

    Args:
        registers: Registers of 32 bits of a thread.
        stack: Bytes of a thread's stack.
        stored: Bytes that are spilled to it.
        loaded: Bytes that are read back.
    """

    registers: int
    stack: int
    stored: int
    loaded: int

    @property
    def threads(self) -> int:
        """Threads that a multiprocessor holds at a time; registers are given to a warp by 256."""
        of_warp = -(-self.registers * WARP // 256) * 256
        return min(MOST_THREADS, REGISTERS // of_warp * WARP)


def assembler() -> str:
    """The path of ``ptxas``.

    Raises:
        FileNotFoundError: There is none.
    """
    package = find_spec("nvidia")
    for folder in package.submodule_search_locations or () if package else ():
        for found in sorted(Path(folder).glob("*/bin/ptxas")):
            return str(found)
    if found := shutil.which("ptxas"):
        return found
    raise FileNotFoundError("no ptxas here: pip install nvidia-cuda-nvcc")


def assembled(code: bytes, architecture: str) -> Usage:
    """Assemble PTX for an architecture.

    Raises:
        ValueError: The assembler refuses it; the message is the assembler's.
    """
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "kernel.ptx"
        source.write_bytes(code)
        command = [assembler(), "-v", f"-arch={architecture}", str(source), "-o", str(source.with_suffix(".cubin"))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError(done.stderr)
    entry = done.stderr[done.stderr.index("Function properties for lanes") :]
    stack, stored, loaded = re.search(
        r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill", entry
    ).groups()
    registers = re.search(r"Used (\d+) registers", entry).group(1)
    return Usage(*map(int, (registers, stack, stored, loaded)))


def version() -> str:
    """The assembler's version."""
    text = subprocess.run([assembler(), "--version"], capture_output=True, text=True, check=True).stdout
    return re.search(r"V([\d.]+)", text).group(1)
