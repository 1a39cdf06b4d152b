"""Contracts of events, each of which changes a loop at a certain time.

An event of the vehicle changes its :class:`Condition`, which is a part of the vehicle's input, as the wind is. An event
of a channel is a part in series with the channel's sensor or with its command. A loop without events has neither.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Sensor, Unmodelled
from dssc_jax.core.default_functions import unchanged_params
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import LastChange, Params, Scalar
from dssc_jax.core.vectors import Vec3

AT = Quantity("s", "time of the event", at_least=0.0, begins=True)
UNTIL = Quantity("s", "time at which it ends; absent: never", at_least=0.0, ends=True)


class Load(NamedTuple):
    """Moments of the point masses that events have added to the vehicle; each is a mass m at a place r.

    Places are in body axes, measured from the centre of mass that the vehicle has without events.

    Args:
        mass: Sum of m [kg]; negative if the vehicle has lost mass.
        first: Sum of m r [kg m].
        square: Sums of m r_i^2 for i = x, y, z [kg m^2].
        product: Sums of m r_y r_z, m r_z r_x and m r_x r_y [kg m^2].
    """

    mass: Scalar
    first: Vec3
    square: Vec3
    product: Vec3


class Shear(NamedTuple):
    """A wind that grows with height.

    Args:
        gradient: Change of the wind with height [1/s].
        height: Height at which this wind is zero [m].
    """

    gradient: Vec3
    height: Scalar


class Condition(NamedTuple):
    """The changes that events have made to a vehicle.

    A field that no event changes is None or empty, and is left out of the program.

    Args:
        effectiveness: Thrust of each rotor relative to its thrust without events.
        voltage: Speed of all rotors relative to their speed without events, as the battery's voltage sets it.
        load: Additional masses.
        shears: Additional winds that change with height.
    """

    effectiveness: tuple[Scalar, ...] = ()
    voltage: Scalar | None = None
    load: Load | None = None
    shears: tuple[Shear, ...] = ()


class VehicleEvent(NamedTuple):
    """An event of the vehicle.

    Args:
        params: NamedTuple type of the parameters: the time ``at`` and, if the event has them, ``until`` and ``rise``
            [s].
        change: ``(params, condition, share, rotors) -> condition`` with the event. ``share`` in [0, 1] tells how much
            of the event has happened, ``rotors`` is the number of rotors.
        changes: Name, in words, of the number of the loop that the event changes.
        prepare: ``(params) -> params`` before tracing; raises ConfigError.
        last_change: Time from which it does nothing new; None: ``[loop.settled]`` refuses it.
    """

    params: type
    change: Callable[[Params, Condition, Scalar, int], Condition]
    changes: str
    prepare: Callable[[Params], Params] = unchanged_params
    last_change: LastChange | None = None


class SensorEvent(NamedTuple):
    """An event of a channel's sensor.

    Args:
        params: NamedTuple type of the parameters.
        wrap: ``(sensor) -> sensor`` with the event; the parameters of the returned sensor are :class:`Wrapped`.
        changes: Name, in words, of the number of the loop that the event changes.
        prepare: ``(params) -> params`` before tracing; raises ConfigError.
        last_change: Time from which it does nothing new; None: ``[loop.settled]`` refuses it.
    """

    params: type
    wrap: Callable[[Sensor], Sensor]
    changes: str
    prepare: Callable[[Params], Params] = unchanged_params
    last_change: LastChange | None = None


class CommandEvent(NamedTuple):
    """An event of a channel's command.

    Args:
        params: NamedTuple type of the parameters.
        model: Unmodelled dynamics with the event, in series with the study's own.
        changes: Name, in words, of the number of the loop that the event changes.
        prepare: ``(params) -> params`` before tracing; raises ConfigError.
        last_change: Time from which it does nothing new; None: ``[loop.settled]`` refuses it.
    """

    params: type
    model: Unmodelled
    changes: str
    prepare: Callable[[Params], Params] = unchanged_params
    last_change: LastChange | None = None


class Wrapped(NamedTuple):
    """Parameters of a part (``inner``), and of the event that wraps it (``event``)."""

    inner: Params
    event: Params


AnyEvent = VehicleEvent | SensorEvent | CommandEvent


def share_of(params: Params, t: Scalar, dt: Scalar) -> Scalar:
    """Return the share of an event that has happened, in [0, 1], averaged over the sample [t, t + dt).

    So an event that begins within a sample acts with its mean over the sample. The share grows in a straight line over
    the event's ``rise``, and vanishes at ``until``. Times are clipped to the sample, so rounding changes nothing: the
    share is exactly 0 before the event, and exactly 1 after the rise.

    Args:
        params: Parameters of the event: ``at`` and, if the event has them, ``rise`` and ``until`` [s].
        t: Start of the sample [s].
        dt: Length of the sample [s].
    """
    rise = getattr(params, "rise", None)
    until = getattr(params, "until", None)

    def within_sample(time: Scalar) -> Scalar:
        """Return the place of a time [s] in the sample, from 0 at t to 1 at t + dt; clipped to [0, 1]."""
        return jnp.clip((time - t) / dt, 0.0, 1.0)

    def risen(place: Scalar) -> Scalar:
        """Return the share of the event that has happened at a place in the sample, in [0, 1]."""
        return jnp.clip((t - params.at + place * dt) / rise, 0.0, 1.0)

    begin = within_sample(params.at)
    end = 1.0 if until is None else within_sample(until)
    if rise is None:
        return jnp.maximum(end - begin, 0.0)
    complete = within_sample(params.at + rise)
    end_of_rise = jnp.minimum(complete, end)
    # the mean of the straight line from begin to end_of_rise, then 1 up to end
    rising = 0.5 * (risen(begin) + risen(end_of_rise)) * jnp.maximum(end_of_rise - begin, 0.0)
    return rising + jnp.maximum(end - complete, 0.0)


def condition_at(
    events: tuple[VehicleEvent, ...], params: tuple[Params, ...], t: Scalar, dt: Scalar, rotors: int
) -> Condition | None:
    """Return the condition of the vehicle in the sample [t, t + dt); None if the study has no events of the vehicle.

    Args:
        events: The events in the order of the study.
        params: Parameters of each event.
        t: Start of the sample [s].
        dt: Length of the sample [s].
        rotors: Number of rotors.
    """
    if not events:
        return None
    condition = Condition()
    for event, values in zip(events, params, strict=True):
        condition = event.change(values, condition, share_of(values, t, dt), rotors)
    return condition
