"""The robust exact differentiator of first order, sampled implicitly.

References:
    A. Levant, "Robust exact differentiation via sliding mode technique", Automatica 34 (1998).
    M. R. Mojallizadeh, B. Brogliato, V. Acary, "Time-discretizations of differentiators: design of implicit
    algorithms and comparative analysis", Int. J. Robust and Nonlinear Control 31 (2021).
    R. Seeber, "Proper implicit discretization of arbitrary-order robust exact differentiators",
    arXiv:2404.02770 (2024).
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Differentiator
from dssc_jax.core.numerics import root_of, sign
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import SMOOTH, not_smooth

LIPSCHITZ = Quantity("y/s^2", "bound L of |y''|", above=0.0)
LAMBDA_1 = Quantity("1", "lambda_1 of the robust exact differentiator", above=0.0)
LAMBDA_0 = Quantity("1", "lambda_0 of the robust exact differentiator", above=1.0)


class LevantParams(NamedTuple):
    """The bound L = ``lipschitz`` of |y''|, and the gains of the robust exact differentiator of first order.

    In continuous time the differentiator is z0' = -lambda_1 (L |z0 - y|)^(1/2) sgn(z0 - y) + z1 and z1' = -lambda_0 L
    sgn(z0 - y), where z0 estimates y, and z1 estimates y'. The default gains are Levant's (1998).
    """

    lipschitz: Annotated[Scalar, LIPSCHITZ]
    lambda1: Annotated[Scalar, LAMBDA_1] = 1.5
    lambda0: Annotated[Scalar, LAMBDA_0] = 1.1


class LevantState(NamedTuple):
    """The differentiator's estimates z0 of y [y] and z1 of y' [y/s]."""

    z0: Scalar
    z1: Scalar


def levant_init(params: LevantParams, measurement: Measurement) -> LevantState:
    """The differentiator at the first measurement: at y, with velocity zero.

    The velocity of the measurement is ignored.
    """
    return LevantState(measurement.y, 0.0)


def levant_step(
    params: LevantParams, state: LevantState, measurement: Measurement, dt: Scalar
) -> tuple[LevantState, Measurement]:
    """Backward Euler with the set-valued sign, solved exactly.

    Let x = z0+ - y be the error after the sample, b = z0 + dt z1 - y the error of the prediction, and xi in Sgn x. A
    sample solves x + dt lambda_1 (L |x|)^(1/2) sgn x + dt^2 lambda_0 L xi = b.

    For |b| <= dt^2 lambda_0 L the solution is x = 0: the differentiator slides, and z1+ is the backward difference of
    y, without chatter or rounding errors that add up. Once reached, sliding persists, because b is then a second
    difference of y, at most L dt^2 < lambda_0 L dt^2. The error of the velocity is at most L dt/2, the least possible
    from samples. Outside of sliding, s = |x|^(1/2) solves a quadratic.
    """
    b = state.z0 + dt * state.z1 - measurement.y
    jump = dt * params.lambda0 * params.lipschitz
    excess = jnp.abs(b) - dt * jump
    sliding = excess <= 0.0
    s = root_of(excess, dt * params.lambda1 * jnp.sqrt(params.lipschitz))
    velocity = jnp.where(sliding, (measurement.y - state.z0) / dt, state.z1 - jump * sign(b))
    return LevantState(measurement.y + s * s * sign(b), velocity), Measurement(measurement.y, velocity)


def backward_difference_step(
    params: LevantParams, state: LevantState, measurement: Measurement, dt: Scalar
) -> tuple[LevantState, Measurement]:
    """One sample of the differentiator while it slides, z0 = y: its velocity is the backward difference of y.

    This is :func:`levant_step` without the sign, so that the result has a derivative everywhere. The parameters are not
    used, because the gains have no effect in sliding.
    """
    velocity = (measurement.y - state.z0) / dt
    return LevantState(measurement.y, velocity), Measurement(measurement.y, velocity)


def in_sliding(params: LevantParams) -> tuple[Differentiator, LevantParams]:
    """The part that is linearised in place of the robust exact differentiator: the backward difference of y.

    It stands for the differentiator while |y''| <= L, when it slides.
    """
    return BACKWARD_DIFFERENCE, params


BACKWARD_DIFFERENCE = Differentiator(LevantParams, levant_init, backward_difference_step, smooth=SMOOTH)
LEVANT = Differentiator(
    LevantParams,
    levant_init,
    levant_step,
    smooth=not_smooth(
        "counts as the backward difference of y, which it is in sliding, while |y''| <= lipschitz", in_sliding
    ),
)
