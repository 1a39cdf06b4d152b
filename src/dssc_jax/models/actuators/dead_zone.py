"""A dead zone in series with the plant input, as of a valve with overlap: small commands have no effect.

In units, u stands for the unit of the command.
"""

from typing import Annotated, NamedTuple

from dssc_jax.core.adapters import static_unmodelled, unit_gain
from dssc_jax.core.numerics import saturate
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import not_smooth


class DeadZoneParams(NamedTuple):
    """The half-width of a dead zone; with 0 the actuator is ideal."""

    half_width: Annotated[Scalar, Quantity("u", "largest command that has no effect", at_least=0.0)]


def beyond_zone(params: DeadZoneParams, command: Scalar) -> Scalar:
    """The plant input [u]: the part of the command beyond the dead zone, 0 within it."""
    return command - saturate(command, params.half_width)


DEAD_ZONE = static_unmodelled(
    DeadZoneParams,
    beyond_zone,
    smooth=not_smooth(
        "counts as its gain 1 for large signals; its describing function lies between 0 and 1, so that a loop which "
        "needs a least gain may oscillate within the margins",
        unit_gain(DeadZoneParams),
    ),
)
