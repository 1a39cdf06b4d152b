"""A recorded wind."""

from typing import Annotated, NamedTuple

import jax
import numpy as np

from dssc_jax.core.default_functions import stateless, unchanged
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.records import (
    TIMES,
    HeldRecord,
    Interpolation,
    Pieces,
    Values,
    columns_as_pieces,
    held_mean,
    held_record,
    last_time,
    piece_at,
)
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.core.wind import Wind, WindBounds
from dssc_jax.models.wind.prescribed import held_wind, mixture_bounds


class RecordedWindParams(NamedTuple):
    """A recorded wind; a study file gives ``file`` and the ``columns`` of x, y and z in place of these fields."""

    time: Annotated[Values, TIMES]
    x: Annotated[Values, Quantity("m/s", "wind velocity along x", law=False, data=True)]
    y: Annotated[Values, Quantity("m/s", "wind velocity along y", law=False, data=True)]
    z: Annotated[Values, Quantity("m/s", "wind velocity along z, up", law=False, data=True)]


def wind_at(pieces: tuple[Pieces, ...], state: tuple[()], t: Scalar) -> Vec3:
    """The wind at t [s]: the three components of the record [m/s].

    Args:
        pieces: The components x, y, z of the record as functions of time.
        state: Not used: the wind has no memory.
        t: Time [s].
    """
    x, y, z = pieces
    return Vec3(piece_at(x, t).y, piece_at(y, t).y, piece_at(z, t).y)


def first_wind(records: tuple[HeldRecord, ...], key: jax.Array) -> Vec3:
    """The state before the first sample: the wind of a held record at t = 0 [m/s]."""
    return wind_at(pieces_of(records), state=(), t=0.0)


def wind_mean(records: tuple[HeldRecord, ...], state: Vec3, key: jax.Array, t: Scalar, dt: Scalar) -> Vec3:
    """The mean of a held record over the sample [t, t + dt) [m/s].

    A jump within the sample therefore does not reduce the integrator's order. ``state`` and ``key`` are not used,
    because the record determines the mean.
    """
    x, y, z = records
    return Vec3(held_mean(x, t, dt), held_mean(y, t, dt), held_mean(z, t, dt))


def pieces_of(records: tuple[HeldRecord, ...]) -> tuple[Pieces, ...]:
    """The pieces, as functions of time, of the three components of a held record."""
    return tuple(record.pieces for record in records)


def held_bounds(records: tuple[HeldRecord, ...]) -> WindBounds:
    """Bounds of a wind that holds its values and jumps between them: the largest norms of the values."""
    values = coefficient_rows(pieces_of(records), power=0)
    return mixture_bounds(values, slopes=None)


def line_bounds(pieces: tuple[Pieces, ...]) -> WindBounds:
    """Bounds of a wind that goes in straight lines: the largest norms of the values and of the slopes between them."""
    return mixture_bounds(coefficient_rows(pieces, power=0), coefficient_rows(pieces, power=1))


def coefficient_rows(pieces: tuple[Pieces, ...], power: int) -> list[Vec3]:
    """The coefficients of one power of time: a vector of the three components for each piece.

    Power 0 has the values at which the pieces begin [m/s], and power 1 their slopes there [m/s^2].
    """
    x, y, z = (np.asarray(component.coefficients)[:, power].tolist() for component in pieces)
    return list(map(Vec3, x, y, z))


def recorded_wind(rule: Interpolation) -> Wind:
    """Make the wind that interpolates a record of three components by a rule; with ``hold`` it is constant in a sample.

    A cubic spline overshoots the recorded values, so it has no bounds.
    """

    def prepare(params: RecordedWindParams) -> tuple[Pieces, ...]:
        """The three components as piecewise cubic functions of time.

        Raises:
            ConfigError: The times do not rise, are too few or too many, or do not have one value each.
        """
        return columns_as_pieces(params.time, {"x": params.x, "y": params.y, "z": params.z}, rule)

    if rule == Interpolation.HOLD:
        return Wind(
            params=RecordedWindParams,
            init=first_wind,
            step=wind_mean,
            value=held_wind,
            prepare=lambda params: tuple(map(held_record, prepare(params))),
            bounds=held_bounds,
            last_change=lambda records: last_time(records[0].pieces),
        )
    return Wind(
        params=RecordedWindParams,
        init=stateless,
        step=unchanged,
        value=wind_at,
        prepare=prepare,
        bounds=line_bounds if rule == Interpolation.LINEAR else None,
        last_change=lambda pieces: last_time(pieces[0]),
    )


RECORDED_WIND = Entry(
    {rule: recorded_wind(rule) for rule in Interpolation},
    "a recorded wind: `file` and three `columns`, or `time`, `x`, `y` and `z`",
    "interpolation",
    Interpolation.LINEAR,
    example={"time": [0.0, 0.3], "x": [0.0, 2.0], "y": [1.0, 0.0], "z": [0.0, 0.0]},
)
