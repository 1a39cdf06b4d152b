"""Dryden turbulence with a mean wind, exactly sampled.

Reference:
    MIL-F-8785C, Military Specification: Flying Qualities of Piloted Airplanes, 1980, section 3.7: turbulence in the
    Dryden form; wind shear, intensities and scale lengths of the low-altitude model.
"""

import math
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.default_functions import unchanging
from dssc_jax.core.numerics import elapsed_share, standard_normals
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.core.wind import Wind
from dssc_jax.models.wind.prescribed import START

FOOT = 0.3048
"""The international foot [m]."""
REFERENCE_HEIGHT = 20.0 * FOOT
"""Height at which W20 is measured [m] (MIL-F-8785C)."""
ROUGHNESS = 0.15 * FOOT
"""z_0 of the flight phases near the ground, category C [m] (MIL-F-8785C; 2 ft in the others)."""
ROOT3 = math.sqrt(3.0)


class DrydenParams(NamedTuple):
    """The mean wind and the height of Dryden turbulence by the low-altitude model.

    ``altitude`` sets mean wind, intensities and scale lengths, which do not follow the vehicle's height. ``airspeed``
    converts lengths to times: the vehicle passes through a frozen field at this speed. In hover it is about the wind
    speed.
    """

    speed: Annotated[Scalar, Quantity("m/s", "mean wind speed at 20 ft (6.1 m), W20", at_least=0.0, leading=True)]
    altitude: Annotated[Scalar, Quantity("m", "height above ground", at_least=3.0, at_most=305.0)]
    airspeed: Annotated[Scalar, Quantity("m/s", "speed of passing through the frozen field, V", above=0.0)]
    direction: Annotated[Scalar, Quantity("rad", "where the wind blows to, from x towards y")] = 0.0
    turbulence: Annotated[Scalar, Quantity("1", "factor on the intensities", at_least=0.0)] = 1.0
    at: Annotated[Scalar, START] = 0.0


class DrydenLaw(NamedTuple):
    """The turbulence at a height: u is along the mean wind, v across it, w vertical.

    Args:
        mean: Mean wind speed [m/s].
        sigma_uv: Intensity of u and v [m/s].
        sigma_w: Intensity of w [m/s].
        length_uv: Scale length of u and v [m].
        length_w: Scale length of w [m].
    """

    mean: Scalar
    sigma_uv: Scalar
    sigma_w: Scalar
    length_uv: Scalar
    length_w: Scalar


class Transverse(NamedTuple):
    """State of the filter of v or w: a' = -a + n, b' = -b + a, with unit white noise n and L/V as the unit of time."""

    a: Scalar
    b: Scalar

    @property
    def output(self) -> Scalar:
        """The output of the filter (1 + sqrt(3) s)/(1 + s)^2, in partial fractions; its variance is 1."""
        return ROOT3 * self.a + (1.0 - ROOT3) * self.b


class DrydenState(NamedTuple):
    """The turbulence over a sample, relative to its intensities.

    Args:
        u: Turbulence u along the mean wind, over its intensity.
        v: Filter of the turbulence v across the mean wind.
        w: Filter of the vertical turbulence w.
        begun: Share of the sample that lies after the wind's beginning, in [0, 1].
    """

    u: Scalar
    v: Transverse
    w: Transverse
    begun: Scalar


def dryden_law(params: DrydenParams) -> DrydenLaw:
    """The low-altitude model of MIL-F-8785C at the height h of the parameters; its formulas are in feet.

    The mean wind is W20 ln(h/z_0)/ln(20 ft/z_0) with z_0 = 0.15 ft. The scale lengths are L_w = h and L_u = L_v =
    h/(0.177 + 0.000823 h)^1.2. The intensities are sigma_w = 0.1 W20 and sigma_u = sigma_v = sigma_w/(0.177 + 0.000823
    h)^0.4, times ``turbulence``.

    Returns:
        Intensities and mean in [m/s], lengths in [m].
    """
    shape = 0.177 + 0.000823 * (params.altitude / FOOT)
    sigma_w = params.turbulence * 0.1 * params.speed
    return DrydenLaw(
        mean=params.speed * jnp.log(params.altitude / ROUGHNESS) / math.log(REFERENCE_HEIGHT / ROUGHNESS),
        sigma_uv=sigma_w / shape**0.4,
        sigma_w=sigma_w,
        length_uv=params.altitude / shape**1.2,
        length_w=params.altitude,
    )


def decayed_sinh_excess(h: Scalar) -> Scalar:
    """exp(-h) (sinh h - h) for h >= 0, without cancellation or overflow.

    Below h = 1 it is exp(-h) h^3/6 times the series 1 + h^2/(4 5) (1 + h^2/(6 7) (1 + ...)).
    """
    small = jnp.minimum(h, 1.0)
    square = small * small
    series = 1.0
    for n in range(16, 2, -2):  # n = 16, 14, .., 4: from the innermost bracket outwards
        series = 1.0 + square / (n * (n + 1)) * series
    direct = -0.5 * jnp.expm1(-2.0 * h) - h * jnp.exp(-h)
    return jnp.where(h < 1.0, jnp.exp(-h) * small * square / 6.0 * series, direct)


def noise_factor(h: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Cholesky factor of the covariance Q of the noise that enters :class:`Transverse` over h = V dt/L.

    Q is the covariance of int_0^h (1, s) exp(-s) dW. Its entries follow from Q_aa = exp(-h) sinh h,
    Q_ab = (exp(-h) (sinh h - h) - h exp(-h) expm1(-h))/2, and det Q = exp(-2 h) (sinh^2 h - h^2)/4. Every term is
    positive, so that single precision resolves the smallest entry, of order h^3.

    Args:
        h: Length of the sample in units of L/V.

    Returns:
        The entries (a, a), (b, a), (b, b).
    """
    decay = jnp.exp(-h)
    variance = -0.5 * jnp.expm1(-2.0 * h)
    excess = decayed_sinh_excess(h)
    a_a = jnp.sqrt(variance)
    b_a = 0.5 * (excess - h * decay * jnp.expm1(-h)) / a_a
    b_b = jnp.sqrt(0.25 * excess * (variance + h * decay) / variance)
    return a_a, b_a, b_b


def transverse_init(n1: Scalar, n2: Scalar) -> Transverse:
    """The filter at t = 0, drawn from the stationary law, of covariance ((1/2, 1/4), (1/4, 1/4)).

    Args:
        n1: Standard normal number.
        n2: Another, independent one.
    """
    return Transverse(math.sqrt(0.5) * n1, math.sqrt(0.125) * (n1 + n2))


def transverse_step(state: Transverse, h: Scalar, n1: Scalar, n2: Scalar) -> Transverse:
    """The filter after h = V dt/L, by exact sampling: the law of the samples does not depend on the step.

    Args:
        state: The filter before.
        h: Length of the sample in units of L/V.
        n1: Standard normal number.
        n2: Another, independent one.
    """
    decay = jnp.exp(-h)
    a_a, b_a, b_b = noise_factor(h)
    return Transverse(decay * state.a + a_a * n1, decay * (state.b + h * state.a) + b_a * n1 + b_b * n2)


def dryden_init(params: DrydenParams, key: jax.Array) -> DrydenState:
    """The state at t = 0, drawn from the stationary law, so that there is no transient."""
    normals = standard_normals(key, 5)
    return DrydenState(
        u=normals[0], v=transverse_init(normals[1], normals[2]), w=transverse_init(normals[3], normals[4]), begun=0.0
    )


def dryden_step(params: DrydenParams, state: DrydenState, key: jax.Array, t: Scalar, dt: Scalar) -> DrydenState:
    """The state at the next sample, by exact sampling of the filters; before ``at`` the filters run without effect.

    H_u = sigma_u sqrt(2 L_u/(pi V))/(1 + L_u s/V) and, for v and w,
    H = sigma sqrt(L/(pi V)) (1 + sqrt(3) L s/V)/(1 + L s/V)^2. Their squared moduli are the one-sided spectra of the
    specification in omega [rad/s], with integral sigma^2 over omega > 0; the noise therefore has the autocovariance
    pi delta(t). The autocorrelations are exp(-T) and exp(-T) (1 - T/2), T = V tau/L: integral scales are L_u, L_v/2
    and L_w/2.
    """
    law = dryden_law(params)
    normals = standard_normals(key, 5)
    h_uv = params.airspeed * dt / law.length_uv  # length of the sample in units of L_u/V
    h_w = params.airspeed * dt / law.length_w  # and of L_w/V
    return DrydenState(
        u=jnp.exp(-h_uv) * state.u + jnp.sqrt(-jnp.expm1(-2.0 * h_uv)) * normals[0],
        v=transverse_step(state.v, h_uv, normals[1], normals[2]),
        w=transverse_step(state.w, h_w, normals[3], normals[4]),
        begun=elapsed_share(params.at, t, dt),
    )


def dryden_value(params: DrydenParams, state: DrydenState, t: Scalar) -> Vec3:
    """The wind in inertial axes, mean and turbulence, which is constant over the sample [m/s]."""
    law = dryden_law(params)
    longitudinal = law.mean + law.sigma_uv * state.u
    lateral = law.sigma_uv * state.v.output
    c = jnp.cos(params.direction)
    s = jnp.sin(params.direction)
    x = longitudinal * c - lateral * s
    y = longitudinal * s + lateral * c
    z = law.sigma_w * state.w.output
    return Vec3(x, y, z) * state.begun


def dryden_mean(params: DrydenParams, dt: Scalar) -> Vec3:
    """The expected wind over the first sample, of length dt [m/s]."""
    speed = dryden_law(params).mean * elapsed_share(params.at, 0.0, dt)
    return Vec3(speed * jnp.cos(params.direction), speed * jnp.sin(params.direction), 0.0)


DRYDEN = Wind(
    params=DrydenParams,
    init=dryden_init,
    step=dryden_step,
    value=dryden_value,
    mean=dryden_mean,
    last_change=unchanging,
)
