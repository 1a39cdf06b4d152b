"""Fits of a log with some of its signals at other times, compared with the fit at the logged times.

The fit is repeated at the shift that leaves the least residual. Both fits then have the noise of their residual, and
the logarithms of their likelihoods tell whether the shift is needed.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem, Readings
from dssc_jax.flight_logs.fit.minima import Minimum, minimise, reweighted_minimum
from dssc_jax.statistics.correlated_noise import Noise, weighted_products

LONGEST_SHIFT = 0.5  # s, longest shift that is tried
LONGEST_SHARE = 0.1  # longest shift that is tried, as a share of the log's samples
MOST_SHIFTS = 25  # largest number of shifts that are tried on either side
LEAST_SHIFT = 0.5  # samples, least shift that matters: commands and outputs count at the nearest sample
ROUNDING = math.sqrt(1.0 / 12.0)  # samples: the standard deviation of a uniform error of one
SIGNIFICANCE = 1e-4
LARGE_MOVE = 1.0  # least move of an estimate that matters, in its standard deviations
LARGE_PART = 0.7  # share of the residual without a shift that is left if a shift matters whatever it moves
EXPLAINED = 0.97  # share of the residual without a shift that may be left if a shift explains it


class Shifts(Protocol):
    """The problem of a fit with signals that are shifted by whole samples; all shifts have the same readings.

    Args:
        problem: The problem without a shift.
        noises: Noise of each channel's residual, which all shifts share.
        variances: Variance of the noise of each channel.
    """

    problem: FitProblem
    noises: list[Noise]
    variances: list[float]

    def at(self, channels: Sequence[int], shift: int) -> FitProblem:
        """The problem corrected for a delay of some channels by a number of samples.

        Late outputs are moved to earlier times, and commands that act late to later times.

        Args:
            channels: Positions of the channels.
            shift: The delay in samples; negative: a lead.
        """
        ...


class Delay(NamedTuple):
    """A delay of outputs, or of commands, with which a log fits better.

    Args:
        channels: Positions of the channels that are shifted.
        time: How much later outputs are than predicted, or commands act than logged [s]; negative: earlier.
        deviation: Standard deviation of the time [s].
        p_value: Largest probability, without a delay, of as large a gain of the likelihood by one of the shifts.
        moves: How far the shift moves the estimates, in their standard deviations without it, by number.
        values: The numbers with the shift.
        unshifted: Root mean squares of the residuals of the shifted channels without the shift.
        shifted: Root mean squares of the residuals of the shifted channels with the shift.
    """

    channels: tuple[int, ...]
    time: float
    deviation: float
    p_value: float
    moves: dict[str, float]
    values: dict[str, float]
    unshifted: tuple[float, ...]
    shifted: tuple[float, ...]

    def matters(self, sample_time: float) -> bool:
        """Whether the delay is certain, and moves an estimate far or explains much of a residual."""
        pairs = zip(self.unshifted, self.shifted, strict=True)
        is_large_part = any(shifted < LARGE_PART * unshifted for unshifted, shifted in pairs)
        is_large_move = max(map(abs, self.moves.values())) > LARGE_MOVE
        is_certain = self.p_value < SIGNIFICANCE and abs(self.time) >= LEAST_SHIFT * sample_time
        return is_certain and (is_large_move or is_large_part)

    @property
    def size_text(self) -> str:
        """The absolute value of the delay with its standard deviation, in words."""
        margin = f" ± {self.deviation:.2g}" if math.isfinite(self.deviation) else ""
        return f"{abs(self.time):.3g}{margin} s"

    def move_text(self, unshifted_values: Mapping[str, float]) -> str:
        """The number that the shift moves farthest, with its values, in words.

        Args:
            unshifted_values: The numbers without the shift.
        """
        number = max(self.moves, key=lambda name: abs(self.moves[name]))
        return f"{number} is {self.values[number]:.4g} in place of {unshifted_values[number]:.4g}"

    @property
    def explains(self) -> bool:
        """Whether the shift clearly lowers the residual of any of the channels."""
        pairs = zip(self.unshifted, self.shifted, strict=True)
        return any(shifted < EXPLAINED * unshifted for unshifted, shifted in pairs)


def longest_shift(problem: FitProblem) -> int:
    """The longest shift that is tried, in samples."""
    samples = problem.log.outputs.shape[1]
    return int(min(LONGEST_SHIFT / problem.study.loop.sample_time, LONGEST_SHARE * samples, MOST_SHIFTS))


def fitted_delay(
    shifts: Shifts, unshifted_end: Minimum, channels: Sequence[int], shift: int, margin: int
) -> Delay | None:
    """Fit a log with a delay, from a likely shift on; None if no shift is better.

    Both fits, with the shift and without it, have the noise of their residual.

    Args:
        shifts: The problems, with the noise of the minimum.
        unshifted_end: The end of the fit without a shift.
        channels: Positions of the channels that are shifted.
        shift: The likely shift, in samples.
        margin: The longest shift, in samples.
    """
    problem = shifts.problem
    sample_time = problem.study.loop.sample_time
    shift, end = climbed_shift(shifts, unshifted_end, unshifted_end, channels, shift, margin)
    if shift == 0 or not end.cost < unshifted_end.cost:
        return None
    shifted_problem = shifts.at(channels, shift)
    end = reweighted_minimum(shifted_problem, end)
    shifts.noises, shifts.variances = shifted_problem.noises, shifted_problem.variances
    shift, end = climbed_shift(shifts, end, minimise(shifts.at((), 0), unshifted_end.x), channels, shift, margin)
    if shift == 0:
        return None
    shifted_problem = shifts.at(channels, shift)
    end = reweighted_minimum(shifted_problem, end)
    unshifted_problem = shifts.at((), 0)
    unshifted_end = reweighted_minimum(unshifted_problem, unshifted_end)
    gain = 2.0 * (log_likelihood(shifted_problem, end.x) - log_likelihood(unshifted_problem, unshifted_end.x))
    compared = 2 * margin + 1
    p_value = min(1.0, compared * float(stats.chi2.sf(max(gain, 0.0), 1)))
    distance, deviation = refinement(shifts, end, channels, shift, margin)
    deviations = np.sqrt(np.diag(np.linalg.pinv(unshifted_end.equations.information)))
    relative_moves = (end.x - unshifted_end.x) / np.maximum(deviations, TINY)
    return Delay(
        channels=tuple(channels),
        time=sample_time * (shift + distance),
        deviation=sample_time * deviation,
        p_value=p_value,
        moves={problem.names[i]: float(relative_moves[i]) for i in problem.fitted},
        values=problem.named_values(end.x),
        unshifted=residuals(unshifted_problem, channels, unshifted_end.x),
        shifted=residuals(shifted_problem, channels, end.x),
    )


def climbed_shift(
    shifts: Shifts, start: Minimum, unshifted_end: Minimum, channels: Sequence[int], shift: int, margin: int
) -> tuple[int, Minimum]:
    """Climb from a shift to one whose neighbours fit no better, and return it with the end of its fit.

    Args:
        shifts: The problems.
        start: The minimum from which fits start.
        unshifted_end: The end of the fit without a shift.
        channels: Indices of the channels that are shifted.
        shift: The first shift.
        margin: The longest shift.
    """
    minimum_of_shift = {0: unshifted_end}

    def cost_at(candidate: int) -> float:
        """The least weighted sum of squares with a shift, infinite beyond the margin; each shift is fitted once."""
        if abs(candidate) > margin:
            return math.inf
        if candidate not in minimum_of_shift:
            minimum_of_shift[candidate] = minimise(shifts.at(channels, candidate), start.x)
        return minimum_of_shift[candidate].cost

    while True:
        better = min((shift, shift - 1, shift + 1), key=cost_at)
        if better == shift:
            return shift, minimum_of_shift[shift]
        shift = better


def log_likelihood(problem: FitProblem, x: np.ndarray) -> float:
    """The logarithm of the likelihood of all readings, at the likeliest variance of each channel's noise.

    Args:
        problem: The problem, with its noises.
        x: Coordinates of the numbers, shape (p,).
    """
    total = 0.0
    for readings, noise, columns in zip(problem.readings, problem.noises, problem.columns(x), strict=True):
        products, log_det = weighted_products(noise, readings.times, columns[:, :1])
        total += likelihood_of_cost(readings, float(products[0, 0]), log_det)
    return total


def likelihood_of_cost(readings: Readings, cost: float, log_det: float) -> float:
    """Logarithm of the likelihood of a channel's readings at the likeliest variance of their noise.

    Args:
        readings: The readings.
        cost: Weighted sum of squares of the residual under noise of unit variance.
        log_det: Logarithm of the determinant of the covariance of that noise.
    """
    count = len(readings.times)
    return -0.5 * (log_det + count * math.log(max(cost, readings.floor * count, TINY)))


def refinement(shifts: Shifts, end: Minimum, channels: Sequence[int], shift: int, margin: int) -> tuple[float, float]:
    """How far the best shift lies beside a whole one, and its standard deviation, both in samples.

    The best shift is at the minimum of a parabola through the fits with the whole shift and its two neighbours.
    Commands and outputs count at the nearest sample, so the deviation includes that of a uniform error of one sample.
    It is infinite at the longest shift, and where the parabola has no minimum.

    Args:
        shifts: The problems.
        end: The minimum with the whole shift.
        channels: Positions of the channels that are shifted.
        shift: The whole shift.
        margin: The longest shift.
    """
    if abs(shift) == margin:
        return 0.0, math.inf
    sides = [minimise(shifts.at(channels, shift + move), end.x).cost for move in (-1, 1)]
    bend = sides[0] + sides[1] - 2.0 * end.cost
    if not math.isfinite(bend) or bend <= 0.0:
        return 0.0, math.inf
    return float(np.clip(0.5 * (sides[0] - sides[1]) / bend, -0.5, 0.5)), math.hypot(math.sqrt(2.0 / bend), ROUNDING)


def residuals(problem: FitProblem, channels: Sequence[int], x: np.ndarray) -> tuple[float, ...]:
    """The root mean square of the residual of each of the given channels, at coordinates x of shape (p,).

    Args:
        problem: The problem, with the shift or without it.
        channels: Positions of the channels.
        x: Coordinates of the numbers, shape (p,).
    """
    pairs = zip(problem.readings, problem.columns(x), strict=True)
    return tuple(float(np.sqrt(np.mean(c[:, 0] ** 2))) for readings, c in pairs if readings.channel in channels)


def linear_cost(products: np.ndarray) -> float:
    """The least weighted sum of squares that a linearised prediction allows.

    Args:
        products: Weighted products of the residual and the prediction's slopes, shape (1 + p, 1 + p).
    """
    step = np.linalg.lstsq(products[1:, 1:], products[1:, 0], rcond=None)[0]
    return float(products[0, 0] - products[1:, 0] @ step)
