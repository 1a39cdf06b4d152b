"""A recorded signal as desired output."""

from typing import Annotated, NamedTuple

from dssc_jax.core.contracts import Reference
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.records import TIMES, Interpolation, Values, cubic_pieces, piece_at
from dssc_jax.core.registry import Entry


class RecordParams(NamedTuple):
    """Times and values; before the first time and after the last, the first and the last value hold.

    A study file gives ``file`` and ``column`` instead; the values become part of the study when it is read.
    """

    time: Annotated[Values, TIMES]
    value: Annotated[Values, Quantity("y", "values at these times", law=False, data=True)]


def record(rule: Interpolation) -> Reference:
    """The reference that follows a record by the given rule."""
    return Reference(RecordParams, piece_at, lambda params: cubic_pieces(params.time, params.value, rule))


RECORD = Entry(
    {rule: record(rule) for rule in Interpolation},
    "a recorded signal: `file` (CSV or Parquet), `column` and `time_column`, or `time` and `value`",
    "interpolation",
    Interpolation.LINEAR,
    example={"time": [0.0, 0.3, 0.6, 1.0], "value": [0.0, 0.2, 0.1, 0.3]},
)
