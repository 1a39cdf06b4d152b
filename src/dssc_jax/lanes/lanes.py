"""Batches of lanes as machine code: trace, translate, compile or read from the cache, run.

The number of lanes in a vector follows from the program and the processor alone. A batch is padded to whole vectors,
so results do not depend on its size, nor on the number of threads.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import arithmetic
from dssc_jax.lanes import machine
from dssc_jax.lanes.cache.user_cache import kept, remembered
from dssc_jax.lanes.interface import stored_type

if TYPE_CHECKING:
    from dssc_jax.lanes.traced_lanes import TracedLanes


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
        self._given, self._bits = (lane, arguments, width, strict), 8 * jnp.result_type(float).itemsize
        self.signature = remembered("signature", lambda: self.traced.signature, *self._given, machine.translator())
        code = kept(self.signature.code, lambda: machine.object_code(self.traced.text))
        self._code = machine.LoadedCode(code)

    @cached_property
    def traced(self) -> "TracedLanes":
        """The program and its text."""
        from dssc_jax.lanes.traced_lanes import TracedLanes  # the translator, if the cache does not do without it

        with arithmetic(self._bits):  # that of the compilation, perhaps by another process
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
        finish = self.start_timed(arguments, count, threads)
        return lambda: finish()[0]

    def start_timed(self, arguments: Any, count: int, threads: int) -> Callable[[], tuple[Any, float]]:
        """As :meth:`start`; the function also tells when the lanes ended, see :meth:`.machine.LoadedCode.start`."""
        width, inputs, outputs, results, _ = self.signature
        lanes = -(-count // width) * width
        given = [
            np.ascontiguousarray(np.pad(np.asarray(column, dtype), (0, lanes - count), mode="edge"))
            for column, dtype in zip(jax.tree.leaves(arguments), inputs, strict=True)
        ]
        columns = [np.empty(lanes * (1 if length is None else length), stored_type(dtype)) for dtype, length in outputs]
        finish = self._code.start(given, columns, lanes, width, threads)

        def unpacked() -> tuple[Any, float]:
            ended = finish()
            pairs = zip(outputs, columns, strict=True)
            inside = [in_order(column, length, width)[:count].view(dtype) for (dtype, length), column in pairs]
            return jax.tree.unflatten(jax.tree.structure(results), inside), ended

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

    def start(self, values: dict[str, np.ndarray], index: np.ndarray) -> Callable[[], tuple[Any, float]]:
        """Begin to run a batch; see :data:`dssc_jax.lanes.forms.Start`."""
        return self._lanes.start_timed((values, index), len(index), self._threads)
