"""Commands that a log lacks for a few samples while the outputs go on: the last value is held, but others flew.

A row may be missing, or may repeat the command before it. A limit or a slow controller repeats commands, too, so that
repeats alone prove nothing. Commands count as lacking only if straight lines over these spans describe the flight far
better than held values.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.flight_logs.fit.command_gaps import along_lines
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum, reweighted_minimum
from dssc_jax.flight_logs.fit.refits import Refit, with_log
from dssc_jax.flight_logs.fit.shifts import EXPLAINED, LARGE_MOVE, LARGE_PART, SIGNIFICANCE, log_likelihood
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning

LONGEST = 25  # samples that repeat a command in one span: more are a controller that rests
MOST_REPEATED = 0.3  # share of the samples: with more, the controller itself is slow
NAMED = 3  # spans that a message names


class Dropout(NamedTuple):
    """A span of samples in which a command keeps the value from before the span.

    Args:
        begin: Index of the first sample in the span.
        end: Index of the first sample after the span.
        change: Size of the command's change at the end of the span [u].
    """

    begin: int
    end: int
    change: float


def possible_dropouts(command: np.ndarray) -> list[Dropout]:
    """Find the spans in which a command may be missing: those in which it repeats its last value.

    Repeats of the largest or smallest value do not count, because the command may be at a limit there.

    Args:
        command: The command, held where the log lacks it, shape (samples,).

    Returns:
        No span if the command repeats itself so often that the controller is slow. Long spans are left out, as the
        controller rests there.
    """
    is_repeated = np.diff(command, prepend=np.nan) == 0.0
    is_repeated[is_repeated] = ~np.isin(command[is_repeated], (command.min(), command.max()))
    spans = []
    for begin, end in zip(*flag_runs(is_repeated), strict=True):
        if end < len(command) and end - begin <= LONGEST:
            spans.append(Dropout(int(begin), int(end), abs(float(command[end] - command[begin]))))
    repeated = sum(span.end - span.begin for span in spans)
    return spans if repeated <= MOST_REPEATED * len(command) else []


def without_spans(command: np.ndarray, spans: list[Dropout]) -> np.ndarray:
    """A copy of the command with NaN in the spans, shape (samples,).

    Args:
        command: The command, shape (samples,).
        spans: The spans.
    """
    remaining = command.copy()
    for span in spans:
        remaining[span.begin : span.end] = np.nan
    return remaining


def dropout_doubts(problem: FitProblem, minimum: Minimum) -> tuple[SignalWarning, ...]:
    """The doubt about commands that the log lacks for a few samples, with the times of these spans and the remedy.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.

    Returns:
        One warning for each channel with such spans; none if straight lines over the spans do not describe the flight
        clearly better, or the fit has estimated the lacking commands already.
    """
    if problem.log.freed is not None:
        return ()
    logged = problem.log.commands
    spans_by_channel = {channel: possible_dropouts(command) for channel, command in enumerate(logged)}
    spans_by_channel = {channel: spans for channel, spans in spans_by_channel.items() if spans}
    if not spans_by_channel or problem.count.reason:
        return ()
    candidates = []
    for jumps_early in (False, True):
        commands = logged.copy()
        for channel, spans in spans_by_channel.items():
            commands[channel] = along_lines(without_spans(logged[channel], spans), jumps_early, LONGEST + 1.0)
        candidates.append(refit_with_commands(problem, minimum, commands))
    held = Refit(problem, minimum)
    better = max(candidates, key=lambda candidate: log_likelihood(candidate.problem, candidate.minimum.x))
    gain = 2.0 * (log_likelihood(better.problem, better.minimum.x) - log_likelihood(problem, minimum.x))
    p_value = len(candidates) * float(stats.chi2.sf(max(gain, 0.0), 1))
    if not p_value < SIGNIFICANCE or not matters(held, better):
        return ()
    doubts = []
    for channel, spans in spans_by_channel.items():
        name = signal_name(problem.study.loop.channels[channel], "u_total")
        text = (
            f"{name} is missing or repeats its last value {spans_text(spans, problem.study.loop.sample_time)} of the "
            f"study, and the vehicle got other commands there (p = {p_value:.1g}): with straight lines over these "
            f"spans {fall_text(held, better)}. Log every command, or fit a part without such a span"
        )
        doubts.append(SignalWarning(name, "command-dropouts", text))
    return tuple(doubts)


def refit_with_commands(problem: FitProblem, minimum: Minimum, commands: np.ndarray) -> Refit:
    """The fit with other commands of shape (channels, samples), from a minimum on, with the noise of its residual."""
    refitted = with_log(problem, problem.log._replace(commands=commands))
    refitted.noises = list(problem.noises)
    refitted.variances = list(problem.variances)
    return Refit(refitted, reweighted_minimum(refitted, minimum))


def matters(logged: Refit, changed: Refit) -> bool:
    """Whether changed commands lower the residual, and move an estimate far or explain a large part of the residual.

    Args:
        logged: The fit with the logged commands.
        changed: The fit with the changed commands.
    """
    ratios = []
    for readings in logged.problem.readings:
        ratios.append(changed.residual(readings.channel) / max(logged.residual(readings.channel), readings.floor**0.5))
    deviations = np.sqrt(np.diag(np.linalg.pinv(logged.minimum.equations.information)))
    moves = np.abs(changed.minimum.x - logged.minimum.x)[logged.problem.fitted]
    is_large_move = bool(np.any(moves > LARGE_MOVE * deviations[logged.problem.fitted]))
    return min(ratios) < EXPLAINED and (is_large_move or min(ratios) < LARGE_PART)


def spans_text(spans: list[Dropout], sample_time: float) -> str:
    """The times of the spans with the largest changes, and the number of the other spans, in words."""
    largest = sorted(spans, key=lambda span: -span.change)[:NAMED]
    times = []
    for span in sorted(largest):
        times.append(f"from {span.begin * sample_time:.4g} s to {span.end * sample_time:.4g} s")
    further = f" and at {len(spans) - NAMED} more times" if len(spans) > NAMED else ""
    return ", ".join(times) + further


def fall_text(logged: Refit, changed: Refit) -> str:
    """How far another fit lowers the residual of the channel that gains most, and which number it moves farthest.

    Args:
        logged: The fit with the logged commands.
        changed: The fit with the changed commands.
    """
    problem = logged.problem
    channels = [readings.channel for readings in problem.readings]
    best = min(channels, key=lambda channel: changed.residual(channel) / logged.residual(channel))
    name = signal_name(problem.study.loop.channels[best], "y")
    unit = problem.study.units[best].output
    moves = np.abs(changed.minimum.x - logged.minimum.x)[problem.fitted]
    place = problem.fitted[int(np.argmax(moves))]
    residuals = f"from {logged.residual(best):.3g} to {changed.residual(best):.3g} {unit} rms"
    return (
        f"the residual of {name} falls {residuals}, and "
        f"{problem.names[place]} is {problem.values(changed.minimum.x)[place]:.4g} in place of "
        f"{problem.values(logged.minimum.x)[place]:.4g}"
    )
