"""Switching wind within bounds: it jumps, or moves at a bounded rate, from one extreme to another at random times."""

import math
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.default_functions import unchanging
from dssc_jax.core.numerics import uniforms
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.core.wind import Wind, WindBounds

VERTICAL_SHARE = 0.5  # default bound of |w_z| relative to that of the horizontal wind (assumed)


class BoundedWindParams(NamedTuple):
    """Bounds of the horizontal wind, the vertical wind and their rates; a draw goes from one extreme to another.

    A draw switches at random times. An extreme is a horizontal vector of length ``speed`` in a random direction, with a
    vertical component ``vertical`` up or down. The wind moves to it along a straight line at ``rate``, or jumps.
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
    """The wind at the last sample [m/s], the time ``since`` of that sample [s], and the extreme ``target`` [m/s].

    The wind moves from ``wind`` towards ``target`` since that time.
    """

    wind: Vec3
    since: Scalar
    target: Vec3


def bounded_limits(params: BoundedWindParams) -> WindBounds:
    """The bounds of the wind: the parameters, with the default bound of the vertical wind where it is absent."""
    vertical = VERTICAL_SHARE * params.speed if params.vertical is None else params.vertical
    return WindBounds(params.speed, vertical, params.rate)


def extreme_wind(params: BoundedWindParams, turn: Scalar, side: Scalar) -> Vec3:
    """A wind at its bounds [m/s]: of the largest horizontal norm, and of the largest vertical component.

    Args:
        params: The bounds.
        turn: Direction of the horizontal wind as a share of the circle, in [0, 1).
        side: Number in [0, 1); below 1/2 the vertical wind points down, else up.
    """
    limits = bounded_limits(params)
    angle = 2.0 * math.pi * turn
    vertical = jnp.where(side < 0.5, -1.0, 1.0) * limits.vertical
    return Vec3(limits.speed * jnp.cos(angle), limits.speed * jnp.sin(angle), vertical)


def moved_towards(wind: Vec3, target: Vec3, distance: Scalar) -> Vec3:
    """The wind after it has moved in a straight line towards a target, but not beyond it.

    Args:
        wind: The wind before [m/s].
        target: The target [m/s].
        distance: Length of the move [m/s], for the horizontal vector and for the vertical component each.
    """
    difference = target - wind
    horizontal = travelled_share(Vec3(difference.x, difference.y, 0.0).norm(), distance)
    vertical = travelled_share(jnp.abs(difference.z), distance)
    # weights that sum to 1: the result stays within the bounds of its ends, to rounding
    return Vec3(
        (1.0 - horizontal) * wind.x + horizontal * target.x,
        (1.0 - horizontal) * wind.y + horizontal * target.y,
        (1.0 - vertical) * wind.z + vertical * target.z,
    )


def travelled_share(length: Scalar, distance: Scalar) -> Scalar:
    """The share of a straight way that a move covers, at most 1.

    Args:
        length: Length of the way [m/s].
        distance: Length of the move [m/s].
    """
    arrives = length <= distance
    return jnp.where(arrives, 1.0, distance / jnp.where(arrives, 1.0, length))


def bounded_init(params: BoundedWindParams, key: jax.Array) -> BoundedWindState:
    """The state at t = 0: the wind is at a random extreme, and stays there until it switches."""
    turn, side = uniforms(key, 2)
    start = extreme_wind(params, turn, side)
    return BoundedWindState(start, 0.0, start)


def bounded_step(
    params: BoundedWindParams, state: BoundedWindState, key: jax.Array, t: Scalar, dt: Scalar
) -> BoundedWindState:
    """The state at the next sample, where the wind may switch to another random extreme.

    Switches are the events of a Poisson process: a sample has at least one of them with the probability
    1 - exp(-dt/period).
    """
    turn, side, number = uniforms(key, 3)
    switches = number < -jnp.expm1(-dt / params.period)
    new_target = extreme_wind(params, turn, side)
    target = Vec3(*(jnp.where(switches, new, old) for new, old in zip(new_target, state.target, strict=True)))
    return BoundedWindState(bounded_value(params, state, t), t, target)


def bounded_value(params: BoundedWindParams, state: BoundedWindState, t: Scalar) -> Vec3:
    """The wind at t [m/s]: the target itself without a rate, else a point on the straight way to the target.

    Args:
        params: The bounds.
        state: The state at the last sample.
        t: Time [s].
    """
    if params.rate is None:
        return state.target
    return moved_towards(state.wind, state.target, params.rate * (t - state.since))


def bounded_mean(params: BoundedWindParams, dt: Scalar) -> Vec3:
    """The expected wind over the first sample [m/s]: 0, because all directions are equally likely.

    It depends neither on the bounds nor on the length ``dt`` of the sample.
    """
    return Vec3(0.0, 0.0, 0.0)


BOUNDED_WIND = Wind(
    params=BoundedWindParams,
    init=bounded_init,
    step=bounded_step,
    value=bounded_value,
    bounds=bounded_limits,
    mean=bounded_mean,
    last_change=unchanging,
)
