"""Matched disturbances d(y, y', t), added to the plant's command (7)."""

import math
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Disturbance, NoParams, Variation, stateless, unchanged
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import begun, cubic_spline, standard_normal
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import SMOOTH, piecewise

VALUE = Quantity("u", "value of d")


class ConstantParams(NamedTuple):
    """A constant disturbance."""

    value: Annotated[Scalar, VALUE]


class StepParams(NamedTuple):
    """A step of height ``value`` at the time ``at``."""

    value: Annotated[Scalar, VALUE]
    at: Annotated[Scalar, Quantity("s", "time of the step", at_least=0.0)] = 0.0


class SineDisturbanceParams(NamedTuple):
    """amplitude sin(2 pi t/period + phase)."""

    amplitude: Annotated[Scalar, Quantity("u", "amplitude")]
    period: Annotated[Scalar, Quantity("s", "period", above=0.0)]
    phase: Annotated[Scalar, Quantity("rad", "phase")] = 0.0


class SplineParams(NamedTuple):
    """A cubic spline with knots ``interval`` apart, the first at ``at``: any signal of bounded amplitude and slope.

    d = sum of knots[i] B((t - at)/interval - i) with the cubic B-spline B: |d| is at most the largest |knot|, and
    |d'| is at most the largest difference of consecutive knots divided by the interval. It begins and ends at 0, two
    intervals outside the knots.
    """

    knots: Annotated[tuple[Scalar, ...], Quantity("u", "coefficient of the spline at a knot")]
    interval: Annotated[Scalar, Quantity("s", "time between two knots", above=0.0)]
    at: Annotated[Scalar, Quantity("s", "time of the first knot")] = 0.0


class NoiseParams(NamedTuple):
    """Gaussian noise of the given standard deviation and correlation time (a first-order Gauss-Markov process)."""

    std: Annotated[Scalar, Quantity("u", "standard deviation", at_least=0.0)]
    correlation_time: Annotated[Scalar, Quantity("s", "correlation time", above=0.0)]


class PartitionParams(NamedTuple):
    """A member of the class (30) that attains the bounds of (A1)-(A3).

    With omega = 2 pi/period and s = sin(omega t):
    d_1 = (k_d1 |y| + k_d2 |y'| + k_d3) sigma;
    d_2 = (k_d4 + min(k_d5/omega, k_d4) (s - 1)) y + (alpha_d2/omega) s, so |dd_2/dy| <= k_d4 and
    |dd_2/dt| <= k_d5 |y| + alpha_d2; d_3 = value + (alpha_d3/omega) s.
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


def held_value(params: Any, state: Scalar, measurement: Measurement, sigma: Scalar, t: Scalar) -> Scalar:
    """The value held over the sample."""
    return state


def step_mean(params: StepParams, state: Scalar, key: jax.Array, t: Scalar, dt: Scalar) -> Scalar:
    """Mean of the step over [t, t + dt): the impulse of a jump within a sample is exact, its time to O(T_s)."""
    return params.value * begun(params.at, t, dt)


def sine_value(params: SineDisturbanceParams, state: Any, measurement: Measurement, sigma: Scalar, t: Scalar) -> Scalar:
    """The sine at t."""
    return params.amplitude * jnp.sin(2.0 * math.pi / params.period * t + params.phase)


def check_knots(params: SplineParams) -> SplineParams:
    """Check that there are knots.

    Raises:
        ConfigError: there are none.
    """
    if not params.knots:
        raise ConfigError("knots", "needs at least one knot, got none")
    return params


def spline_value(params: SplineParams, state: Any, measurement: Measurement, sigma: Scalar, t: Scalar) -> Scalar:
    """The spline at t."""
    return cubic_spline(params.knots, (t - params.at) / params.interval)


def noise_init(params: NoiseParams, key: jax.Array) -> Scalar:
    """A draw from the stationary law, to avoid an initial transient."""
    return params.std * standard_normal(key)


def noise_step(params: NoiseParams, state: Scalar, key: jax.Array, t: Scalar, dt: Scalar) -> Scalar:
    """Exact sampling of the Gauss-Markov process: variance and correlation do not depend on dt."""
    decay = jnp.exp(-dt / params.correlation_time)
    spread = params.std * jnp.sqrt(-jnp.expm1(-2.0 * dt / params.correlation_time))
    return decay * state + spread * standard_normal(key)


def partition_value(params: PartitionParams, state: Any, measurement: Measurement, sigma: Scalar, t: Scalar) -> Scalar:
    """d_1 + d_2 + d_3 of (30)."""
    omega = 2.0 * math.pi / params.period
    s = jnp.sin(omega * t)
    growth = params.k_d1 * jnp.abs(measurement.y) + params.k_d2 * jnp.abs(measurement.y_dot) + params.k_d3
    swing = jnp.minimum(params.k_d5 / omega, params.k_d4)
    stiffness = params.k_d4 + swing * (s - 1.0)
    drift = (params.alpha_d2 + params.alpha_d3) / omega * s
    return growth * sigma + stiffness * measurement.y + drift + params.value


NO_DISTURBANCE = Disturbance(
    NoParams,
    stateless,
    unchanged,
    lambda params, state, measurement, sigma, t: 0.0,
    variation=Variation.HELD,
    smooth=SMOOTH,
)
CONSTANT = Disturbance(
    ConstantParams,
    stateless,
    unchanged,
    lambda params, state, measurement, sigma, t: params.value,
    variation=Variation.HELD,
    smooth=SMOOTH,
)
STEP = Disturbance(StepParams, lambda params, key: 0.0, step_mean, held_value, variation=Variation.HELD, smooth=SMOOTH)
SINE_DISTURBANCE = Disturbance(
    SineDisturbanceParams, stateless, unchanged, sine_value, variation=Variation.TIME, smooth=SMOOTH
)
SPLINE = Disturbance(
    SplineParams, stateless, unchanged, spline_value, check_knots, variation=Variation.TIME, smooth=SMOOTH
)
FILTERED_NOISE = Disturbance(NoiseParams, noise_init, noise_step, held_value, variation=Variation.HELD, smooth=SMOOTH)
PARTITION = Disturbance(
    PartitionParams,
    stateless,
    unchanged,
    partition_value,
    variation=Variation.STATE,
    smooth=piecewise("the kinks of its bounds at y = 0 and y' = 0"),
)
