"""Worst change of the laws within a size, by importance weights of the existing draws.

The failure probability under a changed law is the sum of the weights of the failing draws, divided by the number of all
draws. Its logarithm has a gradient in closed form, and a search from several starts finds its largest value over the
changes within a size. If the failing draws form a convex set, it is concave in a shift and has a single maximum.

**What the limits claim.** For a change that is fixed in advance, the upper limit U of the weighted mean is above the
true probability with its confidence. The worst change is such a change, although it is unknown. The largest U over all
changes is at least U there, so it bounds the worst probability with the same confidence. The lower limit of the best
change follows in the same way. In place of the largest U, the code takes U where the weighted probability is largest;
the two nearly agree.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import optimize

from dssc_jax.core.bisection import bisect
from dssc_jax.statistics.law_changes import Change
from dssc_jax.statistics.weighted import effective_size, weighted_interval

LEAST_EFFECTIVE = 100.0
"""Least effective number of draws of the changed law, among all weighted draws."""

LEAST_FAILING = 20.0
"""Least effective number of failing draws of the changed law."""

STARTS = 5  # corners towards failing draws from which the search for the worst change starts
HALVINGS = 24  # halvings of a size: seven digits
LARGEST_SIZE = 8.0  # largest size tried: no realistic number of draws has useful weights beyond it


@dataclass(frozen=True)
class WeightedChange:
    """Failure probability under a change of the laws, estimated from the weighted draws.

    Args:
        amounts: Amount of the change of each number, shape (numbers,).
        probability: Failure probability under the changed laws.
        interval: Interval of the failure probability.
        effective: Effective number of draws of the changed law, from the exact law of the weights.
        failing: Effective number of failing draws of the changed law, from their weights.
    """

    amounts: np.ndarray
    probability: float
    interval: tuple[float, float]
    effective: float
    failing: float


@dataclass(frozen=True)
class WeightedDraws:
    """Draws with weights, which estimate the failure probability under changed laws.

    Args:
        change: Family of the changes, such as shifts.
        scores: Standard normal scores of each draw, shape (n, numbers).
        failed: Whether each draw failed, shape (n,).
        free: Which numbers change, bool of shape (numbers,).
        confidence: Confidence of the intervals.
    """

    change: Change
    scores: np.ndarray
    failed: np.ndarray
    free: np.ndarray
    confidence: float

    def at(self, amounts: np.ndarray) -> WeightedChange:
        """Failure probability under the change with these amounts, shape (numbers,)."""
        draws = len(self.scores)
        weights = np.exp(self.change.log_weights(amounts, self.scores))
        failing_weights = weights[self.failed]
        return WeightedChange(
            amounts=amounts,
            probability=min(1.0, float(failing_weights.sum()) / draws),
            interval=weighted_interval(failing_weights, draws, float(weights.max()), self.confidence),
            effective=float(draws * np.exp(-self.change.log_second_moment(amounts))),
            failing=effective_size(failing_weights),
        )

    def is_trusted(self, size: float) -> bool:
        """Whether the weights of every change within this size are even enough for an estimate.

        Under every such change, the effective number of draws must be at least :data:`LEAST_EFFECTIVE`. Under the
        change with the most failures, the effective number of failing draws must be at least :data:`LEAST_FAILING`.
        """
        effective = len(self.scores) * np.exp(-self.change.log_second_moment_bound(size, self.free))
        return bool(effective >= LEAST_EFFECTIVE) and self.worst(size).failing >= LEAST_FAILING

    def worst(self, size: float) -> WeightedChange:
        """The change within this size with the largest weighted failure probability."""
        return self.at(self.extreme(size, sign=1.0))

    def best(self, size: float) -> WeightedChange:
        """The change within this size with the smallest weighted failure probability."""
        return self.at(self.extreme(size, sign=-1.0))

    def interval_within(self, size: float) -> tuple[float, float] | None:
        """Interval of the failure probability over all changes within this size; None if the weights are too uneven."""
        if not self.is_trusted(size):
            return None
        return self.best(size).interval[0], self.worst(size).interval[1]

    def extreme(self, size: float, sign: float) -> np.ndarray:
        """Amounts within a size that make the weighted failure probability extreme, shape (numbers,).

        Args:
            size: Largest size of the change.
            sign: 1 for the largest probability, -1 for the smallest.

        Returns:
            The amounts; 0 for numbers that do not change.
        """
        unmoved = np.zeros(self.scores.shape[1])
        failing = self.scores[self.failed]
        if size == 0.0 or not len(failing):
            return unmoved
        low, high = self.change.limits(size)
        bounds = [(low, high) if is_free else (0.0, 0.0) for is_free in self.free]

        def cost(amounts: np.ndarray) -> tuple[float, np.ndarray]:
            """The function to minimise and its slope: -``sign`` times the log sum of the failing draws' weights."""
            logarithms = self.change.log_weights(amounts, failing)
            largest = logarithms.max()  # keeps the exponential finite
            weights = np.exp(logarithms - largest)
            log_sum = float(largest + np.log(weights.sum()))
            slope = self.change.mean_slope(amounts, failing, weights / weights.sum())
            return -sign * log_sum, -sign * slope * self.free

        minima = []
        for start in self._starts(failing, sign, low, high):
            minima.append(optimize.minimize(cost, start * self.free, jac=True, bounds=bounds, method="L-BFGS-B"))
        best = min(minima, key=lambda result: result.fun)
        return np.asarray(best.x)

    def _starts(self, failing: np.ndarray, sign: float, low: float, high: float) -> list[np.ndarray]:
        """Starts of the search: no change, the corner along the signed gradient at no change, and further corners.

        A corner has the least or the greatest amount of every number. For the sign 1 the further corners lie towards
        the mean failing score and towards some failing draws, for -1 on the other side.

        Args:
            failing: Scores of the failing draws, shape (failures, numbers).
            sign: 1 for the largest probability, -1 for the smallest.
            low: Least amount of each number.
            high: Greatest amount of each number.

        Returns:
            Amounts of the change, shape (numbers,) each.
        """
        draw_indices = np.linspace(0, len(failing) - 1, STARTS - 1).astype(int)  # the mean is one of the STARTS
        directions = [failing.mean(axis=0), *failing[draw_indices]]
        corners = [np.where(sign * direction > 0.0, high, low) for direction in directions]
        unmoved = np.zeros(failing.shape[1])
        equal_weights = np.full(len(failing), 1.0 / len(failing))
        slope = sign * self.change.mean_slope(unmoved, failing, equal_weights)
        return [unmoved, np.where(slope > 0.0, high, low), *corners]


@dataclass(frozen=True)
class LargestChange:
    """Size of a change up to which the failure probability keeps a limit.

    Args:
        bound: Size up to which the upper limits of the intervals keep the limit, with their confidence; 0 if the
            interval without a change exceeds the limit already.
        estimate: Size up to which the estimated probabilities keep the limit; None if no trusted change exceeds the
            limit.
        explored: Largest size at which the weights are trusted; 0 if they are not trusted even without a change.
        worst: Worst change of the size ``estimate``, or of the size ``explored`` without an estimate.
    """

    bound: float
    estimate: float | None
    explored: float
    worst: WeightedChange

    @property
    def reason(self) -> str:
        """Why there is no estimate, in words; empty if there is one."""
        if self.estimate is not None:
            return ""
        if self.explored == 0.0:
            return f"{self.worst.failing:.0f} failed draws, {LEAST_FAILING:g} are needed"
        return (
            f"a larger change leaves fewer than {LEAST_EFFECTIVE:g} effective draws or {LEAST_FAILING:g} effective "
            "failures; more draws go further, and so do new draws of the changed laws"
        )


def largest_change(draws: WeightedDraws, limit: float) -> LargestChange:
    """Size of a change up to which the failure probability keeps a limit, by weighted draws.

    The estimate is cautious: the largest of many weighted probabilities is too large on average.

    Args:
        draws: Draws with the family of changes.
        limit: Largest failure probability allowed.
    """
    worst = lru_cache(draws.worst)
    if not draws.is_trusted(0.0):
        return LargestChange(bound=0.0, estimate=None, explored=0.0, worst=worst(0.0))

    def keeps_limit_surely(size: float) -> bool:
        """Whether the upper limit of the failure probability keeps the limit under every change of this size."""
        _, high = worst(size).interval
        return high <= limit

    explored = largest_size(draws.is_trusted, LARGEST_SIZE)
    bound = largest_size(keeps_limit_surely, explored)
    if worst(explored).probability <= limit:
        return LargestChange(bound, None, explored, worst(explored))
    estimate = largest_size(lambda size: worst(size).probability <= limit, explored)
    return LargestChange(bound, estimate, explored, worst(estimate))


def largest_size(condition: Callable[[float], bool], end: float) -> float:
    """Largest size from 0 to ``end`` that meets a condition, by bisection; 0 if no size meets it.

    Args:
        condition: Whether a size is allowed. If it allows a size, it must allow all smaller sizes, too.
        end: Largest size to try.
    """
    if not condition(0.0):
        return 0.0
    if condition(end):
        return end
    inside, _ = bisect(lambda size: condition(float(size)), inside=0.0, outside=end, halvings=HALVINGS)
    return float(inside)
