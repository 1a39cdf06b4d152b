"""A sensor whose noise is a record."""

from enum import StrEnum
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Sensor
from dssc_jax.core.numerics import uniforms
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.records import TIMES, Interpolation, Pieces, Values, columns_as_pieces, piece_at
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import SMOOTH

AHEAD = 0.01  # share of a step by which held noise begins early: rounding of k T_s must not show the value before


class RecordedNoiseParams(NamedTuple):
    """The recorded noise of a sensor; a study file gives ``file`` and the ``columns`` of y and y' instead."""

    time: Annotated[Values, TIMES]
    position: Annotated[Values, Quantity("y", "noise on y at these times", law=False, data=True)]
    velocity: Annotated[Values, Quantity("y/s", "noise on y' at these times", law=False, data=True)]


class RecordedNoise(NamedTuple):
    """Noise on y and y', and the length of the record with the step of its last value [s]."""

    position: Pieces
    velocity: Pieces
    length: Scalar


class NoiseStart(StrEnum):
    """Where in the record a draw begins."""

    RANDOM = "random"
    FIRST = "first"


def prepare(params: RecordedNoiseParams) -> RecordedNoise:
    """The record as functions of time, the first value at t = 0."""
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
    """The measurement with the noise of the record, which is repeated after its end."""
    at = start_time + t
    at = at - noise.length * jnp.floor(at / noise.length + AHEAD / len(noise.position.begins))
    position = piece_at(noise.position, at).y
    velocity = piece_at(noise.velocity, at).y
    return start_time, Measurement(measurement.y + position, measurement.y_dot + velocity)


def recorded_sensor(start: NoiseStart) -> Sensor:
    """The sensor whose noise is a record, held between its times."""

    def init(noise: RecordedNoise, measurement: Measurement, key: jax.Array) -> Scalar:
        return noise.length * uniforms(key, 1)[0] if start == NoiseStart.RANDOM else 0.0

    return Sensor(RecordedNoiseParams, init, step, prepare, smooth=SMOOTH)


RECORDED_NOISE = Entry(
    {start: recorded_sensor(start) for start in NoiseStart},
    "recorded noise on y and y': `file` and two `columns`, or `time`, `position` and `velocity`",
    "start",
    NoiseStart.RANDOM,
    example={"time": [0.0, 0.2, 0.4], "position": [0.01, -0.01, 0.0], "velocity": [0.02, 0.0, -0.02]},
)
