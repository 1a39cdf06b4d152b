"""A disturbance that is coloured Gaussian noise.

In units, u stands for the unit of the command.
"""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Disturbance, Variation
from dssc_jax.core.default_functions import unchanging
from dssc_jax.core.numerics import standard_normal
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.models.disturbances.prescribed import held_value


class NoiseParams(NamedTuple):
    """Standard deviation and correlation time of a first-order Gauss-Markov process, d' = -d/T + white noise."""

    std: Annotated[Scalar, Quantity("u", "standard deviation", at_least=0.0)]
    correlation_time: Annotated[Scalar, Quantity("s", "correlation time", above=0.0)]


def noise_init(params: NoiseParams, key: jax.Array) -> Scalar:
    """The value at t = 0 [u], drawn from the stationary law, so that there is no transient."""
    return params.std * standard_normal(key)


def noise_step(params: NoiseParams, state: Scalar, key: jax.Array, t: Scalar, dt: Scalar) -> Scalar:
    """The value at the next sample [u], by exact sampling of the process.

    The standard deviation, and the correlation exp(-tau/T) over a time tau, are therefore the same for every dt. The
    process is stationary, so that the time ``t`` is not used.
    """
    decay = jnp.exp(-dt / params.correlation_time)
    spread = params.std * jnp.sqrt(-jnp.expm1(-2.0 * dt / params.correlation_time))
    return decay * state + spread * standard_normal(key)


FILTERED_NOISE = Disturbance(
    params=NoiseParams,
    init=noise_init,
    step=noise_step,
    value=held_value,
    variation=Variation.HELD,
    smooth=SMOOTH,
    last_change=unchanging,
)
