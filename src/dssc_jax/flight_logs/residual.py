"""The least-squares problem of a logged flight: the residual, its noise, and the minima by Gauss-Newton.

References:
    C. G. E. Boender, A. H. G. Rinnooy Kan, "Bayesian stopping rules for multistart global optimization methods",
        Mathematical Programming 37 (1987) 59-80.
    J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), section 10.3.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import special, stats

from dssc_jax.flight_logs.prediction import Prediction
from dssc_jax.statistics.correlated_noise import WHITE, Noise, weighted_products
from dssc_jax.statistics.noise_posterior import NoiseSearch, Posterior
from dssc_jax.study import Law, Study

ITERATIONS, FILTERINGS = 40, 5
LARGEST_STEP = 2.0  # prior standard deviations in one iteration
NORMAL_90 = float(special.ndtri(0.95))
LEAST_NOISE = 1e-9  # of the output's size: below, the residual is rounding
LEAST_SAMPLES = 20  # of a channel: fewer do not tell its noise
STARTS, MOST_STARTS = 8, 64  # of the search for the minimum; the first are the medians of the laws
UNSEEN = 0.5  # expected number of minima that the search has not found, below which it ends
NEAR = 0.1  # prior standard deviations between two ends of the search in the same minimum
MINIMUM_ROUNDS = 3  # of looking for the best minimum with the noise of the last one
DRAWS = 512  # of the channels' noises together


def fit_scale(law: Law, values: Any) -> np.ndarray:
    """Values on the scale of the fit."""
    return np.log(values) if law.logarithmic else np.asarray(values, float)


def unscaled(law: Law, values: Any) -> np.ndarray:
    """The inverse of :func:`fit_scale`."""
    return np.exp(values) if law.logarithmic else np.asarray(values, float)


def prior_width(law: Law) -> float:
    """Standard deviation, on the scale of the fit, of a normal law with the same quantiles of 5 and 95 %."""
    low, high = fit_scale(law, law.quantile(np.array([0.05, 0.95])))
    return float(high - low) / (2.0 * NORMAL_90)


class SampledLog(NamedTuple):
    """A log as the fit sees it.

    Args:
        outputs: Measured outputs, NaN where missing, shape (channels, samples).
        offsets: Their times less the sample instants, in samples, shape (channels, samples).
        commands: Shape (channels, samples).
        replayed: Channels whose commands are those of the analysed controller for the logged outputs.
    """

    outputs: np.ndarray
    offsets: np.ndarray
    commands: np.ndarray
    replayed: tuple[str, ...]


class Readings(NamedTuple):
    """The logged outputs of one channel, and how they lie between the simulated samples.

    Args:
        channel: Position of the channel.
        times: Times of the readings [s], shape (n,).
        values: The readings, shape (n,).
        nodes: Four samples around each reading, shape (n, 4).
        weights: Weights of the cubic polynomial through them, shape (n, 4).
        floor: Least variance of the noise.
    """

    channel: int
    times: np.ndarray
    values: np.ndarray
    nodes: np.ndarray
    weights: np.ndarray
    floor: float

    @classmethod
    def of(cls, log: SampledLog, channel: int, sample_time: float) -> "Readings":
        """The readings of a channel."""
        known = np.flatnonzero(np.isfinite(log.outputs[channel]))
        place = known + log.offsets[channel, known]
        first = np.clip(np.floor(place).astype(int) - 1, 0, max(log.outputs.shape[1] - 4, 0))
        nodes = first[:, None] + np.arange(4)
        weights = np.ones((len(known), 4))
        for i in range(4):
            for j in range(4):
                if i != j:
                    weights[:, i] *= (place - nodes[:, j]) / (i - j)
        values = log.outputs[channel, known]
        floor = (LEAST_NOISE * max(float(np.abs(values).max(initial=0.0)), 1e-300)) ** 2
        return cls(channel, sample_time * place, values, nodes, weights, floor)

    def at_times(self, sampled: np.ndarray) -> np.ndarray:
        """Values between samples, shape (..., n), of a signal of shape (..., samples)."""
        return np.sum(self.weights * sampled[..., self.nodes], axis=-1)


class NormalEquations(NamedTuple):
    """The normal equations of one iteration: weighted sum of squares, gradient and information matrix."""

    cost: float
    gradient: np.ndarray
    information: np.ndarray


@dataclass
class FitProblem:
    """The least-squares problem of one log; coordinates are distances from the medians in prior widths.

    Args:
        study: The study.
        names: The numbers.
        predict: Their prediction.
        log: The log.
    """

    study: Study
    names: Sequence[str]
    predict: Prediction
    log: SampledLog

    def __post_init__(self) -> None:
        self.laws = [self.study.laws[name] for name in self.names]
        self.widths = np.array([prior_width(law) for law in self.laws])
        self.middles = np.array([fit_scale(law, law.median) for law in self.laws])
        counts = np.isfinite(self.log.outputs).sum(axis=1)
        sample_time = self.study.loop.sample_time
        self.readings = [Readings.of(self.log, int(i), sample_time) for i in np.flatnonzero(counts >= LEAST_SAMPLES)]
        self.noises: list[Noise] = [WHITE] * len(self.readings)
        self.variances = [max(float(np.var(part.values)), part.floor) for part in self.readings]

    def values(self, at: np.ndarray) -> np.ndarray:
        """The numbers at coordinates."""
        scaled = self.middles + at * self.widths
        return np.array([float(unscaled(law, s)) for law, s in zip(self.laws, scaled, strict=True)])

    def admissible(self, values: np.ndarray) -> bool:
        """Whether every number is in its range."""
        quantities = (self.study.numbers[name].quantity for name in self.names)
        return all(quantity.violated_by(x, x) is None for quantity, x in zip(quantities, values, strict=True))

    def columns(self, at: np.ndarray) -> list[np.ndarray]:
        """Residual and minus its derivative by each coordinate, for each channel with readings, shape (n, 1 + p)."""
        values = self.values(at)
        predicted, slopes = self.predict(values, self.log.commands)
        chain = self.widths * [x if law.logarithmic else 1.0 for law, x in zip(self.laws, values, strict=True)]
        columns = []
        for part in self.readings:
            residual = part.values - part.at_times(predicted[part.channel])
            slope = part.at_times(slopes[:, part.channel]) * chain[:, None]
            columns.append(np.vstack([residual, slope]).T)
        return columns

    def step(self, at: np.ndarray) -> NormalEquations:
        """The normal equations at coordinates; infinite cost where the simulated output is not finite."""
        size = len(self.names)
        whole = np.zeros((1 + size, 1 + size))
        for part, noise, variance, columns in zip(
            self.readings, self.noises, self.variances, self.columns(at), strict=True
        ):
            if not np.isfinite(columns).all():
                return NormalEquations(math.inf, np.zeros(size), np.eye(size))
            whole += weighted_products(noise, part.times, columns)[0] / variance
        return NormalEquations(float(whole[0, 0]), whole[1:, 0], whole[1:, 1:])

    def searches(self, at: np.ndarray) -> list[NoiseSearch]:
        """The search for the noise of each channel's residual."""
        pairs = zip(self.readings, self.columns(at), strict=True)
        return [NoiseSearch(part.times, columns, part.floor) for part, columns in pairs]

    def reweighted(self, at: np.ndarray) -> None:
        """Take for the noise what the residual at coordinates tells of it."""
        for place, search in enumerate(self.searches(at)):
            self.noises[place], misfit = search.likely()
            self.variances[place] = misfit.variance


class Minimum(NamedTuple):
    """Where a search ends.

    Args:
        at: Coordinates.
        step: The normal equations there.
    """

    at: np.ndarray
    step: NormalEquations


def minimised(problem: FitProblem, at: np.ndarray) -> Minimum:
    """Gauss-Newton with Levenberg's damping, from coordinates on."""
    damping, here = 1e-3, problem.step(at)
    for _ in range(ITERATIONS if math.isfinite(here.cost) else 0):
        least = 1e-12 * max(float(np.diag(here.information).max()), 1e-300)
        damped = here.information + damping * np.diag(np.maximum(np.diag(here.information), least))
        move = np.linalg.lstsq(damped, here.gradient, rcond=None)[0]
        move *= min(1.0, LARGEST_STEP / max(float(np.abs(move).max()), 1e-300))
        tried = at + move
        new = None
        if problem.admissible(problem.values(tried)):
            new = problem.step(tried)
        if new is not None and new.cost <= here.cost:
            done = float(np.abs(move).max()) < 1e-8 or here.cost - new.cost < 1e-12 * here.cost
            at, here, damping = tried, new, 0.1 * damping
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e12 or float(np.abs(move).max()) < 1e-12:
                break
    return Minimum(at, here)


def starting_points(problem: FitProblem) -> np.ndarray:
    """Coordinates from which minima are looked for: the laws' medians, then Sobol's points at quantiles of all laws.

    Returns:
        Shape (m, n).
    """
    levels = stats.qmc.Sobol(len(problem.names), rng=np.random.default_rng(0)).random(MOST_STARTS)
    levels[0] = 0.5
    scaled = [fit_scale(law, law.quantile(column)) for law, column in zip(problem.laws, levels.T, strict=True)]
    return (np.array(scaled).T - problem.middles) / problem.widths


Group = tuple[Minimum, int]
"""A minimum, and the number of starts that lead there."""


def distinct_minima(ends: Sequence[Group]) -> list[Group]:
    """Minima that differ, the best first; without infinite ones."""
    groups: list[Group] = []
    finite = [group for group in ends if math.isfinite(group[0].step.cost)]
    for minimum, starts in sorted(finite, key=lambda group: group[0].step.cost):
        for place, (known, count) in enumerate(groups):
            if np.abs(minimum.at - known.at).max() < NEAR:
                groups[place] = (known, count + starts)
                break
        else:
            groups.append((minimum, starts))
    return groups


def unseen_minima(starts: int, minima: int) -> float:
    """Expected number of minima that no start has led to, by Boender and Rinnooy Kan's rule."""
    if starts <= minima + 2:
        return math.inf
    return minima * (starts - 1) / (starts - minima - 2) - minima


class MinimumSearch(NamedTuple):
    """What the search for the minimum found.

    Args:
        best: The best minimum, with the noise of the problem.
        others: Other ends of the search with the number of starts that lead there, by the same noise.
        starts: Starts of the search.
        starts_here: Starts that end in the best minimum.
    """

    best: Minimum
    others: tuple[Group, ...]
    starts: int
    starts_here: int


def reweighted_fit(problem: FitProblem, at: np.ndarray) -> Minimum:
    """The minimum from coordinates on, with the noise that its own residual tells; the problem then has that noise."""
    minimum = minimised(problem, at)
    for _ in range(FILTERINGS):
        problem.reweighted(minimum.at)
        before = minimum
        minimum = minimised(problem, minimum.at)
        wide = math.sqrt(max(float(np.diag(minimum.step.information).max()), 1e-300))
        if np.abs(minimum.at - before.at).max() <= 1e-2 / wide:
            break
    return minimum


def best_fit(problem: FitProblem) -> MinimumSearch | None:
    """The best minimum of several starts, with the noise of its residual; None if no start has a finite output."""
    ends: list[Group] = []
    groups: list[Group] = []
    points = starting_points(problem)
    while len(ends) < MOST_STARTS:
        ends += [(minimised(problem, at), 1) for at in points[len(ends) : len(ends) + STARTS]]
        groups = distinct_minima(ends)
        if unseen_minima(len(ends), len(groups)) < UNSEEN:
            break
    for _ in range(MINIMUM_ROUNDS if groups else 0):
        (first, count), *others = groups
        best = reweighted_fit(problem, first.at)
        groups = distinct_minima([(best, count), *((minimised(problem, other.at), same) for other, same in others)])
        if groups[0][0].step.cost >= best.step.cost:
            break
    if not groups:
        return None
    return MinimumSearch(groups[0][0], tuple(groups[1:]), len(ends), groups[0][1])


def averaged_covariance(problem: FitProblem, posteriors: Sequence[Posterior]) -> np.ndarray:
    """Second moments of the coordinates about the estimate, over all noises that the residual allows; shape (p, p).

    Args:
        problem: The problem.
        posteriors: The noise of each channel with readings, at the estimate.
    """
    size = len(problem.names)
    information, gradient = np.zeros((DRAWS, size, size)), np.zeros((DRAWS, size))
    random = np.random.default_rng(0)
    for posterior in posteriors:
        levels = np.cumsum([candidate.weight for candidate in posterior.candidates])
        chosen = np.searchsorted(levels, (np.arange(DRAWS) + 0.5) / DRAWS * levels[-1])
        chosen = random.permutation(np.minimum(chosen, len(levels) - 1))
        information += np.array([candidate.misfit.information for candidate in posterior.candidates])[chosen]
        gradient += np.array([candidate.misfit.gradient for candidate in posterior.candidates])[chosen]
    scale = np.sqrt(np.mean([np.diag(each) for each in information], axis=0))
    scaled = information / np.outer(scale, scale) + 1e-12 * np.eye(size)
    covariances = np.linalg.inv(scaled)
    moves = np.einsum("gij,gj->gi", covariances, gradient / scale)
    moments = np.mean(covariances + moves[:, :, None] * moves[:, None, :], axis=0)
    return moments / np.outer(scale, scale)
