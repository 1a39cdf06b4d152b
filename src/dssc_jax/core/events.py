"""Contracts of what happens to a loop at a time: an event declares which number of which part it changes.

An event of the vehicle changes its :class:`Condition`, which the vehicle receives with its input, as it receives the
wind. An event of a channel is a part in series with the channel's sensor or with its command. A loop without events has
neither.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Sensor, Unmodelled, unchanged_params
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Params, Scalar
from dssc_jax.core.vectors import Vec3

AT = Quantity("s", "time of the event", at_least=0.0, begins=True)
UNTIL = Quantity("s", "time at which it ends; absent: never", at_least=0.0, ends=True)


class Load(NamedTuple):
    """Moments of point masses that the vehicle carries beyond its own, about its centre of mass, in body axes.

    Args:
        mass: sum m [kg]; below 0 what it has lost.
        first: sum m r [kg m].
        square: sum m r_i^2 for i = x, y, z [kg m^2].
        product: sum m r_y r_z, sum m r_z r_x, sum m r_x r_y [kg m^2].
    """

    mass: Scalar
    first: Vec3
    square: Vec3
    product: Vec3


class Shear(NamedTuple):
    """A wind that changes with height: gradient [1/s] times the height above ``height`` [m]."""

    gradient: Vec3
    height: Scalar


class Condition(NamedTuple):
    """What events have made of a vehicle; what none of them changes is None or empty, and left out of the program.

    Args:
        effectiveness: Thrust of each rotor relative to what it would be.
        voltage: Speed of all rotors relative to what it would be.
        load: Masses beyond the vehicle's own.
        shears: Winds that change with height.
    """

    effectiveness: tuple[Scalar, ...] = ()
    voltage: Scalar | None = None
    load: Load | None = None
    shears: tuple[Shear, ...] = ()


class VehicleEvent(NamedTuple):
    """An event of the vehicle.

    Args:
        params: NamedTuple type of the parameters, with the time ``at``, and ``until`` and ``rise`` where it has them.
        change: ``(params, condition, share, rotors) -> condition``, where the share of the event that has happened is
            in [0, 1], and ``rotors`` is the number of rotors.
        changes: The number of the loop that it changes, in words.
        prepare: ``(params) -> params`` before tracing; raises ConfigError.
    """

    params: type
    change: Callable[[Params, Condition, Scalar, int], Condition]
    changes: str
    prepare: Callable[[Params], Params] = unchanged_params


class SensorEvent(NamedTuple):
    """An event of a channel's sensor: ``wrap(sensor)`` is the sensor with it, whose parameters are ``Wrapped``."""

    params: type
    wrap: Callable[[Sensor], Sensor]
    changes: str
    prepare: Callable[[Params], Params] = unchanged_params


class CommandEvent(NamedTuple):
    """An event of a channel's command: unmodelled dynamics in series with those of the study."""

    params: type
    model: Unmodelled
    changes: str
    prepare: Callable[[Params], Params] = unchanged_params


class Wrapped(NamedTuple):
    """Parameters of a part with an event around it."""

    inner: Params
    event: Params


AnyEvent = VehicleEvent | SensorEvent | CommandEvent


def share_of(params: Params, t: Scalar, dt: Scalar) -> Scalar:
    """Mean over the sample [t, t + dt) of how much of an event has happened, in [0, 1].

    An event that begins within a sample therefore acts with its mean, as a signal that is held. Times within the sample
    are shares of it, clipped to [0, 1]: before the event the result is exactly 0, and after its rise exactly 1, however
    the times round.
    """
    rise = getattr(params, "rise", None)
    until = getattr(params, "until", None)

    def within_sample(time: Scalar) -> Scalar:
        return jnp.clip((time - t) / dt, 0.0, 1.0)

    def risen(place: Scalar) -> Scalar:
        return jnp.clip((t - params.at + place * dt) / rise, 0.0, 1.0)

    begin = within_sample(params.at)
    end = 1.0 if until is None else within_sample(until)
    if rise is None:
        return jnp.maximum(end - begin, 0.0)
    complete = within_sample(params.at + rise)
    end_of_rise = jnp.minimum(complete, end)
    rising = 0.5 * (risen(begin) + risen(end_of_rise)) * jnp.maximum(end_of_rise - begin, 0.0)
    return rising + jnp.maximum(end - complete, 0.0)


def condition_at(
    events: tuple[VehicleEvent, ...], params: tuple[Params, ...], t: Scalar, dt: Scalar, rotors: int
) -> Condition | None:
    """The condition of the vehicle after the events up to the sample at t; None where there are none."""
    if not events:
        return None
    condition = Condition()
    for event, values in zip(events, params, strict=True):
        condition = event.change(values, condition, share_of(values, t, dt), rotors)
    return condition
