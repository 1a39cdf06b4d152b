"""A plant input that is a multiple of a resolution, as behind a digital-to-analogue converter."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.adapters import static_unmodelled
from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import MEAN_GAIN, SMOOTH, not_smooth


class QuantisationParams(NamedTuple):
    """The resolution."""

    resolution: Annotated[Scalar, Quantity("u", "the plant input is a multiple of it", above=0.0)]


def nearest_multiple(params: QuantisationParams, command: Scalar) -> Scalar:
    """The multiple of the resolution that is nearest to the command; the error is at most half the resolution."""
    return params.resolution * jnp.round(command / params.resolution)


def unit_gain(params: QuantisationParams) -> tuple[Unmodelled, QuantisationParams]:
    """The quantiser for signals that are large against its resolution: a gain of 1, with an error of half a step."""
    return UNIT_GAIN, params


UNIT_GAIN = static_unmodelled(QuantisationParams, lambda params, command: command, smooth=SMOOTH, continuous=True)
QUANTISATION = static_unmodelled(
    QuantisationParams, nearest_multiple, smooth=not_smooth(f"counts as {MEAN_GAIN}", unit_gain)
)
