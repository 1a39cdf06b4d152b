"""Wind velocity in the inertial frame, z up: constant, piecewise, gust, splines, Dryden turbulence with a mean wind.

Jumps and random values are held over a sample, with the mean over the sample in which a jump occurs. The gust is
evaluated at every stage of the integrator.

References:
    MIL-F-8785C, Military Specification: Flying Qualities of Piloted Airplanes, 1980, section 3.7: turbulence in the
    Dryden form; wind shear, intensities and scale lengths of the low-altitude model.
    14 CFR 25.341(a)(2) and EASA CS 25.341(a)(2): the discrete gust that returns to zero.
"""

import math
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import NoParams, Wind, stateless, unchanged
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import begun, cubic_spline, standard_normals
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.environment.records import RECORDED_WIND

FOOT = 0.3048
"""The international foot [m]."""
REFERENCE_HEIGHT = 20.0 * FOOT
"""Height at which W20 is measured [m] (MIL-F-8785C)."""
ROUGHNESS = 0.15 * FOOT
"""z_0 of the flight phases near the ground, category C [m] (MIL-F-8785C; 2 ft in the others)."""
ROOT3 = math.sqrt(3.0)

X = Quantity("m/s", "wind velocity along x")
Y = Quantity("m/s", "wind velocity along y")
Z = Quantity("m/s", "wind velocity along z, up")
START = Quantity("s", "time at which the wind begins", at_least=0.0)


class ConstantWindParams(NamedTuple):
    """A constant wind from the time ``at`` on."""

    x: Annotated[Scalar, X]
    y: Annotated[Scalar, Y]
    z: Annotated[Scalar, Z]
    at: Annotated[Scalar, START] = 0.0


class PiecewiseParams(NamedTuple):
    """Row i of the table holds from ``times[i]`` to the next time, the last row for ever; before the first, no wind."""

    times: Annotated[tuple[Scalar, ...], Quantity("s", "time at which the row begins", at_least=0.0)]
    x: Annotated[tuple[Scalar, ...], X]
    y: Annotated[tuple[Scalar, ...], Y]
    z: Annotated[tuple[Scalar, ...], Z]


class GustParams(NamedTuple):
    """A 1-cosine gust of peak (x, y, z) on a constant mean; the peak is at ``at + duration/2``."""

    x: Annotated[Scalar, Quantity("m/s", "peak of the gust along x")]
    y: Annotated[Scalar, Quantity("m/s", "peak of the gust along y")]
    z: Annotated[Scalar, Quantity("m/s", "peak of the gust along z, up")]
    duration: Annotated[Scalar, Quantity("s", "duration of the gust, from zero to zero", above=0.0)]
    at: Annotated[Scalar, Quantity("s", "time at which the gust begins", at_least=0.0)] = 0.0
    mean_x: Annotated[Scalar, Quantity("m/s", "mean wind along x")] = 0.0
    mean_y: Annotated[Scalar, Quantity("m/s", "mean wind along y")] = 0.0
    mean_z: Annotated[Scalar, Quantity("m/s", "mean wind along z, up")] = 0.0


class SplineWindParams(NamedTuple):
    """Cubic splines with knots ``interval`` apart, the first at ``at``: any wind of bounded speed and acceleration.

    Each component is at most its largest |knot|. Its rate is at most the largest difference of consecutive knots
    divided by the interval. The wind begins and ends at 0, two intervals outside the knots.
    """

    interval: Annotated[Scalar, Quantity("s", "time between two knots", above=0.0)]
    x: Annotated[tuple[Scalar, ...], X] = ()
    y: Annotated[tuple[Scalar, ...], Y] = ()
    z: Annotated[tuple[Scalar, ...], Z] = ()
    at: Annotated[Scalar, Quantity("s", "time of the first knot")] = 0.0


class DrydenParams(NamedTuple):
    """Dryden turbulence of the low-altitude model with a mean wind.

    ``altitude`` sets mean wind, intensities and scale lengths; they do not follow the vehicle. ``airspeed`` converts
    lengths to times: the vehicle passes through a frozen field at that speed (about the wind speed in hover).
    """

    speed: Annotated[Scalar, Quantity("m/s", "mean wind speed at 20 ft (6.1 m), W20", at_least=0.0)]
    altitude: Annotated[Scalar, Quantity("m", "height above ground", at_least=3.0, at_most=305.0)]
    airspeed: Annotated[Scalar, Quantity("m/s", "speed of passing through the frozen field, V", above=0.0)]
    direction: Annotated[Scalar, Quantity("rad", "where the wind blows to, from x towards y")] = 0.0
    turbulence: Annotated[Scalar, Quantity("1", "factor on the intensities", at_least=0.0)] = 1.0
    at: Annotated[Scalar, START] = 0.0


class DrydenLaw(NamedTuple):
    """Mean speed and intensities sigma [m/s], scale lengths L [m]; u along and v across the mean wind, w vertical."""

    mean: Scalar
    sigma_uv: Scalar
    sigma_w: Scalar
    length_uv: Scalar
    length_w: Scalar


class Transverse(NamedTuple):
    """State of the filter of v or w: a' = -a + n, b' = -b + a, in units of L/V, with unit white noise n."""

    a: Scalar
    b: Scalar

    @property
    def output(self) -> Scalar:
        """The filtered noise, of variance 1: (1 + sqrt(3) s)/(1 + s)^2 in partial fractions."""
        return ROOT3 * self.a + (1.0 - ROOT3) * self.b


class DrydenState(NamedTuple):
    """Values held over a sample: u over sigma_u, the filters of v and w, and the share of the sample with wind."""

    u: Scalar
    v: Transverse
    w: Transverse
    on: Scalar


def calm(params: Any, key: jax.Array) -> Vec3:
    """No wind before the first sample."""
    return Vec3(0.0, 0.0, 0.0)


def held_wind(params: Any, state: Vec3, t: Scalar) -> Vec3:
    """The wind held over the sample."""
    return state


def constant_step(params: ConstantWindParams, state: Vec3, key: jax.Array, t: Scalar, dt: Scalar) -> Vec3:
    """Mean over [t, t + dt): a jump within a sample does not spoil the integrator's order."""
    return Vec3(params.x, params.y, params.z) * begun(params.at, t, dt)


def check_table(params: PiecewiseParams) -> PiecewiseParams:
    """Check lengths and order of the table.

    Raises:
        ConfigError: it is empty, its columns differ in length, or its times do not increase.
    """
    rows = len(params.times)
    if rows == 0:
        raise ConfigError("times", "needs at least one time, got none")
    for name in ("x", "y", "z"):
        if len(getattr(params, name)) != rows:
            count = len(getattr(params, name))
            raise ConfigError(name, f"must hold {rows} numbers, one for each of times, got {count}")
    for i, (before, after) in enumerate(pairwise(map(extent, params.times)), start=1):
        if not after[0] > before[1]:
            rule = f"times must increase strictly: must be > {before[1]:g}, the one before, got {after[0]:g}"
            raise ConfigError(f"times.{i}", rule)
    return params


def piecewise_step(params: PiecewiseParams, state: Vec3, key: jax.Array, t: Scalar, dt: Scalar) -> Vec3:
    """Mean of the table over [t, t + dt): at each instant the last row that has begun."""
    wind, later = Vec3(0.0, 0.0, 0.0), 0.0
    for at, x, y, z in reversed(list(zip(*params, strict=True))):
        share = jnp.maximum(begun(at, t, dt) - later, 0.0)
        wind, later = wind + Vec3(x, y, z) * share, later + share
    return wind


def gust_value(params: GustParams, state: Any, t: Scalar) -> Vec3:
    """Mean plus peak times (1 - cos(2 pi (t - at)/duration))/2, as the square of a sine."""
    phase = jnp.clip((t - params.at) / params.duration, 0.0, 1.0)
    swell = jnp.square(jnp.sin(math.pi * phase))
    return Vec3(params.mean_x, params.mean_y, params.mean_z) + Vec3(params.x, params.y, params.z) * swell


def check_wind_knots(params: SplineWindParams) -> SplineWindParams:
    """Check that there are knots.

    Raises:
        ConfigError: no component has any.
    """
    if not (params.x or params.y or params.z):
        raise ConfigError("x", "needs at least one knot in x, y or z, got none")
    return params


def spline_wind(params: SplineWindParams, state: Any, t: Scalar) -> Vec3:
    """The splines at t; a component without knots is 0."""
    place = (t - params.at) / params.interval
    return Vec3(*(cubic_spline(knots, place) for knots in (params.x, params.y, params.z)))


def dryden_law(params: DrydenParams) -> DrydenLaw:
    """The low-altitude model at the given height; its formulas use feet.

    Mean W20 ln(h/z_0)/ln(20 ft/z_0) with z_0 = 0.15 ft; L_w = h, L_u = L_v = h/(0.177 + 0.000823 h)^1.2,
    sigma_w = 0.1 W20, sigma_u = sigma_v = sigma_w/(0.177 + 0.000823 h)^0.4, times ``turbulence``.

    Args:
        params: Heights in [m], speeds in [m/s].

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


def sinh_excess(h: Scalar) -> Scalar:
    """exp(-h) (sinh h - h) for h >= 0, without cancellation or overflow."""
    small = jnp.minimum(h, 1.0)
    square, series = small * small, 1.0
    for n in range(16, 2, -2):
        series = 1.0 + square / (n * (n + 1)) * series
    direct = -0.5 * jnp.expm1(-2.0 * h) - h * jnp.exp(-h)
    return jnp.where(h < 1.0, jnp.exp(-h) * small * square / 6.0 * series, direct)


def noise_factor(h: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Cholesky factor of the noise that :class:`Transverse` accumulates over h = V dt/L.

    The covariance is that of int_0^h (1, s) exp(-s) dW: with S = exp(-h) sinh h, Q_aa = S,
    Q_ab = (exp(-h) (sinh h - h) - h exp(-h) expm1(-h))/2, and det Q = exp(-2 h) (sinh^2 h - h^2)/4. Every term is
    positive, so single precision resolves the smallest, of order h^3.

    Returns:
        The entries (a, a), (b, a), (b, b).
    """
    decay, variance, excess = jnp.exp(-h), -0.5 * jnp.expm1(-2.0 * h), sinh_excess(h)
    a_a = jnp.sqrt(variance)
    b_a = 0.5 * (excess - h * decay * jnp.expm1(-h)) / a_a
    b_b = jnp.sqrt(0.25 * excess * (variance + h * decay) / variance)
    return a_a, b_a, b_b


def transverse_init(n1: Scalar, n2: Scalar) -> Transverse:
    """A draw from the stationary law, of covariance ((1/2, 1/4), (1/4, 1/4)), from two normal numbers."""
    return Transverse(math.sqrt(0.5) * n1, math.sqrt(0.125) * (n1 + n2))


def transverse_step(state: Transverse, h: Scalar, n1: Scalar, n2: Scalar) -> Transverse:
    """Exact sampling over h = V dt/L: the law of the samples does not depend on the step."""
    decay = jnp.exp(-h)
    a_a, b_a, b_b = noise_factor(h)
    return Transverse(decay * state.a + a_a * n1, decay * (state.b + h * state.a) + b_a * n1 + b_b * n2)


def dryden_init(params: DrydenParams, key: jax.Array) -> DrydenState:
    """A draw from the stationary law, to avoid an initial transient."""
    n = standard_normals(key, 5)
    return DrydenState(n[0], transverse_init(n[1], n[2]), transverse_init(n[3], n[4]), 0.0)


def dryden_step(params: DrydenParams, state: DrydenState, key: jax.Array, t: Scalar, dt: Scalar) -> DrydenState:
    """Exact sampling of the filters driven by white noise; before ``at`` they run without effect.

    H_u = sigma_u sqrt(2 L_u/(pi V))/(1 + L_u s/V) and, for v and w,
    H = sigma sqrt(L/(pi V)) (1 + sqrt(3) L s/V)/(1 + L s/V)^2. Their squared moduli are the one-sided spectra of the
    specification in omega [rad/s], with integral sigma^2 over omega > 0; the noise therefore has the autocovariance
    pi delta(t). The autocorrelations are exp(-T) and exp(-T) (1 - T/2), T = V tau/L: integral scales are L_u, L_v/2
    and L_w/2.
    """
    law = dryden_law(params)
    n = standard_normals(key, 5)
    h_uv, h_w = params.airspeed * dt / law.length_uv, params.airspeed * dt / law.length_w
    return DrydenState(
        jnp.exp(-h_uv) * state.u + jnp.sqrt(-jnp.expm1(-2.0 * h_uv)) * n[0],
        transverse_step(state.v, h_uv, n[1], n[2]),
        transverse_step(state.w, h_w, n[3], n[4]),
        begun(params.at, t, dt),
    )


def dryden_value(params: DrydenParams, state: DrydenState, t: Scalar) -> Vec3:
    """Mean wind and turbulence, turned from the mean wind's axes to the inertial ones."""
    law = dryden_law(params)
    along, across = law.mean + law.sigma_uv * state.u, law.sigma_uv * state.v.output
    c, s = jnp.cos(params.direction), jnp.sin(params.direction)
    return Vec3(along * c - across * s, along * s + across * c, law.sigma_w * state.w.output) * state.on


NO_WIND = Wind(NoParams, stateless, unchanged, lambda params, state, t: Vec3(0.0, 0.0, 0.0))
CONSTANT_WIND = Wind(ConstantWindParams, calm, constant_step, held_wind)
PIECEWISE = Wind(PiecewiseParams, calm, piecewise_step, held_wind, check_table)
GUST = Wind(GustParams, stateless, unchanged, gust_value)
SPLINE_WIND = Wind(SplineWindParams, stateless, unchanged, spline_wind, check_wind_knots)
DRYDEN = Wind(DrydenParams, dryden_init, dryden_step, dryden_value)

WINDS: Registry = {
    "none": single(NO_WIND, "no wind"),
    "constant": single(CONSTANT_WIND, "a constant velocity from a given time on"),
    "piecewise": single(PIECEWISE, "a table of velocities with jumps"),
    "gust": single(GUST, "a 1-cosine gust on a constant mean"),
    "spline": single(SPLINE_WIND, "cubic splines of given knots: any wind of bounded speed and acceleration"),
    "record": RECORDED_WIND,
    "dryden": single(DRYDEN, "mean wind and Dryden turbulence of MIL-F-8785C at low altitude, exactly sampled"),
}
