"""Importance sampling around predicted design points: the probability of a rare failure by some hundred simulations.

A prediction of the slack, made from plain draws and from points of a wide law, leads to the design points. Rounds of
further points near them improve it. Candidates are then drawn from a mixture of normal laws at the design points and of
the wide law. Each is simulated with a known chance, which is large where it stands for much of the failure probability
or may decide whether the prediction is right. A failing candidate counts with its weight over its chance (Horvitz and
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
from dssc_jax.analyses.rare_events.estimate import Estimate, simulate_plain_draws
from dssc_jax.analyses.rare_events.mixture import WIDE, draw_from_mixture, fit_mixture, weighted_mixture
from dssc_jax.analyses.rare_events.prediction import SMOOTHINGS, Prediction, fit_prediction
from dssc_jax.analyses.slacks import SlackCounter, SlackFunction
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.statistics.weighted import effective_size, weighted_interval

LEARNT = 128  # plain draws in the prediction, namely the draws with the smallest slacks
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
UNSEEN = 0.05  # expected number of simulated failures that weigh more than the largest weight of the interval
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
        """Refuse settings that are out of range."""
        if not 0.0 < self.variation < 1.0:
            raise ConfigError("rare", f"needs variation in (0, 1), got {self.variation:g}")
        if self.most < LEAST_SAMPLED or self.plain < 1:
            rule = f"needs most >= {LEAST_SAMPLED} and plain >= 1"
            raise ConfigError("rare", f"{rule}, got {self.most} and {self.plain}")


@dataclass(frozen=True)
class WeightedEstimate(Estimate):
    """The estimate of importance sampling: the weights of the failing points add up to the failure probability.

    Args:
        weight_bound: Upper bound assumed for the weight of any failing point; the confidence interval uses it.
        design_points: The design points around which the points lie.
    """

    weight_bound: float
    design_points: list[DesignPoint]

    @property
    def mean(self) -> float:
        """The failure probability: the sum of the failing points' weights."""
        return float(self.weights.sum())

    def mean_interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Compute the interval of the sum of weights (:func:`dssc_jax.statistics.weighted.weighted_interval`)."""
        return weighted_interval(self.weights, draws=1, largest=self.weight_bound, confidence=confidence)

    @property
    def variation(self) -> float:
        """Coefficient of variation of the sum of weights."""
        return variation_of_sum(self.weights)

    @property
    def reached(self) -> bool:
        """Whether the effective number of failing points is large enough for an answer."""
        return effective_size(self.weights) >= LEAST_EFFECTIVE

    @property
    def interval_name(self) -> str:
        """How the interval is computed, with the number of design points."""
        count = len(self.design_points)
        return f"importance sampling around {count} design {'point' if count == 1 else 'points'}"


def variation_of_sum(weights: np.ndarray) -> float:
    """Coefficient of variation of the sum of the failing points' weights; infinite without weights."""
    size = effective_size(weights)
    return size**-0.5 if size else np.inf


class Candidates(NamedTuple):
    """Points of the mixture, of which a few are chosen at random and simulated.

    Args:
        points: Coordinates in standard normal space, shape (n, d).
        masses: Probability that each point stands for, shape (n,).
        failure_probabilities: Predicted probability that each point fails, shape (n,).
    """

    points: np.ndarray
    masses: np.ndarray
    failure_probabilities: np.ndarray

    def selection_chances(self, scores: np.ndarray, count: int) -> np.ndarray:
        """Chance of each point to be simulated, in [0, 1], shape (n,).

        A share :data:`BLIND` of the simulations falls on all points equally, whatever the prediction is worth. The
        remainder is distributed in proportion to the scores.

        Args:
            scores: How useful each point is, shape (n,).
            count: Expected number of simulated points.
        """
        total = float(scores.sum())
        shares = scores / total if total else np.full(len(scores), 1.0 / len(scores))
        return np.minimum(1.0, count * ((1.0 - BLIND) * shares + BLIND / len(scores)))

    def informative_chances(self, count: int) -> np.ndarray:
        """Chances that prefer points whose failure is in doubt, shape (n,): they improve the prediction most.

        The score of a point is its mass times sqrt(p (1 - p)), where p is its predicted probability of failure.
        """
        doubts = np.sqrt(self.failure_probabilities * (1.0 - self.failure_probabilities))
        return self.selection_chances(self.masses * doubts, count)

    def efficient_chances(self, count: int) -> np.ndarray:
        """Chances that give the estimate the least variance if the prediction is right, shape (n,)."""
        return self.selection_chances(self.masses * np.sqrt(self.failure_probabilities), count)

    def sample_size(self, variation: float) -> int:
        """Predict how many points have to be simulated for a given coefficient of variation of the estimate.

        With n simulations the variance of the estimate is about V/n, where V = sum_i m_i^2 p_i/c_i. The candidate i
        has the mass m_i, fails with probability p_i, and has the chance c_i of being the only point simulated.
        """
        failing_masses = self.masses * self.failure_probabilities
        total = float(failing_masses.sum())
        if total == 0.0:
            return LEAST_SAMPLED
        variance_of_one_point = float(np.sum(self.masses * failing_masses / self.efficient_chances(1)))
        return max(LEAST_SAMPLED, int(np.ceil(RESERVE * variance_of_one_point / (total * variation) ** 2)))


def systematic_sample(chances: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw indices of points, each with its own chance, so that the number of indices is nearly the sum of the chances.

    Segments as long as the chances are laid end to end in random order; a comb with teeth at distance 1 picks points.

    Args:
        chances: Chance of each point, in [0, 1], shape (n,).
        rng: Random generator.

    Returns:
        The indices in random order.
    """
    order = rng.permutation(len(chances))
    teeth_passed = np.floor(np.cumsum(chances[order]) + rng.random())
    is_hit = np.diff(teeth_passed, prepend=0.0) > 0.0
    return order[is_hit]


@dataclass
class DesignSearch:
    """The state of a search for design points: simulated points, and the prediction and design points from them.

    Args:
        counter: Computes slacks.
        rng: Random generator.
        points: Simulated points in standard normal space, shape (n, d).
        slacks: Slack at each point, shape (n,).
        prediction: Prediction of the slack; set by :meth:`learn`.
        design_points: Design points of the prediction, the nearest first; set by :meth:`learn`.
    """

    counter: SlackCounter
    rng: np.random.Generator
    points: np.ndarray
    slacks: np.ndarray
    prediction: Prediction = field(init=False)
    design_points: list[DesignPoint] = field(init=False)

    def learn(self, points: np.ndarray, slacks: np.ndarray, smoothings: tuple[float, ...] = SMOOTHINGS) -> None:
        """Fit the prediction with further simulated points, and search for its design points.

        Searches start from the failing points, those nearest to the median draw first, and if there are too few, from
        the points with the least slacks.

        Args:
            points: The further points, shape (n, d).
            slacks: Slack at each of them, shape (n,).
            smoothings: Values of the smoothing to try; the likeliest is taken.
        """
        self.points = np.concatenate([self.points, points])
        self.slacks = np.concatenate([self.slacks, slacks])
        self.prediction = fit_prediction(self.points, self.slacks, smoothings)
        has_failed = self.slacks < 0.0
        distances = np.linalg.norm(self.points, axis=1)  # from the median draw
        order = np.lexsort((np.where(has_failed, distances, self.slacks), ~has_failed))  # the last key sorts first
        starts = self.points[distinct_points(self.points, order, START_DISTANCE, limit=STARTS)]
        self.design_points = find_design_points(self.prediction.slacks_and_slopes, starts)

    def draw_candidates(self, count: int) -> Candidates:
        """Draw about ``count`` points of a mixture of normal laws fitted to the predicted failures.

        The fit starts from a normal law with unit covariance at each design point, weighted by the failure probability
        that FORM gives there.
        """
        means = np.array([design_point.point for design_point in self.design_points])
        probabilities = np.array([design_point.first_order_probability for design_point in self.design_points])
        unit_roots = [np.eye(means.shape[1])] * len(means)
        components = weighted_mixture(means, unit_roots, probabilities)
        for _ in range(FITS):
            points, ratios = draw_from_mixture(components, FIT_CANDIDATES, self.rng)
            components = fit_mixture(components, points, ratios * self.prediction.failure_probability(points))
        points, ratios = draw_from_mixture(components, count, self.rng)
        masses = ratios / len(points)
        return Candidates(points, masses, self.prediction.failure_probability(points))

    def simulate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulate points of shape (n, d), each with in-loop noise that no other point has.

        Returns:
            The slacks and the indices of the noise, shape (n,) each.
        """
        noise_index = self.counter.unused_noise(len(points))
        return self.counter(points, noise_index), noise_index

    def improve(self, variation: float) -> None:
        """Improve the prediction in rounds of simulations.

        The first round simulates points of the wide law, each further round the design points and points near them. The
        rounds end when the answer is expected to take few points, after :data:`MOST_ROUNDS`, or as soon as the
        prediction has no design point.

        Args:
            variation: Coefficient of variation that the answer has to reach.
        """
        dimension = self.points.shape[1]
        new_points = WIDE * self.rng.standard_normal((EXPLORED, dimension))
        for round_index in range(MOST_ROUNDS):
            slacks, _ = self.simulate(new_points)
            keeps_smoothing = 0 < round_index < ROUNDS  # the first round and the late rounds choose the smoothing anew
            self.learn(new_points, slacks, (self.prediction.smoothing,) if keeps_smoothing else SMOOTHINGS)
            if not self.design_points:
                return
            candidates = self.draw_candidates(FIT_CANDIDATES)
            if round_index >= ROUNDS and candidates.sample_size(variation) <= ENOUGH:
                return
            informative = candidates.points[systematic_sample(candidates.informative_chances(ADDED), self.rng)]
            nearest_designs = [design_point.point for design_point in self.design_points[:MOST_DESIGNS]]
            new_points = np.concatenate([informative, nearest_designs])


def importance_sampling(
    slack: SlackFunction, dimension: int, seeds: tuple[int, ...], settings: ImportanceSampling
) -> WeightedEstimate | str:
    """Estimate a failure probability by importance sampling around predicted design points.

    Args:
        slack: Computes slacks in standard normal space; -inf or NaN: the point fails without a slack.
        dimension: Number d of coordinates of standard normal space.
        seeds: Seeds of the random numbers.
        settings: The settings.

    Returns:
        The estimate; or in words, the reason why there is none.
    """
    counter = SlackCounter(slack)
    plain = simulate_plain_draws(counter, generator(*seeds, stream("plain")), settings.plain, dimension)
    least = np.argsort(plain.slacks, kind="stable")[:LEARNT]
    search = DesignSearch(counter, generator(*seeds, stream("importance")), plain.points[least], plain.slacks[least])
    search.improve(settings.variation)
    if not search.design_points:
        return "no search ended at the border of failure"
    failures = weigh_failures(search, settings)
    size = effective_size(failures.weights)
    if size < LEAST_EFFECTIVE:
        return f"few failures carry the sum, as if {size:.0f} points failed"
    slacks_and_slopes = search.prediction.slacks_and_slopes
    return WeightedEstimate(
        simulations=counter.simulations - settings.plain,
        points=failures.points,
        noise_index=failures.noise_index,
        weights=failures.weights,
        plain=plain.draws,
        weight_bound=failures.weight_bound,
        design_points=[with_curvature(slacks_and_slopes, design_point) for design_point in search.design_points],
    )


class WeightedFailures(NamedTuple):
    """The failing points from which the failure probability is estimated.

    Args:
        points: Coordinates in standard normal space, shape (n, d).
        noise_index: Index of the in-loop noise of each point, shape (n,).
        weights: Probability that each point stands for, shape (n,).
        weight_bound: Upper bound assumed for the weight of any failing point.
    """

    points: np.ndarray
    noise_index: np.ndarray
    weights: np.ndarray
    weight_bound: float


def weigh_failures(search: DesignSearch, settings: ImportanceSampling) -> WeightedFailures:
    """Simulate the points of the answer in batches, and return the failing points with their weights.

    The size of the first batch follows from the prediction. While the coefficient of variation is too large, a further
    batch doubles the number of points. The estimate is the mean of the batches' estimates, weighted by their planned
    sizes. It has no bias, since the planned size of a batch does not depend on its own slacks.

    Args:
        search: The prediction and the design points; updated after each batch.
        settings: The coefficient of variation to reach, and the largest number of points.
    """
    count = 0  # planned size of all batches so far
    batch_size = 0  # 0: not planned yet; the first candidates determine the size of the first batch
    no_points = np.empty((0, search.points.shape[1]))
    failures = WeightedFailures(no_points, noise_index=np.empty(0, int), weights=np.empty(0), weight_bound=0.0)
    while True:
        candidates = search.draw_candidates(max(CANDIDATES, 2 * batch_size))
        batch_size = batch_size or min(candidates.sample_size(settings.variation), MOST_AT_FIRST, settings.most)
        chances = candidates.efficient_chances(batch_size)
        indices = systematic_sample(chances, search.rng)
        slacks, noise_index = search.simulate(candidates.points[indices])
        has_failed = slacks < 0.0
        failed = indices[has_failed]
        share = batch_size / (count + batch_size)  # weight of this batch in the estimate
        weights = share * candidates.masses / chances
        likely_weight = largest_likely_weight(weights, chances * candidates.failure_probabilities)
        largest_failed_weight = float(weights[failed].max(initial=0.0))
        failures = WeightedFailures(
            points=np.concatenate([failures.points, candidates.points[failed]]),
            noise_index=np.concatenate([failures.noise_index, noise_index[has_failed]]),
            weights=np.concatenate([(1.0 - share) * failures.weights, weights[failed]]),
            weight_bound=max((1.0 - share) * failures.weight_bound, likely_weight, largest_failed_weight),
        )
        count += batch_size
        if variation_of_sum(failures.weights) <= settings.variation or 2 * count > settings.most:
            return failures
        surprise = np.abs(has_failed - candidates.failure_probabilities[indices])
        most_surprising = np.argsort(-surprise)[: 2 * ADDED]
        search.learn(candidates.points[indices[most_surprising]], slacks[most_surprising])
        batch_size = count


def largest_likely_weight(weights: np.ndarray, expected_failures: np.ndarray) -> float:
    """Largest weight that a failing point is likely to have: only :data:`UNSEEN` failures are expected above it.

    The interval of the estimate allows for a failure with this weight, which the sample may have missed.

    Args:
        weights: Weight of each candidate if it is simulated and fails, shape (n,).
        expected_failures: Probability that each candidate is simulated and fails, shape (n,).
    """
    by_weight = np.argsort(-weights)
    failures_above = np.cumsum(expected_failures[by_weight])
    position = min(np.searchsorted(failures_above, UNSEEN), len(by_weight) - 1)
    return float(weights[by_weight[position]])
