"""Batches of lanes as machine code: trace, translate, compile or read from the cache, run.

The number of lanes in a vector follows from the program and the processor alone. A batch is padded to whole vectors,
so results do not depend on its size, nor on the number of threads.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.backend import machine
from dssc_jax.backend.compiled_programs import kept
from dssc_jax.backend.llvm import module_text
from dssc_jax.backend.needed import operation_counts
from dssc_jax.backend.opposites import join_opposites
from dssc_jax.backend.program import BOOL, Program, Recording, Value
from dssc_jax.backend.translate import translate

VECTORS = {512: ((1500, 4), (math.inf, 2)), 256: ((750, 4), (2000, 2), (math.inf, 1))}
"""Bits of a hardware vector: operations of a program, and how many hardware vectors make a vector of lanes for programs
below that, as measured. Processors with 512 bits have twice as many registers."""

MANY_XORS = 100
"""Exclusive ors of a program that draws random numbers, in chains where each operation waits for the one before."""


class CompiledLanes:
    """The program of a lane as machine code.

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
        self.program, self.results = translate(lane, *arguments)
        if not strict:
            join_opposites(self.program)
        self.width = width or best_width(self.program)
        self.text = module_text(self.program, self.width, strict)
        self._code = machine.LoadedCode(kept(machine.code_name(self.text), lambda: machine.object_code(self.text)))

    def start(self, arguments: Any, count: int, threads: int) -> Callable[[], Any]:
        """Begin to run a batch.

        Args:
            arguments: The trees with columns of shape (n,) in place of the scalars.
            count: n.
            threads: Threads to use.

        Returns:
            A function that waits and returns the tree of results: columns of shape (n,), (n, length) of records.
        """
        lanes = -(-count // self.width) * self.width
        columns = [
            np.ascontiguousarray(np.pad(np.asarray(column, dtype), (0, lanes - count), mode="edge"))
            for column, dtype in zip(jax.tree.leaves(arguments), self.program.inputs, strict=True)
        ]
        outputs = [np.empty(lanes * numbers_a_lane(output), stored(output.dtype)) for output in self.program.outputs]
        finish = self._code.start(columns, outputs, lanes, self.width, threads)

        def results() -> Any:
            finish()
            pairs = zip(self.program.outputs, outputs, strict=True)
            return jax.tree.unflatten(
                jax.tree.structure(self.results), [self._unpacked(*pair, count) for pair in pairs]
            )

        return results

    def _unpacked(self, output: Value | Recording, column: np.ndarray, count: int) -> np.ndarray:
        """One result of all lanes in order."""
        if isinstance(output, Recording):
            vectors = column.reshape(-1, output.length, self.width)
            column = np.moveaxis(vectors, 1, 2).reshape(-1, output.length)
        return column[:count].view(output.dtype)


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


def stored(dtype: np.dtype) -> np.dtype:
    """The type in memory: a truth value is a byte."""
    return np.dtype(np.uint8) if dtype == BOOL else dtype


def numbers_a_lane(output: Value | Recording) -> int:
    """Numbers of one lane in a result."""
    return output.length if isinstance(output, Recording) else 1


def best_width(program: Program) -> int:
    """Lanes of a vector: more hide the time that an operation takes, fewer leave the state in registers."""
    bits, counts = machine.vector_bits(), operation_counts(program)
    size = sum(counts.values())
    vectors = next(vectors for limit, vectors in VECTORS[max(bits, 256)] if size < limit)
    if counts.get("xor", 0) > MANY_XORS:
        vectors = max(vectors, 2)
    return vectors * bits // (8 * max(dtype.itemsize for dtype in program.inputs))
