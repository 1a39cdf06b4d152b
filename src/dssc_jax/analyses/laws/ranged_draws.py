"""Draws that answer for every law of a probability box: a mixture of its laws, weighted by their densities.

The draws of each number come from the mixture, in equal parts, of the laws at the corners of its box and in its middle.
A law of the box has a bounded density relative to it: the corners have the widest support and the heaviest tails.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy import optimize, special

from dssc_jax.statistics.weighted import effective_size, weighted_interval
from dssc_jax.statistics.worst_changes import LEAST_EFFECTIVE
from dssc_jax.study.laws import LAWS, Law, RangedLaw

MOST_CORNERS = 256  # corners of the whole box that are tried
EVALUATIONS = 100  # evaluations in the search by DIRECT, for each range
TIE = 1e-3  # share of the estimate in what the smallest lower limit minimises, which may be 0 in many places


@dataclass(frozen=True)
class WeightedLaws:
    """Laws of a box, with the failure probability that the weighted draws give for them.

    Args:
        laws: By number.
        probability: Failure probability.
        interval: Its interval.
        effective: How many draws of these laws the draws are worth (Kish).
    """

    laws: dict[str, Law]
    probability: float
    interval: tuple[float, float]
    effective: float


def components(law: RangedLaw) -> list[Law]:
    """The laws of a number's mixture: those at the corners of its box, and that in its middle."""
    return [*law.corners, law.middle]


def mixture_values(law: RangedLaw, levels: np.ndarray) -> np.ndarray:
    """Values of the mixture from uniform levels: the first of B equal parts of them gives the first law, and so on."""
    laws = components(law)
    positions = levels * len(laws)
    component_indices = np.minimum(positions.astype(int), len(laws) - 1)
    tiny = np.finfo(float).eps
    component_levels = np.clip(positions - component_indices, tiny, 1.0 - tiny)
    return np.choose(component_indices, [component.quantile(component_levels) for component in laws])


def log_mixture(law: RangedLaw, values: np.ndarray) -> np.ndarray:
    """Logarithm of the mixture's density."""
    laws = components(law)
    return special.logsumexp([log_density(component, values) for component in laws], axis=0) - np.log(len(laws))


def log_density(law: Law, values: np.ndarray) -> np.ndarray:
    """Logarithm of a law's density at values, shape (n,)."""
    density = LAWS[law.kind].log_density
    assert density is not None  # a law without one has no ranges
    return density(law.arguments, values)


@dataclass(frozen=True)
class RangedDraws:
    """Draws of the mixtures of all numbers whose laws have ranges for arguments.

    Args:
        laws: Law of each of these numbers.
        values: Value of each of these numbers in each draw, shape (n,) each.
        failed: Whether each draw failed, shape (n,).
        confidence: Confidence of the intervals.
    """

    laws: Mapping[str, RangedLaw]
    values: Mapping[str, np.ndarray]
    failed: np.ndarray
    confidence: float

    @cached_property
    def log_proposal(self) -> np.ndarray:
        """Logarithm of the density of the draws, shape (n,)."""
        return np.sum([log_mixture(law, self.values[name]) for name, law in self.laws.items()], axis=0)

    @cached_property
    def bounds(self) -> list[tuple[float, float]]:
        """The ranges that are searched: those whose ends differ, number by number."""
        return [pair for law in self.laws.values() for pair in law.ranges if pair[0] < pair[1]]

    def laws_at(self, point: np.ndarray) -> dict[str, Law]:
        """The laws at a point of the box, which has a coordinate for each of :attr:`bounds`."""
        coordinates = iter(point.tolist())
        laws = {}
        for name, law in self.laws.items():
            arguments = tuple(low if low == high else next(coordinates) for low, high in law.ranges)
            laws[name] = Law(law.kind, arguments)
        return laws

    def log_weights(self, laws: Mapping[str, Law]) -> np.ndarray:
        """Logarithm of the draws' density by laws of the box, relative to that by which they were drawn, shape (n,)."""
        return np.sum([log_density(law, self.values[name]) for name, law in laws.items()], axis=0) - self.log_proposal

    def estimate(self, laws: dict[str, Law]) -> WeightedLaws:
        """The failure probability under laws of the box, estimated with weighted draws, and its interval."""
        weights = np.exp(self.log_weights(laws))
        failing = weights[self.failed]
        draws = len(weights)
        interval = weighted_interval(failing, draws, float(weights.max()), self.confidence)
        probability = min(1.0, float(failing.sum()) / draws)
        return WeightedLaws(laws, probability, interval, effective_size(weights))

    @cached_property
    def corners(self) -> np.ndarray:
        """The corners of the box, or some of them if there are very many, and its middle; shape (points, ranges)."""
        middle = np.mean(self.bounds, axis=1)
        if 2 ** len(self.bounds) <= MOST_CORNERS:
            return np.array([*product(*self.bounds), middle])
        end_indices = np.random.default_rng(0).integers(0, 2, (MOST_CORNERS, len(self.bounds)))
        return np.array(
            [*np.take_along_axis(np.array(self.bounds)[None], end_indices[..., None], axis=2)[..., 0], middle]
        )

    @cached_property
    def least_effective(self) -> float:
        """The smallest effective number of draws over the corners of the box and its middle."""
        sizes = [effective_size(np.exp(self.log_weights(self.laws_at(point)))) for point in self.corners]
        return min(sizes)

    @property
    def trusted(self) -> bool:
        """Whether the weights are even enough to answer for the box."""
        return self.least_effective >= LEAST_EFFECTIVE

    def highest(self) -> WeightedLaws:
        """The laws of the box with the largest upper limit of the failure probability."""

        def cost(laws: dict[str, Law]) -> float:
            return -self.estimate(laws).interval[1]

        return self.estimate(self.laws_at(self._search(cost)))

    def lowest(self) -> WeightedLaws:
        """The laws of the box with the smallest lower limit of the failure probability."""

        def cost(laws: dict[str, Law]) -> float:
            estimate = self.estimate(laws)
            return estimate.interval[0] + TIE * estimate.probability

        return self.estimate(self.laws_at(self._search(cost)))

    def _search(self, cost: Callable[[dict[str, Law]], float]) -> np.ndarray:
        """The point of the box with the lowest cost: by its corners, DIRECT, and downhill from the best of them."""

        def at_point(point: np.ndarray) -> float:
            return cost(self.laws_at(point))

        candidates = list(self.corners)
        candidates.append(optimize.direct(at_point, self.bounds, maxfun=EVALUATIONS * len(self.bounds)).x)
        best = min(candidates, key=at_point)
        scale = np.ptp(self.bounds, axis=1)
        low = np.array(self.bounds)[:, 0]
        descent = optimize.minimize(
            lambda share: at_point(low + scale * np.clip(share, 0.0, 1.0)),
            (best - low) / scale,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * len(low),
        )
        point = low + scale * np.clip(descent.x, 0.0, 1.0)
        return min((best, point), key=at_point)
