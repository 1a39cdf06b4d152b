"""Whether logged outputs are later or earlier than the study predicts: a delay that a fit puts into other numbers.

The outputs are shifted by whole samples: all channels together, all but one (such as the position of a vehicle without
its heading), and each alone. Where the search has ended early, no fit can be repeated, and the linearised sum of
squares at the best numbers decides.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.fit.first_integrals import free_integrals, integral_doubt
from dssc_jax.flight_logs.fit.late_commands import command_delay_warning, late_command
from dssc_jax.flight_logs.fit.least_squares import LEAST_SAMPLES, TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum, minimise
from dssc_jax.flight_logs.fit.prediction import declares_noise
from dssc_jax.flight_logs.fit.refusals import Explained
from dssc_jax.flight_logs.fit.remaining_residuals import certain_delay, remaining_text
from dssc_jax.flight_logs.fit.shifts import Delay, fitted_delay, linear_cost, longest_shift
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning
from dssc_jax.statistics.correlated_noise import weighted_products

MOST_REMAINING = 0.7  # share of the sum of squares that a shift may leave to be reported without a fit


class ScreenedShift(NamedTuple):
    """The shift with the least residual, if the prediction is linear in the numbers.

    Args:
        channels: Positions of the channels that are shifted.
        shift: By how many samples the outputs of these channels are later than predicted; 0: no shift is better.
        remaining_share: Share of the weighted sum of squares that is left with the shift.
    """

    channels: tuple[int, ...]
    shift: int
    remaining_share: float


class ShiftedOutputs:
    """The problem of a fit with outputs that are shifted by whole samples; all shifts have the same readings.

    Args:
        problem: The problem, with the noise of its minimum.
        margin: The longest shift, in samples. Readings so close to either end are dropped, so that all shifts have
            the same readings.
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
        """The problem, with the same noise, in which late outputs are moved back in time.

        Args:
            channels: Positions of the channels whose outputs are moved.
            shift: By how many samples they are moved to earlier times; negative: to later times.
        """
        offsets = self.problem.log.offsets.copy()
        offsets[list(channels)] -= shift
        shifted = replace(
            self.problem, is_shifted=True, log=self.problem.log._replace(outputs=self.outputs, offsets=offsets)
        )
        shifted.noises = list(self.noises)
        shifted.variances = list(self.variances)
        return shifted


def late_output(problem: FitProblem, minimum: Minimum) -> Delay | None:
    """The shift of outputs that lowers the residual at a minimum most.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.

    Returns:
        None if the log is too short, or no shift is better.
    """
    margin = longest_shift(problem)
    shifts = ShiftedOutputs(problem, margin)
    if margin < 1 or not shifts.has_enough_readings():
        return None
    unshifted_end = minimise(shifts.at((), 0), minimum.x)
    channels, shift, _ = screened_shift(shifts, unshifted_end.x, margin)
    if shift == 0:
        return None
    return fitted_delay(shifts, unshifted_end, channels, shift, margin)


def screened_shift(shifts: ShiftedOutputs, x: np.ndarray, margin: int, white: bool = False) -> ScreenedShift:
    """Find the channels and the shift with the least residual, by one simulation and its linearisation.

    Args:
        shifts: The problems.
        x: Coordinates of the numbers, shape (p,).
        margin: The longest shift, in samples.
        white: Whether the residual of each channel counts as white noise. The residual of a poor fit is smooth for
            other reasons than correlated noise.
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
        for unshifted in channels:
            choices.append(tuple(channel for channel in channels if channel != unshifted))
    if len(channels) > 1:
        choices += [(channel,) for channel in channels]
    return choices


def replace_prediction(problem: FitProblem, prediction: tuple[np.ndarray, np.ndarray]) -> FitProblem:
    """Replace the prediction of a problem by one result, whatever the numbers; returns the problem.

    Args:
        problem: The problem.
        prediction: The predicted outputs and their slopes.
    """
    problem.predict = lambda values, commands, forces=None: prediction
    return problem


def delay_doubts(
    problem: FitProblem, minimum: Minimum, results: Sequence[Explained], lateness: Delay | None = None
) -> tuple[SignalWarning, ...]:
    """The doubt about outputs, or commands, that are later or earlier than the study predicts, with the remedy.

    If other integrals at the first sample explain the flight better than a delay, the doubt is about the integrals. The
    estimates are those without a shift all the same: whether a delay is the log's or the vehicle's is not known.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
        results: How well the study describes each channel.
        lateness: A certain delay of the outputs that explains the flight better than other integrals; None: both are
            looked for here.
    """
    if problem.count.reason:
        return screened_doubts(problem, minimum)
    if lateness is None:
        lateness = certain_delay(problem, late_output(problem, minimum), results)
        integrals = free_integrals(problem, minimum)
        if integrals is not None and integrals.explain_more_than(lateness):
            return (integral_doubt(problem, integrals),)
    remains = "" if lateness is None else remaining_text(problem, minimum, lateness, results)
    if lateness is None or remains:
        delay = certain_delay(problem, late_command(problem, minimum), results)
        if delay is not None and (lateness is None or delay.shifted[0] < lateness.shifted[0]):
            return (command_delay_warning(problem, minimum, results, delay),)
    if lateness is None:
        return ()
    return (output_delay_warning(problem, minimum, lateness, remains),)


def output_delay_warning(problem: FitProblem, minimum: Minimum, lateness: Delay, remains: str) -> SignalWarning:
    """The doubt about outputs that are later or earlier than the study predicts, with the remedy.

    Args:
        problem: The problem.
        minimum: Its minimum without the delay.
        lateness: The delay.
        remains: A sentence about the residual that the delay leaves; empty if that is noise.
    """
    study = problem.study
    names = [signal_name(study.loop.channels[channel], "y") for channel in lateness.channels]
    sizes = []
    for name, channel, unshifted, shifted in zip(
        names, lateness.channels, lateness.unshifted, lateness.shifted, strict=True
    ):
        sizes.append(f"that of {name} from {unshifted:.3g} to {shifted:.3g} {study.units[channel].output} rms")
    falls = f"the residual falls, {', '.join(sizes)}, and "
    if declares_noise(study):  # the residual then is mostly what the gusts did, whatever the delay
        falls = ""
    side, opposite_side = ("later", "earlier") if lateness.time > 0.0 else ("earlier", "later")
    remedy = (
        "Log the time of the measurement, not that of its arrival (`timestamp_sample` of PX4), or give the study the "
        "delay that the vehicle has (unmodelled, actuator)"
        if lateness.time > 0.0
        else "Log the time of the command at which the vehicle gets it, and look for a delay in the study that the "
        "vehicle does not have"
    )
    verb = "are" if len(names) > 1 else "is"
    text = (
        f"{', '.join(names)} {verb} {lateness.size_text} {side} than the study predicts for the logged commands, or "
        f"these are as much {opposite_side} (p = {lateness.p_value:.1g}): moved by that, {falls}"
        f"{lateness.move_text(problem.named_values(minimum.x))}. {remedy}{remains}"
    )
    signal = names[0] if len(names) == 1 else ""  # of several channels: the answer as such
    return SignalWarning(signal, "delayed-output", text)


def screened_doubts(problem: FitProblem, minimum: Minimum) -> tuple[SignalWarning, ...]:
    """The doubt about shifted outputs after a search that has ended early, if a shift leaves a far smaller residual.

    A gust leaves a smooth residual, which any shift changes, so a study that declares gusts has no such doubt. If the
    longest shift is the best one, it is not taken for a delay.

    Args:
        problem: The problem whose search has ended early.
        minimum: The best minimum so far.
    """
    margin = longest_shift(problem)
    shifts = ShiftedOutputs(problem, margin)
    if margin < 1 or not shifts.has_enough_readings() or declares_noise(problem.study):
        return ()
    channels, shift, remaining_share = screened_shift(shifts, minimum.x, margin, white=True)
    if shift == 0 or abs(shift) == margin or remaining_share > MOST_REMAINING:
        return ()
    names = [signal_name(problem.study.loop.channels[channel], "y") for channel in channels]
    delay = abs(shift) * problem.study.loop.sample_time
    side = "earlier" if shift > 0 else "later"
    text = (
        f"with {', '.join(names)} {delay:.3g} s {side}, {100 * remaining_share:.2g} % of the sum of squares would be "
        "left: they seem to be logged at other times than the study predicts, and the search has ended too early to "
        "tell by how much and what the numbers are without it. Compare the stamps of the log's topics"
    )
    signal = names[0] if len(names) == 1 else ""  # of several channels: the answer as such
    return (SignalWarning(signal, "delayed-output", text),)
