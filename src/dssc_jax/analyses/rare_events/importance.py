"""Importance sampling around design points: the probability of a rare failure by few simulations.

Points are drawn from a mixture of normal laws around the design points, and of a wide normal law around the median.
Each failing point counts with the ratio of the draws' density to the mixture's. The wide law finds the starts of the
search. Its points in the mixture meet failures that the design points do not represent: a point that makes up a large
part of the sum starts another search. The method misses failures of a kind that no point of the wide law and no plain
draw meets; the plain draws bound their probability.

Reference:
    R. E. Melchers, "Importance sampling in structural systems", Structural Safety 6 (1989) 3-10.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg, special

from dssc_jax.analyses.defaults import FEWER_PLAIN, MOST_WEIGHTED, VARIATION
from dssc_jax.analyses.rare_events.design_points import (
    DesignPoint,
    SlopeFunction,
    distinct,
    find_design_points,
    relevant,
    with_curvature,
)
from dssc_jax.analyses.rare_events.estimate import Counter, Estimate, SlackFunction, plain_draws
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.statistics.weighted import effective_size, weighted_interval

WIDE = 2.5  # standard deviations of the wide normal law
WIDE_SHARE = 0.1  # of the points
LEAST_SHARE = 0.05  # of a design point's law
EXPLORED = 256  # points of the wide law at first
STARTS = 8  # of the first search
START_DISTANCE = 1.5  # between starts; from all design points, beyond which a failure is not represented
PILOT = 500  # points that decide whether the mixture fits
MORE_SEARCHES = 3  # largest number of searches from failures that the design points do not represent
FITS = 4  # largest number of fits of the mixture
HEAVY = 0.2  # share of the sum from which a single point hints at failures of another kind
FITTING = 0.12  # effective size of the failing points, relative to all, from which the mixture fits
LEAST_EFFECTIVE = 20  # effective number of failing points of an answer
RESERVE = 1.2  # ratio of points to the number that follows from the pilot's variation


@dataclass(frozen=True)
class ImportanceSampling:
    """The settings of importance sampling around design points.

    Args:
        variation: Coefficient of variation to reach; 0.1 leaves a factor of about 1.2 between estimate and truth.
        most: Largest number of weighted points of the answer.
        plain: Number of additional plain draws.

    Raises:
        ConfigError: a number is out of range.
    """

    variation: float = VARIATION
    most: int = MOST_WEIGHTED
    plain: int = FEWER_PLAIN

    def __post_init__(self) -> None:
        if not 0.0 < self.variation < 1.0:
            raise ConfigError("rare", f"needs variation in (0, 1), got {self.variation:g}")
        if self.most < PILOT or self.plain < 1:
            raise ConfigError("rare", f"needs most >= {PILOT} and plain >= 1, got {self.most} and {self.plain}")


@dataclass(frozen=True)
class WeightedEstimate(Estimate):
    """The estimate of importance sampling.

    Args:
        sampled: Number of weighted points of the answer, n.
        scatter: Standard deviation of :attr:`mean`.
        design_points: The design points.
    """

    sampled: int
    scatter: float
    design_points: list[DesignPoint]

    @property
    def mean(self) -> float:
        """Sum of the failing points' weights over n."""
        return float(self.weights.sum()) / self.sampled

    def mean_interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Interval of a weighted sum; see :func:`dssc_jax.statistics.weighted.weighted_interval`."""
        largest = float(self.weights.max(initial=0.0))
        return weighted_interval(self.weights, self.sampled, largest, confidence)

    @property
    def variation(self) -> float:
        """Coefficient of variation of :attr:`mean`."""
        return self.scatter / self.mean

    @property
    def reached(self) -> bool:
        """Whether enough failing points carry the sum."""
        return effective_size(self.weights) >= LEAST_EFFECTIVE

    @property
    def interval_name(self) -> str:
        """See :class:`Estimate`."""
        count = len(self.design_points)
        return f"importance sampling around {count} design {'point' if count == 1 else 'points'}"


class Component(NamedTuple):
    """A normal law of the mixture.

    Args:
        mean: Shape (d,).
        root: Lower triangular root of its covariance, shape (d, d).
        share: Its share of the mixture.
    """

    mean: np.ndarray
    root: np.ndarray
    share: float

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """Logarithm of the density, without the constant that all normal laws have, shape (n,)."""
        scores = linalg.solve_triangular(self.root, (points - self.mean).T, lower=True)
        return -0.5 * np.sum(scores**2, axis=0) - float(np.log(np.diag(self.root)).sum())


class Sample(NamedTuple):
    """Points of a mixture.

    Args:
        points: Shape (n, d).
        noise: Their noise indices, shape (n,).
        weights: Their weights, 0 where they do not fail, shape (n,).
        strata: Index of the component that each was drawn from, shape (n,).
    """

    points: np.ndarray
    noise: np.ndarray
    weights: np.ndarray
    strata: np.ndarray

    @property
    def scatter(self) -> float:
        """Standard deviation of the mean weight; the numbers of points of the components are fixed."""
        variance = 0.0
        for stratum in np.unique(self.strata):
            weights = self.weights[self.strata == stratum]
            if len(weights) > 1:
                variance += len(weights) * float(weights.var(ddof=1))
        return variance**0.5 / len(self.weights)


@dataclass
class Search:
    """An importance sampling in progress.

    Args:
        counter: Computes slacks.
        slope: Computes slacks and slopes.
        dimension: d.
        rng: Random generator.
    """

    counter: Counter
    slope: SlopeFunction
    dimension: int
    rng: np.random.Generator

    @property
    def wide(self) -> Component:
        """The wide normal law."""
        return Component(np.zeros(self.dimension), WIDE * np.eye(self.dimension), WIDE_SHARE)

    def counted_slope(self, points: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slacks and slopes; each counts 1 + d simulations."""
        self.counter.simulations += len(points) * (1 + self.dimension)
        return self.slope(points, noise)

    def starts(self) -> tuple[np.ndarray, np.ndarray]:
        """Starts of the first search: failing points of the wide law nearest to the median, else the least slacks."""
        points = WIDE * self.rng.standard_normal((EXPLORED, self.dimension))
        noise = self.counter.fresh(EXPLORED)
        slacks = self.counter(points, noise)
        lengths = np.linalg.norm(points, axis=1)
        order = np.lexsort((np.where(slacks < 0.0, lengths, slacks), slacks >= 0.0))
        chosen = distinct(points, order, START_DISTANCE)[:STARTS]
        return points[chosen], noise[chosen]

    def design_points(self, found: list[DesignPoint], points: np.ndarray, noise: np.ndarray) -> list[DesignPoint]:
        """The design points found earlier and those that searches from some points find."""
        return relevant([*found, *find_design_points(self.counted_slope, points, noise)])

    def around(self, found: list[DesignPoint]) -> list[Component]:
        """The mixture of normal laws around design points, with the shares that FORM gives them, and the wide law."""
        means = np.array([candidate.point for candidate in found])
        shares = np.array([candidate.first_order_probability for candidate in found])
        return mixture_of(means, [np.eye(self.dimension)] * len(found), shares, self.wide)

    def sample(self, components: list[Component], count: int) -> Sample:
        """Draw about ``count`` points of a mixture and simulate them.

        Each component gives a fixed number of points, at least 2. The weight of a failing point is the density of the
        standard normal law over that of the mixture; points that do not fail have weight 0.
        """
        numbers = [max(2, round(component.share * count)) for component in components]
        parts = []
        for component, number in zip(components, numbers, strict=True):
            parts.append(component.mean + self.rng.standard_normal((number, self.dimension)) @ component.root.T)
        points = np.concatenate(parts)
        shares = np.array(numbers) / len(points)
        densities = np.stack([component.log_density(points) for component in components])
        mixture = special.logsumexp(densities, axis=0, b=shares[:, None])
        noise = self.counter.fresh(len(points))
        failing = self.counter(points, noise) < 0.0
        ratios = np.exp(-0.5 * np.sum(points**2, axis=1) - mixture)
        weights = np.where(failing, ratios, 0.0)
        component_of_point = np.repeat(np.arange(len(numbers)), numbers)
        return Sample(points, noise, weights, component_of_point)


def unrepresented(sample: Sample, found: list[DesignPoint]) -> np.ndarray:
    """Indices of points that make up a large part of the sum and lie far from all design points."""
    heavy = np.flatnonzero(sample.weights > HEAVY * sample.weights.sum())
    means = np.array([candidate.point for candidate in found])
    distances = np.linalg.norm(sample.points[heavy, None] - means, axis=2).min(axis=1)
    return heavy[distances > START_DISTANCE]


def mixture_of(means: np.ndarray, roots: list[np.ndarray], weights: np.ndarray, wide: Component) -> list[Component]:
    """A mixture of normal laws with shares proportional to weights, none too small, and the wide law."""
    shares = np.maximum(weights / weights.sum(), LEAST_SHARE)
    shares *= (1.0 - WIDE_SHARE) / shares.sum()
    components = [Component(mean, root, float(share)) for mean, root, share in zip(means, roots, shares, strict=True)]
    return [*components, wide]


def fitted(components: list[Component], sample: Sample) -> list[Component]:
    """The mixture whose laws have the mean and, where it is wider, the covariance of the failures near them."""
    *narrow, wide = components
    densities = np.stack([component.log_density(sample.points) for component in narrow])
    responsibilities = np.exp(densities - special.logsumexp(densities, axis=0))
    means = []
    roots = []
    totals = []
    for component, responsibility in zip(narrow, responsibilities, strict=True):
        weights = sample.weights * responsibility
        total = float(weights.sum())
        size = effective_size(weights)
        totals.append(total)
        if size < 5.0:  # too few failures to fit a law
            means.append(component.mean)
            roots.append(component.root)
            continue
        mean = weights @ sample.points / total
        means.append(mean)
        roots.append(root_of_failures(sample.points - mean, weights / total, size))
    return mixture_of(np.array(means), roots, np.array(totals), wide)


def root_of_failures(deviations: np.ndarray, weights: np.ndarray, size: float) -> np.ndarray:
    """Root of the covariance of weighted points, shrunk towards the unit matrix, in no direction narrower than that."""
    dimension = deviations.shape[1]
    covariance = (weights[:, None] * deviations).T @ deviations
    doubt = (dimension + 1.0) / (dimension + 1.0 + size)
    values, vectors = np.linalg.eigh((1.0 - doubt) * covariance + doubt * np.eye(dimension))
    return np.linalg.cholesky((vectors * np.maximum(values, 1.0)) @ vectors.T)


def importance_sampling(
    slack: SlackFunction, slope: SlopeFunction, dimension: int, seeds: tuple[int, ...], settings: ImportanceSampling
) -> WeightedEstimate | str:
    """Estimate a failure probability by importance sampling around design points.

    Args:
        slack: Computes slacks; -inf or NaN if there is none.
        slope: Computes slacks and slopes.
        dimension: d of the standard normal space.
        seeds: Of the random numbers.
        settings: The settings.

    Returns:
        The estimate, or the reason why there is none.
    """
    counter = Counter(slack)
    search = Search(counter, slope, dimension, generator(*seeds, stream("importance")))
    found = search.design_points([], *search.starts())
    if not found:
        return "no search ended at the border of failure"
    components = search.around(found)
    pilot = search.sample(components, PILOT)
    for _ in range(MORE_SEARCHES):
        unknown = unrepresented(pilot, found)
        if not unknown.size:
            break
        found = search.design_points(found, pilot.points[unknown], pilot.noise[unknown])
        components = search.around(found)
        pilot = search.sample(components, PILOT)
    if not pilot.weights.any():
        return "no point around the design points fails"
    for _ in range(FITS):
        if effective_size(pilot.weights) >= FITTING * len(pilot.weights):
            break
        components = fitted(components, pilot)
        pilot = search.sample(components, PILOT)
        if not pilot.weights.any():
            return "no point of the fitted laws fails"
    single = pilot.weights.std() / pilot.weights.mean()
    needed = int(np.ceil(RESERVE * (single / settings.variation) ** 2))
    sample = search.sample(components, min(max(needed, PILOT), settings.most))
    if effective_size(sample.weights) < LEAST_EFFECTIVE:
        return f"few failures carry the sum, as if {effective_size(sample.weights):.0f} points failed"
    found = [with_curvature(search.counted_slope, candidate) for candidate in found]
    simulations = counter.simulations
    failing = sample.weights > 0.0
    return WeightedEstimate(
        simulations=simulations,
        points=sample.points[failing],
        noise=sample.noise[failing],
        weights=sample.weights[failing],
        plain=plain_draws(counter, generator(*seeds, stream("plain")), settings.plain, dimension),
        sampled=len(sample.weights),
        scatter=sample.scatter,
        design_points=found,
    )
