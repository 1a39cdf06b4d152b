"""The text for LLVM of a lane's program as a kernel: each thread runs the whole time loop of one lane.

The instructions are those for a CPU with vectors of one lane, so strict arithmetic gives the same bits.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dssc_jax.lanes.foreign import ForeignFunction
from dssc_jax.lanes.gpu import ptx
from dssc_jax.lanes.interface import ENTRY_POINT
from dssc_jax.lanes.llvm.function_text import MANY_REGISTERS
from dssc_jax.lanes.llvm.module_text import Emitter
from dssc_jax.lanes.program import Program, Recording, Value
from dssc_jax.lanes.traced_lanes import TracedLanes, lane_program, signature_of
from dssc_jax.lanes.unsupported import Unsupported

SPECIAL_REGISTERS = {"block": "ctaid", "size": "ntid", "thread": "tid"}
"""Registers in which a thread finds the number of its block, the size of a block and its number within the block."""
WINDOW = 0  # the assembler orders instructions for the registers that it has
REGISTERS = 128
"""Registers of a thread in single precision: two blocks then share a multiprocessor, and hide their latencies."""


class KernelEmitter(Emitter):
    """Writes the kernel of a program.

    Args:
        program: The program.
        strict: Whether products and sums are never contracted.
    """

    def __init__(self, program: Program, strict: bool) -> None:
        """Begin without lines; a vector has one lane."""
        super().__init__(program, 1, strict, WINDOW, MANY_REGISTERS)

    def head(self) -> str:
        """Return the first line of the kernel, whose argument ``count`` is the number of lanes of the batch.

        In single precision a thread has at most :data:`REGISTERS` registers; in double precision there is no limit.
        """
        double = np.dtype(np.float64) in self.program.inputs
        limit = "" if double else f' "nvvm.maxnreg"="{REGISTERS}"'  # LLVM 20 ignores it
        return f"define ptx_kernel void @{ENTRY_POINT}(ptr noalias %inputs, ptr noalias %outputs, i64 %count){limit} {{"

    def opening(self) -> list[str]:
        """Return the lines that compute the number of a thread's lane, and that end a thread beyond the last lane."""
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
        """Return the lines that end the thread."""
        return ["  br label %done", "done:", "  ret void"]

    def recorded_element(self, recording: Recording, index: str) -> str:
        """Write where in the column of a recording the element at an index lies for the thread's lane.

        The elements of all lanes at one index are neighbours, so that the threads write a block of memory together.

        Args:
            recording: The recording; its length has no effect, because the columns of all lanes are interleaved.
            index: Register of the index, an integer of 64 bits.

        Returns:
            The register of the element's position in the column.
        """
        start = self.emit(f"mul i64 {index}, %count")
        return self.emit(f"add i64 {start}, %lane")

    def foreign(self, function: ForeignFunction, value: Value) -> str:
        """Refuse a function of C, whose code exists for the CPU alone; ``value`` has no effect.

        Raises:
            Unsupported: Always.
        """
        raise Unsupported("a GPU cannot call it; run the study on a CPU", f"the function of C '{function.symbol}'")

    def arithmetic(self, operation: str, dtype: Any, wide: bool, names: Sequence[str]) -> str:
        """Write an operation whose result has the type of its operands, with the instructions for a CPU.

        Args:
            operation: The operation.
            dtype: Dtype of operands and result.
            wide: Whether they are vectors of lanes.
            names: Register or literal of each operand.

        Returns:
            The register of the result.

        Raises:
            Unsupported: The operation is a remainder of floating-point numbers, which is not exact on a GPU.
        """
        if operation == "rem" and dtype.kind == "f":  # LLVM subtracts a multiple of a rounded quotient
            raise Unsupported("it is not exact on a GPU; run the study on a CPU", f"'rem' of {dtype}")
        return super().arithmetic(operation, dtype, wide, names)


class TracedKernel(TracedLanes):
    """The program of a lane and the kernel's text for LLVM.

    Args:
        lane: A function of trees of scalars.
        arguments: Its arguments, with ``jax.ShapeDtypeStruct`` in place of each scalar.
        strict: Whether products and sums are never contracted.

    Raises:
        Unsupported: An operation has no translation, or none for a GPU.
    """

    def __init__(self, lane: Callable[..., Any], arguments: tuple[Any, ...], strict: bool) -> None:
        """Trace and translate the lane, and write its text."""
        self.program, results = lane_program(lane, arguments, strict)
        self.text = KernelEmitter(self.program, strict).text()
        self.signature = signature_of(self.program, results, 1, ptx.code_name(self.text))
