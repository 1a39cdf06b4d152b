"""A plant input that is a multiple of a resolution, as behind a digital-to-analogue converter.

In units, u stands for the unit of the command.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.adapters import static_unmodelled, unit_gain
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import MEAN_GAIN, not_smooth


class QuantisationParams(NamedTuple):
    """The resolution of a plant input, the difference of two neighbouring values."""

    resolution: Annotated[Scalar, Quantity("u", "the plant input is a multiple of it", above=0.0)]


def nearest_multiple(params: QuantisationParams, command: Scalar) -> Scalar:
    """The plant input [u]: the multiple of the resolution that is nearest to the command."""
    return params.resolution * jnp.round(command / params.resolution)


QUANTISATION = static_unmodelled(
    QuantisationParams, nearest_multiple, smooth=not_smooth(f"counts as {MEAN_GAIN}", unit_gain(QuantisationParams))
)
