"""A sensor whose noise is a record.

In units, y stands for the unit of the plant's output.
"""

from enum import StrEnum
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Sensor
from dssc_jax.core.default_functions import always
from dssc_jax.core.numerics import uniforms
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.records import TIMES, Interpolation, Pieces, Values, columns_as_pieces, piece_at
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import SMOOTH

AHEAD = 0.01  # share of a step by which each value begins early, because t = k T_s is rounded


class RecordedNoiseParams(NamedTuple):
    """The recorded noise of a sensor.

    A study file gives ``file`` and the ``columns`` of y and y' in place of these fields.
    """

    time: Annotated[Values, TIMES]
    position: Annotated[Values, Quantity("y", "noise on y at these times", law=False, data=True)]
    velocity: Annotated[Values, Quantity("y/s", "noise on y' at these times", law=False, data=True)]


class RecordedNoise(NamedTuple):
    """Noise on y (``position``) and y' (``velocity``) as functions of time, and the record's ``length`` [s].

    The length includes the step during which the last value holds.
    """

    position: Pieces
    velocity: Pieces
    length: Scalar


class NoiseStart(StrEnum):
    """Whether a draw begins at a random time of the record, or at its first value."""

    RANDOM = "random"
    FIRST = "first"


def prepare(params: RecordedNoiseParams) -> RecordedNoise:
    """The record as functions of time, shifted so that the first value is at t = 0.

    Each value begins a little early, because the times k T_s of samples are rounded.

    Raises:
        ConfigError: The times do not rise, are too few or too many, or do not have one value each in both columns.
    """
    columns = {"position": params.position, "velocity": params.velocity}
    pieces = columns_as_pieces(params.time, columns, Interpolation.HOLD)
    start = params.time[0]
    end = params.time[-1]
    steps = len(params.time) - 1
    early = AHEAD * (end - start) / steps
    position, velocity = (part._replace(begins=part.begins - start - early) for part in pieces)
    return RecordedNoise(position, velocity, (end - start) * (steps + 1) / steps)


def step(
    noise: RecordedNoise, start_time: Scalar, measurement: Measurement, key: jax.Array, t: Scalar, dt: Scalar
) -> tuple[Scalar, Measurement]:
    """The state, and the measurement with the record's noise added.

    The state is the time of the record at which the draw began [s]; it stays. The record is repeated after its end. The
    random ``key`` and ``dt`` are not used, because the record determines the noise.
    """
    at = start_time + t
    # a repetition begins as early as a value does: by the share AHEAD of a step
    repetitions = jnp.floor(at / noise.length + AHEAD / len(noise.position.begins))
    at = at - noise.length * repetitions
    position = piece_at(noise.position, at).y
    velocity = piece_at(noise.velocity, at).y
    return start_time, Measurement(measurement.y + position, measurement.y_dot + velocity)


def recorded_sensor(start: NoiseStart) -> Sensor:
    """Make the sensor whose noise is a record with held values.

    Args:
        start: Whether the noise begins at the record's first value, or at a random time of the record.
    """

    def init(noise: RecordedNoise, measurement: Measurement, key: jax.Array) -> Scalar:
        """The time of the record at which the draw begins [s]."""
        if start == NoiseStart.FIRST:
            return 0.0
        (share,) = uniforms(key, 1)
        return noise.length * share

    return Sensor(RecordedNoiseParams, init, step, prepare, smooth=SMOOTH, transparent=always)


RECORDED_NOISE = Entry(
    {start: recorded_sensor(start) for start in NoiseStart},
    "recorded noise on y and y': `file` and two `columns`, or `time`, `position` and `velocity`",
    "start",
    NoiseStart.RANDOM,
    example={"time": [0.0, 0.2, 0.4], "position": [0.01, -0.01, 0.0], "velocity": [0.02, 0.0, -0.02]},
)
