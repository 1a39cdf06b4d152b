"""Batches of lanes as machine code: trace, translate, compile or read from the cache, run.

The number of lanes in a vector follows from the program and the processor alone. A batch is padded to whole vectors,
so results do not depend on its size, nor on the number of threads.
"""

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.lanes.interface import Loaded, Signature, stored_type
from dssc_jax.lanes.llvm import machine
from dssc_jax.lanes.program_cache import cached

if TYPE_CHECKING:
    from dssc_jax.lanes.traced_lanes import TracedLanes

Recall: TypeAlias = Callable[[Callable[[], Signature]], Signature]
"""``(compute) -> signature``, from a cache or by calling ``compute``, which traces the lane."""


class CompiledLanes:
    """The program of a lane as machine code, from the user's cache or compiled.

    Args:
        lane: A function of trees of scalars.
        arguments: Its arguments, with ``jax.ShapeDtypeStruct`` in place of each scalar.
        width: Lanes of a vector; None: by the size of the program.
        strict: Whether products and sums are never contracted, which gives the same bits on every machine.
        recall: Finds the signature in a cache, so that the lane need not be traced; None: the lane is traced.

    Raises:
        Unsupported: An operation has no translation.
    """

    def __init__(
        self,
        lane: Callable[..., Any],
        *arguments: Any,
        width: int | None = None,
        strict: bool = False,
        recall: Recall | None = None,
    ) -> None:
        self._request = (lane, arguments, width, strict)
        self._wide = jnp.result_type(float) == jnp.float64
        self.signature = recall(self._signature) if recall else self._signature()
        self._code = self.load(cached(self.signature.code, self.compiled))

    def _signature(self) -> Signature:
        return self.traced.signature

    @cached_property
    def traced(self) -> "TracedLanes":
        """The program and its text, in the precision that JAX had when this object was made."""
        with jax.enable_x64(self._wide), np.errstate(all="ignore"):
            return self.translated(*self._request)

    def translated(
        self, lane: Callable[..., Any], arguments: tuple[Any, ...], width: int | None, strict: bool
    ) -> "TracedLanes":
        """Trace a lane; return its program and its text for LLVM."""
        from dssc_jax.lanes.traced_lanes import TracedLanes  # not needed if the cache has the program

        return TracedLanes(lane, arguments, width, strict)

    def compiled(self) -> bytes:
        """Compile the text to machine code."""
        return machine.object_code(self.traced.text)

    def load(self, code: bytes) -> Loaded:
        """Load machine code into this process."""
        return machine.LoadedCode(code)

    def interleaved(self, lanes: int) -> int:
        """Number of neighbouring lanes whose recordings are stored sample by sample, in a batch of ``lanes``."""
        return self.signature.width

    def start(self, arguments: Any, count: int, threads: int) -> Callable[[], Any]:
        """Begin to run a batch of lanes.

        Args:
            arguments: The lane's arguments, with a column of shape (n,) in place of each scalar.
            count: Number of lanes n.
            threads: Number of threads.

        Returns:
            A function that waits and returns the tree of results: columns of shape (n,), and (n, length) for
            recordings.
        """
        finish = self.start_timed(arguments, count, threads)
        return lambda: finish()[0]

    def start_timed(self, arguments: Any, count: int, threads: int) -> Callable[[], tuple[Any, float]]:
        """As :meth:`start`; the function also returns when the lanes ended, a time of :func:`time.perf_counter`."""
        width, inputs, outputs, results, _ = self.signature
        lanes = -(-count // width) * width
        padded_columns = [
            np.ascontiguousarray(np.pad(np.asarray(column, dtype), (0, lanes - count), mode="edge"))
            for column, dtype in zip(jax.tree.leaves(arguments), inputs, strict=True)
        ]
        columns = [np.empty(lanes * (1 if length is None else length), stored_type(dtype)) for dtype, length in outputs]
        finish = self._code.start(padded_columns, columns, lanes, width, threads)

        def results_and_end() -> tuple[Any, float]:
            end_time = finish()
            pairs = zip(outputs, columns, strict=True)
            group = self.interleaved(lanes)
            arrays = [in_order(column, length, group)[:count].view(dtype) for (dtype, length), column in pairs]
            return jax.tree.unflatten(jax.tree.structure(results), arrays), end_time

        return results_and_end


def in_order(column: np.ndarray, length: int | None, width: int) -> np.ndarray:
    """One result of all lanes, in the order of the lanes.

    Args:
        column: The numbers as they are stored.
        length: Length of a recording; None: a number for each lane.
        width: Number of neighbouring lanes whose recordings are stored sample by sample.

    Returns:
        Shape (lanes,), or (lanes, length) for recordings.
    """
    if length is None:
        return column
    return np.moveaxis(column.reshape(-1, length, width), 1, 2).reshape(-1, length)
