"""A saturation in series with the plant input."""

from typing import Annotated, NamedTuple

from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.numerics import saturate
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar


class SaturationParams(NamedTuple):
    """The largest magnitude; infinite for an ideal actuator."""

    limit: Annotated[Scalar, Quantity("u", "largest magnitude of the plant input", above=0.0)]


SATURATION = Unmodelled(
    SaturationParams,
    init=lambda params: (),
    step=lambda params, state, command, dt: state,
    output=lambda params, state, command: saturate(command, params.limit),
    held=True,
)
