"""Machine code of lanes whose signature is known from the user's cache, so that a known lane is not even traced."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.trace_memory.memory import remembered
from dssc_jax.lanes.gpu import ptx
from dssc_jax.lanes.gpu.driver import GpuError
from dssc_jax.lanes.gpu.kernel_lanes import KernelLanes
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.llvm import machine


def compiled_lanes(
    lane: Callable[..., Any], *arguments: Any, width: int | None = None, strict: bool = False, gpu: bool = False
) -> CompiledLanes:
    """The program of a lane as machine code; arguments and errors as for :class:`CompiledLanes`.

    ``gpu`` makes a kernel of it, see :class:`KernelLanes`.
    """
    lanes = KernelLanes if gpu else CompiledLanes
    translator = ptx.translator() if gpu else machine.translator()

    def recall(compute: Callable[[], Any]) -> Any:
        return remembered("signature", compute, lane, arguments, width, strict, translator)

    return lanes(lane, *arguments, width=width, strict=strict, recall=recall)


class LaneBatch:
    """A lane's program as machine code, for batches of its numbers by name.

    Args:
        lane: (numbers by name, draw index) -> results.
        names: Names of the numbers.
        cores: Cores to use; None: all.
        strict: See :class:`CompiledLanes`.
        gpu: See :func:`compiled_lanes`.

    Raises:
        ConfigError: A GPU refuses the program.
    """

    def __init__(
        self, lane: Callable[..., Any], names: Sequence[str], cores: int | None, strict: bool, gpu: bool = False
    ) -> None:
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        index = jax.ShapeDtypeStruct((), jnp.uint32)
        with gpu_errors():
            self._lanes = compiled_lanes(lane, dict.fromkeys(names, number), index, strict=strict, gpu=gpu)
        self._threads = min(cores or machine.usable_cores(), machine.usable_cores())

    def start(self, values: dict[str, np.ndarray], index: np.ndarray) -> Callable[[], tuple[Any, float]]:
        """Begin to run a batch; see :data:`dssc_jax.engine.kernels.Start`.

        Raises:
            ConfigError: A GPU refuses the batch, such as for want of memory; the returned function raises it, too.
        """
        with gpu_errors():
            finish = self._lanes.start_timed((values, index), len(index), self._threads)

        def finished() -> tuple[Any, float]:
            with gpu_errors():
                return finish()

        return finished


@contextmanager
def gpu_errors() -> Iterator[None]:
    """Turn what a GPU's driver refuses into an error for the user."""
    try:
        yield
    except GpuError as problem:
        raise ConfigError("kernel", str(problem)) from None
