"""Importance sampling around predicted design points: the probability of a rare failure by some hundred simulations.

A prediction of the slack, made from plain draws and from points of a wide law, leads to the design points. Rounds of
further points near them improve it. Candidates are then drawn from a mixture of normal laws at the design points and of
the wide law. Each is simulated with a known chance: a likely one where it stands for much of the failure probability or
may decide whether the prediction is right. A failing candidate counts with its weight over its chance (Horvitz and
Thompson), so the estimate has no bias, whatever the prediction is worth. The points that made the prediction do not
count. The method misses failures of a kind that no simulated point meets; the plain draws bound their probability.

References:
    R. E. Melchers, "Importance sampling in structural systems", Structural Safety 6 (1989) 3-10; D. G. Horvitz,
    D. J. Thompson, "A generalization of sampling without replacement from a finite universe", J. American Statistical
    Association 47 (1952) 663-685; B. Echard, N. Gayton, M. Lemaire, N. Relun, "A combined importance sampling and
    kriging reliability method for small failure probabilities", Reliability Engineering and System Safety 111 (2013)
    232-240.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.defaults import FEWER_PLAIN, MOST_WEIGHTED, VARIATION
from dssc_jax.analyses.rare_events.design_points import (
    DesignPoint,
    distinct,
    find_design_points,
    with_curvature,
)
from dssc_jax.analyses.rare_events.estimate import Counter, Estimate, SlackFunction, plain_draws
from dssc_jax.analyses.rare_events.mixture import WIDE, fitted, mixture_of, mixture_sample
from dssc_jax.analyses.rare_events.prediction import SMOOTHINGS, Prediction, predicted
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.statistics.weighted import effective_size, weighted_interval

LEARNT = 128  # plain draws, those with the least slacks, that the prediction learns
EXPLORED = 256  # points of the wide law
STARTS = 16  # of the searches for design points
START_DISTANCE = 1.5  # between starts
ROUNDS = 3  # least number of rounds that improve the prediction
MOST_ROUNDS = 8
ADDED = 24  # points of a round besides the design points
MOST_DESIGNS = 8  # design points that a round simulates
ENOUGH = 256  # points of the answer from which further rounds may save simulations
FIT_CANDIDATES = 512  # for each fit of the mixture
FITS = 2
CANDIDATES = 4096  # least number of candidates for the answer's points
BLIND = 0.4  # share of the points whose chance does not depend on the prediction
RESERVE = 1.15  # ratio of points to the number that the prediction expects
LEAST_SAMPLED = 64
MOST_AT_FIRST = 1024  # points of the first batch, which a bad prediction would make too large
UNSEEN = 0.05  # expected number of failures with larger weights than the largest one that the interval allows for
LEAST_EFFECTIVE = 20  # effective number of failing points of an answer


@dataclass(frozen=True)
class ImportanceSampling:
    """The settings of importance sampling around design points.

    Args:
        variation: Coefficient of variation to reach; 0.1 leaves a factor of about 1.2 between estimate and truth.
        most: Largest number of weighted points of the answer.
        plain: Number of plain draws, which bound the failures that the method may miss.

    Raises:
        ConfigError: a number is out of range.
    """

    variation: float = VARIATION
    most: int = MOST_WEIGHTED
    plain: int = FEWER_PLAIN

    def __post_init__(self) -> None:
        if not 0.0 < self.variation < 1.0:
            raise ConfigError("rare", f"needs variation in (0, 1), got {self.variation:g}")
        if self.most < LEAST_SAMPLED or self.plain < 1:
            rule = f"needs most >= {LEAST_SAMPLED} and plain >= 1"
            raise ConfigError("rare", f"{rule}, got {self.most} and {self.plain}")


@dataclass(frozen=True)
class WeightedEstimate(Estimate):
    """The estimate of importance sampling; each failing point's weight is the probability that it stands for.

    Args:
        largest: The largest weight that a failing point could be expected to have.
        design_points: The design points.
    """

    largest: float
    design_points: list[DesignPoint]

    @property
    def mean(self) -> float:
        """Sum of the failing points' weights."""
        return float(self.weights.sum())

    def mean_interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Interval of a weighted sum; see :func:`dssc_jax.statistics.weighted.weighted_interval`."""
        return weighted_interval(self.weights, 1, self.largest, confidence)

    @property
    def variation(self) -> float:
        """Coefficient of variation of :attr:`mean`."""
        return variation_of(self.weights)

    @property
    def reached(self) -> bool:
        """Whether enough failing points carry the sum."""
        return effective_size(self.weights) >= LEAST_EFFECTIVE

    @property
    def interval_name(self) -> str:
        """See :class:`Estimate`."""
        count = len(self.design_points)
        return f"importance sampling around {count} design {'point' if count == 1 else 'points'}"


def variation_of(weights: np.ndarray) -> float:
    """Coefficient of variation of the weights' sum; infinite without weights."""
    size = effective_size(weights)
    return size**-0.5 if size else np.inf


class Candidates(NamedTuple):
    """Points that may be simulated.

    Args:
        points: Shape (n, d).
        masses: Probability that each stands for, shape (n,).
        failing: Predicted probability that each fails, shape (n,).
    """

    points: np.ndarray
    masses: np.ndarray
    failing: np.ndarray

    def chances(self, scores: np.ndarray, count: int) -> np.ndarray:
        """Chance of each point to be simulated, ``count`` in all: a share ``BLIND`` equally, the rest by the scores."""
        total = float(scores.sum())
        shares = scores / total if total else np.full(len(scores), 1.0 / len(scores))
        return np.minimum(1.0, count * ((1.0 - BLIND) * shares + BLIND / len(scores)))

    def informative_chances(self, count: int) -> np.ndarray:
        """Chances that improve the prediction."""
        return self.chances(self.masses * np.sqrt(self.failing * (1.0 - self.failing)), count)

    def efficient_chances(self, count: int) -> np.ndarray:
        """Chances with the least variance of the sum."""
        return self.chances(self.masses * np.sqrt(self.failing), count)

    def sample_size(self, variation: float) -> int:
        """Number of points with which the predicted coefficient of variation is as small as ``variation``."""
        failing_masses = self.masses * self.failing
        total = float(failing_masses.sum())
        if total == 0.0:
            return LEAST_SAMPLED
        squares = float(np.sum(self.masses * failing_masses / self.efficient_chances(1)))
        return max(LEAST_SAMPLED, int(np.ceil(RESERVE * squares / (total * variation) ** 2)))


def systematic_sample(chances: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Indices of a systematic sample in random order, each drawn with its chance."""
    order = rng.permutation(len(chances))
    cumulative_counts = np.floor(np.cumsum(chances[order]) + rng.random())
    return order[np.diff(cumulative_counts, prepend=0.0) > 0.0]


@dataclass
class Search:
    """The simulated points, and what they predict.

    Args:
        counter: Computes slacks.
        rng: Random generator.
        points: Simulated points, shape (n, d).
        slacks: Their slacks, shape (n,).
    """

    counter: Counter
    rng: np.random.Generator
    points: np.ndarray
    slacks: np.ndarray
    prediction: Prediction = field(init=False)
    design_points: list[DesignPoint] = field(init=False)

    def learn(self, points: np.ndarray, slacks: np.ndarray, smoothings: tuple[float, ...] = SMOOTHINGS) -> None:
        """Add simulated points to the prediction, which chooses a smoothing, and search its design points.

        The searches start from failing points nearest to the median, then from the least slacks.
        """
        self.points = np.concatenate([self.points, points])
        self.slacks = np.concatenate([self.slacks, slacks])
        self.prediction = predicted(self.points, self.slacks, smoothings)
        lengths = np.linalg.norm(self.points, axis=1)
        order = np.lexsort((np.where(self.slacks < 0.0, lengths, self.slacks), self.slacks >= 0.0))
        starts = self.points[distinct(self.points, order, START_DISTANCE, STARTS)]
        self.design_points = find_design_points(self.prediction.slope, starts)

    def candidates(self, count: int) -> Candidates:
        """Points of the mixture that fits the predicted failures around the design points."""
        means = np.array([design_point.point for design_point in self.design_points])
        probabilities = np.array([design_point.first_order_probability for design_point in self.design_points])
        components = mixture_of(means, [np.eye(means.shape[1])] * len(means), probabilities)
        for _ in range(FITS):
            points, ratios = mixture_sample(components, FIT_CANDIDATES, self.rng)
            components = fitted(components, points, ratios * self.prediction.failing(points))
        points, ratios = mixture_sample(components, count, self.rng)
        return Candidates(points, ratios / len(points), self.prediction.failing(points))

    def simulated(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slacks and noise indices of points."""
        noise = self.counter.fresh(len(points))
        return self.counter(points, noise), noise


def importance_sampling(
    slack: SlackFunction, dimension: int, seeds: tuple[int, ...], settings: ImportanceSampling
) -> WeightedEstimate | str:
    """Estimate a failure probability by importance sampling around predicted design points.

    Args:
        slack: Computes slacks; -inf or NaN if there is none.
        dimension: d of the standard normal space.
        seeds: Seeds of the random numbers.
        settings: The settings.

    Returns:
        The estimate, or the reason why there is none.
    """
    counter = Counter(slack)
    plain, points, slacks = plain_draws(counter, generator(*seeds, stream("plain")), settings.plain, dimension)
    least = np.argsort(slacks, kind="stable")[:LEARNT]
    search = Search(counter, generator(*seeds, stream("importance")), points[least], slacks[least])
    new_points = WIDE * search.rng.standard_normal((EXPLORED, dimension))
    for round_index in range(MOST_ROUNDS):
        slacks, _ = search.simulated(new_points)
        is_middle_round = 0 < round_index < ROUNDS
        search.learn(new_points, slacks, (search.prediction.smoothing,) if is_middle_round else SMOOTHINGS)
        if not search.design_points:
            return "no search ended at the border of failure"
        candidates = search.candidates(FIT_CANDIDATES)
        if round_index >= ROUNDS and candidates.sample_size(settings.variation) <= ENOUGH:
            break
        informative = candidates.points[systematic_sample(candidates.informative_chances(ADDED), search.rng)]
        designs = [design_point.point for design_point in search.design_points[:MOST_DESIGNS]]
        new_points = np.concatenate([informative, designs])
    sample = sampled(search, settings)
    size = effective_size(sample.weights)
    if size < LEAST_EFFECTIVE:
        return f"few failures carry the sum, as if {size:.0f} points failed"
    return WeightedEstimate(
        simulations=counter.simulations - plain.draws,
        points=sample.points,
        noise=sample.noise,
        weights=sample.weights,
        plain=plain,
        largest=sample.largest,
        design_points=[with_curvature(search.prediction.slope, design_point) for design_point in search.design_points],
    )


class Sample(NamedTuple):
    """Failing points of the answer.

    Args:
        points: Shape (n, d).
        noise: Their noise indices, shape (n,).
        weights: Probability that each stands for, shape (n,).
        largest: The largest weight that a failing point could be expected to have.
    """

    points: np.ndarray
    noise: np.ndarray
    weights: np.ndarray
    largest: float


def sampled(search: Search, settings: ImportanceSampling) -> Sample:
    """Simulate the points of the answer.

    Their number follows from the prediction. While it is too small for the coefficient of variation, as many points
    again follow. Each batch counts in proportion to its planned number, which does not depend on its slacks.
    """
    count = 0
    batch_size = 0
    sample = Sample(np.empty((0, search.points.shape[1])), np.empty(0, int), np.empty(0), 0.0)
    while True:
        candidates = search.candidates(max(CANDIDATES, 2 * batch_size))
        batch_size = batch_size or min(candidates.sample_size(settings.variation), MOST_AT_FIRST, settings.most)
        chances = candidates.efficient_chances(batch_size)
        indices = systematic_sample(chances, search.rng)
        slacks, noise = search.simulated(candidates.points[indices])
        failed = indices[slacks < 0.0]
        share = batch_size / (count + batch_size)
        weights = share * candidates.masses / chances
        by_weight = np.argsort(-weights)
        expected_failures = np.cumsum((chances * candidates.failing)[by_weight])
        likely_weight = weights[by_weight[min(np.searchsorted(expected_failures, UNSEEN), len(by_weight) - 1)]]
        sample = Sample(
            np.concatenate([sample.points, candidates.points[failed]]),
            np.concatenate([sample.noise, noise[slacks < 0.0]]),
            np.concatenate([(1.0 - share) * sample.weights, weights[failed]]),
            max((1.0 - share) * sample.largest, float(likely_weight), float(weights[failed].max(initial=0.0))),
        )
        count += batch_size
        if variation_of(sample.weights) <= settings.variation or 2 * count > settings.most:
            return sample
        surprises = np.argsort(-np.abs((slacks < 0.0) - candidates.failing[indices]))[: 2 * ADDED]
        search.learn(candidates.points[indices[surprises]], slacks[surprises])
        batch_size = count
