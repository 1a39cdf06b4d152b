"""A saturation in series with the plant input."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.adapters import static_unmodelled
from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import clip
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import piecewise


class SaturationParams(NamedTuple):
    """Limits of the plant input: [low, limit], or [-limit, limit] without ``low``; infinite for an ideal actuator."""

    limit: Annotated[Scalar, Quantity("u", "largest plant input", above=0.0)]
    low: Annotated[Scalar | None, Quantity("u", "smallest plant input; absent: -limit")] = None


def limited_command(params: SaturationParams, command: Scalar) -> Scalar:
    """The plant input: the command, clipped to the limits."""
    return clip(command, -params.limit if params.low is None else params.low, params.limit)


def prepare(params: SaturationParams) -> SaturationParams:
    """Require that the lower limit lies below the upper one; raises ConfigError."""
    if params.low is not None:
        top = extent(params.low)[1]
        bottom = extent(params.limit)[0]
        if not top < bottom:
            raise ConfigError("low", f"must be below limit = {bottom:g}, got up to {top:g}")
    return params


def without_limit(params: SaturationParams) -> tuple[Unmodelled, SaturationParams]:
    """The substitute for commands within the limits: infinite limits, which make a gain of 1."""
    return SATURATION, SaturationParams(jnp.inf, None if params.low is None else -jnp.inf)


SATURATION = static_unmodelled(
    SaturationParams,
    limited_command,
    smooth=piecewise("its limit; there it counts as within the limit, a gain of 1", without_limit),
    continuous=True,
    prepare=prepare,
)
