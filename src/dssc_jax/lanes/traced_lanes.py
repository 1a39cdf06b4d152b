"""From a lane to a module's text for LLVM: trace, translate, choose the size of a vector, write."""

import math
import os
from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from dssc_jax.lanes.interface import Signature
from dssc_jax.lanes.llvm import machine
from dssc_jax.lanes.llvm.module_text import module_text
from dssc_jax.lanes.passes.liveness import operation_counts
from dssc_jax.lanes.passes.negated_states import join_opposites
from dssc_jax.lanes.passes.verify import verify
from dssc_jax.lanes.program import Program, Recording
from dssc_jax.lanes.tracing.translate import translate

VERIFY_VARIABLE = "DSSC_JAX_VERIFY"


class Packing(NamedTuple):
    """How the program of a lane becomes that of a vector of lanes.

    Args:
        operations: The packing is for programs of fewer operations.
        vectors: Hardware vectors that make a vector of lanes: more hide the time that an operation takes, fewer leave
            the state in registers.
        window: See :func:`dssc_jax.lanes.passes.scheduling.schedule`. A processor looks that far ahead, too; where many
            vectors share the registers, operations that come early cost more than they gain.
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
"""For programs that draw random numbers, in chains where each operation waits for the one before."""
MANY_XORS = 100
"""Exclusive ors of a program that draws random numbers."""


class TracedLanes:
    """The program of a lane as text for LLVM; arguments as of :class:`dssc_jax.lanes.lanes.CompiledLanes`.

    Raises:
        Unsupported: An operation has no translation.
    """

    def __init__(self, lane: Callable[..., Any], arguments: tuple[Any, ...], width: int | None, strict: bool) -> None:
        self.program, results = lane_program(lane, arguments, strict)
        packing = best_packing(self.program)
        width = width or packing.vectors * machine.vector_bits() // number_bits(self.program)
        self.text = module_text(self.program, width, strict, packing.window, machine.has_near_constants())
        self.signature = signature_of(self.program, results, width, machine.code_name(self.text))


def lane_program(lane: Callable[..., Any], arguments: tuple[Any, ...], strict: bool) -> tuple[Program, Any]:
    """The program of a lane, and the tree of its results.

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
    """The signature of the program's code, for its callers; ``code`` is the name of the code."""
    outputs = []
    for output in program.outputs:
        outputs.append((output.dtype, output.length if isinstance(output, Recording) else None))
    empty = jax.tree.map(lambda _: 0, results)
    return Signature(width, tuple(program.inputs), tuple(outputs), empty, code)


def check(program: Program) -> None:
    """Verify a program if the environment asks for it, as the tests do; it takes a fifth of the translation's time."""
    if os.environ.get(VERIFY_VARIABLE):
        verify(program)


def best_packing(program: Program) -> Packing:
    """The packing for this processor by the size of a program."""
    counts = operation_counts(program)
    random = counts.get("xor", 0) > MANY_XORS
    packings = RANDOM_PACKINGS if random else PACKINGS[max(machine.vector_bits(), 256)]
    return next(packing for packing in packings if sum(counts.values()) < packing.operations)


def number_bits(program: Program) -> int:
    """Bits of the longest number that a lane is given."""
    return 8 * max((dtype.itemsize for dtype in program.inputs), default=8)
