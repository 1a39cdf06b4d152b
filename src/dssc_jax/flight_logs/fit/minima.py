"""The minima of a logged flight's sum of squares: Gauss-Newton steps from many starts.

References:
    C. G. E. Boender, A. H. G. Rinnooy Kan, "Bayesian stopping rules for multistart global optimization methods",
        Mathematical Programming 37 (1987) 59-80.
    J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), section 10.3.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem, NormalEquations, fit_scale

ITERATIONS = 40  # most steps of Gauss-Newton
REWEIGHTINGS = 5  # most times that the residual is weighted by its noise again
LARGEST_STEP = 2.0  # prior standard deviations in one iteration
SCREENED = 64  # points whose residuals are compared; the search starts at the best ones
STARTS = 8  # of the search for the minimum, at first; the first one is at the medians of the laws
MOST_STARTS = 24
UNSEEN_MINIMA = 0.5  # expected number of minima that the search has not found, below which it ends
SAME_MINIMUM = 0.1  # prior standard deviations between two ends of the search in the same minimum
MINIMUM_ROUNDS = 3  # of the search for the best minimum, each with the noise of the minimum before
NEIGHBOURS = 48  # points around a minimum whose residuals are compared
FARTHEST = 5.0  # farthest of these neighbours, in standard deviations of the estimate
RESTARTED = 4  # best of them, from which the search starts again
NEIGHBOUR_ROUNDS = 4
LEAST_GAIN = 0.1  # least decrease of the weighted sum of squares by which another round follows


class Minimum(NamedTuple):
    """The end of a search.

    Args:
        x: Coordinates of the end, shape (p,).
        equations: The normal equations at the end.
        starts: Number of starts of the search that end there.
    """

    x: np.ndarray
    equations: NormalEquations
    starts: int

    @property
    def cost(self) -> float:
        """The weighted sum of squares."""
        return self.equations.cost


def minimise(problem: FitProblem, x: np.ndarray, starts: int = 1, to_end: bool = False) -> Minimum:
    """Minimise the weighted sum of squares by Gauss-Newton steps with Levenberg's damping.

    Args:
        problem: The problem.
        x: Coordinates at which the steps begin, shape (p,).
        starts: Number of starts of the search for which the minimum counts.
        to_end: Whether to converge even if the search has reached a limit, which ends the steps otherwise.
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
    """Points at which the search may start, shape (m, p): the laws' medians, then quantiles at Sobol points."""
    levels = stats.qmc.Sobol(len(problem.names), rng=np.random.default_rng(0)).random(SCREENED)
    levels[0] = 0.5  # the medians
    scaled = [fit_scale(law, law.quantile(column)) for law, column in zip(problem.laws, levels.T, strict=True)]
    return (np.array(scaled).T - problem.medians) / problem.widths


def screened_points(problem: FitProblem) -> np.ndarray:
    """The candidates in the order of the search, shape (m, p): the medians, then the others by increasing residual.

    Candidates that a limit of the search leaves without a simulation come last.
    """
    points = candidate_points(problem)
    costs = np.full(len(points), np.inf)
    costs[0] = -np.inf
    for row in range(1, len(points)):
        if problem.count.reason:
            break
        costs[row] = problem.normal_equations(points[row]).cost
    return points[np.argsort(costs, kind="stable")]


def cost_with_laws(problem: FitProblem, minimum: Minimum) -> float:
    """The weighted sum of squares, plus the squares of the distances by which numbers lie outside of their laws.

    A log that determines unlikely numbers well keeps its minimum there, because its sum of squares is far larger
    elsewhere. Where a log hardly determines a number, a minimum inside the laws is the better one.

    Args:
        problem: The problem.
        minimum: The minimum.
    """
    return minimum.cost + float(np.sum(problem.beyond_laws(minimum.x) ** 2))


def distinct_minima(problem: FitProblem, ends: Sequence[Minimum]) -> list[Minimum]:
    """The distinct minima among the ends of searches, the best first, without those of infinite cost.

    Ends in the same minimum count once, with the sum of their starts.
    """
    minima: list[Minimum] = []
    finite = [end for end in ends if math.isfinite(end.cost)]
    for end in sorted(finite, key=lambda end: cost_with_laws(problem, end)):
        for index, minimum in enumerate(minima):
            if np.abs(end.x - minimum.x).max() < SAME_MINIMUM:
                minima[index] = minimum._replace(starts=minimum.starts + end.starts)
                break
        else:
            minima.append(end)
    return minima


def unseen_minima(starts: int, minima: int) -> float:
    """Expected number of minima that no start has led to, by Boender and Rinnooy Kan's rule.

    Args:
        starts: Number of starts.
        minima: Number of distinct minima that they have led to.
    """
    if starts <= minima + 2:
        return math.inf
    return minima * (starts - 1) / (starts - minima - 2) - minima


class MinimumSearch(NamedTuple):
    """The best minimum and its rivals, all weighted by the noise of the best one, and the number of starts."""

    best: Minimum
    rivals: list[Minimum]
    starts: int


def reweighted_minimum(problem: FitProblem, minimum: Minimum) -> Minimum:
    """Minimise from another minimum on, in turns with weighting by the likeliest noise of the residual.

    The noise of ``problem`` is replaced in place.

    Args:
        problem: The problem.
        minimum: The minimum from whose coordinates the search goes on.
    """
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
    """Vectors in random directions, one in each row, with random lengths.

    Args:
        seed: Seed of the random numbers.
        shape: Number of vectors and of their elements.
        nearest: The least length.
        farthest: The largest length.
    """
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
    """Search from the best of many points; return all ends, or those found before a limit or an interrupt."""
    ends: list[Minimum] = []
    try:
        points = screened_points(problem)
        while len(ends) < MOST_STARTS and not (ends and problem.count.reason):
            for x in points[len(ends) : len(ends) + STARTS]:
                if ends and problem.count.reason:
                    break
                ends.append(minimise(problem, x))
            if unseen_minima(len(ends), len(distinct_minima(problem, ends))) < UNSEEN_MINIMA:
                break
    except KeyboardInterrupt:
        if not ends:
            raise
        problem.count.interrupted = True
    return ends


def find_minima(problem: FitProblem, starting_minima: Sequence[Minimum] = ()) -> MinimumSearch | None:
    """Find the minima from several starts, or from given minima; None if the output diverges from every start.

    Args:
        problem: The problem, whose noises are replaced in place.
        starting_minima: Minima to start from; empty: a search from many points.
    """
    problem.weight_as_declared()
    ends = [minimise(problem, minimum.x, minimum.starts) for minimum in starting_minima] or searched_minima(problem)
    minima = distinct_minima(problem, ends)
    for turn in range(MINIMUM_ROUNDS if minima else 0):
        best = reweighted_minimum(problem, minima[0])
        if turn == 0:
            best = neighbouring_minimum(problem, best)
        ends = [best, *(minimise(problem, rival.x, rival.starts) for rival in minima[1:])]
        minima = distinct_minima(problem, ends)
        if cost_with_laws(problem, minima[0]) >= cost_with_laws(problem, best):
            break
    return MinimumSearch(minima[0], minima[1:], sum(end.starts for end in ends)) if minima else None
