"""PTX of a kernel: compilation by LLVM's NVPTX back end. The driver translates it for the GPU that is there."""

import hashlib
from typing import Any

import llvmlite
import llvmlite.binding as llvm

TRIPLE = "nvptx64-nvidia-cuda"
CAPABILITY = 8, 0
"""The oldest GPUs that the code is for, by NVIDIA's compute capability: Ampere. Newer ones run it, too."""
FEATURES = "+ptx74"  # the language of drivers since CUDA 11.4
LEVEL = 2  # optimisation level of LLVM's code generation


def target_machine() -> Any:
    """A description of the GPU for LLVM."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    major, minor = CAPABILITY
    return llvm.Target.from_triple(TRIPLE).create_target_machine(cpu=f"sm_{major}{minor}", features=FEATURES, opt=LEVEL)


def ptx(text: str) -> bytes:
    """Compile a module's text to PTX."""
    module = llvm.parse_assembly(text)
    machine = target_machine()
    module.triple = TRIPLE
    module.data_layout = str(machine.target_data)
    return machine.emit_assembly(module).encode()


def translator() -> tuple[str, ...]:
    """The facts that decide the PTX of a module's text."""
    return llvmlite.__version__, str(llvm.llvm_version_info), TRIPLE, str(CAPABILITY), FEATURES, str(LEVEL)


def code_name(text: str) -> str:
    """A name for the PTX of a module: that of its text and of all that translates it."""
    return f"kernel-{hashlib.sha256(chr(10).join((text, *translator())).encode()).hexdigest()}"
