"""A kind of change of all laws: what the weights say, what is guaranteed, and the curves over its size."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dssc_jax.statistics.worst_changes import LargestChange, WeightedDraws

POINTS = 25  # sizes of a curve
BEYOND = 1.5  # how far a curve goes beyond what is guaranteed


@dataclass(frozen=True)
class AllChanges:
    """A kind of change of all laws.

    Args:
        draws: The weighted draws.
        largest: The largest change by the weights.
        guaranteed: The largest size whatever draws fail; 0 if nothing is guaranteed.
        limit_at: Size -> upper limit of the failure probability whatever draws fail.
    """

    draws: WeightedDraws
    largest: LargestChange
    guaranteed: float
    limit_at: Callable[[float], float]

    def curves(self) -> tuple[np.ndarray, np.ndarray]:
        """Sizes, shape (points,), and at each size the probability, its limit, and the guaranteed limit; (points, 3).

        NaN where the weights are not trusted.
        """
        end = max(self.largest.explored, BEYOND * self.guaranteed, np.finfo(float).eps)
        sizes = np.union1d(np.linspace(0.0, end, POINTS), [self.largest.explored])
        rows = []
        for size in sizes:
            weighted_estimate = (np.nan, np.nan)
            if size <= self.largest.explored and self.largest.explored > 0.0:
                worst = self.draws.worst(float(size))
                weighted_estimate = (worst.probability, worst.interval[1])
            rows.append((*weighted_estimate, self.limit_at(float(size))))
        return sizes, np.array(rows)
