"""Bounds of the failure probability under changed laws, whatever set of draws fails."""

from dataclasses import dataclass

import numpy as np

from dssc_jax.statistics.normal_moves import (
    largest_distance,
    largest_width,
    worst_when_moved,
    worst_when_widened,
)


@dataclass(frozen=True)
class AnyFailures:
    """Bounds that need the interval of the failure probability, but no draws.

    Args:
        precision: The inverse of the scores' correlation matrix, shape (laws, laws).
        interval: Interval of the failure probability.
    """

    precision: np.ndarray
    interval: tuple[float, float]

    def distance(self, free: np.ndarray) -> float:
        """Largest Euclidean length, in independent scores, of a shift of these means by one standard deviation each.

        Exact without correlations, and an upper bound with them.
        """
        return float(np.sqrt(np.abs(self.precision[np.ix_(free, free)]).sum()))

    def uncorrelated(self, free: np.ndarray) -> bool:
        """Whether none of these laws is correlated with another."""
        return not np.any(self.precision[free] - np.diag(np.diag(self.precision))[free])

    def largest_shift(self, free: np.ndarray, limit: float) -> float:
        """The shift of these means up to which at most the limit fails."""
        return largest_distance(self.interval[1], limit) / self.distance(free)

    def largest_widening(self, free: np.ndarray, limit: float) -> float | None:
        """The relative width of these laws up to which at most the limit fails; None if the laws are correlated."""
        return largest_width(self.interval[1], limit, int(free.sum())) if self.uncorrelated(free) else None

    def shifted(self, free: np.ndarray, shift: float) -> tuple[float, float]:
        """The interval of the failure probability if these means may be wrong by a shift."""
        distance = shift * self.distance(free)
        low, high = self.interval
        return worst_when_moved(low, -distance), worst_when_moved(high, distance)

    def widened(self, free: np.ndarray, width: float) -> tuple[float, float] | None:
        """The interval of the failure probability up to this relative width of these laws; None if correlated."""
        if not self.uncorrelated(free):
            return None
        low, high = self.interval
        numbers = int(free.sum())
        return 1.0 - worst_when_widened(1.0 - low, width, numbers), worst_when_widened(high, width, numbers)
