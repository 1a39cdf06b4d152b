"""Fits of a log with free commands where it lacks them for a few samples: what flew there is not known.

Each span in which a command is held adds one number: the command's mean less the held value. This change has a normal
law, whose deviation is the size of the command's changes over as many samples elsewhere. So only commands of usual size
may explain a residual, and they count only if they leave no more than noise.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.flight_logs.fit.command_dropouts import Dropout, possible_dropouts, spans_text
from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.refits import Refit, with_log
from dssc_jax.flight_logs.fit.refusals import Explained, explain
from dssc_jax.flight_logs.fit.sampled_log import FreedCommands, SampledLog
from dssc_jax.flight_logs.fit.shifts import SIGNIFICANCE
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning

MOST_SPANS = 50  # each takes a simulation in each step
MOST_FREE = 0.1  # spans for each reading: more explain anything
STEPS = 3  # of Gauss and Newton
DIFFERENCE = 1e-3  # of a change's standard deviation: step of the derivative by it
LARGEST_CHANGE = 3.0  # standard deviations of a change that is as usual


class FreeSpan(NamedTuple):
    """A span in which a command is free.

    Args:
        channel: Position of the command's channel.
        dropout: The span.
        deviation: Standard deviation of the law of the command's change in the span [u].
    """

    channel: int
    dropout: Dropout
    deviation: float


def free_spans(log: SampledLog) -> list[FreeSpan]:
    """The spans in which a log lacks or repeats a command that changes.

    Returns:
        No span if there are too many for the readings, or a command is logged more rarely than it is given.
    """
    spans = []
    for channel, command in enumerate(log.commands):
        is_lacking = np.isnan(log.signals[channel].get("u_total", command))
        for dropout in possible_dropouts(command):
            is_lacking[dropout.begin : dropout.end] = True
        for begin, end in zip(*flag_runs(is_lacking), strict=True):
            if 0 < begin < end < len(command):
                changes = command[end - begin :] - command[: begin - end]
                change = abs(float(command[end] - command[begin]))
                deviation = max(rms(changes), change)
                if deviation > 0.0:
                    spans.append(FreeSpan(channel, Dropout(int(begin), int(end), change), deviation))
    readings = int(np.count_nonzero(np.isfinite(log.outputs)))
    is_few = len(spans) <= min(MOST_SPANS, MOST_FREE * readings)
    return spans if is_few and not log.rare else []


def freed_commands(problem: FitProblem, minimum: Minimum) -> FitProblem | None:
    """The problem with estimated commands where the log lacks them; None if these do not explain the residual.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
    """
    log = problem.log
    spans = [] if log.freed is not None or problem.count.reason else free_spans(log)
    results = explain(problem, minimum.x) if spans else []
    if not any(result.is_doubtful for result in results):
        return None
    free = FreeProblem(problem, spans, np.array([max(result.noise, TINY) for result in results]))
    point = free.minimum(minimum.x)
    if not np.all(np.abs(point.changes) <= LARGEST_CHANGE * free.deviations):
        return None
    freed = with_log(problem, log._replace(commands=free.commands(point.changes), jumps={}))
    freed_results = explain(freed, point.x)
    gain = free.cost(minimum.x, np.zeros(len(spans))) - free.cost(point.x, point.changes)
    p_value = float(stats.chi2.sf(max(gain, 0.0), len(spans)))
    if any(result.is_doubtful for result in freed_results) or not p_value < SIGNIFICANCE:
        return None
    warnings = freed_warnings(Refit(problem, minimum), point.x, spans, results, freed_results)
    freed = with_log(problem, freed.log._replace(freed=FreedCommands(warnings, free.moves(point))))
    freed.count = problem.count
    freed.disturbances = problem.disturbances
    return freed


class FreePoint(NamedTuple):
    """Coordinates of the numbers, shape (p,), and changes of the commands, shape (k,)."""

    x: np.ndarray
    changes: np.ndarray


class FreeProblem:
    """The least squares of a log whose commands are free in k spans.

    A point has coordinates x of the numbers, shape (p,), and changes of the commands in the spans, shape (k,) [u].

    Args:
        problem: The problem with held commands.
        spans: The spans.
        noises: Root mean square of the noise of each channel's readings.
    """

    def __init__(self, problem: FitProblem, spans: list[FreeSpan], noises: np.ndarray) -> None:
        """Add the information of the changes' laws to that of the numbers' laws."""
        self.problem = problem
        self.spans = spans
        self.noises = noises
        self.deviations = np.array([span.deviation for span in spans])
        self.prior = np.append(problem.prior, 1.0 / self.deviations**2)

    def commands(self, changes: np.ndarray) -> np.ndarray:
        """The commands with changes in the spans, shape (channels, samples)."""
        commands = self.problem.log.commands.copy()
        for span, change in zip(self.spans, changes, strict=True):
            commands[span.channel, span.dropout.begin : span.dropout.end] += change
        return commands

    def columns(self, x: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """The residual of all readings and the prediction's slopes by the numbers, over the noise, shape (n, 1 + p)."""
        columns = self.problem.columns(x, self.commands(changes))
        return np.vstack([part / noise for part, noise in zip(columns, self.noises, strict=True)])

    def cost(self, x: np.ndarray, changes: np.ndarray) -> float:
        """The sum of squares of the residual over the noise, plus those of the changes and numbers with kept laws."""
        squares = self.columns(x, changes)[:, 0] ** 2
        return float(np.sum(squares)) + float(self.prior @ np.append(x, changes) ** 2)

    def products(self, point: FreePoint) -> tuple[np.ndarray, np.ndarray]:
        """The descent direction, shape (p + k,), and the information, shape (p + k, p + k), both with the laws."""
        columns = self.columns(*point)
        slopes = [columns[:, 1:]]
        for row, deviation in enumerate(self.deviations):
            changes = point.changes.copy()
            changes[row] += DIFFERENCE * deviation
            moved = self.columns(point.x, changes)[:, 0]
            slopes.append((columns[:, :1] - moved[:, None]) / (DIFFERENCE * deviation))
        jacobian = np.hstack(slopes)
        gradient = jacobian.T @ columns[:, 0] - self.prior * np.concatenate(point)
        return gradient, jacobian.T @ jacobian + np.diag(self.prior)

    def minimum(self, x: np.ndarray) -> FreePoint:
        """The point after a few Gauss-Newton steps from the coordinates of the minimum with held commands."""
        point = FreePoint(x, np.zeros(len(self.spans)))
        for _ in range(STEPS):
            gradient, information = self.products(point)
            if not np.isfinite(information).all():
                break
            step = np.linalg.lstsq(information, gradient, rcond=None)[0]
            point = FreePoint(point.x + step[: len(x)], point.changes + step[len(x) :])
        return point

    def moves(self, point: FreePoint) -> np.ndarray:
        """How far the uncertainty of the changes moves the coordinates, shape (k, p).

        Each row is the move by one standard deviation along one principal axis of the changes' covariance.
        """
        count = len(point.x)
        _, information = self.products(point)
        covariance = np.linalg.pinv(information)[count:, count:]
        values, vectors = np.linalg.eigh(covariance)
        slopes = -np.linalg.lstsq(information[:count, :count], information[:count, count:], rcond=None)[0]
        return (slopes @ vectors * np.sqrt(np.maximum(values, 0.0))).T


def freed_warnings(
    held: Refit, x: np.ndarray, spans: list[FreeSpan], results: list[Explained], freed_results: list[Explained]
) -> tuple[SignalWarning, ...]:
    """Warnings, by channel, that a fit has estimated commands which the log lacks, with their times and effects.

    Args:
        held: The fit with held commands.
        x: Coordinates of the numbers with free commands.
        spans: The spans.
        results: How well the study describes each channel with held commands.
        freed_results: How well the study describes each channel with free commands.
    """
    problem = held.problem
    loop = problem.study.loop
    moves = np.abs(x - held.minimum.x)[problem.fitted]
    place = problem.fitted[int(np.argmax(moves))]
    falls = []
    for readings, result, freed in zip(problem.readings, results, freed_results, strict=True):
        name = signal_name(loop.channels[readings.channel], "y")
        unit = problem.study.units[readings.channel].output
        falls.append(f"that of {name} from {result.residual:.3g} to {freed.residual:.3g} {unit} rms")
    warnings = []
    for channel in dict.fromkeys(span.channel for span in spans):
        name = signal_name(loop.channels[channel], "u_total")
        dropouts = [span.dropout for span in spans if span.channel == channel]
        times = spans_text(dropouts, loop.sample_time)
        text = (
            f"{name} is missing or repeats its last value {times} of the study, and the vehicle got other commands "
            f"there: with a free one in each of these spans the residual falls, {', '.join(falls)}, which is noise, "
            f"and {problem.names[place]} is {problem.values(x)[place]:.4g} in place of "
            f"{problem.values(held.minimum.x)[place]:.4g}. The estimates are those with free commands, and intervals "
            "are wider by what these leave open. Log every command"
        )
        warnings.append(SignalWarning(name, "command-dropouts", text))
    return tuple(warnings)
