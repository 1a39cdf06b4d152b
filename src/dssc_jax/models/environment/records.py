"""Recorded signals, as reference, disturbance, wind or noise: values held, joined by lines, or by a cubic spline."""

from enum import StrEnum
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.contracts import Disturbance, Reference, Sensor, Wind, stateless, unchanged
from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.numerics import uniforms
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import Measurement, ReferencePoint, Scalar
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.core.vectors import Vec3

MOST_VALUES = 50_000
AHEAD = 0.01  # of a step, by which held noise begins early: rounding of k T_s must not show the value before


class RecordParams(NamedTuple):
    """Times and values; before the first time and after the last, the first and the last value hold.

    A study file gives ``file`` and ``column`` instead; the values become part of the study when it is read.
    """

    time: Annotated[tuple[Scalar, ...], Quantity("s", "times, rising", law=False, data=True)]
    value: Annotated[tuple[Scalar, ...], Quantity("y", "values at these times", law=False, data=True)]


class RecordedDisturbanceParams(NamedTuple):
    """A recorded disturbance; as in :class:`RecordParams`."""

    time: Annotated[tuple[Scalar, ...], Quantity("s", "times, rising", law=False, data=True)]
    value: Annotated[tuple[Scalar, ...], Quantity("u", "values at these times", law=False, data=True)]


class RecordedWindParams(NamedTuple):
    """A recorded wind; a study file gives ``file`` and the ``columns`` of x, y and z instead."""

    time: Annotated[tuple[Scalar, ...], Quantity("s", "times, rising", law=False, data=True)]
    x: Annotated[tuple[Scalar, ...], Quantity("m/s", "wind velocity along x", law=False, data=True)]
    y: Annotated[tuple[Scalar, ...], Quantity("m/s", "wind velocity along y", law=False, data=True)]
    z: Annotated[tuple[Scalar, ...], Quantity("m/s", "wind velocity along z, up", law=False, data=True)]


class RecordedNoiseParams(NamedTuple):
    """The recorded noise of a sensor; a study file gives ``file`` and the ``columns`` of y and y' instead."""

    time: Annotated[tuple[Scalar, ...], Quantity("s", "times, rising", law=False, data=True)]
    position: Annotated[tuple[Scalar, ...], Quantity("y", "noise on y at these times", law=False, data=True)]
    velocity: Annotated[tuple[Scalar, ...], Quantity("y/s", "noise on y' at these times", law=False, data=True)]


class Pieces(NamedTuple):
    """A piecewise cubic function.

    Args:
        begins: Time at which each piece begins [s], shape (n,).
        coefficients: Shape (n + 1, 4), in ascending powers of the time since the piece began; the first row holds
            before the first time.
    """

    begins: jax.Array | np.ndarray
    coefficients: jax.Array | np.ndarray


class RecordedNoise(NamedTuple):
    """Noise on y and y', and how long the record is, the last value's own step included [s]."""

    position: Pieces
    velocity: Pieces
    length: Scalar


class NoiseStart(StrEnum):
    """Where in the record a draw begins."""

    RANDOM = "random"
    FIRST = "first"


class Interpolation(StrEnum):
    """How values between two recorded times are found."""

    HOLD = "hold"
    LINEAR = "linear"
    CUBIC = "cubic"


def held_pieces(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Coefficients of a value that holds until the next one, shape (n - 1, 4)."""
    return np.pad(value[:-1, None], ((0, 0), (0, 3)))


def line_pieces(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Coefficients of straight lines, shape (n - 1, 4)."""
    return np.pad(np.column_stack([value[:-1], np.diff(value) / np.diff(time)]), ((0, 0), (0, 2)))


def spline_pieces(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Coefficients of the natural cubic spline, shape (n - 1, 4): y_m' and y_m'' are continuous."""
    from scipy.interpolate import CubicSpline  # slow to load, and few studies follow a record

    return CubicSpline(time, value, bc_type="natural").c[::-1].T


RULES = {Interpolation.HOLD: held_pieces, Interpolation.LINEAR: line_pieces, Interpolation.CUBIC: spline_pieces}


def check_record(params: RecordParams | RecordedDisturbanceParams) -> None:
    """Require at least two values, one for each time, at rising times.

    Raises:
        ConfigError: otherwise.
    """
    count = len(params.time)
    if len(params.value) != count:
        raise ConfigError("value", f"must hold as many numbers as time, {count}, got {len(params.value)}")
    if not 2 <= count <= MOST_VALUES:
        raise ConfigError("time", f"must hold 2 to {MOST_VALUES} numbers, got {count}")
    fall = np.diff(np.asarray(params.time, float)) <= 0.0
    if fall.any():
        index = int(fall.argmax()) + 1
        raise ConfigError(f"time.{index}", f"must be above the time before it, {params.time[index - 1]:g} s, got "
                          f"{params.time[index]:g} s")  # fmt: skip


def record(rule: Interpolation) -> Reference:
    """The reference that follows a record by the given rule."""

    return Reference(RecordParams, piece_at, lambda params: cubic_pieces(params, rule))


def cubic_pieces(params: RecordParams | RecordedDisturbanceParams, rule: Interpolation) -> Pieces:
    """The piecewise cubic through a record.

    Raises:
        ConfigError: As in :func:`check_record`.
    """
    check_record(params)
    time, value = np.asarray(params.time, float), np.asarray(params.value, float)
    ends = np.pad(value[[0, -1], None], ((0, 0), (0, 3)))
    return Pieces(time, np.concatenate([ends[:1], RULES[rule](time, value), ends[1:]]))


def columns_as_pieces(
    params: RecordedWindParams | RecordedNoiseParams, names: tuple[str, ...], rule: Interpolation
) -> tuple[Pieces, ...]:
    """The piecewise cubics through several columns with the same times.

    Raises:
        ConfigError: As in :func:`check_record`, under the name of the column whose length is wrong.
    """
    parts = []
    for name in names:
        values = getattr(params, name)
        with errors_under("" if len(values) == len(params.time) else name):
            parts.append(cubic_pieces(RecordParams(params.time, values), rule))
    return tuple(parts)


def recorded_disturbance(rule: Interpolation) -> Disturbance:
    """The disturbance that follows a record by the given rule; one that holds its values holds them over a sample."""

    def prepare(params: RecordedDisturbanceParams) -> Pieces:
        return cubic_pieces(params, rule)

    if rule == Interpolation.HOLD:
        return Disturbance(
            RecordedDisturbanceParams,
            lambda pieces, key: 0.0,
            lambda pieces, state, key, t, dt: piece_at(pieces, t).y,
            lambda pieces, state, measurement, sigma, t: state,
            prepare,
            smooth=SMOOTH,
        )
    return Disturbance(
        RecordedDisturbanceParams,
        stateless,
        unchanged,
        lambda pieces, state, measurement, sigma, t: piece_at(pieces, t).y,
        prepare,
        smooth=SMOOTH,
    )


def recorded_wind(rule: Interpolation) -> Wind:
    """The wind that follows a record of its three components by the given rule."""

    def prepare(params: RecordedWindParams) -> tuple[Pieces, ...]:
        return columns_as_pieces(params, ("x", "y", "z"), rule)

    return Wind(
        RecordedWindParams,
        stateless,
        unchanged,
        lambda pieces, state, t: Vec3(*(piece_at(part, t).y for part in pieces)),
        prepare,
    )


def recorded_sensor(start: NoiseStart) -> Sensor:
    """The sensor whose noise is a record, held between its times and repeated after its end."""

    def prepare(params: RecordedNoiseParams) -> RecordedNoise:
        pieces = columns_as_pieces(params, ("position", "velocity"), Interpolation.HOLD)
        first, last, steps = params.time[0], params.time[-1], len(params.time) - 1
        early = AHEAD * (last - first) / steps
        begins = [part._replace(begins=part.begins - first - early) for part in pieces]
        return RecordedNoise(begins[0], begins[1], (last - first) * (steps + 1) / steps)

    def init(noise: RecordedNoise, measurement: Measurement, key: jax.Array) -> Scalar:
        return noise.length * uniforms(key, 1)[0] if start == NoiseStart.RANDOM else 0.0

    def step(
        noise: RecordedNoise, begin: Scalar, measurement: Measurement, key: jax.Array, t: Scalar, dt: Scalar
    ) -> tuple[Scalar, Measurement]:
        at = begin + t
        at = at - noise.length * jnp.floor(at / noise.length + AHEAD / len(noise.position.begins))
        errors = piece_at(noise.position, at).y, piece_at(noise.velocity, at).y
        return begin, Measurement(measurement.y + errors[0], measurement.y_dot + errors[1])

    return Sensor(RecordedNoiseParams, init, step, prepare, smooth=SMOOTH)


def piece_at(pieces: Pieces, t: Scalar) -> ReferencePoint:
    """The value at t with its derivatives; a piece begins at its time, up to the rounding of t = k T_s."""
    t = jnp.asarray(t, jnp.result_type(float))
    begins = jnp.asarray(pieces.begins, t.dtype)
    rounded = t + 4.0 * jnp.finfo(t.dtype).eps * jnp.abs(t)
    after = jnp.searchsorted(begins, rounded, side="right", method="scan_unrolled")
    a, b, c, d = jnp.asarray(pieces.coefficients, t.dtype)[after]
    x = jnp.maximum(t - begins[jnp.maximum(after - 1, 0)], 0.0)
    return ReferencePoint(a + x * (b + x * (c + x * d)), b + x * (2.0 * c + 3.0 * x * d), 2.0 * c + 6.0 * x * d)


RECORD = Entry(
    {rule: record(rule) for rule in Interpolation},
    "a recorded signal: `file` (CSV or Parquet), `column` and `time_column`, or `time` and `value`",
    "interpolation",
    Interpolation.LINEAR,
)
RECORDED_DISTURBANCE = Entry(
    {rule: recorded_disturbance(rule) for rule in Interpolation},
    "a recorded disturbance: `file` and `column`, or `time` and `value`",
    "interpolation",
    Interpolation.LINEAR,
)
RECORDED_WIND = Entry(
    {rule: recorded_wind(rule) for rule in Interpolation},
    "a recorded wind: `file` and three `columns`, or `time`, `x`, `y` and `z`",
    "interpolation",
    Interpolation.LINEAR,
)
RECORDED_NOISE = Entry(
    {start: recorded_sensor(start) for start in NoiseStart},
    "recorded noise on y and y': `file` and two `columns`, or `time`, `position` and `velocity`",
    "start",
    NoiseStart.RANDOM,
)
