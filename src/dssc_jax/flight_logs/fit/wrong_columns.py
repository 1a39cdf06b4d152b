"""Whether other columns than the given ones describe a flight: an error in place of y, or exchanged columns.

Each hypothesis is the same log with other outputs and commands, which is fitted once more. A warning names the
hypothesis if the study then describes nearly all of the outputs, but little of them with the given columns. A
hypothesis that contradicts the analysed controller is not tried: if the controller gives the logged command for the
logged outputs, both columns are right.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.channel_replay import ChannelReplay
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.refits import Refit, refit
from dssc_jax.flight_logs.fit.sampled_log import SampledLog
from dssc_jax.flight_logs.hints.conversions import FEWER
from dssc_jax.flight_logs.hints.references import study_references
from dssc_jax.flight_logs.hints.replayed_columns import DESCRIBED as SAME_COMMAND
from dssc_jax.flight_logs.hints.replayed_columns import command_share
from dssc_jax.flight_logs.reading.reader import forward_filled, signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning

DESCRIBED = 0.2  # largest residual of other columns, as a share of the outputs' standard deviation
LEAST_SHARE = 0.05  # of the outputs' standard deviation: a smaller residual is that of the right columns


class OtherColumns(NamedTuple):
    """A log in which signals come from other columns.

    Args:
        signal: A signal whose column is wrong.
        words: What is wrong with the columns.
        channels: Positions of the channels whose outputs or commands differ.
        log: The log with the columns of the hypothesis.
    """

    signal: str
    words: str
    channels: list[int]
    log: SampledLog


class ReplayedChannels:
    """The analysed controllers, replayed with the logged signals of their channels and with other columns.

    Args:
        problem: The least-squares problem of the log.
    """

    def __init__(self, problem: FitProblem) -> None:
        """Prepare the controllers; nothing is replayed yet."""
        self.log = problem.log
        references = study_references(problem.study, problem.log.outputs.shape[1])
        self.replays = [ChannelReplay(problem.study, *row) for row in enumerate(references)]
        self.shares: dict[int, float] = {}  # with the logged columns, by channel

    def refute(self, columns: OtherColumns) -> bool:
        """Whether an analysed controller contradicts other columns.

        It does if it gives the logged command of a channel with the given columns, and gives it less well with others.
        """
        for channel in columns.channels:
            if channel not in self.shares:
                self.shares[channel] = self.share(channel, self.log.signals[channel])
            share = self.shares[channel]
            if share > SAME_COMMAND:
                continue
            replaced = {"y": columns.log.outputs[channel], "u_total": columns.log.commands[channel]}
            if self.share(channel, {**self.log.signals[channel], **replaced}) > share:
                return True
        return False

    def share(self, channel: int, signals: Mapping[str, np.ndarray]) -> float:
        """The difference of the replayed command from the logged one, as a share of the variation of the logged one.

        The share is infinite if there is no logged command, or the controller cannot be replayed.

        Args:
            channel: Position of the channel.
            signals: Signals of the channel by name, NaN where missing, shape (samples,) each.
        """
        if "u_total" not in signals:
            return np.inf
        try:
            command = self.replays[channel].command(signals)
        except ConfigError:
            return np.inf
        return np.inf if isinstance(command, str) else command_share(signals["u_total"], command)


def column_doubts(problem: FitProblem, minimum: Minimum) -> tuple[SignalWarning, ...]:
    """The doubt about columns of outputs and commands, if others describe the flight far better, with the remedy.

    Other commands are tried only if no other outputs describe the flight, because other commands need more simulations.

    Args:
        problem: The least-squares problem of the log.
        minimum: Its minimum.
    """
    if problem.count.is_stopped:
        return ()
    logged = Refit(problem, minimum)
    if problem.count.reason:  # the search has hit a limit: minimise with the given columns as far as with others
        logged = refit(problem, minimum, problem.log)
    replays = ReplayedChannels(problem)
    candidates = [candidate for candidate in other_columns(problem) if not replays.refute(candidate)]
    for is_same_command in (True, False):
        chosen = []
        for candidate in candidates:
            if (candidate.log.commands is problem.log.commands) == is_same_command:
                chosen.append(candidate)
        best, share = best_columns(logged, chosen)
        if best is not None:
            text = (
                f"{best.words}: with that, the study describes the flight, and the residual is {100 * share:.2g} % of "
                "the output. Correct the columns, and fit again"
            )
            return (SignalWarning(best.signal, "exchanged-columns", text),)
    return ()


def best_columns(logged: Refit, candidates: Sequence[OtherColumns]) -> tuple[OtherColumns | None, float]:
    """The hypothesis that describes the flight best, and its residual as a share of the outputs' standard deviation.

    Args:
        logged: The fit with the given columns.
        candidates: The hypotheses.

    Returns:
        None in place of the hypothesis if none describes the flight far better than the given columns.
    """
    best = None
    least_share = DESCRIBED
    for candidate in candidates:
        squares = logged.squares(candidate.channels)
        if squares is None or squares.share < LEAST_SHARE:
            continue
        changed = refit(logged.problem, logged.minimum, candidate.log)
        changed_squares = changed.squares(candidate.channels)
        if changed_squares is None or changed.problem.is_far_outside(changed.minimum.x):
            continue
        if changed_squares.share < min(least_share, FEWER * squares.share):
            least_share = changed_squares.share
            best = candidate
    return best, least_share


def other_columns(problem: FitProblem) -> Iterator[OtherColumns]:
    """All hypotheses about the columns of a log; fewer in a study of several channels, where each takes longer."""
    channels = [readings.channel for readings in problem.readings]
    for channel in channels:
        yield from errors_as_outputs(problem, channel)
        if len(channels) == 1:
            yield from exchanged_signals(problem, channel)
    for first, second in itertools.combinations(channels, 2):
        if problem.study.units[first] == problem.study.units[second]:
            yield from exchanged_channels(problem, first, second)


def errors_as_outputs(problem: FitProblem, channel: int) -> Iterator[OtherColumns]:
    """The hypotheses that the column of y holds the error: of either sign, from the logged reference or the study's.

    Args:
        problem: The least-squares problem of the log.
        channel: Position of the channel.
    """
    log = problem.log
    name = problem.study.loop.channels[channel]
    y = signal_name(name, "y")
    y_ref = signal_name(name, "y_ref")
    logged_reference = log.signals[channel].get("y_ref")
    for reference in (logged_reference, log.references[channel]):
        if reference is None or len(np.unique(reference[np.isfinite(reference)])) < 2:
            continue  # without a reference that moves, the error is y with an offset
        for error, output in (
            (f"{y_ref} - {y}", reference - log.outputs[channel]),
            (f"{y} - {y_ref}", reference + log.outputs[channel]),
        ):
            words = f"the column of {y} seems to hold the error {error}"
            yield OtherColumns(y, words, [channel], log._replace(outputs=with_row(log.outputs, channel, output)))


def exchanged_signals(problem: FitProblem, channel: int) -> Iterator[OtherColumns]:
    """The hypotheses that y and the command of a channel are in other columns of that channel, such as each other's.

    Args:
        problem: The least-squares problem of the log.
        channel: Position of the channel.
    """
    log = problem.log
    name = problem.study.loop.channels[channel]
    signals = log.signals[channel]
    for output, command in itertools.permutations(signals, 2):
        wrong = {"y": output, "u_total": command}
        wrong = {signal: column for signal, column in wrong.items() if signal != column}
        if not wrong or not np.isfinite(signals[command]).any():
            continue
        pairs = []
        for signal, column in wrong.items():
            pairs.append(f"{signal_name(name, signal)} in that of {signal_name(name, column)}")
        first = signal_name(name, next(iter(wrong)))
        words = f"columns seem to be exchanged, {' and '.join(pairs)}"
        is_logged = np.isfinite(log.offsets[channel])  # elsewhere no reading of y says when it was taken
        outputs = with_row(log.outputs, channel, np.where(is_logged, signals[output], np.nan))
        commands = with_row(log.commands, channel, forward_filled(signals[command]))
        yield OtherColumns(first, words, [channel], log._replace(outputs=outputs, commands=commands))


def exchanged_channels(problem: FitProblem, first: int, second: int) -> Iterator[OtherColumns]:
    """The hypotheses that the outputs, or the commands, of two channels are in each other's column.

    Args:
        problem: The least-squares problem of the log.
        first: Position of one channel.
        second: Position of the other channel, whose signals have the same units.
    """
    log = problem.log
    channels = problem.study.loop.channels
    exchanged = np.arange(len(channels))
    exchanged[[first, second]] = second, first
    outputs = [signal_name(channels[channel], "y") for channel in (first, second)]
    commands = [signal_name(channels[channel], "u_total") for channel in (first, second)]
    words = "seem to have each other's column"
    changed = log._replace(outputs=log.outputs[exchanged], offsets=log.offsets[exchanged])
    alternatives = f"{' and '.join(outputs)}, or {' and '.join(commands)}, {words}"  # the same, where both begin alike
    yield OtherColumns(outputs[0], alternatives, [first, second], changed)
    changed = log._replace(commands=log.commands[exchanged])
    yield OtherColumns(commands[0], f"{' and '.join(commands)} {words}", [first, second], changed)


def with_row(rows: np.ndarray, row: int, values: np.ndarray) -> np.ndarray:
    """A copy of the signals of all channels, shape (channels, samples), in which ``values`` replace one row.

    Args:
        rows: Signals of all channels, shape (channels, samples).
        row: Position of the channel.
        values: The new signal of that channel, shape (samples,).
    """
    changed = rows.copy()
    changed[row] = values
    return changed
