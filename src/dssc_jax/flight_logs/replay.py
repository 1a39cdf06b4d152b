"""A logged flight through the analysed controller, and the signals that the study's draws would log."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Annotated, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.control import near_reference
from dssc_jax.closed_loop.draw import Progress, initial_progress, make_sample_step
from dssc_jax.closed_loop.time_loops import scan_recorded
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Outcome, Scalar
from dssc_jax.engine import kernels
from dssc_jax.engine.batching import values_of_draws
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_logs.channel_replay import ChannelReplay
from dssc_jax.flight_logs.hints.angle_units import angle_hints
from dssc_jax.flight_logs.hints.attitudes import attitude_hints
from dssc_jax.flight_logs.hints.channel_hints import LoggedChannel, add_output_hints, add_replay_hints
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.hints.integrals import add_integral_hints
from dssc_jax.flight_logs.hints.log_hints import LogHints
from dssc_jax.flight_logs.hints.references import compared_references, study_references
from dssc_jax.flight_logs.hints.repeated_rows import repeated_rows_hint
from dssc_jax.flight_logs.hints.reset_hints import reset_hints
from dssc_jax.flight_logs.hints.starts import start_hints
from dssc_jax.flight_logs.reading.coverage import times_text
from dssc_jax.flight_logs.reading.reader import (
    FlightLog,
    channel_signals,
    held_samples,
    samples_within,
    signal_name,
)
from dssc_jax.flight_logs.signal_warnings import Hint, SignalWarning, causes_first, signal_warnings
from dssc_jax.study import Study

LONGER = 2.0  # factor on a study's duration: times of a longer log that count by one may be the numbers of its rows
SIGNAL_UNITS = {"y": "y", "y_dot": "y/s", "u_total": "u"}
"""Units of the compared signals, by those of the channel."""
REMEDY = (
    "Compare the log's columns, units and signs with the study: a table of columns has a scale for each signal. "
    "Where the flight had another reference or controller, give the study that one, or leave the signal out"
)


class ChannelCurves(NamedTuple):
    """The signals of a channel that a log may have, simulated in one draw, each of shape (samples,).

    Args:
        y: Measured output; an angle lies within pi of its reference.
        y_dot: Measured derivative of the output.
        u_total: The command u + u_n (11).
    """

    y: jax.Array
    y_dot: jax.Array
    u_total: jax.Array


DrawCurves: TypeAlias = tuple[ChannelCurves, ...]
"""The curves of each channel."""


@dataclass(frozen=True)
class ReplayedCommand:
    """The difference of the analysed controller's command from the logged one, in the signal's unit."""

    largest_difference: Annotated[float, Quantity("that of the signal", "largest difference")]
    largest_difference_at: Annotated[float, Quantity("s", "time of the largest difference")]
    rms_difference: Annotated[float, Quantity("that of the signal", "root mean square of the difference")]
    rms_logged: Annotated[float, Quantity("that of the signal", "root mean square of the logged command")]


def replayed_command(time: np.ndarray, logged: np.ndarray, command: np.ndarray) -> ReplayedCommand | None:
    """The difference of a replayed command from the logged one; None if no sample has both.

    Args:
        time: Time of each sample [s], shape (samples,).
        logged: The logged command, NaN where it is missing, shape (samples,).
        command: The analysed controller's command, NaN where it is missing, shape (samples,).
    """
    difference = command - logged
    is_compared = np.isfinite(difference)
    if not is_compared.any():
        return None
    largest = int(np.argmax(np.abs(np.where(is_compared, difference, 0.0))))
    return ReplayedCommand(
        largest_difference=float(abs(difference[largest])),
        largest_difference_at=float(time[largest]),
        rms_difference=rms(difference),
        rms_logged=rms(logged[is_compared]),
    )


def signal_unit(study: Study, name: str) -> str:
    """The unit of a logged signal by its name; empty if the comparison does not have such a signal."""
    for channel, units in zip(study.loop.channels, study.units, strict=True):
        for quantity, unit in SIGNAL_UNITS.items():
            if name == signal_name(channel, quantity):
                return units.of(unit)
    return ""


class LogReplay(NamedTuple):
    """A log at the study's samples, the commands of the analysed controller for it, and why both may disagree.

    Args:
        samples: Samples of the study up to the log's end.
        logged: The logged signals by name, NaN where missing, each of shape (samples,).
        commands: Commands of the analysed controller, by the name of the logged command.
        held_samples: Samples of the replay at which the log lacks a signal, and its last value counts; by signal.
        not_replayed: Why a channel's log was not replayed, by channel.
        references: Largest difference between the logged and the study's reference, by channel; empty if not logged.
        rates: Largest difference between the derivatives of these references, by channel; empty if not logged.
        hints: Why log and study may disagree.
        dropped: Rows that are left out because their times fall, by signal.
    """

    samples: int
    logged: dict[str, np.ndarray]
    commands: dict[str, np.ndarray]
    held_samples: dict[str, int]
    not_replayed: dict[str, str]
    references: dict[str, float]
    rates: dict[str, float]
    hints: LogHints
    dropped: dict[str, int]

    def differences(self, sample_time: float) -> dict[str, ReplayedCommand]:
        """The differences of the replayed commands from the logged ones, by signal; ``sample_time`` is in s."""
        times = sample_time * np.arange(self.samples)
        differences = {}
        for name, command in self.commands.items():
            if name in self.logged:
                difference = replayed_command(times, self.logged[name], command)
                if difference is not None:
                    differences[name] = difference
        return differences

    @property
    def warnings(self) -> tuple[SignalWarning, ...]:
        """The hints as warnings, causes before effects."""
        return causes_first(signal_warnings(self.hints.all()))

    def summary(self, study: Study) -> dict[str, object]:
        """The replay, the differences and the warnings as plain data for JSON."""
        differences = self.differences(study.loop.sample_time)
        return {
            "replay": {
                name: asdict(replayed) | {"unit": signal_unit(study, name)} for name, replayed in differences.items()
            },
            "replayed_samples": self.samples,
            "dropped_rows": self.dropped,
            "held_samples": self.held_samples,
            "not_replayed": self.not_replayed,
            "reference_differences": self.references,
            "reference_rate_differences": self.rates,
            "warned": bool(self.warnings),
            "warnings": [asdict(warning) for warning in self.warnings],
        }


def replay_log(study: Study, log: FlightLog, commands: bool = True) -> LogReplay:
    """Compare a log, at the study's samples, with the analysed controller's commands and the study's references.

    Args:
        study: The study, without a sweep.
        log: The flight.
        commands: Whether the analysed controller is replayed; if not, only outputs and references are checked.
    """
    loop = study.loop
    samples = samples_within(log, loop.sample_time, loop.steps)
    references = study_references(study, max(samples, 1))
    channels = logged_channels(study, log, references)
    hints = LogHints()
    add_integral_hints(hints, study, log)
    comparison = compared_references(hints, study, log, [channel.signals for channel in channels], references)
    hints.factors.update(time_hints(study, log))
    logged: dict[str, np.ndarray] = {}
    replays: dict[str, np.ndarray] = {}
    held_counts: dict[str, int] = {}
    not_replayed: dict[str, str] = {}
    for channel in channels:
        logged |= {channel.signal(label): values for label, values in channel.signals.items()}
        add_output_hints(hints, study, channel)
        if not commands:
            continue
        replay = ChannelReplay(study, channel.index, channel.reference)
        command = replay.command(channel.signals)
        add_replay_hints(hints, log, channel, replay, command)
        if isinstance(command, str):
            not_replayed[channel.name] = command
            continue
        name = channel.signal("u_total")
        replays[name] = command
        inputs = {label: values for label, values in channel.signals.items() if label != "u_total"}
        held_counts |= {channel.signal(label): count for label, count in held_samples(inputs).items()}
        if "u_total" not in channel.signals:
            not_replayed[channel.name] = (
                f"the log has no command {name} to compare with that of the analysed controller"
            )
    hints.conversions.update(angle_hints(study, log, references))
    hints.starts.update(start_hints(study, log))
    hints.attitudes.update(attitude_hints(study, log))
    hints.estimator.update(reset_hints(study, log))
    return LogReplay(
        samples=samples,
        logged=logged,
        commands=replays,
        held_samples=held_counts,
        not_replayed=not_replayed,
        references=comparison.differences,
        rates=comparison.rates,
        hints=hints,
        dropped=dict(log.dropped),
    )


def logged_channels(study: Study, log: FlightLog, references: np.ndarray) -> list[LoggedChannel]:
    """The channels of a log with their signals at the study's samples.

    Args:
        study: The study.
        log: The flight.
        references: The study's references and their derivatives, shape (channels, 3, samples).
    """
    channels = []
    for index, name in enumerate(study.loop.channels):
        signals = channel_signals(study, log, index, references[index, 0])
        channels.append(LoggedChannel(index, name, study.units[index], signals, references[index]))
    return channels


def time_hints(study: Study, log: FlightLog) -> dict[str, Hint]:
    """The hint about the times ``t`` of a log: they count rows, repeat, or belong to rows written again."""
    repeated_rows = repeated_rows_hint(log.columns)
    if repeated_rows is not None:
        return {"t": repeated_rows}
    text = times_text(log, LONGER * study.loop.sample_time * study.loop.steps)
    if not text:
        return {}
    return {"t": Hint("row-numbers" if text.startswith("counts") else "repeated-times", text)}


def require_same_signals(log: FlightLog, replay: LogReplay) -> None:
    """Require that a log has an output, and that no signal is the study's in another unit, sign or column.

    Raises:
        ConfigError: The log has no output, or a signal is in another unit, sign or column.
    """
    if not any(name.endswith("y") for name in log.columns):
        names = ", ".join(log.columns)
        raise ConfigError(
            log.name,
            f"has no column of the measured output (y, of a channel x x_y) among {names}: a fit compares it with the "
            "study's. Give its column in a table of columns, or by --column y=COLUMN",
        )
    wrong = replay.hints.conversions
    if wrong:
        reasons = "; ".join(f"{name} {hint.text}" for name, hint in wrong.items())
        raise ConfigError(log.name, f"{reasons}. {REMEDY}")


def curves_of_draws(study: Study, samples: int, stride: int = 1) -> Iterator[DrawCurves]:
    """Simulate the draws of a study one after another, and yield the curves of each channel.

    A draw that has ended early is NaN from then on. No draw ends because it has settled.

    Args:
        study: The study.
        samples: Number of samples of each simulation.
        stride: Of the samples, every ``stride``-th is kept.
    """
    program = recorded_lane(study, samples, stride)
    draws = study.config.draws
    values = values_of_draws(study, slice(0, draws))
    with arithmetic(study.config.loop.precision):
        compiled = kernels.compile_single_lane(program, list(study.laws))
    for index in range(draws):
        with arithmetic(study.config.loop.precision):
            yield compiled({name: float(column[index]) for name, column in values.items()}, index)


def recorded_lane(study: Study, samples: int, stride: int) -> Callable[[dict[str, Scalar], jax.Array], DrawCurves]:
    """The program of a draw: (numbers by name, draw index) -> the curves of each channel.

    Args:
        study: The study.
        samples: Number of samples of the simulation.
        stride: Of the samples, every ``stride``-th is kept.
    """
    loop = replace(study.loop, settled=None)

    def lane(values: dict[str, Scalar], index: jax.Array) -> DrawCurves:
        params = study.params(values)
        key = draw_key(study.config.seed, index)
        advance = make_sample_step(loop, params, key, (), (), freeze=True)

        def sample(progress: Progress) -> tuple[Progress, DrawCurves]:
            """One sample: the progress after it, and each channel's signals, NaN once the draw has ended."""
            next_progress, record = advance(progress)
            is_running = next_progress.outcome == Outcome.OK
            curves = []
            for i, controlled in enumerate(record.controlled):
                # an angle within half a turn of its reference
                reading = near_reference(loop, i, controlled.reading, record.references[i])
                y, y_dot, command = map(jnp.asarray, (reading.y, reading.y_dot, controlled.command.total))
                curves.append(ChannelCurves(y, y_dot, command))
            until_end = jax.tree.map(lambda signal: jnp.where(is_running, signal, jnp.nan), tuple(curves))
            return next_progress, until_end

        return scan_recorded(sample, initial_progress(loop, params, key, ()), samples, stride)[1]

    return lane
