"""A saturation in series with the plant input.

In units, u stands for the unit of the command.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.adapters import static_unmodelled
from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.numerics import clip
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import piecewise


class SaturationParams(NamedTuple):
    """Limits of the plant input: [low, limit], or [-limit, limit] without ``low``.

    With infinite limits the actuator is ideal.
    """

    limit: Annotated[Scalar, Quantity("u", "largest plant input", above=0.0)]
    low: Annotated[Scalar | None, Quantity("u", "smallest plant input; absent: -limit", less_than="limit")] = None


def limited_command(params: SaturationParams, command: Scalar) -> Scalar:
    """The plant input [u]: the command, clipped to the limits."""
    low = -params.limit if params.low is None else params.low
    return clip(command, low, params.limit)


def without_limit(params: SaturationParams) -> tuple[Unmodelled, SaturationParams]:
    """The part that is linearised in place of the saturation: infinite limits, which make a gain of 1.

    It stands for the actuator under commands within the limits. A missing ``low`` stays missing, because it stands for
    -limit.
    """
    return SATURATION, SaturationParams(jnp.inf, None if params.low is None else -jnp.inf)


SATURATION = static_unmodelled(
    SaturationParams,
    limited_command,
    smooth=piecewise("its limit; there it counts as within the limit, a gain of 1", without_limit),
    continuous=True,
)
