"""A recorded disturbance.

In units, u stands for the unit of the command.
"""

from typing import Annotated, NamedTuple

import jax

from dssc_jax.core.contracts import Disturbance
from dssc_jax.core.default_functions import stateless, unchanged
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.records import (
    TIMES,
    HeldRecord,
    Interpolation,
    Pieces,
    Values,
    cubic_pieces,
    held_mean,
    held_record,
    last_time,
    piece_at,
)
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import SMOOTH


class RecordedDisturbanceParams(NamedTuple):
    """A recorded disturbance; a study file gives ``file`` and ``column`` in place of these fields."""

    time: Annotated[Values, TIMES]
    value: Annotated[Values, Quantity("u", "values at these times", law=False, data=True)]


def record_mean(record: HeldRecord, state: Scalar, key: jax.Array, t: Scalar, dt: Scalar) -> Scalar:
    """Mean of a held record over the sample [t, t + dt) [u], which the plant gets in place of jumps within the sample.

    The integral of the disturbance is therefore exact at all samples. ``state`` and ``key`` are not used, because the
    record determines the mean.
    """
    return held_mean(record, t, dt)


def recorded_disturbance(rule: Interpolation) -> Disturbance:
    """Make the disturbance that interpolates a record by a rule; with ``hold`` it is constant over a sample."""

    def prepare(params: RecordedDisturbanceParams) -> Pieces:
        """The record as a piecewise cubic function of time.

        Raises:
            ConfigError: The times do not rise, are too few or too many, or do not have one value each.
        """
        return cubic_pieces(params.time, params.value, rule)

    if rule == Interpolation.HOLD:
        return Disturbance(
            params=RecordedDisturbanceParams,
            init=lambda record, key: 0.0,
            step=record_mean,
            value=lambda record, state, measurement, sigma, t: state,
            prepare=lambda params: held_record(prepare(params)),
            smooth=SMOOTH,
            last_change=lambda record: last_time(record.pieces),
        )
    return Disturbance(
        params=RecordedDisturbanceParams,
        init=stateless,
        step=unchanged,
        value=lambda pieces, state, measurement, sigma, t: piece_at(pieces, t).y,
        prepare=prepare,
        smooth=SMOOTH,
        last_change=last_time,
    )


RECORDED_DISTURBANCE = Entry(
    {rule: recorded_disturbance(rule) for rule in Interpolation},
    "a recorded disturbance: `file` and `column`, or `time` and `value`",
    "interpolation",
    Interpolation.LINEAR,
    example={"time": [0.0, 0.3, 0.6], "value": [0.0, 0.2, 0.1]},
)
