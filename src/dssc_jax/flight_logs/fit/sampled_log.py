"""A log at the samples of a study."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.reading.gaps import Gap
from dssc_jax.flight_logs.signal_warnings import SignalWarning


class Reconstruction(NamedTuple):
    """A possible course of the commands between their logged values.

    Args:
        text: What the commands do between two logged values, in words.
        commands: The commands at all samples, shape (channels, samples).
    """

    text: str
    commands: np.ndarray


class FreedCommands(NamedTuple):
    """Commands that a fit has estimated where the log lacks them.

    Args:
        warnings: The warnings about these commands.
        moves: How far the uncertainty of these commands moves the coordinates of the numbers, shape (k, p).
    """

    warnings: tuple[SignalWarning, ...]
    moves: np.ndarray


class SampledLog(NamedTuple):
    """A log at the study's samples; arrays of shape (channels, samples)."""

    outputs: np.ndarray  # measured outputs, NaN where missing
    offsets: np.ndarray  # their times less the sample instants, in samples
    commands: np.ndarray
    held_samples: dict[str, int]  # samples at which the log lacks a command, and its last value counts, by signal
    replayed: tuple[str, ...]  # channels whose commands are those of the analysed controller for the logged outputs
    jumps: dict[str, float]  # changes of held commands at the gaps' ends, at most, where they are large; by signal
    gaps: tuple[Gap, ...]  # spans without messages, over which a command is held or replayed
    references: np.ndarray  # references of the study
    signals: tuple[Mapping[str, np.ndarray], ...]  # all logged signals by channel, NaN where missing, shape (samples,)
    rare: tuple[str, ...] = ()  # commands that are logged more rarely than the controller gives them
    between: str = ""  # what commands do between two logged values
    sensor_noise: tuple[float, ...] = ()  # standard deviation of what the study's sensor adds to a reading, by channel
    alternatives: tuple[Reconstruction, ...] = ()  # commands that may have flown instead
    slow: Mapping[str, float] = MappingProxyType({})  # outputs that are held, with the time between readings
    interpolated: Mapping[str, float] = MappingProxyType({})  # outputs that are straight lines between readings
    freed: FreedCommands | None = None  # commands that a fit has estimated where the log lacks them
