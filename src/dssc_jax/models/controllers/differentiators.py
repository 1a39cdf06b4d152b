"""Differentiators that estimate y' from sampled y, for channels where only y is measured.

Each starts at the first y with velocity zero and ignores the velocity of the first measurement, because only y is
known. A step estimates y' at the current sample. Each is exact on y = c0 + c1 t after its transient, and stable at
every dt. Angles must not be wrapped.

References:
    A. Levant, "Robust exact differentiation via sliding mode technique", Automatica 34 (1998).
    M. R. Mojallizadeh, B. Brogliato, V. Acary, "Time-discretizations of differentiators: design of implicit
    algorithms and comparative analysis", Int. J. Robust and Nonlinear Control 31 (2021).
    R. Seeber, "Proper implicit discretization of arbitrary-order robust exact differentiators",
    arXiv:2404.02770 (2024).
    H. K. Khalil, L. Praly, "High-gain observers in nonlinear feedback control", Int. J. Robust and Nonlinear
    Control 24 (2014).
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Differentiator, NoParams
from dssc_jax.core.numerics import sign
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import SMOOTH, not_smooth
from dssc_jax.models.controllers.sta import root_of

TAU_F = Quantity("s", "time constant tau_f of the lead filter", above=0.0)
EPSILON = Quantity("s", "time constant epsilon of the high-gain observer", above=0.0)
ALPHA_1 = Quantity("1", "alpha_1 of the high-gain observer", above=0.0)
ALPHA_2 = Quantity("1", "alpha_2 of the high-gain observer", above=0.0)
LIPSCHITZ = Quantity("y/s^2", "bound L of |y''|", above=0.0)
LAMBDA_1 = Quantity("1", "lambda_1 of the robust exact differentiator", above=0.0)
LAMBDA_0 = Quantity("1", "lambda_0 of the robust exact differentiator", above=1.0)


class LeadFilterParams(NamedTuple):
    """y' ~ s y/(tau_f s + 1)."""

    tau_f: Annotated[Scalar, TAU_F]


class LeadFilterState(NamedTuple):
    """The last sample of y [m], and the filter's output [m/s]."""

    y: Scalar
    velocity: Scalar


class HighGainParams(NamedTuple):
    """x1' = x2 + (alpha_1/epsilon)(y - x1), x2' = (alpha_2/epsilon^2)(y - x1).

    Its transfer function from y to x2 is s/((epsilon s)^2/alpha_2 + (alpha_1/alpha_2) epsilon s + 1); the defaults
    (assumed) give it the double pole -1/epsilon.
    """

    epsilon: Annotated[Scalar, EPSILON]
    alpha1: Annotated[Scalar, ALPHA_1] = 2.0
    alpha2: Annotated[Scalar, ALPHA_2] = 1.0


class HighGainState(NamedTuple):
    """Estimates of y [m] and y' [m/s]."""

    x1: Scalar
    x2: Scalar


class LevantParams(NamedTuple):
    """z0' = -lambda_1 (L |z0 - y|)^(1/2) sgn(z0 - y) + z1, z1' = -lambda_0 L sgn(z0 - y).

    The defaults are Levant's (1998).
    """

    lipschitz: Annotated[Scalar, LIPSCHITZ]
    lambda1: Annotated[Scalar, LAMBDA_1] = 1.5
    lambda0: Annotated[Scalar, LAMBDA_0] = 1.1


class LevantState(NamedTuple):
    """Estimates of y [m] and y' [m/s]."""

    z0: Scalar
    z1: Scalar


def lead_filter_init(params: LeadFilterParams, measurement: Measurement) -> LeadFilterState:
    """At rest at the first y."""
    return LeadFilterState(measurement.y, 0.0)


def lead_filter_step(
    params: LeadFilterParams, state: LeadFilterState, measurement: Measurement, dt: Scalar
) -> tuple[LeadFilterState, Measurement]:
    """Exact solution of tau_f v' = y' - v over dt, for y linear between the samples.

    Args:
        params: Time constant.
        state: Last sample and last output.
        measurement: The sampled y [m].
        dt: Time since the last sample [s].

    Returns:
        The next state, and y with the estimate of y'.
    """
    share = -jnp.expm1(-dt / params.tau_f)
    slope = (measurement.y - state.y) / dt
    velocity = state.velocity + share * (slope - state.velocity)
    return LeadFilterState(measurement.y, velocity), Measurement(measurement.y, velocity)


def high_gain_init(params: HighGainParams, measurement: Measurement) -> HighGainState:
    """At rest at the first y."""
    return HighGainState(measurement.y, 0.0)


def high_gain_step(
    params: HighGainParams, state: HighGainState, measurement: Measurement, dt: Scalar
) -> tuple[HighGainState, Measurement]:
    """Backward Euler, solved for the innovation y - x1+; tends to the backward difference for dt >> epsilon.

    Args:
        params: Time constant and coefficients.
        state: Estimates at the last sample.
        measurement: The sampled y [m].
        dt: Time since the last sample [s].

    Returns:
        The next state, and y with the estimate of y'.
    """
    # multiplied by epsilon^2, so that nothing is divided by a small epsilon
    first, second = dt * params.alpha1 * params.epsilon, dt * dt * params.alpha2
    square = params.epsilon * params.epsilon
    scaled = (measurement.y - state.x1 - dt * state.x2) / (square + first + second)
    velocity = state.x2 + dt * params.alpha2 * scaled
    return HighGainState(measurement.y - square * scaled, velocity), Measurement(measurement.y, velocity)


def levant_init(params: LevantParams, measurement: Measurement) -> LevantState:
    """At rest at the first y."""
    return LevantState(measurement.y, 0.0)


def levant_step(
    params: LevantParams, state: LevantState, measurement: Measurement, dt: Scalar
) -> tuple[LevantState, Measurement]:
    """Backward Euler with the set-valued sign, solved exactly.

    With x = z0+ - y, b = z0 + dt z1 - y and xi in Sgn x: x + dt lambda_1 (L |x|)^(1/2) sgn x + dt^2 lambda_0 L xi = b.
    For |b| <= dt^2 lambda_0 L the solution is x = 0, and z1+ is the backward difference of y: no chatter, and no
    rounding that adds up. Once reached, sliding persists: b is then a second difference of y, at most
    L dt^2 < lambda_0 L dt^2. The error is at most L dt/2, the least possible from samples. Outside of sliding, s =
    |x|^(1/2) solves a quadratic.

    Args:
        params: Bound of y'' and gains.
        state: Estimates at the last sample.
        measurement: The sampled y [m].
        dt: Time since the last sample [s].

    Returns:
        The next state, and y with the estimate of y'.
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
    """The step of :func:`levant_step` in sliding; with its arguments."""
    velocity = (measurement.y - state.z0) / dt
    return LevantState(measurement.y, velocity), Measurement(measurement.y, velocity)


def in_sliding(params: LevantParams) -> tuple[Differentiator, LevantParams]:
    """The robust exact differentiator in sliding."""
    return BACKWARD_DIFFERENCE, params


NO_DIFFERENTIATOR = Differentiator(
    NoParams,
    init=lambda params, measurement: (),
    step=lambda params, state, measurement, dt: (state, measurement),
    smooth=SMOOTH,
)
LEAD_FILTER = Differentiator(LeadFilterParams, lead_filter_init, lead_filter_step, smooth=SMOOTH)
HIGH_GAIN_OBSERVER = Differentiator(HighGainParams, high_gain_init, high_gain_step, smooth=SMOOTH)
BACKWARD_DIFFERENCE = Differentiator(LevantParams, levant_init, backward_difference_step, smooth=SMOOTH)
LEVANT = Differentiator(
    LevantParams,
    levant_init,
    levant_step,
    smooth=not_smooth(
        "counts as the backward difference of y, which it is in sliding, while |y''| <= lipschitz", in_sliding
    ),
)

DIFFERENTIATORS: Registry = {
    "none": single(NO_DIFFERENTIATOR, "the measured velocity"),
    "lead_filter": single(LEAD_FILTER, "s y/(tau_f s + 1), exact for y linear between samples"),
    "high_gain_observer": single(HIGH_GAIN_OBSERVER, "two estimates with poles of order 1/epsilon, backward Euler"),
    "levant": single(LEVANT, "robust exact differentiator of first order, implicit: no chatter"),
}
