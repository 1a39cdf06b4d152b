"""A recorded disturbance."""

from typing import Annotated, NamedTuple

from dssc_jax.core.contracts import Disturbance
from dssc_jax.core.default_functions import stateless, unchanged
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.records import TIMES, Interpolation, Pieces, Values, cubic_pieces, piece_at
from dssc_jax.core.registry import Entry
from dssc_jax.core.smoothness import SMOOTH


class RecordedDisturbanceParams(NamedTuple):
    """A recorded disturbance; a study file has ``file`` and ``column`` instead."""

    time: Annotated[Values, TIMES]
    value: Annotated[Values, Quantity("u", "values at these times", law=False, data=True)]


def recorded_disturbance(rule: Interpolation) -> Disturbance:
    """The disturbance that interpolates a record by a rule; with ``hold`` it is constant over each sample."""

    def prepare(params: RecordedDisturbanceParams) -> Pieces:
        return cubic_pieces(params.time, params.value, rule)

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


RECORDED_DISTURBANCE = Entry(
    {rule: recorded_disturbance(rule) for rule in Interpolation},
    "a recorded disturbance: `file` and `column`, or `time` and `value`",
    "interpolation",
    Interpolation.LINEAR,
    example={"time": [0.0, 0.3, 0.6], "value": [0.0, 0.2, 0.1]},
)
