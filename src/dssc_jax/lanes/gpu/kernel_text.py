"""LLVM's text of a lane's program as a kernel: one lane a thread, the whole time loop within the thread.

The instructions are those of a CPU with vectors of one lane, and so are the bits in strict arithmetic.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dssc_jax.lanes.foreign import ForeignFunction
from dssc_jax.lanes.gpu import ptx
from dssc_jax.lanes.interface import ENTRY_POINT
from dssc_jax.lanes.llvm.module_text import Emitter
from dssc_jax.lanes.program import Program, Recording, Value
from dssc_jax.lanes.traced_lanes import TracedLanes, lane_program, signature_of
from dssc_jax.lanes.unsupported import Unsupported

SPECIAL_REGISTERS = {"block": "ctaid", "size": "ntid", "thread": "tid"}
"""Where a thread reads the number of its block, the threads of a block and its number in the block."""
WINDOW = 0  # the assembler orders instructions for the registers that it has
REGISTERS = 128
"""Registers of a thread in single precision: two blocks then share a multiprocessor, and hide their latencies."""


class KernelEmitter(Emitter):
    """Writes the kernel of a program; arguments as of :class:`~dssc_jax.lanes.llvm.module_text.Emitter`."""

    def __init__(self, program: Program, strict: bool) -> None:
        super().__init__(program, 1, strict, WINDOW)

    def head(self) -> str:
        """The line with which the kernel begins; ``count`` is the number of lanes of the batch.

        In double precision a thread takes all registers that it needs.
        """
        double = np.dtype(np.float64) in self.program.inputs
        limit = "" if double else f' "nvvm.maxnreg"="{REGISTERS}"'  # LLVM 20 ignores it
        return f"define ptx_kernel void @{ENTRY_POINT}(ptr noalias %inputs, ptr noalias %outputs, i64 %count){limit} {{"

    def opening(self) -> list[str]:
        """The lane of a thread; a thread beyond the last lane does nothing."""
        lines: list[str] = []
        for name, register in SPECIAL_REGISTERS.items():
            function = f"@llvm.nvvm.read.ptx.sreg.{register}.x()"
            self.declarations.add(f"declare i32 {function}")
            lines += [f"  %{name}32 = call i32 {function}", f"  %{name} = zext i32 %{name}32 to i64"]
        return [
            *lines,
            "  %start = mul i64 %block, %size",
            "  %lane = add i64 %start, %thread",
            "  %some = icmp ult i64 %lane, %count",
            "  br i1 %some, label %lanes, label %done",
            "lanes:",
        ]

    def closing(self) -> list[str]:
        """The end of the lane."""
        return ["  br label %done", "done:", "  ret void"]

    def recorded_element(self, recording: Recording, index: str) -> str:
        """An element of a recorded array: those of all lanes lie side by side, so that threads write together."""
        start = self.emit(f"mul i64 {index}, %count")
        return self.emit(f"add i64 {start}, %lane")

    def foreign(self, function: ForeignFunction, value: Value) -> str:
        """Refuse a function of C.

        Raises:
            Unsupported: Always.
        """
        raise Unsupported("a GPU cannot call it; run the study on a CPU", f"the function of C '{function.symbol}'")

    def arithmetic(self, operation: str, dtype: Any, wide: bool, names: Sequence[str]) -> str:
        """An operation with the type of its operands.

        Raises:
            Unsupported: It is not exact on a GPU.
        """
        if operation == "rem" and dtype.kind == "f":  # LLVM takes a multiple of a rounded quotient away
            raise Unsupported("it is not exact on a GPU; run the study on a CPU", f"'rem' of {dtype}")
        return super().arithmetic(operation, dtype, wide, names)


class TracedKernel(TracedLanes):
    """The program of a lane as a kernel's text for LLVM.

    Raises:
        Unsupported: An operation has no translation.
    """

    def __init__(self, lane: Callable[..., Any], arguments: tuple[Any, ...], strict: bool) -> None:
        self.program, results = lane_program(lane, arguments, strict)
        self.text = KernelEmitter(self.program, strict).text()
        self.signature = signature_of(self.program, results, 1, ptx.code_name(self.text))
