"""The interval of the failure probability if the laws are wrong by a stated amount."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from dssc_jax.analyses.laws.any_failures import AnyFailures
from dssc_jax.analyses.laws.worst_changes import WeightedDraws
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import Quantity
from dssc_jax.statistics.divergence_balls import BALLS


@dataclass(frozen=True)
class StatedError:
    """An amount by which the laws may be wrong, and what follows for the failure probability."""

    kind: Annotated[str, Quantity("", "total_variation, kl, chi_square, mean_shift or widening")]
    amount: Annotated[float, Quantity("that of the kind", "how wrong the laws may be")]
    interval: Annotated[
        tuple[float, float] | None,
        Quantity("1", "interval of the failure probability, whatever draws fail; None: laws are correlated"),
    ]
    weighted_interval: Annotated[
        tuple[float, float] | None,
        Quantity("1", "the same from the draws' weights; None: they say nothing, or are not needed"),
    ]


@dataclass(frozen=True)
class StatedAmounts:
    """Amounts by which the laws may be wrong.

    Args:
        within: Radii by the names of :data:`dssc_jax.statistics.divergence_balls.BALLS`.
        shift: Of all means [standard deviations].
        widening: Relative width of all laws.

    Raises:
        ConfigError: An amount is out of range.
    """

    within: Mapping[str, float]
    shift: float | None
    widening: float | None

    def __post_init__(self) -> None:
        for name, radius in self.within.items():
            if name not in BALLS:
                raise ConfigError("within", f"'{name}' is no divergence; {nearest(name, BALLS)}")
            if not 0.0 <= radius < math.inf:
                raise ConfigError("within", f"the radius of {name} must be finite and 0 or more, got {radius:g}")
        if self.shift is not None and not 0.0 <= self.shift < math.inf:
            raise ConfigError("shift", f"must be finite and 0 or more, got {self.shift:g}")
        if self.widening is not None and not 1.0 <= self.widening < math.inf:
            raise ConfigError("widening", f"must be finite and 1 or more, got {self.widening:g}")

    def errors(self, shifts: WeightedDraws, widenings: WeightedDraws, bounds: AnyFailures) -> list[StatedError]:
        """What follows from each amount.

        Args:
            shifts: The draws, weighted for shifts.
            widenings: The draws, weighted for widenings.
            bounds: What holds whatever draws fail.
        """
        free = shifts.free
        found = []
        for name, radius in self.within.items():
            found.append(StatedError(name, radius, BALLS[name].interval(bounds.interval, radius), None))
        if self.shift is not None:
            weighted = weighted_interval(shifts, self.shift)
            found.append(StatedError("mean_shift", self.shift, bounds.shifted(free, self.shift), weighted))
        if self.widening is not None:
            weighted = weighted_interval(widenings, float(np.log(self.widening)))
            found.append(StatedError("widening", self.widening, bounds.widened(free, self.widening), weighted))
        return found


def weighted_interval(draws: WeightedDraws, size: float) -> tuple[float, float] | None:
    """From the lower limit of the best change to the upper limit of the worst; None if the weights say nothing."""
    if not draws.trusted(size):
        return None
    return draws.best(size).interval[0], draws.worst(size).interval[1]
