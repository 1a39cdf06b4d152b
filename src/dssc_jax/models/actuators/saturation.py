"""A saturation in series with the plant input."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.adapters import static_unmodelled
from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.numerics import saturate
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import piecewise


class SaturationParams(NamedTuple):
    """The largest magnitude; infinite for an ideal actuator."""

    limit: Annotated[Scalar, Quantity("u", "largest magnitude of the plant input", above=0.0)]


def without_limit(params: SaturationParams) -> tuple[Unmodelled, SaturationParams]:
    """The saturation within its limit: a gain of 1."""
    return SATURATION, SaturationParams(jnp.inf)


SATURATION = static_unmodelled(
    SaturationParams,
    lambda params, command: saturate(command, params.limit),
    smooth=piecewise("its limit; there it counts as within the limit, a gain of 1", without_limit),
    continuous=True,
)
