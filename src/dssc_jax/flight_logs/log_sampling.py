"""From a log to outputs and commands at the samples of a study."""

from collections.abc import Mapping

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.command_gaps import is_rare, largest_jump, reconstructions
from dssc_jax.flight_logs.coverage import time_unit_text
from dssc_jax.flight_logs.gaps import log_gaps
from dssc_jax.flight_logs.held_outputs import drop_repeats, usual_hold
from dssc_jax.flight_logs.least_squares import LEAST_SAMPLES
from dssc_jax.flight_logs.reader import (
    FlightLog,
    channel_signals,
    column_remedy,
    held_samples,
    nearest_offsets,
    samples_within,
    signal_name,
)
from dssc_jax.flight_logs.reading_noise import reading_noise
from dssc_jax.flight_logs.references import study_references
from dssc_jax.flight_logs.replay import replayed_channel
from dssc_jax.flight_logs.sampled_log import SampledLog
from dssc_jax.study import Study

LARGE_JUMP = 0.2  # of a command's range


def sampled_log(study: Study, log: FlightLog) -> SampledLog:
    """Measured outputs, the offsets of their times, and commands of every channel, at the study's samples.

    A command that was not logged is that of the analysed controller for the logged outputs.

    Raises:
        ConfigError: The log has too few outputs, or neither a command nor what its replay needs.
    """
    loop = study.loop
    samples = max(samples_within(log, loop.sample_time, loop.steps), 1)
    references = study_references(study, samples)
    outputs = SampledOutputs(study, log, samples)
    commands = SampledCommands(study, log, samples)
    for row in range(len(loop.channels)):
        signals = channel_signals(study, log, row, references[row, 0])
        if "y" in signals:
            outputs.add(row, signals["y"])
        command = signals.get("u_total")
        if command is not None and np.isfinite(command).any():
            commands.add_logged(row, command)
        else:
            commands.add_replayed(row, signals, references[row])
    require_outputs(study, log, outputs.values)
    end = log.start + (samples - 1) * loop.sample_time
    reconstruction, *alternatives = reconstructions(list(commands.values))
    return SampledLog(
        outputs=outputs.values,
        offsets=outputs.offsets,
        commands=reconstruction.commands,
        held_samples=commands.held_samples,
        replayed=tuple(commands.replayed),
        jumps=commands.jumps,
        gaps=log_gaps(log, commands.needed_signals, end),
        rare=tuple(commands.rare),
        between=reconstruction.text,
        sensor_noise=reading_noise(study, outputs.values),
        alternatives=tuple(alternatives),
        slow=outputs.slow,
    )


class SampledOutputs:
    """The outputs of a log at a study's samples.

    Args:
        study: The study.
        log: The log.
        samples: Number of samples.
    """

    def __init__(self, study: Study, log: FlightLog, samples: int) -> None:
        self._study = study
        self._log = log
        self.values = np.full((len(study.loop.channels), samples), np.nan)
        self.offsets = np.zeros(self.values.shape)
        self.slow: dict[str, float] = {}

    def add(self, row: int, output: np.ndarray) -> None:
        """Add a channel's output; of one that is held between rarer readings, the readings."""
        loop = self._study.loop
        name = signal_name(loop.channels[row], "y")
        samples = self.values.shape[1]
        self.offsets[row] = nearest_offsets(self._log.columns[name], self._log.start, loop.sample_time, samples)
        self.values[row] = np.where(np.isfinite(self.offsets[row]), output, np.nan)
        hold = usual_hold(self.values[row])
        if hold > 1:
            self.values[row] = drop_repeats(self.values[row])
            self.slow[name] = hold * loop.sample_time


class SampledCommands:
    """The commands of a log at a study's samples, logged or replayed.

    Args:
        study: The study.
        log: The log.
        samples: Number of samples.
    """

    def __init__(self, study: Study, log: FlightLog, samples: int) -> None:
        self._study = study
        self._log = log
        self.values = np.zeros((len(study.loop.channels), samples))
        self.replayed: list[str] = []
        self.rare: list[str] = []
        self.needed_signals: list[str] = []  # their gaps falsify a command
        self.held_samples: dict[str, int] = {}
        self.jumps: dict[str, float] = {}

    def add_logged(self, row: int, command: np.ndarray) -> None:
        """Add a channel's logged command."""
        name = signal_name(self._study.loop.channels[row], "u_total")
        self.values[row] = command
        self.needed_signals.append(name)
        self.held_samples |= held_samples({name: command})
        if is_rare(command):
            self.rare.append(name)
        jump = largest_jump(command)
        if jump > LARGE_JUMP * np.nanmax(command) - LARGE_JUMP * np.nanmin(command):
            self.jumps[name] = jump

    def add_replayed(self, row: int, signals: Mapping[str, np.ndarray], reference: np.ndarray) -> None:
        """Add the command of the analysed controller for what was logged of a channel.

        Args:
            row: Index of the channel.
            signals: Its logged signals at the samples.
            reference: The study's reference with two derivatives, shape (3, samples).

        Raises:
            ConfigError: The log lacks what the controller needs.
        """
        channel = self._study.loop.channels[row]
        replay = replayed_channel(self._study, row, dict(signals), reference)
        if isinstance(replay, str):
            name = signal_name(channel, "u_total")
            rule = f"has no command {name}, and {replay}; {column_remedy(channel, 'u_total')}"
            raise ConfigError(self._log.name, rule)
        self.values[row] = replay
        self.replayed.append(channel)
        self.needed_signals += [signal_name(channel, name) for name in signals if name.startswith("y")]


def require_outputs(study: Study, log: FlightLog, outputs: np.ndarray) -> None:
    """Require that some channel has enough outputs for a fit.

    Raises:
        ConfigError: None has.
    """
    channels = study.loop.channels
    if outputs.shape[1] < 4 or np.isfinite(outputs).sum(axis=1).max() < LEAST_SAMPLES:
        rule = f"has fewer than {LEAST_SAMPLES} values of the output y at the study's samples"
        place = " in every channel" if len(channels) > 1 else ""
        raise ConfigError(log.name, f"{rule}{place}{time_unit_text(log, study.loop.sample_time)}")
