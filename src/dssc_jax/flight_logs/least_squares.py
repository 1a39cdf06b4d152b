"""The least-squares problem of a logged flight: its residual, the noise of it, its minima and their covariance.

Coordinates x are distances of the numbers from the medians of their laws, in standard deviations of the laws; numbers
with a logarithmic law count by their logarithms. With the residual r(x), its Jacobian -J and the covariance S of its
noise, the sum of squares r' S^-1 r has the information matrix J' S^-1 J and the descent direction J' S^-1 r.

References:
    C. G. E. Boender, A. H. G. Rinnooy Kan, "Bayesian stopping rules for multistart global optimization methods",
        Mathematical Programming 37 (1987) 59-80.
    J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), section 10.3.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy import special, stats

from dssc_jax.flight_logs.prediction import Prediction
from dssc_jax.flight_logs.sampled_log import SampledLog
from dssc_jax.flight_logs.search_limits import SearchCount
from dssc_jax.statistics.correlated_noise import WHITE, Noise, weighted_products
from dssc_jax.statistics.noise_posterior import NoisePosterior, NoiseSearch
from dssc_jax.study import Law, Study

ITERATIONS = 40  # of Gauss-Newton
REWEIGHTINGS = 5  # of the residual by its noise
LARGEST_STEP = 2.0  # prior standard deviations in one iteration
NORMAL_90 = float(special.ndtri(0.95))
LEAST_NOISE = 1e-9  # of the output's size: below, the residual is rounding
LEAST_SAMPLES = 20  # of a channel: fewer do not identify its noise
SCREENED = 64  # points whose residuals are compared; the search starts at the best ones
STARTS = 8  # of the search for the minimum, at first; the first one is at the medians of the laws
MOST_STARTS = 24
UNSEEN_MINIMA = 0.5  # expected number of minima that the search has not found, below which it ends
SAME_MINIMUM = 0.1  # prior standard deviations between two ends of the search in the same minimum
MINIMUM_ROUNDS = 3  # of the search for the best minimum, each with the noise of the minimum before
NOISE_DRAWS = 512  # of the channels' noises together
NEIGHBOURS = 48  # points around a minimum whose residuals are compared
FARTHEST = 5.0  # farthest of these neighbours, in standard deviations of the estimate
RESTARTED = 4  # best of them, from which the search starts again
NEIGHBOUR_ROUNDS = 4
LEAST_GAIN = 0.1  # least decrease of the weighted sum of squares by which another round follows
TINY = 1e-300  # in place of 0 in a denominator


def fit_scale(law: Law, values: np.ndarray | float) -> np.ndarray:
    """Values on the scale of the fit."""
    return np.log(values) if law.logarithmic else np.asarray(values, float)


def from_fit_scale(law: Law, values: np.ndarray | float) -> np.ndarray:
    """The inverse of :func:`fit_scale`."""
    return np.exp(values) if law.logarithmic else np.asarray(values, float)


def prior_width(law: Law) -> float:
    """Standard deviation, on the scale of the fit, of a normal law with the same quantiles of 5 and 95 %."""
    low, high = fit_scale(law, law.quantile(np.array([0.05, 0.95])))
    return float(high - low) / (2.0 * NORMAL_90)


class Readings(NamedTuple):
    """The n logged outputs of one channel, and their interpolation between the simulated samples."""

    channel: int  # position of the channel
    times: np.ndarray  # [s], shape (n,)
    values: np.ndarray  # shape (n,)
    nodes: np.ndarray  # four samples around each reading, shape (n, 4)
    weights: np.ndarray  # of the cubic polynomial through them, shape (n, 4)
    floor: float  # least variance of the noise
    sensor: float  # variance of what the study's sensor adds to a reading

    @classmethod
    def of(cls, log: SampledLog, channel: int, sample_time: float) -> "Readings":
        """The readings of a channel."""
        finite_rows = np.flatnonzero(np.isfinite(log.outputs[channel]))
        values = log.outputs[channel, finite_rows]
        position = finite_rows + log.offsets[channel, finite_rows]
        first = np.clip(np.floor(position).astype(int) - 1, 0, max(log.outputs.shape[1] - 4, 0))
        nodes = first[:, None] + np.arange(4)
        weights = np.ones((len(finite_rows), 4))
        for i in range(4):
            for j in range(4):
                if i != j:
                    weights[:, i] *= (position - nodes[:, j]) / (i - j)
        largest = max(float(np.abs(values).max(initial=0.0)), TINY)
        sensor = log.sensor_noise[channel] ** 2
        return cls(
            channel=channel,
            times=sample_time * position,
            values=values,
            nodes=nodes,
            weights=weights,
            floor=(LEAST_NOISE * largest) ** 2,
            sensor=sensor,
        )

    def interpolate(self, sampled: np.ndarray) -> np.ndarray:
        """Values at the times of the readings, shape (..., n), of a signal of shape (..., samples)."""
        with np.errstate(invalid="ignore"):  # a simulation that diverges becomes NaN, and no minimum
            return np.sum(self.weights * sampled[..., self.nodes], axis=-1)


class NormalEquations(NamedTuple):
    """The normal equations at a point: r' S^-1 r, J' S^-1 r of shape (p,), and J' S^-1 J of shape (p, p)."""

    cost: float
    gradient: np.ndarray
    information: np.ndarray


@dataclass
class FitProblem:
    """The least-squares problem of one log for p numbers of a study."""

    study: Study
    names: Sequence[str]
    predict: Prediction
    log: SampledLog
    count: SearchCount = field(default_factory=SearchCount)

    def __post_init__(self) -> None:
        self.laws = [self.study.laws[name] for name in self.names]
        self.widths = np.array([prior_width(law) for law in self.laws])
        self.medians = np.array([fit_scale(law, law.median) for law in self.laws])
        counts = np.isfinite(self.log.outputs).sum(axis=1)
        sample_time = self.study.loop.sample_time
        channels = np.flatnonzero(counts >= LEAST_SAMPLES)
        self.readings = [Readings.of(self.log, int(channel), sample_time) for channel in channels]
        self.noises: list[Noise] = [WHITE] * len(self.readings)
        self.variances = [max(float(np.var(readings.values)), readings.floor) for readings in self.readings]

    def scaled(self, x: np.ndarray) -> np.ndarray:
        """The numbers on the scale of the fit, at coordinates."""
        return self.medians + x * self.widths

    def values(self, x: np.ndarray) -> np.ndarray:
        """The numbers at coordinates."""
        pairs = zip(self.laws, self.scaled(x), strict=True)
        return np.array([float(from_fit_scale(law, scaled)) for law, scaled in pairs])

    def named_values(self, x: np.ndarray) -> dict[str, float]:
        """The numbers at coordinates, by name."""
        return dict(zip(self.names, self.values(x).tolist(), strict=True))

    def is_admissible(self, values: np.ndarray) -> bool:
        """Whether these values of the fitted numbers, and all numbers that follow from them, are in their ranges.

        All other laws have their medians, which are checked, too.
        """
        medians = {name: law.median for name, law in self.study.laws.items()}
        return not self.study.violations(medians | dict(zip(self.names, values.tolist(), strict=True)))

    def columns(self, x: np.ndarray, commands: np.ndarray | None = None) -> list[np.ndarray]:
        """Residual r and slopes J at coordinates, for each channel with readings, shape (n, 1 + p).

        The commands are those of the log, or others.
        """
        values = self.values(x)
        predicted, slopes = self.predict(values, self.log.commands if commands is None else commands)
        chain = self.widths * [value if law.logarithmic else 1.0 for law, value in zip(self.laws, values, strict=True)]
        columns = []
        for readings in self.readings:
            residual = readings.values - readings.interpolate(predicted[readings.channel])
            slope = readings.interpolate(slopes[:, readings.channel]) * chain[:, None]
            columns.append(np.vstack([residual, slope]).T)
        return columns

    def normal_equations(self, x: np.ndarray, commands: np.ndarray | None = None) -> NormalEquations:
        """The normal equations at coordinates; infinite cost where the simulated output diverges."""
        self.count.add()
        count = len(self.names)
        products = np.zeros((1 + count, 1 + count))
        for readings, noise, variance, columns in zip(
            self.readings, self.noises, self.variances, self.columns(x, commands), strict=True
        ):
            if not np.isfinite(columns).all():
                return NormalEquations(math.inf, np.zeros(count), np.eye(count))
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # squares of what diverges
                products += weighted_products(noise, readings.times, columns)[0] / variance
        if not np.isfinite(products).all():
            return NormalEquations(math.inf, np.zeros(count), np.eye(count))
        return NormalEquations(float(products[0, 0]), products[1:, 0], products[1:, 1:])

    def noise_searches(self, x: np.ndarray) -> list[NoiseSearch]:
        """The search for the noise of each channel's residual at coordinates."""
        pairs = zip(self.readings, self.columns(x), strict=True)
        return [NoiseSearch(readings.times, columns, readings.floor, readings.sensor) for readings, columns in pairs]

    def reweight(self, x: np.ndarray) -> None:
        """Replace the noises by the likeliest ones of the residual at coordinates."""
        for row, search in enumerate(self.noise_searches(x)):
            self.noises[row], noise_fit = search.likeliest()
            self.variances[row] = noise_fit.variance


class Minimum(NamedTuple):
    """The end of a search: its coordinates, the normal equations there, and the number of starts that end there."""

    x: np.ndarray
    equations: NormalEquations
    starts: int

    @property
    def cost(self) -> float:
        """The weighted sum of squares."""
        return self.equations.cost


def minimise(problem: FitProblem, x: np.ndarray, starts: int = 1, to_end: bool = False) -> Minimum:
    """Gauss-Newton with Levenberg's damping, from coordinates on, for a number of starts.

    It ends early where the search has to end, unless ``to_end``.
    """
    damping = 1e-3
    equations = problem.normal_equations(x)
    for _ in range(ITERATIONS if math.isfinite(equations.cost) else 0):
        if problem.count.reason and not to_end:
            break
        diagonal = np.diag(equations.information)
        floor = 1e-12 * max(float(diagonal.max()), TINY)
        damped = equations.information + damping * np.diag(np.maximum(diagonal, floor))
        move = np.linalg.lstsq(damped, equations.gradient, rcond=None)[0]
        move *= min(1.0, LARGEST_STEP / max(float(np.abs(move).max()), TINY))
        largest = float(np.abs(move).max())
        trial_x = x + move
        trial = None
        if problem.is_admissible(problem.values(trial_x)):
            trial = problem.normal_equations(trial_x)
        if trial is not None and trial.cost <= equations.cost:
            is_converged = largest < 1e-8 or equations.cost - trial.cost < 1e-12 * equations.cost
            x = trial_x
            equations = trial
            damping *= 0.1
            if is_converged:
                break
        else:
            damping *= 10.0
            if damping > 1e12 or largest < 1e-12:
                break
    return Minimum(x, equations, starts)


def candidate_points(problem: FitProblem) -> np.ndarray:
    """Points at which the search may start, shape (m, p): the laws' medians, then Sobol's at quantiles of all laws."""
    levels = stats.qmc.Sobol(len(problem.names), rng=np.random.default_rng(0)).random(SCREENED)
    levels[0] = 0.5
    scaled = [fit_scale(law, law.quantile(column)) for law, column in zip(problem.laws, levels.T, strict=True)]
    return (np.array(scaled).T - problem.medians) / problem.widths


def screened_points(problem: FitProblem) -> np.ndarray:
    """The candidates in the order of the search, shape (m, p): the medians, then by their residuals."""
    points = candidate_points(problem)
    costs = np.full(len(points), np.inf)
    costs[0] = -np.inf
    for row in range(1, len(points)):
        if problem.count.reason:
            break
        costs[row] = problem.normal_equations(points[row]).cost
    return points[np.argsort(costs, kind="stable")]


def distinct_minima(ends: Sequence[Minimum]) -> list[Minimum]:
    """Minima that differ, the best first; without infinite ones."""
    minima: list[Minimum] = []
    finite = [end for end in ends if math.isfinite(end.cost)]
    for end in sorted(finite, key=lambda end: end.cost):
        for index, minimum in enumerate(minima):
            if np.abs(end.x - minimum.x).max() < SAME_MINIMUM:
                minima[index] = minimum._replace(starts=minimum.starts + end.starts)
                break
        else:
            minima.append(end)
    return minima


def unseen_minima(starts: int, minima: int) -> float:
    """Expected number of minima that no start has led to, by Boender and Rinnooy Kan's rule."""
    if starts <= minima + 2:
        return math.inf
    return minima * (starts - 1) / (starts - minima - 2) - minima


class MinimumSearch(NamedTuple):
    """The best minimum and its rivals, all by the noise of the best one, and the number of starts of the search."""

    best: Minimum
    rivals: list[Minimum]
    starts: int

    def restricted_to(self, mask: Sequence[bool]) -> list[Minimum]:
        """The minima in some of the coordinates, as starts of another search."""
        return [minimum._replace(x=minimum.x[np.array(mask)]) for minimum in (self.best, *self.rivals)]


def reweighted_minimum(problem: FitProblem, minimum: Minimum) -> Minimum:
    """Minimise from another minimum, weighted by the noise of the residual, which the problem then has."""
    starts = minimum.starts
    minimum = minimise(problem, minimum.x, starts, to_end=True)
    for _ in range(REWEIGHTINGS):
        problem.reweight(minimum.x)
        previous = minimum
        minimum = minimise(problem, minimum.x, starts, to_end=True)
        precision = math.sqrt(max(float(np.diag(minimum.equations.information).max()), TINY))
        if np.abs(minimum.x - previous.x).max() <= 1e-2 / precision:
            break
    return minimum


def random_rays(seed: int, shape: tuple[int, int], nearest: float, farthest: float) -> np.ndarray:
    """Random directions, one in each row, with lengths between two."""
    random = np.random.default_rng(seed)
    rays = random.normal(size=shape)
    return rays * random.uniform(nearest, farthest, (shape[0], 1)) / np.linalg.norm(rays, axis=1, keepdims=True)


def neighbouring_minimum(problem: FitProblem, minimum: Minimum) -> Minimum:
    """The best minimum that the search finds from points around a minimum; the same one if none is better.

    Where limits of a sampled loop act, the residual has kinks and small jumps, and the search stops at one of them
    while better points are some standard deviations away.
    """
    for turn in range(NEIGHBOUR_ROUNDS):
        values, directions = np.linalg.eigh(minimum.equations.information)
        lengths = np.minimum(1.0 / np.sqrt(np.maximum(values, TINY)), LARGEST_STEP / FARTHEST)
        rays = random_rays(2 * turn, (NEIGHBOURS, len(problem.names)), 0.0, FARTHEST)
        points = []
        for x in minimum.x + (rays * lengths) @ directions.T:
            if problem.count.reason:
                return minimum
            if problem.is_admissible(problem.values(x)):
                points.append(Minimum(x, problem.normal_equations(x), minimum.starts))
        points.sort(key=lambda point: point.cost)
        ends = [minimise(problem, point.x, minimum.starts) for point in points[:RESTARTED]]
        best = min([minimum, *ends], key=lambda end: end.cost)
        gain = minimum.cost - best.cost
        minimum = best
        if gain < LEAST_GAIN:
            break
    return minimum


def searched_minima(problem: FitProblem) -> list[Minimum]:
    """Search from the best of many points, and return the ends, or those so far at a limit or an interrupt."""
    ends: list[Minimum] = []
    try:
        points = screened_points(problem)
        while len(ends) < MOST_STARTS and not (ends and problem.count.reason):
            for x in points[len(ends) : len(ends) + STARTS]:
                if ends and problem.count.reason:
                    break
                ends.append(minimise(problem, x))
            if unseen_minima(len(ends), len(distinct_minima(ends))) < UNSEEN_MINIMA:
                break
    except KeyboardInterrupt:
        if not ends:
            raise
        problem.count.interrupted = True
    return ends


def find_minima(problem: FitProblem, starting_minima: Sequence[Minimum] = ()) -> MinimumSearch | None:
    """Find the minima from several starts, or from given minima; None if no start has a finite output."""
    ends = [minimise(problem, minimum.x, minimum.starts) for minimum in starting_minima] or searched_minima(problem)
    minima = distinct_minima(ends)
    for turn in range(MINIMUM_ROUNDS if minima else 0):
        best = reweighted_minimum(problem, minima[0])
        if turn == 0:
            best = neighbouring_minimum(problem, best)
        minima = distinct_minima([best, *(minimise(problem, rival.x, rival.starts) for rival in minima[1:])])
        if minima[0].cost >= best.cost:
            break
    return MinimumSearch(minima[0], minima[1:], sum(end.starts for end in ends)) if minima else None


def averaged_covariance(problem: FitProblem, posteriors: Sequence[NoisePosterior]) -> np.ndarray:
    """Second moments of the coordinates about the estimate, over all noises that the residual allows; shape (p, p)."""
    count = len(problem.names)
    information = np.zeros((NOISE_DRAWS, count, count))
    gradient = np.zeros((NOISE_DRAWS, count))
    random = np.random.default_rng(0)
    for posterior in posteriors:
        noise_fits = [candidate.fit for candidate in posterior.candidates]
        levels = np.cumsum([candidate.weight for candidate in posterior.candidates])
        candidate_indices = np.searchsorted(levels, (np.arange(NOISE_DRAWS) + 0.5) / NOISE_DRAWS * levels[-1])
        candidate_indices = random.permutation(np.minimum(candidate_indices, len(levels) - 1))
        information += np.array([fit.information for fit in noise_fits])[candidate_indices]
        gradient += np.array([fit.gradient for fit in noise_fits])[candidate_indices]
    scale = np.sqrt(np.mean([np.diag(matrix) for matrix in information], axis=0))
    scaled = information / np.outer(scale, scale) + 1e-12 * np.eye(count)
    covariances = np.linalg.inv(scaled)
    moves = np.einsum("gij,gj->gi", covariances, gradient / scale)
    moments = np.mean(covariances + moves[:, :, None] * moves[:, None, :], axis=0)
    return moments / np.outer(scale, scale)
