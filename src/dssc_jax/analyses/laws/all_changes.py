"""The worst failure probability under a change of all laws at once, over the size of the change."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dssc_jax.statistics.worst_changes import LargestChange, WeightedDraws

POINTS = 25  # evenly spaced sizes of a curve
BEYOND = 1.5  # ratio of the largest size of a curve to the guaranteed size


@dataclass(frozen=True)
class AllChanges:
    """One kind of change of all laws at once: a shift of all means, or a widening of all laws, of any size.

    Args:
        draws: The draws, weighted by the changed laws.
        largest: The largest change at which the weights keep the failure probability below its limit.
        guaranteed: The largest size that keeps the limit whatever set of draws fails; 0 if there is none.
        limit_at: (size) -> upper limit of the failure probability whatever set of draws fails.
    """

    draws: WeightedDraws
    largest: LargestChange
    guaranteed: float
    limit_at: Callable[[float], float]

    def curves(self) -> tuple[np.ndarray, np.ndarray]:
        """The worst failure probability over the size of the change.

        Returns:
            Sizes, shape (points,), and for each size three columns, shape (points, 3): the worst failure probability by
            the weights and its upper limit, NaN where the weights are not trusted, and the limit whatever draws fail.
        """
        explored = self.largest.explored
        end = max(explored, BEYOND * self.guaranteed, np.finfo(float).eps)
        sizes = np.union1d(np.linspace(0.0, end, POINTS), [explored])
        rows = []
        for size in sizes:
            probability = np.nan
            upper_limit = np.nan
            if explored > 0.0 and size <= explored:
                worst = self.draws.worst(float(size))
                probability = worst.probability
                upper_limit = worst.interval[1]
            rows.append((probability, upper_limit, self.limit_at(float(size))))
        return sizes, np.array(rows)
