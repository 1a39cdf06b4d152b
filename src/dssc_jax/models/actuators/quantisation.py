"""A plant input that is a multiple of a resolution, as behind a digital-to-analogue converter."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.adapters import static_unmodelled, unit_gain
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import MEAN_GAIN, not_smooth


class QuantisationParams(NamedTuple):
    """Parameters of a quantisation."""

    resolution: Annotated[Scalar, Quantity("u", "the plant input is a multiple of it", above=0.0)]


def nearest_multiple(params: QuantisationParams, command: Scalar) -> Scalar:
    """The multiple of the resolution that is nearest to the command; the error is at most half the resolution."""
    return params.resolution * jnp.round(command / params.resolution)


QUANTISATION = static_unmodelled(
    QuantisationParams, nearest_multiple, smooth=not_smooth(f"counts as {MEAN_GAIN}", unit_gain(QuantisationParams))
)
