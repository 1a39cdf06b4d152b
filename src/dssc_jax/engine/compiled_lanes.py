"""Machine code of lanes whose signature is known from the user's cache, so that a known lane is not even traced."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.trace_memory.memory import remembered
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.llvm import machine


def compiled_lanes(
    lane: Callable[..., Any], *arguments: Any, width: int | None = None, strict: bool = False
) -> CompiledLanes:
    """The program of a lane as machine code; arguments and errors as for :class:`CompiledLanes`."""

    def recall(compute: Callable[[], Any]) -> Any:
        return remembered("signature", compute, lane, arguments, width, strict, machine.translator())

    return CompiledLanes(lane, *arguments, width=width, strict=strict, recall=recall)


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
        self._lanes = compiled_lanes(lane, dict.fromkeys(names, number), index, strict=strict)
        self._threads = min(cores or machine.usable_cores(), machine.usable_cores())

    def start(self, values: dict[str, np.ndarray], index: np.ndarray) -> Callable[[], tuple[Any, float]]:
        """Begin to run a batch; see :data:`dssc_jax.engine.kernels.Start`."""
        return self._lanes.start_timed((values, index), len(index), self._threads)
