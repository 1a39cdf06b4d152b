"""Resampling of a log: its outputs and commands at the samples of a study."""

from collections.abc import Mapping, Sequence

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.channel_replay import replayed_channel
from dssc_jax.flight_logs.fit.command_gaps import is_rare, largest_jump, reconstructions
from dssc_jax.flight_logs.fit.least_squares import LEAST_SAMPLES
from dssc_jax.flight_logs.fit.reading_noise import reading_noise
from dssc_jax.flight_logs.fit.sampled_log import SampledLog
from dssc_jax.flight_logs.hints.references import study_references
from dssc_jax.flight_logs.reading.coverage import time_unit_text
from dssc_jax.flight_logs.reading.gaps import log_gaps
from dssc_jax.flight_logs.reading.held_outputs import drop_repeats, usual_hold
from dssc_jax.flight_logs.reading.interpolated_outputs import bends
from dssc_jax.flight_logs.reading.reader import (
    FlightLog,
    channel_signals,
    column_remedy,
    held_samples,
    nearest_offsets,
    samples_within,
    signal_name,
)
from dssc_jax.study import Study

LARGE_JUMP = 0.2  # of a command's range
MOST = 1e100  # size of a signal: squares of larger ones overflow


def sampled_log(study: Study, log: FlightLog) -> SampledLog:
    """Measured outputs, the offsets of their times, and commands of every channel, at the study's samples.

    A command that was not logged is that of the analysed controller for the logged outputs.

    Raises:
        ConfigError: The log has too few outputs, or a value beyond all units; or it lacks a command, and also a signal
            that the analysed controller needs.
    """
    loop = study.loop
    samples = max(samples_within(log, loop.sample_time, loop.steps), 1)
    references = study_references(study, samples)
    sampling = LogSampling(study, log, samples)
    all_signals = []
    for row in range(len(loop.channels)):
        signals = channel_signals(study, log, row, references[row, 0])
        all_signals.append(signals)
        if "y" in signals:
            sampling.add_output(row, signals["y"])
        command = signals.get("u_total")
        if command is not None and np.isfinite(command).any():
            sampling.add_command(row, command)
        else:
            sampling.replay_command(row, signals, references[row])
    require_outputs(study, log, sampling.outputs)
    require_sizes(study, log, all_signals)
    end = log.start + (samples - 1) * loop.sample_time
    reconstruction, *alternatives = reconstructions(list(sampling.commands))
    return SampledLog(
        outputs=sampling.outputs,
        offsets=sampling.offsets,
        commands=reconstruction.commands,
        held_samples=sampling.held_samples,
        replayed=tuple(sampling.replayed),
        jumps=sampling.jumps,
        gaps=log_gaps(log, sampling.needed_signals, end),
        references=references[:, 0],
        signals=tuple(all_signals),
        rare=tuple(sampling.rare),
        between=reconstruction.text,
        sensor_noise=reading_noise(study, sampling.outputs),
        alternatives=tuple(alternatives),
        slow=sampling.slow,
        interpolated=sampling.interpolated,
    )


class LogSampling:
    """Collects a log's outputs and commands at a study's samples; its fields are those of :class:`SampledLog`.

    Args:
        study: The study.
        log: The log.
        samples: Number of samples.
    """

    def __init__(self, study: Study, log: FlightLog, samples: int) -> None:
        self._study = study
        self._log = log
        shape = (len(study.loop.channels), samples)
        self.outputs = np.full(shape, np.nan)
        self.offsets = np.zeros(shape)
        self.commands = np.zeros(shape)
        self.slow: dict[str, float] = {}
        self.interpolated: dict[str, float] = {}
        self.replayed: list[str] = []
        self.rare: list[str] = []
        self.needed_signals: list[str] = []  # their gaps falsify a command
        self.held_samples: dict[str, int] = {}
        self.jumps: dict[str, float] = {}

    def add_output(self, row: int, output: np.ndarray) -> None:
        """Add a channel's output. If it is held or interpolated between rarer readings, keep the readings alone.

        Args:
            row: Index of the channel.
            output: The output at the samples, NaN where missing, shape (samples,).
        """
        loop = self._study.loop
        name = signal_name(loop.channels[row], "y")
        samples = self.outputs.shape[1]
        self.offsets[row] = nearest_offsets(self._log.columns[name], self._log.start, loop.sample_time, samples)
        self.outputs[row] = np.where(np.isfinite(self.offsets[row]), output, np.nan)
        hold = usual_hold(self.outputs[row])
        if hold > 1:
            self.outputs[row] = drop_repeats(self.outputs[row])
            self.slow[name] = hold * loop.sample_time
            return
        is_bend = bends(self.outputs[row])
        if is_bend.size:
            self.outputs[row] = np.where(np.resize(is_bend, samples), self.outputs[row], np.nan)
            self.interpolated[name] = len(is_bend) / np.count_nonzero(is_bend) * loop.sample_time

    def add_command(self, row: int, command: np.ndarray) -> None:
        """Add a channel's logged command. If it is interpolated between rarer commands, keep these alone.

        Args:
            row: Index of the channel.
            command: The command at the samples, NaN where missing, shape (samples,).
        """
        name = signal_name(self._study.loop.channels[row], "u_total")
        self.commands[row] = command
        self.needed_signals.append(name)
        self.held_samples |= held_samples({name: command})
        is_bend = bends(command)
        if is_bend.size:
            self.commands[row] = np.where(np.resize(is_bend, len(command)), command, np.nan)
        if is_rare(self.commands[row]):
            self.rare.append(name)
        jump = largest_jump(command)
        if jump > LARGE_JUMP * np.nanmax(command) - LARGE_JUMP * np.nanmin(command):
            self.jumps[name] = jump

    def replay_command(self, row: int, signals: dict[str, np.ndarray], reference: np.ndarray) -> None:
        """Add the command of the analysed controller for what was logged of a channel.

        Args:
            row: Index of the channel.
            signals: Logged signals of the channel at the samples, by name.
            reference: The study's reference with two derivatives, shape (3, samples).

        Raises:
            ConfigError: The log lacks what the controller needs.
        """
        channel = self._study.loop.channels[row]
        replay = replayed_channel(self._study, row, signals, reference)
        if isinstance(replay, str):
            name = signal_name(channel, "u_total")
            rule = f"has no command {name}, and {replay}; {column_remedy(channel, 'u_total')}"
            raise ConfigError(self._log.name, rule)
        self.commands[row] = replay
        self.replayed.append(channel)
        self.needed_signals += [signal_name(channel, name) for name in signals if name.startswith("y")]


def require_outputs(study: Study, log: FlightLog, outputs: np.ndarray) -> None:
    """Require that some channel has enough outputs for a fit.

    Raises:
        ConfigError: No channel has enough outputs.
    """
    channels = study.loop.channels
    if outputs.shape[1] < 4 or np.isfinite(outputs).sum(axis=1).max() < LEAST_SAMPLES:
        rule = f"has fewer than {LEAST_SAMPLES} values of the output y at the study's samples"
        place = " in every channel" if len(channels) > 1 else ""
        raise ConfigError(log.name, f"{rule}{place}{time_unit_text(log, study.loop.sample_time)}")


def require_sizes(study: Study, log: FlightLog, signals: Sequence[Mapping[str, np.ndarray]]) -> None:
    """Require that outputs and commands have a size that some unit could give them.

    Args:
        study: The study.
        log: The flight.
        signals: Signals of each channel by names without the channel, NaN where missing, shape (samples,) each.

    Raises:
        ConfigError: An output or a command is larger than any unit could make it.
    """
    for channel, values_by_name in zip(study.loop.channels, signals, strict=True):
        for name in ("y", "u_total"):
            largest = float(np.nanmax(np.abs(values_by_name.get(name, np.zeros(1))), initial=0.0))
            if largest > MOST:
                rule = f"has {signal_name(channel, name)} up to {largest:.3g}, beyond {MOST:g}"
                raise ConfigError(log.name, f"{rule}: compare its column and scale, and leave broken values empty")
