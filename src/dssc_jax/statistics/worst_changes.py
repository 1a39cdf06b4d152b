"""The worst change of the laws of a given size, by importance weights of the existing draws.

The failure probability under a changed law is the mean over the draws of the weights of those that fail. Its logarithm
has a gradient in closed form, and its largest value over the changes of a size is sought from several starts. Where the
draws that fail form a convex set, it is concave in a shift and has one maximum only.

**What the limits claim.** For one change that is fixed in advance, the upper limit U of the weighted mean is above the
true probability with its confidence. The worst change is such a change, although it is unknown. The largest U over all
changes is not below U there, hence it bounds the worst probability with the same confidence. The lower limit of the
best change follows in the same way. It is taken where the weighted probability is largest, and U nearly so.
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
"""Fewest draws of the changed law that the weighted draws have to be worth."""

LEAST_FAILING = 20.0
"""Fewest failing draws of the changed law that the weighted failing draws have to be worth."""

STARTS = 5  # corners from which the worst change is sought, besides no change
HALVINGS = 24  # halvings of a size: seven digits
LARGEST_SIZE = 8.0  # beyond, weights of no number of draws say anything


@dataclass(frozen=True)
class WeightedChange:
    """A change, with the failure probability that the weighted draws give for it.

    Args:
        amounts: Amount of the change of each number, shape (numbers,).
        probability: Failure probability.
        interval: Its interval.
        effective: How many draws of the changed law the draws are worth, from the exact law of the weights.
        failing: How many draws of the changed law the failing draws alone are worth, from their weights.
    """

    amounts: np.ndarray
    probability: float
    interval: tuple[float, float]
    effective: float
    failing: float


@dataclass(frozen=True)
class WeightedDraws:
    """Draws whose weights answer for changed laws.

    Args:
        change: The family of changes.
        scores: Scores of each draw, shape (n, numbers).
        failed: Whether each draw failed, shape (n,).
        free: Which numbers are changed, shape (numbers,).
        confidence: Confidence of the intervals.
    """

    change: Change
    scores: np.ndarray
    failed: np.ndarray
    free: np.ndarray
    confidence: float

    def at(self, amounts: np.ndarray) -> WeightedChange:
        """The failure probability under a change, as the weights of the draws give it."""
        draws = len(self.scores)
        weights = np.exp(self.change.log_weights(amounts, self.scores))
        failing = weights[self.failed]
        interval = weighted_interval(failing, draws, float(weights.max()), self.confidence)
        effective = draws * np.exp(-self.change.log_second_moment(amounts))
        probability = min(1.0, float(failing.sum()) / draws)
        return WeightedChange(amounts, probability, interval, float(effective), effective_size(failing))

    def trusted(self, size: float) -> bool:
        """Whether the weights of every change of at most this size are even enough to say anything.

        The draws must be worth :data:`LEAST_EFFECTIVE` draws of every such law, and the failing draws
        :data:`LEAST_FAILING` of the law with the most failures.
        """
        effective = len(self.scores) * np.exp(-self.change.corner(size, self.free))
        return bool(effective >= LEAST_EFFECTIVE) and self.worst(size).failing >= LEAST_FAILING

    def worst(self, size: float) -> WeightedChange:
        """The change of at most this size with the largest weighted failure probability."""
        return self.at(self.extreme(size, 1.0))

    def best(self, size: float) -> WeightedChange:
        """The change of at most this size with the smallest weighted failure probability."""
        return self.at(self.extreme(size, -1.0))

    def interval_within(self, size: float) -> tuple[float, float] | None:
        """From the lower limit of the best change to the upper limit of the worst; None if the weights say nothing."""
        if not self.trusted(size):
            return None
        return self.best(size).interval[0], self.worst(size).interval[1]

    def extreme(self, size: float, sign: float) -> np.ndarray:
        """The amounts that make the failure probability largest (sign 1) or smallest (sign -1) within a size."""
        unmoved = np.zeros(self.scores.shape[1])
        failing = self.scores[self.failed]
        if size == 0.0 or not len(failing):
            return unmoved
        low, high = self.change.limits(size)
        limits = [(low, high) if free else (0.0, 0.0) for free in self.free]

        def cost(amounts: np.ndarray) -> tuple[float, np.ndarray]:
            logarithms = self.change.log_weights(amounts, failing)
            largest = logarithms.max()
            weights = np.exp(logarithms - largest)
            value = float(largest + np.log(weights.sum()))
            slope = self.change.mean_slope(amounts, failing, weights / weights.sum())
            return -sign * value, -sign * slope * self.free

        minima = []
        for start in self._starts(failing, sign, low, high):
            minima.append(optimize.minimize(cost, start * self.free, jac=True, bounds=limits, method="L-BFGS-B"))
        return np.asarray(min(minima, key=lambda result: result.fun).x)

    def _starts(self, failing: np.ndarray, sign: float, low: float, high: float) -> list[np.ndarray]:
        """No change, and corners: towards the mean of the failing draws, and towards some of them."""
        towards = [failing.mean(axis=0), *failing[np.linspace(0, len(failing) - 1, STARTS - 1).astype(int)]]
        corners = [np.where(sign * direction > 0.0, high, low) for direction in towards]
        unmoved = np.zeros(failing.shape[1])
        slope = sign * self.change.mean_slope(unmoved, failing, np.full(len(failing), 1.0 / len(failing)))
        return [unmoved, np.where(slope > 0.0, high, low), *corners]


@dataclass(frozen=True)
class LargestChange:
    """How large a change may be before the failure probability exceeds a limit.

    Args:
        bound: With the confidence of the intervals; 0 if not even the unchanged law is known to keep the limit.
        estimate: Without the draws' own uncertainty; None if the weights do not reach the limit.
        explored: The largest size at which the weights are trusted; 0 if they are not even without a change.
        worst: The worst change at the estimate, or at the largest size explored.
    """

    bound: float
    estimate: float | None
    explored: float
    worst: WeightedChange

    @property
    def reason(self) -> str:
        """Why the weights do not tell more; empty if they reach the limit."""
        if self.estimate is not None:
            return ""
        if self.explored == 0.0:
            return f"{self.worst.failing:.0f} failed draws, {LEAST_FAILING:g} are needed"
        return (
            f"a larger change leaves fewer than {LEAST_EFFECTIVE:g} effective draws or {LEAST_FAILING:g} effective "
            "failures; more draws go further, and so do new draws of the changed laws"
        )


def largest_change(draws: WeightedDraws, limit: float) -> LargestChange:
    """How large a change may be, by the weights.

    The estimate is cautious: the largest of many weighted probabilities is too large on average.

    Args:
        draws: The draws.
        limit: Largest failure probability allowed.
    """
    worst = lru_cache(draws.worst)
    if not draws.trusted(0.0):
        return LargestChange(0.0, None, 0.0, worst(0.0))
    explored = largest(draws.trusted, LARGEST_SIZE)
    bound = largest(lambda size: worst(size).interval[1] <= limit, explored)
    estimate = None
    if worst(explored).probability > limit:
        estimate = largest(lambda size: worst(size).probability <= limit, explored)
    return LargestChange(bound, estimate, explored, worst(explored if estimate is None else estimate))


def largest(holds: Callable[[float], bool], end: float) -> float:
    """The largest size up to which a condition holds; 0 if it never holds."""
    if not holds(0.0):
        return 0.0
    if holds(end):
        return end
    inside, _ = bisect(lambda size: holds(float(size)), 0.0, end, HALVINGS)
    return float(inside)
