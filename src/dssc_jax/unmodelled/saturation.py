"""A saturation in series with the plant input."""

from typing import Annotated, NamedTuple

from dssc_jax.numerics import saturate
from dssc_jax.types import Quantity, Scalar, Unmodelled


class SaturationParams(NamedTuple):
    """The largest magnitude; an ideal actuator has an infinite one."""

    limit: Annotated[Scalar, Quantity("m/s", "largest magnitude of the plant input", above=0.0)]


SATURATION = Unmodelled(
    SaturationParams,
    init=lambda params: (),
    step=lambda params, state, command, dt: state,
    output=lambda params, state, command: saturate(command, params.limit),
)
