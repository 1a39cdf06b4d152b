"""Times and counts of an engine."""

from collections.abc import Callable
from dataclasses import dataclass, field

import jax

from dssc_jax.core.signals import Scalar


@dataclass
class Clock:
    """Times and counts of an engine.

    Args:
        compile_seconds: Time of compilations [s].
        margin_seconds: Time in which margins of the linearised loop were computed [s].
        run_seconds: Time in which batches ran [s].
        lanes: Number of lanes done.
        traces: Number of traces of the lane's program; 0 if its machine code is in the cache.
    """

    compile_seconds: float = 0.0
    margin_seconds: float = 0.0
    run_seconds: float = 0.0
    lanes: int = 0
    traces: int = 0


@dataclass
class CountedLane:
    """The program of a lane that counts how often JAX traces it.

    Args:
        lane: The program.
        clock: The clock that counts.
    """

    lane: Callable[[dict[str, jax.Array], jax.Array], dict[str, Scalar]]
    clock: Clock = field(compare=False)

    def __call__(self, values: dict[str, jax.Array], index: jax.Array) -> dict[str, Scalar]:
        """The results of the lane; JAX calls this once for each trace."""
        self.clock.traces += 1
        return self.lane(values, index)
