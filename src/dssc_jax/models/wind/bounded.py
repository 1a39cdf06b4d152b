"""Switching wind within bounds: an adversary that jumps, or turns at a bounded rate, from one extreme to another."""

import math
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.numerics import uniforms
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.core.wind import Wind, WindBounds

VERTICAL_SHARE = 0.5  # default bound of |w_z| relative to that of the horizontal wind (assumed)


class BoundedWindParams(NamedTuple):
    """Winds whose horizontal vector, vertical component and rates stay within bounds; a draw is an extreme one.

    A draw switches at random times between extremes: a horizontal vector of length ``speed`` in a random direction, and
    a vertical component ``vertical`` up or down. It moves along straight lines at ``rate``, or jumps.
    """

    speed: Annotated[Scalar, Quantity("m/s", "bound of the horizontal wind's norm", at_least=0.0, leading=True)]
    vertical: Annotated[
        Scalar | None, Quantity("m/s", "bound of the vertical wind |w_z|; absent: half of speed", at_least=0.0)
    ] = None
    rate: Annotated[
        Scalar | None,
        Quantity("m/s^2", "bound of |w'|, horizontal and vertical; absent: the wind may jump", above=0.0),
    ] = None
    period: Annotated[Scalar, Quantity("s", "mean time between switches of a draw", above=0.0)] = 2.0


class BoundedWindState(NamedTuple):
    """The wind at the last sample, its time [s], and the extreme towards which the wind moves [m/s]."""

    wind: Vec3
    since: Scalar
    target: Vec3


def bounded_limits(params: BoundedWindParams) -> WindBounds:
    """The bounds that the parameters state."""
    vertical = VERTICAL_SHARE * params.speed if params.vertical is None else params.vertical
    return WindBounds(params.speed, vertical, params.rate)


def extreme(params: BoundedWindParams, turn: Scalar, side: Scalar) -> Vec3:
    """The extreme wind of two numbers in [0, 1): its direction as a share of the circle, and below 1/2 downwards."""
    limits = bounded_limits(params)
    angle = 2.0 * math.pi * turn
    vertical = jnp.where(side < 0.5, -1.0, 1.0) * limits.vertical
    return Vec3(limits.speed * jnp.cos(angle), limits.speed * jnp.sin(angle), vertical)


def towards(wind: Vec3, target: Vec3, distance: Scalar) -> Vec3:
    """The wind after a straight way of the given length towards the target, horizontally and vertically [m/s]."""
    way = target - wind
    horizontal = travelled_share(Vec3(way.x, way.y, 0.0).norm(), distance)
    vertical = travelled_share(jnp.abs(way.z), distance)
    # weights that sum to 1: the result stays within the bounds of its ends, to rounding
    return Vec3(
        (1.0 - horizontal) * wind.x + horizontal * target.x,
        (1.0 - horizontal) * wind.y + horizontal * target.y,
        (1.0 - vertical) * wind.z + vertical * target.z,
    )


def travelled_share(length: Scalar, distance: Scalar) -> Scalar:
    """Share of a way of the given length that a distance covers, at most 1."""
    arrives = length <= distance
    return jnp.where(arrives, 1.0, distance / jnp.where(arrives, 1.0, length))


def bounded_init(params: BoundedWindParams, key: jax.Array) -> BoundedWindState:
    """A random extreme."""
    start = extreme(params, *uniforms(key, 2))
    return BoundedWindState(start, 0.0, start)


def bounded_step(
    params: BoundedWindParams, state: BoundedWindState, key: jax.Array, t: Scalar, dt: Scalar
) -> BoundedWindState:
    """Switch to another extreme with the probability 1 - exp(-dt/period) that a Poisson process has an event.

    The times between switches are whole samples; their law is that of a Poisson process seen at the samples.
    """
    turn, side, chance = uniforms(key, 3)
    switches = chance < -jnp.expm1(-dt / params.period)
    fresh = extreme(params, turn, side)
    target = Vec3(*(jnp.where(switches, new, old) for new, old in zip(fresh, state.target, strict=True)))
    return BoundedWindState(bounded_value(params, state, t), t, target)


def bounded_value(params: BoundedWindParams, state: BoundedWindState, t: Scalar) -> Vec3:
    """The wind at t: the extreme itself without a rate, else on the straight way there."""
    if params.rate is None:
        return state.target
    return towards(state.wind, state.target, params.rate * (t - state.since))


def bounded_mean(params: BoundedWindParams, dt: Scalar) -> Vec3:
    """No wind: all directions are equally likely."""
    return Vec3(0.0, 0.0, 0.0)


BOUNDED_WIND = Wind(
    BoundedWindParams, bounded_init, bounded_step, bounded_value, bounds=bounded_limits, mean=bounded_mean
)
