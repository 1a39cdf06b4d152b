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
    """The program of a lane as machine code, which comes from the user's cache or is compiled.

    Args:
        lane: A function of trees of scalars.
        arguments: Its arguments, with ``jax.ShapeDtypeStruct`` in place of each scalar.
        width: Number of lanes in a vector; None: chosen by the size of the program and the processor.
        strict: Whether products and sums are never contracted, so that every machine computes the same bits.
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
        """Find the machine code in the cache, or compile it; load it."""
        self._request = (lane, arguments, width, strict)
        self._has_64_bits = jnp.result_type(float) == jnp.float64
        self.signature = recall(self._signature) if recall else self._signature()
        self._code = self.load(cached(self.signature.code, self.compiled))

    def _signature(self) -> Signature:
        """Trace the lane, and return the signature of its machine code."""
        return self.traced.signature

    @cached_property
    def traced(self) -> "TracedLanes":
        """The program and its text for LLVM, traced in the precision that JAX had when this object was made."""
        with jax.enable_x64(self._has_64_bits), np.errstate(all="ignore"):
            return self.translated(*self._request)

    def translated(
        self, lane: Callable[..., Any], arguments: tuple[Any, ...], width: int | None, strict: bool
    ) -> "TracedLanes":
        """Trace a lane; return the lane's program and the program's text for LLVM.

        Args:
            lane: A function of trees of scalars.
            arguments: Its arguments, with ``jax.ShapeDtypeStruct`` in place of each scalar.
            width: Number of lanes in a vector; None: chosen by the size of the program and the processor.
            strict: Whether products and sums are never contracted.
        """
        from dssc_jax.lanes.traced_lanes import TracedLanes  # not needed if the cache has the program

        return TracedLanes(lane, arguments, width, strict)

    def compiled(self) -> bytes:
        """Compile the lane's text to machine code, the content of an object file."""
        return machine.object_code(self.traced.text)

    def load(self, code: bytes) -> Loaded:
        """Load machine code into this process."""
        return machine.LoadedCode(code)

    def interleaved(self, lanes: int) -> int:
        """Return the number of neighbouring lanes whose recordings are stored together, sample by sample.

        On a CPU these are the lanes of one vector, so the number ``lanes`` of lanes in the batch has no effect.
        """
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
        wait = self.start_timed(arguments, count, threads)

        def wait_for_results() -> Any:
            """Wait for the lanes, and return the tree of results."""
            results, _ = wait()
            return results

        return wait_for_results

    def start_timed(self, arguments: Any, count: int, threads: int) -> Callable[[], tuple[Any, float]]:
        """Begin to run a batch of lanes, and measure when it ends.

        Args:
            arguments: The lane's arguments, with a column of shape (n,) in place of each scalar.
            count: Number of lanes n.
            threads: Number of threads.

        Returns:
            A function that waits, and returns the tree of results, as that of :meth:`start`, and the time
            [s, :func:`time.perf_counter`] at which the lanes ended.
        """
        signature = self.signature
        lanes = whole_multiple(count, signature.width)
        inputs = [
            np.ascontiguousarray(np.pad(np.asarray(column, dtype), (0, lanes - count), mode="edge"))
            for column, dtype in zip(jax.tree.leaves(arguments), signature.inputs, strict=True)
        ]
        outputs = []
        for dtype, length in signature.outputs:
            numbers_per_lane = 1 if length is None else length  # None: a number, no recording
            outputs.append(np.empty(lanes * numbers_per_lane, stored_type(dtype)))
        wait = self._code.start(inputs, outputs, lanes, signature.width, threads)

        def wait_for_results() -> tuple[Any, float]:
            """Wait for the lanes; return the tree of results without the padded lanes, and the time of the end [s]."""
            end_time = wait()
            group = self.interleaved(lanes)
            arrays = []
            for (dtype, length), column in zip(signature.outputs, outputs, strict=True):
                arrays.append(in_order(column, length, group)[:count].view(dtype))
            return jax.tree.unflatten(jax.tree.structure(signature.results), arrays), end_time

        return wait_for_results


def whole_multiple(count: int, width: int) -> int:
    """Return the smallest multiple of ``width`` that is at least ``count``: the lanes of a batch in whole vectors."""
    vectors = -(-count // width)  # count / width, rounded up
    return vectors * width


def in_order(column: np.ndarray, length: int | None, width: int) -> np.ndarray:
    """Return one result of all lanes in the order of the lanes, from the order in which the machine code stores it.

    Args:
        column: The stored numbers.
        length: Length of a recording; None: a number for each lane.
        width: Number of neighbouring lanes whose recordings are stored sample by sample.

    Returns:
        Shape (lanes,), or (lanes, length) for recordings.
    """
    if length is None:
        return column
    groups = column.reshape(-1, length, width)  # of neighbouring lanes, sample, lane of the group
    by_lane = np.swapaxes(groups, 1, 2)
    return by_lane.reshape(-1, length)
