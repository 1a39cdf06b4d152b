"""Whether logged outputs are later or earlier than the study predicts: a delay that a fit puts into other numbers.

The outputs are shifted by whole samples: all together, all but one, as the position of a vehicle without its heading,
and each channel alone. The fit is repeated at the shift that leaves least. Both fits then have the noise of their
residual, and the logarithms of their likelihoods tell whether the shift is needed. Where the search has ended early, no
fit can be repeated, and the sum of squares near its best numbers counts.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.least_squares import (
    LEAST_SAMPLES,
    TINY,
    FitProblem,
    Minimum,
    minimise,
    reweighted_minimum,
)
from dssc_jax.flight_logs.reader import signal_name
from dssc_jax.flight_logs.refusals import Doubt
from dssc_jax.statistics.correlated_noise import weighted_products

LONGEST_SHIFT = 0.5  # s
LONGEST_SHARE = 0.1  # of the log
MOST_SHIFTS = 25  # on either side
LEAST_SHIFT = 0.5  # samples: commands and outputs count at the nearest sample
ROUNDING = math.sqrt(1.0 / 12.0)  # samples: the standard deviation of a uniform error of one
SIGNIFICANCE = 1e-4
LARGE_MOVE = 1.0  # least move of an estimate that matters, in its standard deviations
EXPLAINED = 0.97  # share of the residual without a shift that may be left if a shift explains it
MOST_REMAINING = 0.7  # share of the sum of squares that a shift may leave to be told without a fit


class ScreenedShift(NamedTuple):
    """The shift with the least residual, if the prediction is linear in the numbers.

    Args:
        channels: Positions of the channels that are shifted.
        shift: By how many samples they are later; 0: none is better.
        remaining_share: Share of the weighted sum of squares that is left.
    """

    channels: tuple[int, ...]
    shift: int
    remaining_share: float


class LateOutput(NamedTuple):
    """Outputs that fit better at other times.

    Args:
        channels: Positions of the channels that are shifted.
        delay: How much later they are than predicted [s].
        p_value: Probability of as large a gain without a delay.
        deviation: Its standard deviation [s].
        moves: How far the shift moves the estimates, in their standard deviations without it, by number.
        values: The numbers with the shift.
        unshifted: Root mean squares of the residuals of the shifted channels without the shift.
        shifted: Root mean squares of the residuals of the shifted channels with the shift.
    """

    channels: tuple[int, ...]
    delay: float
    deviation: float
    p_value: float
    moves: dict[str, float]
    values: dict[str, float]
    unshifted: tuple[float, ...]
    shifted: tuple[float, ...]

    def matters(self, sample_time: float) -> bool:
        """Whether the outputs are certainly at other times, and the estimates depend on it."""
        is_large_move = max(map(abs, self.moves.values())) > LARGE_MOVE
        return self.p_value < SIGNIFICANCE and abs(self.delay) >= LEAST_SHIFT * sample_time and is_large_move

    @property
    def explains(self) -> bool:
        """Whether the shift clearly lowers the residual of any of the channels."""
        pairs = zip(self.unshifted, self.shifted, strict=True)
        return any(shifted < EXPLAINED * unshifted for unshifted, shifted in pairs)


class ShiftedProblems:
    """The problem of a fit with outputs that are shifted by whole samples; all shifts have the same readings.

    Args:
        problem: The problem, with the noise of its minimum.
        margin: The longest shift, in samples, within which no reading is at either end.
    """

    def __init__(self, problem: FitProblem, margin: int) -> None:
        self.problem = problem
        self.noises = problem.noises
        self.variances = problem.variances
        samples = problem.log.outputs.shape[1]
        self.outputs = problem.log.outputs.copy()
        self.outputs[:, : margin + 1] = np.nan
        self.outputs[:, samples - margin - 1 :] = np.nan
        for row in set(range(len(self.outputs))) - {readings.channel for readings in problem.readings}:
            self.outputs[row] = np.nan

    def has_enough_readings(self) -> bool:
        """Whether every channel keeps enough readings."""
        counts = np.isfinite(self.outputs).sum(axis=1)
        return all(counts[readings.channel] >= LEAST_SAMPLES for readings in self.problem.readings)

    def at(self, channels: Sequence[int], shift: int) -> FitProblem:
        """The problem with some channels' outputs earlier by a number of samples, with the same noise."""
        offsets = self.problem.log.offsets.copy()
        offsets[list(channels)] -= shift
        shifted = replace(self.problem, log=self.problem.log._replace(outputs=self.outputs, offsets=offsets))
        shifted.noises = list(self.noises)
        shifted.variances = list(self.variances)
        return shifted


def late_output(problem: FitProblem, minimum: Minimum) -> LateOutput | None:
    """The shift of outputs that lowers the residual at a minimum most.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.

    Returns:
        None if the log is too short, or no shift is better.
    """
    sample_time = problem.study.loop.sample_time
    margin = longest_shift(problem)
    shifts = ShiftedProblems(problem, margin)
    if margin < 1 or not shifts.has_enough_readings():
        return None
    unshifted_end = minimise(shifts.at((), 0), minimum.x)
    channels, shift, _ = screened_shift(shifts, unshifted_end.x, margin)
    if shift == 0:
        return None
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
    p_value = float(stats.chi2.sf(max(gain, 0.0), 1))
    distance, deviation = refinement(shifts, end, channels, shift, margin)
    delay = sample_time * (shift + distance)
    deviations = np.sqrt(np.diag(np.linalg.pinv(unshifted_end.equations.information)))
    relative_moves = (end.x - unshifted_end.x) / np.maximum(deviations, TINY)
    moves = dict(zip(problem.names, relative_moves.tolist(), strict=True))
    unshifted = residuals(unshifted_problem, channels, unshifted_end.x)
    shifted = residuals(shifted_problem, channels, end.x)
    return LateOutput(
        channels=channels,
        delay=delay,
        deviation=sample_time * deviation,
        p_value=p_value,
        moves=moves,
        values=problem.named_values(end.x),
        unshifted=unshifted,
        shifted=shifted,
    )


def longest_shift(problem: FitProblem) -> int:
    """The longest shift, in samples."""
    samples = problem.log.outputs.shape[1]
    return int(min(LONGEST_SHIFT / problem.study.loop.sample_time, LONGEST_SHARE * samples, MOST_SHIFTS))


def screened_shift(shifts: ShiftedProblems, x: np.ndarray, margin: int, white: bool = False) -> ScreenedShift:
    """Find the channels and the shift with the least residual, by one simulation and its linearisation.

    Args:
        shifts: The problems.
        x: The numbers.
        margin: The longest shift.
        white: Whether to take the residual of each channel for white noise: that of a poor fit is smooth for another
            reason.
    """
    plain = shifts.at((), 0)
    prediction = plain.predict(plain.values(x), plain.log.commands)
    channels = tuple(readings.channel for readings in plain.readings)
    unshifted_columns = replace_prediction(shifts.at((), 0), prediction).columns(x)
    mean_squares = [float(np.mean(columns[:, 0] ** 2)) + TINY for columns in unshifted_columns]
    products = []  # by channel and shift
    for shift in range(-margin, margin + 1):
        shifted_problem = replace_prediction(shifts.at(channels, shift), prediction)
        columns = shifted_problem.columns(x)
        if white:
            products.append([c.T @ c / mean_square for c, mean_square in zip(columns, mean_squares, strict=True)])
            continue
        rows = zip(shifted_problem.readings, shifted_problem.noises, shifted_problem.variances, columns, strict=True)
        products.append([weighted_products(noise, part.times, c)[0] / variance for part, noise, variance, c in rows])
    table = np.array(products)  # shifts, channels, 1 + p, 1 + p
    if not np.isfinite(table).all():
        return ScreenedShift((), 0, 1.0)
    best = ((), 0)
    unshifted_cost = linear_cost(table[margin].sum(axis=0))
    least_cost = unshifted_cost
    for shifted_channels in choices_of(channels):
        is_shifted = np.isin(channels, shifted_channels)
        for row, shift in enumerate(range(-margin, margin + 1)):
            cost = linear_cost(table[row, is_shifted].sum(axis=0) + table[margin, ~is_shifted].sum(axis=0))
            if cost < least_cost:
                least_cost = cost
                best = (shifted_channels, shift)
    return ScreenedShift(*best, least_cost / max(unshifted_cost, TINY))


def choices_of(channels: tuple[int, ...]) -> list[tuple[int, ...]]:
    """The channels that are shifted together: all, all but one, and each alone."""
    choices = [channels]
    if len(channels) > 2:
        choices += [tuple(other for other in channels if other != channel) for channel in channels]
    if len(channels) > 1:
        choices += [(channel,) for channel in channels]
    return choices


def replace_prediction(problem: FitProblem, prediction: tuple[np.ndarray, np.ndarray]) -> FitProblem:
    """Replace the prediction of a problem by one result, whatever the numbers; returns the problem."""
    problem.predict = lambda values, commands: prediction
    return problem


def linear_cost(products: np.ndarray) -> float:
    """The least weighted sum of squares by products of the residual and its slopes, shape (1 + p, 1 + p)."""
    step = np.linalg.lstsq(products[1:, 1:], products[1:, 0], rcond=None)[0]
    return float(products[0, 0] - products[1:, 0] @ step)


def climbed_shift(
    shifts: ShiftedProblems, start: Minimum, unshifted_end: Minimum, channels: Sequence[int], shift: int, margin: int
) -> tuple[int, Minimum]:
    """Climb from a shift to one whose neighbours fit no better, and return it with the end of its fit.

    Args:
        shifts: The problems.
        start: The minimum from which fits start.
        unshifted_end: The end of the fit without a shift.
        channels: Indices of the channels that are shifted.
        shift: The first shift.
        margin: The longest one.
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
    """The logarithm of the likelihood of all readings, at the likeliest variance of each channel's noise."""
    total = 0.0
    for readings, noise, columns in zip(problem.readings, problem.noises, problem.columns(x), strict=True):
        products, log_det = weighted_products(noise, readings.times, columns[:, :1])
        count = len(readings.times)
        total -= 0.5 * (log_det + count * math.log(max(float(products[0, 0]), readings.floor * count, TINY)))
    return total


def refinement(
    shifts: ShiftedProblems, end: Minimum, channels: Sequence[int], shift: int, margin: int
) -> tuple[float, float]:
    """The best shift less the whole one, by a parabola through three fits, and its standard deviation, in samples.

    Commands and outputs count at the nearest sample, so the deviation has that of a uniform error of one sample, too.
    It is infinite where the fits are on no parabola with a minimum.
    """
    if abs(shift) == margin:
        return 0.0, math.inf
    sides = [minimise(shifts.at(channels, shift + move), end.x).cost for move in (-1, 1)]
    bend = sides[0] + sides[1] - 2.0 * end.cost
    if not math.isfinite(bend) or bend <= 0.0:
        return 0.0, math.inf
    return float(np.clip(0.5 * (sides[0] - sides[1]) / bend, -0.5, 0.5)), math.hypot(math.sqrt(2.0 / bend), ROUNDING)


def residuals(problem: FitProblem, channels: Sequence[int], x: np.ndarray) -> tuple[float, ...]:
    """The root mean square of the residual of some channels."""
    pairs = zip(problem.readings, problem.columns(x), strict=True)
    return tuple(float(np.sqrt(np.mean(c[:, 0] ** 2))) for readings, c in pairs if readings.channel in channels)


def delay_doubts(problem: FitProblem, minimum: Minimum) -> tuple[Doubt, ...]:
    """The doubt about outputs that are later or earlier than the study predicts, with the remedy.

    The estimates are those without a shift all the same: whether a delay is the log's or the vehicle's is not known.
    """
    study = problem.study
    if problem.count.reason:
        return screened_doubts(problem, minimum)
    lateness = late_output(problem, minimum)
    if lateness is None or not lateness.matters(study.loop.sample_time) or not lateness.explains:
        return ()
    names = [signal_name(study.loop.channels[channel], "y") for channel in lateness.channels]
    sizes = []
    for name, channel, unshifted, shifted in zip(
        names, lateness.channels, lateness.unshifted, lateness.shifted, strict=True
    ):
        sizes.append(f"that of {name} from {unshifted:.3g} to {shifted:.3g} {study.units[channel].output} rms")
    side, opposite_side = ("later", "earlier") if lateness.delay > 0.0 else ("earlier", "later")
    number = max(lateness.moves, key=lambda name: abs(lateness.moves[name]))
    estimate = problem.named_values(minimum.x)[number]
    remedy = (
        "Log the time of the measurement, not that of its arrival (`timestamp_sample` of PX4), or give the study the "
        "delay that the vehicle has (unmodelled, actuator)"
        if lateness.delay > 0.0
        else "Log the time of the command at which the vehicle gets it, and look for a delay in the study that the "
        "vehicle does not have"
    )
    margin_text = f" ± {lateness.deviation:.2g}" if math.isfinite(lateness.deviation) else ""
    verb = "are" if len(names) > 1 else "is"
    text = (
        f"{', '.join(names)} {verb} {abs(lateness.delay):.3g}{margin_text} s {side} than the study predicts for the "
        f"logged commands, or these are as much {opposite_side} (p = {lateness.p_value:.1g}): moved by that, the "
        f"residual falls, {', '.join(sizes)}, and {number} is {lateness.values[number]:.4g} in place of "
        f"{estimate:.4g}. {remedy}"
    )
    return tuple(Doubt(name, text) for name in names[:1])


def screened_doubts(problem: FitProblem, minimum: Minimum) -> tuple[Doubt, ...]:
    """The doubt about a search that has ended early, if a shift leaves a far smaller residual near its best numbers."""
    margin = longest_shift(problem)
    shifts = ShiftedProblems(problem, margin)
    if margin < 1 or not shifts.has_enough_readings():
        return ()
    channels, shift, remaining_share = screened_shift(shifts, minimum.x, margin, white=True)
    if shift == 0 or remaining_share > MOST_REMAINING:
        return ()
    names = [signal_name(problem.study.loop.channels[channel], "y") for channel in channels]
    delay = abs(shift) * problem.study.loop.sample_time
    side = "earlier" if shift > 0 else "later"
    text = (
        f"with {', '.join(names)} {delay:.3g} s {side}, {100 * remaining_share:.2g} % of the sum of squares would be "
        "left: they seem to be logged at other times than the study predicts, and the search has ended too early to "
        "tell by how much and what the numbers are without it. Compare the stamps of the log's topics"
    )
    return tuple(Doubt(name, text) for name in names[:1])
