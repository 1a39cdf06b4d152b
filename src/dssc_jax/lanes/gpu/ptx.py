"""Compilation of kernels to PTX by LLVM's NVPTX back end; the driver translates PTX for the GPU of the machine."""

import hashlib
from typing import Any

import llvmlite
import llvmlite.binding as llvm

TRIPLE = "nvptx64-nvidia-cuda"
CAPABILITY = 8, 0
"""NVIDIA's compute capability of the oldest GPUs that can run the code: Ampere."""
FEATURES = "+ptx74"  # the language of drivers since CUDA 11.4
LEVEL = 2  # optimisation level of LLVM's code generation


def target_machine() -> Any:
    """Return LLVM's description of the GPU for which it compiles: the oldest one that is supported."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    major, minor = CAPABILITY
    return llvm.Target.from_triple(TRIPLE).create_target_machine(cpu=f"sm_{major}{minor}", features=FEATURES, opt=LEVEL)


def ptx(text: str) -> bytes:
    """Compile the text of a module of LLVM to PTX, NVIDIA's portable assembly language."""
    module = llvm.parse_assembly(text)
    machine = target_machine()
    module.triple = TRIPLE
    module.data_layout = str(machine.target_data)
    return machine.emit_assembly(module).encode()


def translator() -> tuple[str, ...]:
    """Return all that determines the PTX of a module, apart from the module's text: versions and settings."""
    return llvmlite.__version__, str(llvm.llvm_version_info), TRIPLE, str(CAPABILITY), FEATURES, str(LEVEL)


def code_name(text: str) -> str:
    """Return the name under which the cache keeps a module's PTX: a digest of the text and of :func:`translator`."""
    lines = "\n".join((text, *translator()))
    return f"kernel-{hashlib.sha256(lines.encode()).hexdigest()}"
