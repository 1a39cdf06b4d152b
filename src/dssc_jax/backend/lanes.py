"""Batches of lanes as machine code: trace, translate, compile or read from the cache, run.

The number of lanes in a vector follows from the program and the processor alone. A batch is padded to whole vectors,
so results do not depend on its size, nor on the number of threads.
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.backend import machine
from dssc_jax.backend.instructions import stored_type
from dssc_jax.backend.llvm import module_text
from dssc_jax.backend.needed import operation_counts
from dssc_jax.backend.opposites import join_opposites
from dssc_jax.backend.program import Program, Recording
from dssc_jax.backend.translate import translate
from dssc_jax.cache.user_cache import kept, remembered


class Packing(NamedTuple):
    """How the program of a lane becomes that of a vector of lanes.

    Args:
        below: The packing is for programs of fewer operations.
        vectors: Hardware vectors that make a vector of lanes: more hide the time that an operation takes, fewer leave
            the state in registers.
        window: See :func:`dssc_jax.backend.order.ordered`. A processor looks that far ahead, too; where many vectors
            share the registers, operations that come early cost more than they gain.
    """

    below: float
    vectors: int
    window: int


PACKINGS = {
    512: (Packing(750, 4, 30), Packing(math.inf, 2, 75)),
    256: (Packing(750, 4, 120), Packing(2000, 2, 150), Packing(math.inf, 1, 300)),
}
"""Packings by the bits of a hardware vector, as measured. Processors with 512 bits have twice as many registers."""

RANDOM_PACKINGS = Packing(5000, 4, 150), Packing(math.inf, 2, 150)
"""For programs that draw random numbers, in chains where each operation waits for the one before."""
MANY_XORS = 100
"""Exclusive ors of a program that draws random numbers."""


class Signature(NamedTuple):
    """What a caller of a lane's machine code must know.

    Args:
        width: Lanes of a vector.
        inputs: Types of the columns that it reads.
        outputs: Type of each column that it writes, and the length of a recording; None for a number.
        results: The tree of results, with 0 in place of each.
        code: The name of the machine code.
    """

    width: int
    inputs: tuple[np.dtype, ...]
    outputs: tuple[tuple[np.dtype, int | None], ...]
    results: Any
    code: str


class TracedLanes:
    """The program of a lane as text for LLVM; arguments as of :class:`CompiledLanes`.

    Raises:
        Unsupported: An operation has no translation.
    """

    def __init__(self, lane: Callable[..., Any], arguments: tuple[Any, ...], width: int | None, strict: bool) -> None:
        self.program, results = translate(lane, *arguments, fast=not strict)
        if not strict:
            join_opposites(self.program)
        packing = best_packing(self.program)
        width = width or packing.vectors * machine.vector_bits() // number_bits(self.program)
        self.text = module_text(self.program, width, strict, packing.window)
        outputs = ((each.dtype, each.length if isinstance(each, Recording) else None) for each in self.program.outputs)
        empty = jax.tree.map(lambda _: 0, results)
        code = machine.code_name(self.text)
        self.signature = Signature(width, tuple(self.program.inputs), tuple(outputs), empty, code)


class CompiledLanes:
    """The program of a lane as machine code.

    If the user's cache has the machine code and tells its name, the lane is not even traced.

    Args:
        lane: A function of trees of scalars.
        arguments: ``jax.ShapeDtypeStruct`` in place of the scalars.
        width: Lanes of a vector; None: by the size of the program.
        strict: Without contraction, for the same bits on every machine.

    Raises:
        Unsupported: An operation has no translation.
    """

    def __init__(
        self, lane: Callable[..., Any], *arguments: Any, width: int | None = None, strict: bool = False
    ) -> None:
        self._given = lane, arguments, width, strict
        self.signature = remembered("signature", lambda: self.traced.signature, *self._given, machine.translator())
        code = kept(self.signature.code, lambda: machine.object_code(self.traced.text))
        self._code = machine.LoadedCode(code)

    @cached_property
    def traced(self) -> TracedLanes:
        """The program and its text."""
        return TracedLanes(*self._given)

    def start(self, arguments: Any, count: int, threads: int) -> Callable[[], Any]:
        """Begin to run a batch.

        Args:
            arguments: The trees with columns of shape (n,) in place of the scalars.
            count: n.
            threads: Threads to use.

        Returns:
            A function that waits and returns the tree of results: columns of shape (n,), (n, length) of records.
        """
        width, inputs, outputs, results, _ = self.signature
        lanes = -(-count // width) * width
        given = [
            np.ascontiguousarray(np.pad(np.asarray(column, dtype), (0, lanes - count), mode="edge"))
            for column, dtype in zip(jax.tree.leaves(arguments), inputs, strict=True)
        ]
        columns = [np.empty(lanes * (1 if length is None else length), stored_type(dtype)) for dtype, length in outputs]
        finish = self._code.start(given, columns, lanes, width, threads)

        def unpacked() -> Any:
            finish()
            pairs = zip(outputs, columns, strict=True)
            inside = [in_order(column, length, width)[:count].view(dtype) for (dtype, length), column in pairs]
            return jax.tree.unflatten(jax.tree.structure(results), inside)

        return unpacked


def in_order(column: np.ndarray, length: int | None, width: int) -> np.ndarray:
    """One result of all lanes: numbers, or recordings, which are stored sample by sample within a vector."""
    if length is None:
        return column
    return np.moveaxis(column.reshape(-1, length, width), 1, 2).reshape(-1, length)


class LaneBatch:
    """A lane's program as machine code, for batches of its numbers by name.

    Args:
        lane: (numbers by name, draw index) -> results.
        names: Names of the numbers.
        cores: Cores to use; None: all.
        strict: See :class:`CompiledLanes`.
    """

    def __init__(self, lane: Callable[..., Any], names: Sequence[str], cores: int | None, strict: bool) -> None:
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        index = jax.ShapeDtypeStruct((), jnp.uint32)
        self._lanes = CompiledLanes(lane, dict.fromkeys(names, number), index, strict=strict)
        self._threads = min(cores or machine.usable_cores(), machine.usable_cores())

    def start(self, values: dict[str, np.ndarray], index: np.ndarray) -> Callable[[], Any]:
        """Begin to run a batch; see :data:`dssc_jax.backend.forms.Start`."""
        return self._lanes.start((values, index), len(index), self._threads)


def best_packing(program: Program) -> Packing:
    """The packing for this processor by the size of a program."""
    counts = operation_counts(program)
    random = counts.get("xor", 0) > MANY_XORS
    packings = RANDOM_PACKINGS if random else PACKINGS[max(machine.vector_bits(), 256)]
    return next(packing for packing in packings if sum(counts.values()) < packing.below)


def number_bits(program: Program) -> int:
    """Bits of the longest number that a lane is given."""
    return 8 * max((dtype.itemsize for dtype in program.inputs), default=8)
