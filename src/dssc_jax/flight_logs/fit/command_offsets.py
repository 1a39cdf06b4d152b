"""A constant in the logged command that the vehicle did not answer, such as the thrust at hover.

The constant shows as the difference between the logged command and that of the analysed controller; the fit tells
whether the vehicle answered it. What an integral gave against a steady wind before the log began is such a constant,
too. Other causes of the residual are sought without the constant, because a delay, a lag or another start may resemble
it.
"""

from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.channel_replay import replayed_channel
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum, reweighted_minimum
from dssc_jax.flight_logs.fit.refits import Refit, refit
from dssc_jax.flight_logs.fit.refusals import Explained, explain, signal_and_unit
from dssc_jax.flight_logs.fit.start_speeds import fitted_start
from dssc_jax.flight_logs.hints.command_hints import constant_offset
from dssc_jax.flight_logs.hints.references import study_references
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning

LARGE_PART = 0.5  # share of the residual that may be left if the constant explains it


class MendedCommand(NamedTuple):
    """The fit of a log after a fault of its command, such as a constant, has been mended.

    Args:
        warning: The warning about the fault.
        problem: The problem with the mended command, with the noise of its minimum.
        minimum: The minimum of that problem.
        results: How well the study describes each channel at that minimum.
    """

    warning: SignalWarning
    problem: FitProblem
    minimum: Minimum
    results: list[Explained]

    @property
    def residual(self) -> float:
        """Root mean square of the first channel's residual with the mended command, in the output's unit."""
        return self.results[0].residual

    @property
    def leaves_noise(self) -> bool:
        """Whether the residual with the mended command is nothing but noise."""
        return not any(result.is_doubtful for result in self.results)


def logged_offset(problem: FitProblem) -> float | None:
    """The constant [u] by which the logged command of one channel differs from that of the analysed controller.

    Returns:
        None if there is no such constant, or the controller cannot be replayed.
    """
    log = problem.log
    (reference,) = study_references(problem.study, log.commands.shape[1])
    try:
        replayed = replayed_channel(problem.study, 0, log.signals[0], reference)
    except ConfigError:
        return None
    return None if isinstance(replayed, str) else constant_offset(log.commands[0], replayed)


def without_offset(
    problem: FitProblem, minimum: Minimum, results: list[Explained], logged: Refit
) -> MendedCommand | None:
    """Fit a log without the constant in its command.

    Args:
        problem: The problem of one channel, with the noise of the minimum.
        minimum: The minimum.
        results: How well the study describes each channel.
        logged: The fit of the log with its command, with white noise.

    Returns:
        None if the command has no constant, or the vehicle answered the constant.
    """
    offset = logged_offset(problem)
    if offset is None:
        return None
    log = problem.log
    white = refit(problem, minimum, log._replace(commands=log.commands - offset))
    end = reweighted_minimum(white.problem, white.minimum)
    mended = min((white, Refit(white.problem, end)), key=lambda fit: fit.residual(0))
    fall = residual_fall(logged, mended)
    if fall is None or not fall.after < LARGE_PART * results[0].residual:
        return None
    warning = offset_warning(offset, logged, mended, fall)
    return MendedCommand(warning, white.problem, end, explain(white.problem, end.x))


class ResidualFall(NamedTuple):
    """The root mean squares of a residual with a constant in the command, and without it.

    Args:
        before: Root mean square with the constant, in the output's unit.
        after: Root mean square without the constant, in the output's unit.
        words: What else is fitted in both cases; empty: nothing.
    """

    before: float
    after: float
    words: str = ""


def residual_fall(logged: Refit, mended: Refit) -> ResidualFall | None:
    """The fall of the residual without the constant; None if the residual does not fall to less than half.

    If only a fit of the start of the flight shows such a fall, both residuals are those with the fitted start.

    Args:
        logged: The fit of the log with the constant.
        mended: The fit of the log without the constant.
    """
    fall = ResidualFall(logged.residual(0), mended.residual(0))
    if fall.after < LARGE_PART * fall.before:
        return fall
    started = fitted_start(*mended)
    started_before = None if started is None else fitted_start(*logged)
    if started is None or started_before is None or not started.residual < LARGE_PART * started_before.residual:
        return None
    return ResidualFall(started_before.residual, started.residual, ", with the start of the flight fitted,")


def offset_warning(offset: float, logged: Refit, mended: Refit, fall: ResidualFall) -> SignalWarning:
    """The warning of a constant in the command, with what it changes.

    Args:
        offset: The constant [u].
        logged: The fit of the log with the constant.
        mended: The fit of the log without the constant.
        fall: How far the residual falls without the constant.
    """
    problem = logged.problem
    name = signal_name(problem.study.loop.channels[0], "u_total")
    y, unit = signal_and_unit(problem, 0)
    command = problem.study.units[0].of("u")
    place = problem.fitted[int(np.argmax(np.abs(mended.minimum.x - logged.minimum.x)[problem.fitted]))]
    values = [end.problem.values(end.minimum.x)[place] for end in (logged, mended)]
    moves = f", and {problem.names[place]} is {values[1]:.4g} in place of {values[0]:.4g}"
    if fall.words:  # without the right start, neither value is right
        moves = ""
    text = (
        f"{name} has a constant of {offset:.4g} {command} that the vehicle did not answer: the analysed controller "
        "gives the logged command without it, as where a log has the whole thrust with that at hover, or where an "
        "integral held a steady wind before the log began. Without it the "
        f"residual of {y}{fall.words} falls from {fall.before:.3g} to {fall.after:.3g} {unit} rms"
        f"{moves}. Give the column of {name} an offset of {-offset:.4g}"
    )
    return SignalWarning(name, "command-offset", text)
