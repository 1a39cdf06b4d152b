"""Wind prescribed over time: constant, piecewise constant, gust, splines.

A jump within a sample acts through its mean over the sample. The gust is evaluated at every stage of the integrator.

Reference:
    14 CFR 25.341(a)(2) and EASA CS 25.341(a)(2): the discrete gust that returns to zero.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.default_functions import stateless, unchanged, unchanging
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import cubic_spline, elapsed_share, spline_end
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.signals import Params, Scalar, State
from dssc_jax.core.vectors import Vec3
from dssc_jax.core.wind import Wind, WindBounds

X = Quantity("m/s", "wind velocity along x")
Y = Quantity("m/s", "wind velocity along y")
Z = Quantity("m/s", "wind velocity along z, up")
START = Quantity("s", "time at which the wind begins", at_least=0.0, begins=True)


class ConstantWindParams(NamedTuple):
    """A constant wind from the time ``at`` on."""

    x: Annotated[Scalar, replace(X, leading=True)]
    y: Annotated[Scalar, replace(Y, leading=True)]
    z: Annotated[Scalar, Z]
    at: Annotated[Scalar, START] = 0.0


class PiecewiseParams(NamedTuple):
    """A table of winds: row i is the wind from ``times[i]`` to the next time; before the first there is no wind."""

    times: Annotated[tuple[Scalar, ...], Quantity("s", "time at which the row begins", at_least=0.0, begins=True)]
    x: Annotated[tuple[Scalar, ...], X]
    y: Annotated[tuple[Scalar, ...], Y]
    z: Annotated[tuple[Scalar, ...], Z]


class GustParams(NamedTuple):
    """A 1-cosine gust of peak (x, y, z) on a constant mean; the peak is at ``at + duration/2``."""

    x: Annotated[Scalar, Quantity("m/s", "peak of the gust along x")]
    y: Annotated[Scalar, Quantity("m/s", "peak of the gust along y")]
    z: Annotated[Scalar, Quantity("m/s", "peak of the gust along z, up")]
    duration: Annotated[Scalar, Quantity("s", "duration of the gust, from zero to zero", above=0.0)]
    at: Annotated[Scalar, Quantity("s", "time at which the gust begins", at_least=0.0, begins=True)] = 0.0
    mean_x: Annotated[Scalar, Quantity("m/s", "mean wind along x")] = 0.0
    mean_y: Annotated[Scalar, Quantity("m/s", "mean wind along y")] = 0.0
    mean_z: Annotated[Scalar, Quantity("m/s", "mean wind along z, up")] = 0.0


class SplineWindParams(NamedTuple):
    """Cubic splines with knots ``interval`` apart, the first at the time ``at``.

    The splines can approximate any wind of bounded speed and acceleration. The magnitude of a component is at most its
    largest |knot|, and its rate at most the largest difference of consecutive knots divided by the interval. The wind
    begins at 0 two intervals before the first knot, and ends at 0 two intervals after the last knot.
    """

    interval: Annotated[Scalar, Quantity("s", "time between two knots", above=0.0)]
    x: Annotated[tuple[Scalar, ...], X] = ()
    y: Annotated[tuple[Scalar, ...], Y] = ()
    z: Annotated[tuple[Scalar, ...], Z] = ()
    at: Annotated[Scalar, Quantity("s", "time of the first knot", begins=True)] = 0.0


def mixture_bounds(winds: Iterable[Vec3], slopes: Iterable[Vec3] | None) -> WindBounds:
    """The bounds of a wind that is always a weighted mean of some vectors.

    Args:
        winds: The vectors [m/s].
        slopes: Vectors of which w' is always a weighted mean [m/s^2]; None: the wind may jump.
    """
    speed, vertical = largest_norms(winds)
    rate = None if slopes is None else max(largest_norms(slopes))
    return WindBounds(speed, vertical, rate)


def largest_norms(vectors: Iterable[Vec3]) -> tuple[float, float]:
    """The largest horizontal norm and the largest vertical magnitude of some vectors of plain numbers."""
    horizontal = []
    vertical = []
    for x, y, z in vectors:
        horizontal.append(math.hypot(float(x), float(y)))
        vertical.append(abs(float(z)))
    return max(horizontal), max(vertical)


def calm(params: Params, key: jax.Array) -> Vec3:
    """The state before the first sample: no wind."""
    return Vec3(0.0, 0.0, 0.0)


def held_wind(params: Params, state: Vec3, t: Scalar) -> Vec3:
    """The wind over the sample, which is the state [m/s]."""
    return state


def constant_step(params: ConstantWindParams, state: Vec3, key: jax.Array, t: Scalar, dt: Scalar) -> Vec3:
    """The mean wind over [t, t + dt) [m/s], so that a jump within a sample does not reduce the integrator's order.

    ``state`` and ``key`` are not used, because the wind neither remembers anything nor is random.
    """
    return Vec3(params.x, params.y, params.z) * elapsed_share(params.at, t, dt)


def constant_bounds(params: ConstantWindParams) -> WindBounds:
    """The bounds of the wind: its own norms, and the rate 0 if it begins at t = 0.

    A wind that begins later jumps then, so that it has no bound of the rate.
    """
    wind = Vec3(params.x, params.y, params.z)
    slopes = [Vec3(0.0, 0.0, 0.0)] if float(params.at) == 0.0 else None
    return mixture_bounds([wind], slopes)


def check_table(params: PiecewiseParams) -> PiecewiseParams:
    """The parameters themselves, whose table must have a time for each row and times that rise strictly.

    Raises:
        ConfigError: A column has another length than the times, or the times do not rise for all values of their laws.
    """
    rows = len(params.times)
    if rows == 0:
        raise ConfigError("times", "needs at least one time, got none")
    for name in ("x", "y", "z"):
        count = len(getattr(params, name))
        if count != rows:
            raise ConfigError(name, f"must hold {rows} numbers, one for each of times, got {count}")
    for i, (previous_extent, next_extent) in enumerate(pairwise(map(extent, params.times)), start=1):
        _, latest_before = previous_extent
        earliest, _ = next_extent
        if not earliest > latest_before:
            bounds = f"must be > {latest_before:g}, the one before, got {earliest:g}"
            raise ConfigError(f"times.{i}", f"times must increase strictly: {bounds}")
    return params


def piecewise_step(params: PiecewiseParams, state: Vec3, key: jax.Array, t: Scalar, dt: Scalar) -> Vec3:
    """The mean wind over [t, t + dt) [m/s]; at each instant, the last row that has begun counts.

    ``state`` and ``key`` are not used, because the wind neither remembers anything nor is random.
    """
    wind = Vec3(0.0, 0.0, 0.0)
    covered_share = 0.0  # share of the sample to which later rows belong
    rows = list(zip(params.times, params.x, params.y, params.z, strict=True))
    for at, x, y, z in reversed(rows):
        remaining_share = elapsed_share(at, t, dt) - covered_share
        # where the share is exactly 0, as for a row that has ended, it keeps its derivative
        share = jnp.where(remaining_share < 0.0, 0.0, remaining_share)
        wind = wind + Vec3(x, y, z) * share
        covered_share = covered_share + share
    return wind


def piecewise_bounds(params: PiecewiseParams) -> WindBounds:
    """The bounds of the wind: the largest norms of the rows, between which it jumps."""
    return mixture_bounds(map(Vec3, params.x, params.y, params.z), slopes=None)


def gust_value(params: GustParams, state: State, t: Scalar) -> Vec3:
    """The wind at t [m/s]: the mean plus the peak times (1 - cos(2 pi (t - at)/duration))/2, the square of a sine."""
    phase = jnp.clip((t - params.at) / params.duration, 0.0, 1.0)
    swell = jnp.square(jnp.sin(math.pi * phase))
    return Vec3(params.mean_x, params.mean_y, params.mean_z) + Vec3(params.x, params.y, params.z) * swell


def gust_bounds(params: GustParams) -> WindBounds:
    """The bounds of the wind, which is between mean and mean plus peak; its largest rate is peak pi/duration."""
    mean = Vec3(params.mean_x, params.mean_y, params.mean_z)
    peak = Vec3(params.x, params.y, params.z)
    return mixture_bounds([mean, mean + peak], [peak * (math.pi / params.duration)])


def check_wind_knots(params: SplineWindParams) -> SplineWindParams:
    """The parameters themselves, which must have at least one knot in x, y or z.

    Raises:
        ConfigError: There is no knot.
    """
    if not (params.x or params.y or params.z):
        raise ConfigError("x", "needs at least one knot in x, y or z, got none")
    return params


def spline_wind(params: SplineWindParams, state: State, t: Scalar) -> Vec3:
    """The wind at t [m/s]: a spline for each component, or 0 for one without knots."""
    place = (t - params.at) / params.interval
    return Vec3(*(cubic_spline(knots, place) for knots in (params.x, params.y, params.z)))


def spline_bounds(params: SplineWindParams) -> WindBounds:
    """The bounds of the wind from its knots.

    A cubic B-spline is always a weighted mean of its knots, and its slope a weighted mean of the differences of
    consecutive knots, divided by the interval. Before and after its knots the spline goes to 0, as if further knots
    were 0; the padding adds them.
    """
    count = most_knots(params)
    columns = (padded_knots(knots, count) for knots in (params.x, params.y, params.z))
    knots = [Vec3(*row) for row in zip(*columns, strict=True)]
    slopes = [(next_knot - previous_knot) / params.interval for previous_knot, next_knot in pairwise(knots)]
    return mixture_bounds(knots, slopes)


def most_knots(params: SplineWindParams) -> int:
    """The number of knots of the component that has the most."""
    return max(len(params.x), len(params.y), len(params.z))


def padded_knots(knots: Sequence[Scalar], count: int) -> list[Scalar]:
    """The knots, filled up with zeros to ``count``, and with one more zero at each end."""
    missing = [0.0] * (count - len(knots))
    return [0.0, *knots, *missing, 0.0]


CONSTANT_WIND = Wind(
    params=ConstantWindParams,
    init=calm,
    step=constant_step,
    value=held_wind,
    bounds=constant_bounds,
    last_change=unchanging,
)
PIECEWISE = Wind(
    params=PiecewiseParams,
    init=calm,
    step=piecewise_step,
    value=held_wind,
    prepare=check_table,
    bounds=piecewise_bounds,
    last_change=unchanging,
)
GUST = Wind(
    params=GustParams,
    init=stateless,
    step=unchanged,
    value=gust_value,
    bounds=gust_bounds,
    last_change=lambda params: params.at + params.duration,
)
SPLINE_WIND = Wind(
    params=SplineWindParams,
    init=stateless,
    step=unchanged,
    value=spline_wind,
    prepare=check_wind_knots,
    bounds=spline_bounds,
    last_change=lambda params: spline_end(params.at, params.interval, most_knots(params)),
)
