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
    """Bounds of the failure probability under changed laws, from the interval of the failure probability alone.

    The bounds hold for any set of failing draws, so the draws themselves are not needed. In each method ``free`` tells
    which laws change (bool, shape (laws,)). A shift moves each mean by at most a number of standard deviations, up or
    down. A widening multiplies each width by a factor from 1 to a relative width.

    Args:
        precision: Inverse of the scores' correlation matrix, shape (laws, laws).
        interval: Lower and upper limit of the failure probability under the assumed laws.
    """

    precision: np.ndarray
    interval: tuple[float, float]

    def unit_shift_length(self, free: np.ndarray) -> float:
        """Largest Euclidean length, in independent scores, of a shift by one standard deviation in every changed law.

        The squared length is s' P s, where s holds the signs of the shifts and P is the precision matrix. Its bound is
        the sum of |P_ij|, which is exact without correlations, and may be too large with them.

        Args:
            free: Whether the law of each number may change, shape (numbers,).
        """
        precision = self.precision[np.ix_(free, free)]
        return float(np.sqrt(np.abs(precision).sum()))

    def is_uncorrelated(self, free: np.ndarray) -> bool:
        """Whether no changed law is correlated with any other law."""
        off_diagonal = self.precision - np.diag(np.diag(self.precision))
        return not np.any(off_diagonal[free])

    def largest_shift(self, free: np.ndarray, limit: float) -> float:
        """Largest shift [standard deviations] under which the failure probability cannot exceed the limit.

        Args:
            free: Whether the law of each number may change, shape (laws,).
            limit: Largest failure probability allowed, in (0, 1).
        """
        _, high = self.interval
        return largest_distance(high, limit) / self.unit_shift_length(free)

    def largest_widening(self, free: np.ndarray, limit: float) -> float | None:
        """Largest relative width at which the failure probability cannot exceed the limit.

        Args:
            free: Whether the law of each number may change, shape (laws,).
            limit: Largest failure probability allowed, in (0, 1).

        Returns:
            The width; None if a changed law is correlated with another one, because there is no such bound then.
        """
        if not self.is_uncorrelated(free):
            return None
        _, high = self.interval
        return largest_width(high, limit, int(free.sum()))

    def interval_after_shift(self, free: np.ndarray, shift: float) -> tuple[float, float]:
        """Interval of the failure probability after any shift up to a size.

        Args:
            free: Whether the law of each number may change, shape (laws,).
            shift: Largest shift of a mean [standard deviations].
        """
        distance = shift * self.unit_shift_length(free)
        low, high = self.interval
        return worst_when_moved(low, -distance), worst_when_moved(high, distance)

    def interval_after_widening(self, free: np.ndarray, width: float) -> tuple[float, float] | None:
        """Interval of the failure probability after any widening up to a relative width.

        Args:
            free: Whether the law of each number may change, shape (laws,).
            width: Largest relative width, >= 1.

        Returns:
            The interval; None if a changed law is correlated with another one, because there is no such bound then.
        """
        if not self.is_uncorrelated(free):
            return None
        low, high = self.interval
        numbers = int(free.sum())
        most_passes = worst_when_widened(1.0 - low, width, numbers)
        return 1.0 - most_passes, worst_when_widened(high, width, numbers)
