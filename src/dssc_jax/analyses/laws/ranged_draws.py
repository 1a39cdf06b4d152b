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
TIE = 1e-3  # weight of the estimate beside the lower limit, which may be 0 in many places


@dataclass(frozen=True)
class WeightedLaws:
    """One law of the box for each number, with the failure probability under these laws by the weighted draws.

    Args:
        laws: The law of each number, by name.
        probability: Failure probability under these laws.
        interval: Interval of the failure probability.
        effective: Number of plain draws from these laws that are worth as much as the weighted draws (Kish).
    """

    laws: dict[str, Law]
    probability: float
    interval: tuple[float, float]
    effective: float


def mixture_laws(law: RangedLaw) -> list[Law]:
    """The laws of a number's mixture: the laws at the corners of its box of arguments, and the law in the middle."""
    return [*law.corners, law.middle]


def mixture_values(law: RangedLaw, levels: np.ndarray) -> np.ndarray:
    """Convert uniform levels to values of a number's mixture, shape (n,).

    The interval from 0 to 1 is divided into as many equal parts as the mixture has laws. The part that contains a level
    selects the law. The position of the level within the part, scaled to (0, 1), is the quantile level of that law.

    Args:
        law: The law with ranges.
        levels: Uniform levels, shape (n,).
    """
    laws = mixture_laws(law)
    positions = levels * len(laws)
    parts = np.minimum(positions.astype(int), len(laws) - 1)
    tiny = np.finfo(float).eps
    levels_in_parts = np.clip(positions - parts, tiny, 1.0 - tiny)
    return np.choose(parts, [component.quantile(levels_in_parts) for component in laws])


def log_mixture(law: RangedLaw, values: np.ndarray) -> np.ndarray:
    """Natural logarithm of the density of a number's mixture at values, shape (n,) both."""
    laws = mixture_laws(law)
    log_densities = [log_density(component, values) for component in laws]
    return special.logsumexp(log_densities, axis=0) - np.log(len(laws))


def log_density(law: Law, values: np.ndarray) -> np.ndarray:
    """Natural logarithm of a law's density at values, shape (n,) both."""
    density = LAWS[law.kind].log_density
    assert density is not None  # a kind of law without a density does not accept ranges
    return density(values, *law.arguments)


@dataclass(frozen=True)
class RangedDraws:
    """Draws from the mixtures of all numbers whose laws have ranges; their weights answer for every law of the box.

    Under given laws of the box, a draw has the weight p/q: p is its density under these laws, and q its density under
    the mixtures.

    Args:
        laws: The law with ranges of each of these numbers, by name.
        values: Value of each of these numbers in each draw, by name, shape (n,) each.
        failed: Whether each draw failed, shape (n,).
        confidence: Confidence of the intervals.
    """

    laws: Mapping[str, RangedLaw]
    values: Mapping[str, np.ndarray]
    failed: np.ndarray
    confidence: float

    @cached_property
    def log_proposal(self) -> np.ndarray:
        """Logarithm of the density under the mixtures from which the draws came, shape (n,)."""
        return np.sum([log_mixture(law, self.values[name]) for name, law in self.laws.items()], axis=0)

    @cached_property
    def bounds(self) -> list[tuple[float, float]]:
        """The ranges that span the box, number by number; arguments without a range (equal ends) are left out."""
        ranges = []
        for law in self.laws.values():
            ranges += [(low, high) for low, high in law.ranges if low < high]
        return ranges

    def laws_at(self, point: np.ndarray) -> dict[str, Law]:
        """The law of each number at a point of the box.

        Args:
            point: Arguments of the laws, one for each of :attr:`bounds`, shape (ranges,).
        """
        coordinates = iter(point.tolist())
        laws = {}
        for name, law in self.laws.items():
            arguments = []
            for low, high in law.ranges:
                arguments.append(low if low == high else next(coordinates))
            laws[name] = Law(law.kind, tuple(arguments))
        return laws

    def log_weights(self, laws: Mapping[str, Law]) -> np.ndarray:
        """Natural logarithm of the weight that each draw has under laws of the box, shape (n,)."""
        log_densities = [log_density(law, self.values[name]) for name, law in laws.items()]
        return np.sum(log_densities, axis=0) - self.log_proposal

    def estimate(self, laws: dict[str, Law]) -> WeightedLaws:
        """Estimate the failure probability under laws of the box from the weighted draws."""
        weights = np.exp(self.log_weights(laws))
        failing_weights = weights[self.failed]
        draws = len(weights)
        interval = weighted_interval(failing_weights, draws, float(weights.max()), self.confidence)
        probability = min(1.0, float(failing_weights.sum()) / draws)
        return WeightedLaws(laws, probability, interval, effective_size(weights))

    @cached_property
    def corners(self) -> np.ndarray:
        """The corners of the box, or random ones if there are very many, and its middle; shape (points, ranges)."""
        ranges = len(self.bounds)
        middle = np.mean(self.bounds, axis=1)
        if 2**ranges <= MOST_CORNERS:
            return np.array([*product(*self.bounds), middle])
        low, high = np.array(self.bounds).T
        is_high = np.random.default_rng(0).integers(0, 2, (MOST_CORNERS, ranges)) == 1
        corners = np.where(is_high, high, low)
        return np.array([*corners, middle])

    @cached_property
    def least_effective(self) -> float:
        """The smallest effective number of draws over the corners of the box and its middle."""
        sizes = []
        for point in self.corners:
            weights = np.exp(self.log_weights(self.laws_at(point)))
            sizes.append(effective_size(weights))
        return min(sizes)

    @property
    def trusted(self) -> bool:
        """Whether the weights are even enough for every law of the box."""
        return self.least_effective >= LEAST_EFFECTIVE

    def highest(self) -> WeightedLaws:
        """Search for the laws of the box with the largest upper limit of the failure probability."""

        def minus_upper_limit(laws: dict[str, Law]) -> float:
            """The cost that the search minimises: minus the upper limit of the failure probability under some laws."""
            _, high = self.estimate(laws).interval
            return -high

        return self.estimate(self.laws_at(self._search(minus_upper_limit)))

    def lowest(self) -> WeightedLaws:
        """Search for the laws of the box with the smallest lower limit of the failure probability."""

        def lower_limit(laws: dict[str, Law]) -> float:
            """The cost that the search minimises: the lower limit of the failure probability under some laws.

            The estimate is added with a tiny weight, to decide between laws with the same lower limit, often 0.
            """
            estimate = self.estimate(laws)
            low, _ = estimate.interval
            return low + TIE * estimate.probability

        return self.estimate(self.laws_at(self._search(lower_limit)))

    def _search(self, cost: Callable[[dict[str, Law]], float]) -> np.ndarray:
        """Search the box for the point with the lowest cost, shape (ranges,).

        The starting point is the best among the corners and the point found by DIRECT, a global search. A local search
        (L-BFGS-B) improves it.

        Args:
            cost: (law of each number) -> what to minimise.
        """
        low = np.array(self.bounds)[:, 0]
        width = np.ptp(self.bounds, axis=1)

        def cost_at(point: np.ndarray) -> float:
            """The cost at a point of the box."""
            return cost(self.laws_at(point))

        def point_at(shares: np.ndarray) -> np.ndarray:
            """The point of the box at shares of its widths: 0 is the lower end of each range, 1 the upper end."""
            return low + width * np.clip(shares, 0.0, 1.0)

        by_direct = optimize.direct(cost_at, self.bounds, maxfun=EVALUATIONS * len(self.bounds)).x
        best = min([*self.corners, by_direct], key=cost_at)
        descent = optimize.minimize(
            lambda shares: cost_at(point_at(shares)),
            (best - low) / width,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * len(low),
        )
        return min((best, point_at(descent.x)), key=cost_at)
