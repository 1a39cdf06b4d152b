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
        draws: The draws with the weights that the changed laws give them.
        largest: The largest change for which the weighted draws keep the failure probability below its limit.
        guaranteed: The largest size that keeps the failure probability below its limit for every conceivable set of
            failing draws; 0 if there is none.
        limit_at: (size) -> upper limit of the failure probability for every conceivable set of failing draws.
    """

    draws: WeightedDraws
    largest: LargestChange
    guaranteed: float
    limit_at: Callable[[float], float]

    def curves(self) -> tuple[np.ndarray, np.ndarray]:
        """The worst failure probability over the size of the change.

        Returns:
            The sizes, shape (points,), and three columns for them, shape (points, 3): the worst failure probability by
            the weights, its upper limit (both NaN where the weights are not trusted), and :attr:`limit_at`.
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
