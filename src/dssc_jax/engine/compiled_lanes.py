"""Lanes as machine code.

The user's cache stores the signatures of compiled lanes, so that a lane in the cache is not even traced.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.trace_memory.memory import cached_by_subjects
from dssc_jax.lanes.gpu import ptx
from dssc_jax.lanes.gpu.driver import GpuError
from dssc_jax.lanes.gpu.kernel_lanes import KernelLanes
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.llvm import machine


def compiled_lanes(
    lane: Callable[..., Any], *arguments: Any, width: int | None = None, strict: bool = False, gpu: bool = False
) -> CompiledLanes:
    """The program of a lane as machine code for a CPU, or as a kernel for a GPU.

    Args:
        lane: A function of trees of scalars.
        arguments: ``jax.ShapeDtypeStruct`` in place of the scalars.
        width: Lanes in a vector of the processor; None: by the size of the program.
        strict: Whether to compile without contraction of multiply-adds, for the same bits on every machine.
        gpu: Whether to compile a kernel, see :class:`KernelLanes`.

    Raises:
        Unsupported: An operation has no translation.
    """
    lanes = KernelLanes if gpu else CompiledLanes
    translator = ptx.translator() if gpu else machine.translator()

    def recall(compute: Callable[[], Any]) -> Any:
        """The lane's signature from the cache, or computed and kept there."""
        return cached_by_subjects("signature", compute, lane, arguments, width, strict, translator)

    return lanes(lane, *arguments, width=width, strict=strict, recall=recall)


class LaneBatch:
    """The program of a lane as machine code, for batches of lanes.

    Args:
        lane: ``(numbers by name, draw index) -> results``.
        names: Names of the numbers.
        cores: Most cores to use; None: all.
        strict: See :func:`compiled_lanes`.
        gpu: See :func:`compiled_lanes`.

    Raises:
        ConfigError: A GPU refuses the program.
    """

    def __init__(
        self, lane: Callable[..., Any], names: Sequence[str], cores: int | None, strict: bool, gpu: bool = False
    ) -> None:
        """Compile the lane, in the precision that is in use; the arguments are those of the class."""
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        index = jax.ShapeDtypeStruct((), jnp.uint32)
        with gpu_errors():
            self._lanes = compiled_lanes(lane, dict.fromkeys(names, number), index, strict=strict, gpu=gpu)
        self._threads = min(cores or machine.usable_cores(), machine.usable_cores())

    def start(self, values: dict[str, np.ndarray], index: np.ndarray) -> Callable[[], tuple[Any, float]]:
        """Start a batch; see :data:`dssc_jax.engine.kernels.Start`.

        Args:
            values: Numbers of each lane by name, shape (n,).
            index: Draw index of each lane, shape (n,).

        Raises:
            ConfigError: A GPU refuses the batch, such as for want of memory. The returned function may raise it, too.
        """
        with gpu_errors():
            finish = self._lanes.start_timed((values, index), len(index), self._threads)

        def finish_batch() -> tuple[Any, float]:
            """Wait for the batch, and return its results and the time at which it ended."""
            with gpu_errors():
                return finish()

        return finish_batch


@contextmanager
def gpu_errors() -> Iterator[None]:
    """A context in which an error of the GPU's driver becomes a ConfigError."""
    try:
        yield
    except GpuError as problem:
        raise ConfigError("kernel", str(problem)) from None
