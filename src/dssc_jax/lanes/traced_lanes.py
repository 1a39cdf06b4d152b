"""Trace the program of a lane, translate it, choose the width of its vectors, and write its text for LLVM."""

import math
import os
from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from dssc_jax.lanes.interface import Signature
from dssc_jax.lanes.llvm import machine
from dssc_jax.lanes.llvm.function_text import MANY_REGISTERS, RegisterUse
from dssc_jax.lanes.llvm.module_text import module_text
from dssc_jax.lanes.passes.liveness import operation_counts
from dssc_jax.lanes.passes.negated_states import join_opposites
from dssc_jax.lanes.passes.verify import verify
from dssc_jax.lanes.program import Program, Recording
from dssc_jax.lanes.tracing.translate import translate

VERIFY_VARIABLE = "DSSC_JAX_VERIFY"


class Packing(NamedTuple):
    """The choice of the number of lanes in a vector and of the order of operations, for programs of a certain size.

    Args:
        operations: The packing is for programs with fewer operations than this.
        vectors: Number of hardware vectors in a vector of lanes. More of them hide the latency of operations; fewer
            leave the state in registers.
        window: See :func:`dssc_jax.lanes.passes.scheduling.schedule`. The more hardware vectors share the registers,
            the narrower the best window.
    """

    operations: float
    vectors: int
    window: int


PACKINGS = {
    512: (Packing(450, 4, 25), Packing(math.inf, 2, 60)),
    256: (Packing(750, 4, 0), Packing(2000, 2, 20), Packing(math.inf, 1, 20)),
}
"""Packings by the bits of a hardware vector, as measured. Processors with 512 bits have twice as many registers."""

RANDOM_PACKINGS = Packing(5000, 4, 150), Packing(math.inf, 2, 150)
"""Packings for programs that draw random numbers, by long chains of operations that each need the one before."""
MANY_XORS = 100
"""A program with more exclusive ors than this draws random numbers."""


class TracedLanes:
    """The program of a lane and its text for LLVM.

    Args:
        lane: A function of trees of scalars.
        arguments: Its arguments, with ``jax.ShapeDtypeStruct`` in place of each scalar.
        width: Number of lanes in a vector; None: chosen by the size of the program and the processor.
        strict: Whether products and sums are never contracted.

    Raises:
        Unsupported: An operation has no translation.
    """

    def __init__(self, lane: Callable[..., Any], arguments: tuple[Any, ...], width: int | None, strict: bool) -> None:
        """Trace and translate the lane, and write its text."""
        self.program, results = lane_program(lane, arguments, strict)
        packing = best_packing(self.program)
        if width is None:
            width = packing.vectors * machine.vector_bits() // number_bits(self.program)
        self.text = module_text(self.program, width, strict, packing.window, register_use(self.program, width))
        self.signature = signature_of(self.program, results, width, machine.code_name(self.text))


def lane_program(lane: Callable[..., Any], arguments: tuple[Any, ...], strict: bool) -> tuple[Program, Any]:
    """Trace and translate a lane; return its program, and the tree of its results with shapes and types.

    Fast arithmetic (not ``strict``) also removes the states of loops that are the negative of another state.

    Raises:
        Unsupported: An operation has no translation.
    """
    program, results = translate(lane, *arguments, fast=not strict)
    check(program)
    if not strict:
        join_opposites(program)
        check(program)
    return program, results


def signature_of(program: Program, results: Any, width: int, code: str) -> Signature:
    """Return the signature of a program's machine code: all that a caller must know to run the code.

    Args:
        program: The program.
        results: The tree of the lane's results.
        width: Number of lanes in a vector.
        code: Name of the machine code in the cache.
    """
    outputs = []
    for output in program.outputs:
        length = output.length if isinstance(output, Recording) else None
        outputs.append((output.dtype, length))
    structure = jax.tree.map(lambda _: 0, results)
    return Signature(width, tuple(program.inputs), tuple(outputs), structure, code)


def check(program: Program) -> None:
    """Verify a program's form if the environment variable :data:`VERIFY_VARIABLE` is set, as it is in the tests.

    The verification costs a fifth of the translation's time.
    """
    if os.environ.get(VERIFY_VARIABLE):
        verify(program)


def best_packing(program: Program) -> Packing:
    """Return the packing that measurements found fastest on this processor for programs of this size."""
    counts = operation_counts(program)
    operations = sum(counts.values())
    draws_random_numbers = counts.get("xor", 0) > MANY_XORS
    vector_bits = max(machine.vector_bits(), 256)  # processors with 128 bits take the packings for 256
    packings = RANDOM_PACKINGS if draws_random_numbers else PACKINGS[vector_bits]
    return next(packing for packing in packings if operations < packing.operations)


def register_use(program: Program, width: int) -> RegisterUse:
    """Return how a program spares registers on this processor; a processor with many registers need not spare any.

    On a processor with few registers, a vector of lanes that consists of 2, 4 or 8 hardware vectors is written in
    pieces of one hardware vector each.

    Args:
        program: The program.
        width: Number of lanes in a vector.
    """
    if not machine.has_near_constants():
        return MANY_REGISTERS
    hardware_width = machine.vector_bits() // number_bits(program)
    has_pieces = hardware_width > 1 and width in (2 * hardware_width, 4 * hardware_width, 8 * hardware_width)
    return RegisterUse(stored_constants=True, piece_width=hardware_width if has_pieces else 0)


def number_bits(program: Program) -> int:
    """Return the number of bits of a program's longest input, 32 or 64 for floats; 64 if the program has no input."""
    most_bytes = max((dtype.itemsize for dtype in program.inputs), default=8)
    return 8 * most_bytes
