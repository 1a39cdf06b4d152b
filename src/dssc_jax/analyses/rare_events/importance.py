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
    distinct_points,
    find_design_points,
    with_curvature,
)
from dssc_jax.analyses.rare_events.estimate import Estimate, make_plain_draws
from dssc_jax.analyses.rare_events.mixture import WIDE, fit_mixture, mixture_sample, weighted_mixture
from dssc_jax.analyses.rare_events.prediction import SMOOTHINGS, Prediction, fit_prediction
from dssc_jax.analyses.slacks import SlackCounter, SlackFunction
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.statistics.weighted import effective_size, weighted_interval

LEARNT = 128  # plain draws in the prediction: those with the smallest slacks
EXPLORED = 256  # points of the wide law in the prediction
STARTS = 16  # starts of the searches for design points
START_DISTANCE = 1.5  # least distance between two starts
ROUNDS = 3  # least number of rounds that improve the prediction
MOST_ROUNDS = 8
ADDED = 24  # points of a round besides the design points
MOST_DESIGNS = 8  # design points that a round simulates
ENOUGH = 256  # rounds end when the answer is expected to take no more points than this
FIT_CANDIDATES = 512  # candidates for each fit of the mixture
FITS = 2  # fits of the mixture
CANDIDATES = 4096  # least number of candidates for the points of the answer
BLIND = 0.4  # share of the points whose chance does not depend on the prediction
RESERVE = 1.15  # ratio of points to the number that the prediction expects to be needed
LEAST_SAMPLED = 64  # least number of points of the answer
MOST_AT_FIRST = 1024  # most points of the first batch, since a bad prediction may ask for too many
UNSEEN = 0.05  # expected number of failures with a larger weight than the largest one that the interval allows for
LEAST_EFFECTIVE = 20  # least effective number of failing points of an answer


@dataclass(frozen=True)
class ImportanceSampling:
    """The settings of importance sampling around design points.

    Args:
        variation: Coefficient of variation to reach; with 0.1 the estimate is within a factor of about 1.2.
        most: Largest number of weighted points of the answer.
        plain: Number of plain draws, which bound the failures that the method may miss.

    Raises:
        ConfigError: A number is out of range.
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
        """The failure probability: the sum of the failing points' weights."""
        return float(self.weights.sum())

    def mean_interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """The interval of the sum of weights (:func:`dssc_jax.statistics.weighted.weighted_interval`)."""
        return weighted_interval(self.weights, 1, self.largest, confidence)

    @property
    def variation(self) -> float:
        """Coefficient of variation of the sum of weights."""
        return variation_of(self.weights)

    @property
    def reached(self) -> bool:
        """Whether the effective number of failing points is large enough for an answer."""
        return effective_size(self.weights) >= LEAST_EFFECTIVE

    @property
    def interval_name(self) -> str:
        """Name of the interval: importance sampling around so many design points."""
        count = len(self.design_points)
        return f"importance sampling around {count} design {'point' if count == 1 else 'points'}"


def variation_of(weights: np.ndarray) -> float:
    """Coefficient of variation of the weights' sum; infinite without weights."""
    size = effective_size(weights)
    return size**-0.5 if size else np.inf


class Candidates(NamedTuple):
    """Points of the mixture, some of which are simulated.

    Args:
        points: Coordinates in standard normal space, shape (n, d).
        masses: Probability that each point stands for, shape (n,).
        failing: Predicted probability that each point fails, shape (n,).
    """

    points: np.ndarray
    masses: np.ndarray
    failing: np.ndarray

    def chances(self, scores: np.ndarray, count: int) -> np.ndarray:
        """Chance of each point to be simulated, shape (n,): a share ``BLIND`` is equal, the remainder follows scores.

        Args:
            scores: How useful each point is, shape (n,).
            count: Expected number of simulated points.
        """
        total = float(scores.sum())
        shares = scores / total if total else np.full(len(scores), 1.0 / len(scores))
        return np.minimum(1.0, count * ((1.0 - BLIND) * shares + BLIND / len(scores)))

    def informative_chances(self, count: int) -> np.ndarray:
        """Chances that prefer points whose failure is in doubt, to improve the prediction; see :meth:`chances`."""
        return self.chances(self.masses * np.sqrt(self.failing * (1.0 - self.failing)), count)

    def efficient_chances(self, count: int) -> np.ndarray:
        """Chances that give the estimate its least variance, if the prediction is right; see :meth:`chances`."""
        return self.chances(self.masses * np.sqrt(self.failing), count)

    def sample_size(self, variation: float) -> int:
        """Number of points to simulate so that the estimate has a given coefficient of variation, as predicted."""
        failing_masses = self.masses * self.failing
        total = float(failing_masses.sum())
        if total == 0.0:
            return LEAST_SAMPLED
        squares = float(np.sum(self.masses * failing_masses / self.efficient_chances(1)))
        return max(LEAST_SAMPLED, int(np.ceil(RESERVE * squares / (total * variation) ** 2)))


def systematic_sample(chances: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Indices of a systematic sample in random order: each point is in it with its chance, shape (n,)."""
    order = rng.permutation(len(chances))
    cumulative_counts = np.floor(np.cumsum(chances[order]) + rng.random())
    return order[np.diff(cumulative_counts, prepend=0.0) > 0.0]


@dataclass
class DesignSearch:
    """The search for design points: simulated points, the prediction from them, and the design points it leads to.

    Args:
        counter: Computes slacks.
        rng: Random generator.
        points: Simulated points, shape (n, d).
        slacks: Slack at each point, shape (n,).
    """

    counter: SlackCounter
    rng: np.random.Generator
    points: np.ndarray
    slacks: np.ndarray
    prediction: Prediction = field(init=False)
    design_points: list[DesignPoint] = field(init=False)

    def learn(self, points: np.ndarray, slacks: np.ndarray, smoothings: tuple[float, ...] = SMOOTHINGS) -> None:
        """Fit the prediction with further simulated points, and search for its design points.

        The searches start from the failing points nearest to the median draw, then from those with the least slacks.

        Args:
            points: The further points, shape (n, d).
            slacks: Slack at each of them, shape (n,).
            smoothings: Smoothings among which the prediction takes the likeliest.
        """
        self.points = np.concatenate([self.points, points])
        self.slacks = np.concatenate([self.slacks, slacks])
        self.prediction = fit_prediction(self.points, self.slacks, smoothings)
        lengths = np.linalg.norm(self.points, axis=1)
        order = np.lexsort((np.where(self.slacks < 0.0, lengths, self.slacks), self.slacks >= 0.0))
        starts = self.points[distinct_points(self.points, order, START_DISTANCE, STARTS)]
        self.design_points = find_design_points(self.prediction.slacks_and_slopes, starts)

    def candidates(self, count: int) -> Candidates:
        """Points of a mixture that is fitted to the predicted failures around the design points."""
        means = np.array([design_point.point for design_point in self.design_points])
        probabilities = np.array([design_point.first_order_probability for design_point in self.design_points])
        components = weighted_mixture(means, [np.eye(means.shape[1])] * len(means), probabilities)
        for _ in range(FITS):
            points, ratios = mixture_sample(components, FIT_CANDIDATES, self.rng)
            components = fit_mixture(components, points, ratios * self.prediction.failure_probability(points))
        points, ratios = mixture_sample(components, count, self.rng)
        return Candidates(points, ratios / len(points), self.prediction.failure_probability(points))

    def simulate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulate points with fresh in-loop noise; return the slacks and the indices of the noise, shape (n,) each."""
        noise = self.counter.fresh(len(points))
        return self.counter(points, noise), noise


def importance_sampling(
    slack: SlackFunction, dimension: int, seeds: tuple[int, ...], settings: ImportanceSampling
) -> WeightedEstimate | str:
    """Estimate a failure probability by importance sampling around predicted design points.

    Args:
        slack: Computes slacks in standard normal space; -inf or NaN if there is none.
        dimension: Number d of coordinates of that space.
        seeds: Seeds of the random numbers.
        settings: The settings.

    Returns:
        The estimate, or the reason why there is none.
    """
    counter = SlackCounter(slack)
    plain, points, slacks = make_plain_draws(counter, generator(*seeds, stream("plain")), settings.plain, dimension)
    least = np.argsort(slacks, kind="stable")[:LEARNT]
    search = DesignSearch(counter, generator(*seeds, stream("importance")), points[least], slacks[least])
    new_points = WIDE * search.rng.standard_normal((EXPLORED, dimension))
    for round_index in range(MOST_ROUNDS):
        slacks, _ = search.simulate(new_points)
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
    sample = weigh_failures(search, settings)
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
        design_points=[
            with_curvature(search.prediction.slacks_and_slopes, design_point) for design_point in search.design_points
        ],
    )


class Sample(NamedTuple):
    """The failing points of the answer.

    Args:
        points: Coordinates in standard normal space, shape (n, d).
        noise: Index of the in-loop noise of each point, shape (n,).
        weights: Probability that each point stands for, shape (n,).
        largest: The largest weight that a failing point could be expected to have.
    """

    points: np.ndarray
    noise: np.ndarray
    weights: np.ndarray
    largest: float


def weigh_failures(search: DesignSearch, settings: ImportanceSampling) -> Sample:
    """Simulate the points of the answer in batches, and weight those that fail.

    The size of the first batch follows from the prediction. While the coefficient of variation is too large, a further
    batch doubles the number of points. Each batch counts in proportion to its planned size, which does not depend on
    its own slacks, so that the estimate has no bias.

    Args:
        search: The prediction and the design points; updated after each batch.
        settings: The coefficient of variation to reach, and the largest number of points.
    """
    count = 0
    batch_size = 0
    sample = Sample(np.empty((0, search.points.shape[1])), np.empty(0, int), np.empty(0), 0.0)
    while True:
        candidates = search.candidates(max(CANDIDATES, 2 * batch_size))
        batch_size = batch_size or min(candidates.sample_size(settings.variation), MOST_AT_FIRST, settings.most)
        chances = candidates.efficient_chances(batch_size)
        indices = systematic_sample(chances, search.rng)
        slacks, noise = search.simulate(candidates.points[indices])
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
