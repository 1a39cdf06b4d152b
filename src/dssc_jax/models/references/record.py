"""A recorded signal as desired output.

In units, y stands for the unit of the plant's output.
"""

from typing import Annotated, NamedTuple

import numpy as np

from dssc_jax.core.contracts import Reference
from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.records import TIMES, Interpolation, Pieces, Values, cubic_pieces, last_time, piece_at
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import ReferencePoint, Scalar


class RecordParams(NamedTuple):
    """A recorded desired output; the first value holds before the first time, the last one after the last time.

    Derivatives follow from the interpolation. With a recorded rate, y_ref' is this rate, interpolated by the same
    rule, and y_ref'' its slope.

    The record of an angle may jump by a turn, as one within (-pi, pi] does; the reference then takes the shorter way.

    A study file has ``file`` and ``column`` instead, and ``rate_column``, with ``rate_file`` if that is another file.
    The values become part of the study when it is read.
    """

    time: Annotated[Values, TIMES]
    value: Annotated[Values, Quantity("y", "values at these times", law=False, data=True)]
    rate: Annotated[Values | None, Quantity("y/s", "recorded derivative y_ref'", law=False, data=True)] = None
    rate_time: Annotated[
        Values | None, Quantity("s", "times of the rate, rising; absent: those of the values", law=False, data=True)
    ] = None


class RatedPieces(NamedTuple):
    """A recorded value and its recorded rate as functions of time."""

    value: Pieces
    rate: Pieces


def record_pieces(params: RecordParams, rule: Interpolation) -> Pieces | RatedPieces:
    """The record as functions of time, with its recorded rate if it has one.

    Args:
        params: The record.
        rule: Rule of interpolation between the recorded values.

    Raises:
        ConfigError: Lengths do not fit, times do not rise, or times of a rate are given without a rate.
    """
    value = cubic_pieces(params.time, params.value, rule)
    if params.rate is None:
        if params.rate_time is not None:
            raise ConfigError("rate_time", "is the time of a rate, and there is no rate")
        return value
    if params.rate_time is None:
        if len(params.rate) != len(params.time):
            raise ConfigError("rate", f"must hold as many numbers as time, {len(params.time)}, got {len(params.rate)}")
        return RatedPieces(value, cubic_pieces(params.time, params.rate, rule))
    with errors_under("rate"):
        return RatedPieces(value, cubic_pieces(params.rate_time, params.rate, rule))


def record_at(pieces: Pieces | RatedPieces, t: Scalar) -> ReferencePoint:
    """The reference at t [s]; its derivatives follow from the recorded rate, or else from the value."""
    if isinstance(pieces, RatedPieces):
        rate = piece_at(pieces.rate, t)
        return ReferencePoint(piece_at(pieces.value, t).y, rate.y, rate.y_dot)
    return piece_at(pieces, t)


def record_end(pieces: Pieces | RatedPieces) -> float:
    """The time [s] from which both value and rate are constant."""
    if isinstance(pieces, RatedPieces):
        return max(last_time(pieces.value), last_time(pieces.rate))
    return last_time(pieces)


def unwrapped(params: RecordParams) -> RecordParams:
    """The record of an angle with whole turns added, so that it goes from value to value by the shorter way."""
    return params._replace(value=tuple(np.unwrap(np.array(params.value, float)).tolist()))


def record(rule: Interpolation) -> Reference:
    """Make the reference that interpolates a record by a rule; an angle takes the shorter way between values."""
    plain = Reference(RecordParams, record_at, lambda params: record_pieces(params, rule), last_change=record_end)
    of_angle = plain._replace(prepare=lambda params: record_pieces(unwrapped(params), rule))
    return plain._replace(of_angle=of_angle)


RECORD = Entry(
    {rule: record(rule) for rule in Interpolation},
    "a recorded signal: `file` (CSV or Parquet), `column`, `time_column` and `rate_column`, or `time`, `value`, `rate`",
    "interpolation",
    Interpolation.LINEAR,
    example={"time": [0.0, 0.3, 0.6, 1.0], "value": [0.0, 0.2, 0.1, 0.3]},
)
