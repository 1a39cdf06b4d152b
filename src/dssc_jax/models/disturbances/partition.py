"""A disturbance of the class (30), which depends on the output and attains the bounds of the class.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

import math
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Disturbance, Variation
from dssc_jax.core.default_functions import stateless, unchanged
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import piecewise
from dssc_jax.models.disturbances.prescribed import VALUE


class PartitionParams(NamedTuple):
    """The bounds (A1)-(A3) of the class (30), and the period of the disturbance d_1 + d_2 + d_3 that attains them.

    With omega = 2 pi/period and s = sin(omega t):

    * d_1 = (k_d1 |y| + k_d2 |y'| + k_d3) sigma;
    * d_2 = (k_d4 + min(k_d5/omega, k_d4) (s - 1)) y + (alpha_d2/omega) s, so that |dd_2/dy| <= k_d4 and
      |dd_2/dt| <= k_d5 |y| + alpha_d2;
    * d_3 = value + (alpha_d3/omega) s, so that |d_3'| <= alpha_d3.
    """

    k_d1: Annotated[Scalar, Quantity("u s/y^2", "k_d1 of (A1)", at_least=0.0)] = 0.0
    k_d2: Annotated[Scalar, Quantity("u s^2/y^2", "k_d2 of (A1)", at_least=0.0)] = 0.0
    k_d3: Annotated[Scalar, Quantity("u s/y", "k_d3 of (A1)", at_least=0.0)] = 0.0
    k_d4: Annotated[Scalar, Quantity("u/y", "k_d4 of (A2)", at_least=0.0)] = 0.0
    k_d5: Annotated[Scalar, Quantity("u/(s y)", "k_d5 of (A2)", at_least=0.0)] = 0.0
    alpha_d2: Annotated[Scalar, Quantity("u/s", "alpha_d2 of (A2)", at_least=0.0)] = 0.0
    alpha_d3: Annotated[Scalar, Quantity("u/s", "alpha_d3 of (A3)", at_least=0.0)] = 0.0
    value: Annotated[Scalar, VALUE] = 0.0
    period: Annotated[Scalar, Quantity("s", "period of the time-varying parts", above=0.0)] = 10.0


def partition_value(
    params: PartitionParams, state: tuple[()], measurement: Measurement, sigma: Scalar, t: Scalar
) -> Scalar:
    """The disturbance d_1 + d_2 + d_3 of (30) at t [s], in units of the command [u]; see :class:`PartitionParams`.

    Args:
        params: The bounds of the class, and the period.
        state: Not used: the disturbance has no memory.
        measurement: y [y] and y' [y/s].
        sigma: Sliding variable [y/s].
        t: Time [s].
    """
    omega = 2.0 * math.pi / params.period
    s = jnp.sin(omega * t)
    growth = params.k_d1 * jnp.abs(measurement.y) + params.k_d2 * jnp.abs(measurement.y_dot) + params.k_d3  # d_1/sigma
    swing = jnp.minimum(params.k_d5 / omega, params.k_d4)  # amplitude with which the stiffness varies
    stiffness = params.k_d4 + swing * (s - 1.0)  # part of d_2 that is proportional to y
    drift = (params.alpha_d2 + params.alpha_d3) / omega * s  # parts of d_2 and d_3 that depend on time alone
    return growth * sigma + stiffness * measurement.y + drift + params.value


PARTITION = Disturbance(
    PartitionParams,
    stateless,
    unchanged,
    partition_value,
    variation=Variation.STATE,
    smooth=piecewise("the kinks of its bounds at y = 0 and y' = 0"),
    last_change=lambda params: params.period,
)
