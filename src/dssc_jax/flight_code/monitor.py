"""The monitor of a flight: a pure step function that tells which premises of a certificate the flight violates.

``initial_monitor(premises)`` gives the monitor's state before the first sample, and ``monitor(premises, state,
sample)`` makes one step. The step is written as C in the same way as the controllers. A number that is not finite
counts as unknown: it raises no flag, and clears none that is latched.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.numerics import turned_near
from dssc_jax.core.signals import Measurement, ReferencePoint, Scalar, State, tracking_error
from dssc_jax.flight_code.premises import ChannelPremises, Interval, Premises
from dssc_jax.flight_code.seen_disturbance import initial_seen, roundings, see

NEVER = -1
"""First sample of a flag that was never raised."""
LAST_SAMPLE = 2**31 - 1
"""Number at which the count of samples stops."""


class ChannelSample(NamedTuple):
    """The signals of a channel that the monitor reads at one sample.

    Args:
        y: The output, as the controller receives it.
        y_dot: Rate of the output.
        y_ref: The reference.
        y_ref_dot: Rate of the reference.
        u_p: The whole command of the controller; () if no bound uses it.
        sliding_margin: rho - abs(u_eq), as the controller reports it; () if no bound uses it.
    """

    y: Scalar
    y_dot: Scalar
    y_ref: Scalar
    y_ref_dot: Scalar
    u_p: State
    sliding_margin: State


class MonitorSample(NamedTuple):
    """The monitor's inputs at one sample.

    Args:
        channels: Signals of each channel.
        tilt: Angle between body z and the vertical [rad]; () if the certificate does not bound it.
        rotor: Commanded thrust of each rotor [N]; () if the certificate does not bound the thrusts.
    """

    channels: tuple[ChannelSample, ...]
    tilt: State
    rotor: tuple[Scalar, ...]


class ChannelMemory(NamedTuple):
    """The monitor's state of one channel.

    Args:
        sigma: sigma at the last sample at which all measurements were finite.
        gap: Number of samples since that sample, 1 or more; 0: there was no such sample.
        seen: The state of the disturbance's enclosure, a :class:`SeenDisturbance`; () if no bound uses it.
    """

    sigma: Scalar
    gap: Scalar
    seen: State


class MonitorState(NamedTuple):
    """The monitor's state between two samples.

    Args:
        latched: Flags that were raised so far; each has one bit, in the order of ``premises.flags()``.
        sample: Number of the next sample, from 0 on.
        first: Sample at which each flag was first raised, or :data:`NEVER`.
        started: 1 once the start of the flight has been compared with its bounds, else 0.
        channels: State of each channel.
    """

    latched: jax.Array
    sample: jax.Array
    first: tuple[jax.Array, ...]
    started: Scalar
    channels: tuple[ChannelMemory, ...]


class Deviation(NamedTuple):
    """The tracking errors of a channel at one sample.

    Args:
        e: Output error e.
        e_dot: Rate of the error e'.
        sigma: sigma = e' + l_0 e.
        rounding: Bound of the rounding errors of e' and of sigma; the rounding error of e is at most ``rounding``/l_0.
        known: Whether y, y' and their references are all finite; if not, the errors are 0.
    """

    e: Scalar
    e_dot: Scalar
    sigma: Scalar
    rounding: Scalar
    known: jax.Array


def initial_monitor(premises: Premises) -> MonitorState:
    """The state before the first sample.

    Nothing is latched, no flag has a first sample, and no sigma is known.

    Args:
        premises: The bounds, which determine the flags and the states of the channels.
    """
    memories = []
    for channel in premises.channels:
        disturbance_state = () if channel.disturbance is None else initial_seen(channel.disturbance)
        memories.append(ChannelMemory(sigma=0.0, gap=0.0, seen=disturbance_state))
    never = jnp.full((), NEVER, jnp.int32)
    return MonitorState(
        latched=jnp.zeros((), jnp.uint32),
        sample=jnp.zeros((), jnp.int32),
        first=(never,) * len(premises.flags()),
        started=0.0,
        channels=tuple(memories),
    )


def monitor(premises: Premises, state: MonitorState, sample: MonitorSample) -> tuple[MonitorState, jax.Array]:
    """One sample.

    The monitor compares the signals with the bounds of the certificate, and latches the flag of each violated bound.

    Args:
        premises: The bounds.
        state: The state before the sample.
        sample: The signals at the sample.

    Returns:
        The next state, and the flags that this sample raises; each has one bit, in the order of ``premises.flags()``.
    """
    deviations = []
    for channel, seen in zip(premises.channels, sample.channels, strict=True):
        deviations.append(deviation(channel, seen))
    started, outside = leaves_start(premises, state, deviations)
    raised = [outside]
    memories = []
    for i, channel in enumerate(premises.channels):
        memory, flags = check_channel(premises, channel, state.channels[i], sample.channels[i], deviations[i])
        memories.append(memory)
        raised += flags
    if premises.tilt is not None:
        raised.append(exceeds(sample.tilt, premises.tilt))
    if premises.rotors is not None:
        low, high = premises.rotors
        raised.append(any_of([is_finite(rotor) & jnp.less(rotor, low) for rotor in sample.rotor]))
        raised.append(any_of([is_finite(rotor) & jnp.greater(rotor, high) for rotor in sample.rotor]))
    current = flag_word(raised)
    first = []
    for flag, earlier in zip(raised, state.first, strict=True):
        first.append(jnp.where(flag & (earlier < 0), state.sample, earlier))
    following = jnp.where(state.sample < LAST_SAMPLE, state.sample + 1, state.sample)
    return MonitorState(state.latched | current, following, tuple(first), started, tuple(memories)), current


def deviation(channel: ChannelPremises, seen: ChannelSample) -> Deviation:
    """The errors of a channel; 0 where a measurement or a reference is not finite.

    Args:
        channel: The bounds of the channel.
        seen: The signals of the channel.
    """
    known = is_finite(seen.y) & is_finite(seen.y_dot) & is_finite(seen.y_ref) & is_finite(seen.y_ref_dot)
    y = jnp.where(known, seen.y, 0.0)
    y_dot = jnp.where(known, seen.y_dot, 0.0)
    y_ref = jnp.where(known, seen.y_ref, 0.0)
    y_ref_dot = jnp.where(known, seen.y_ref_dot, 0.0)
    desired = turned_near(y_ref, y) if channel.angle else y_ref
    error = tracking_error(Measurement(y, y_dot), ReferencePoint(desired, y_ref_dot, 0.0), channel.l0)
    sizes = jnp.abs(y_dot) + jnp.abs(y_ref_dot) + channel.l0 * (jnp.abs(y) + jnp.abs(desired))
    return Deviation(error.e, y_dot - y_ref_dot, error.sigma, roundings() * sizes, known)


def leaves_start(premises: Premises, state: MonitorState, deviations: Sequence[Deviation]) -> tuple[Scalar, jax.Array]:
    """Whether the start was compared, and whether it is outside: at the first sample that has every channel.

    The comparison takes place once, at the first sample at which the errors of all channels are known.

    Args:
        premises: The bounds of the flight.
        state: The state before the sample.
        deviations: The tracking errors of each channel at the sample.

    Returns:
        1 if the comparison has taken place by the end of this sample, else 0; and whether it takes place at this sample
        and finds the start out of bounds.
    """
    outside = []
    for channel, errors in zip(premises.channels, deviations, strict=True):
        if channel.start is not None:
            within_e, within_e_dot = channel.start
            outside.append(is_outside(errors.e, within_e, errors.rounding / channel.l0))
            outside.append(is_outside(errors.e_dot, within_e_dot, errors.rounding))
    if premises.plane_start is not None:
        x, y = deviations[:2]
        l0 = premises.channels[0].l0
        distance, fast = premises.plane_start
        outside.append(jnp.greater(plane_norm(x.e, y.e), distance + (x.rounding + y.rounding) / l0))
        outside.append(jnp.greater(plane_norm(x.e_dot, y.e_dot), fast + (x.rounding + y.rounding)))
    known = deviations[0].known
    for errors in deviations[1:]:
        known = known & errors.known
    begins = known & jnp.equal(state.started, 0.0)
    return jnp.where(begins, 1.0, state.started), begins & any_of(outside)


def check_channel(
    premises: Premises, channel: ChannelPremises, memory: ChannelMemory, sample: ChannelSample, errors: Deviation
) -> tuple[ChannelMemory, list[jax.Array]]:
    """Compare one sample of a channel with the bounds that the proof assumes.

    Args:
        premises: The bounds of the flight.
        channel: The bounds of the channel.
        memory: The state of the channel before the sample.
        sample: The signals of the channel.
        errors: The tracking errors of the channel.

    Returns:
        The state for the next sample, and a flag for each exceeded bound, in the order of ``channel.flags()``.
    """
    begun = jnp.greater(memory.gap, 0.0)
    flags = [errors.known & jnp.greater(jnp.abs(errors.e), channel.e)]
    if channel.e_dot is not None:
        flags.append(errors.known & jnp.greater(jnp.abs(errors.e_dot), channel.e_dot))
    flags.append(errors.known & jnp.greater(jnp.abs(errors.sigma), channel.sigma))
    if channel.sigma_slope is not None:
        # gap samples lie between both values of sigma, each with its own rounding error
        allowed = channel.sigma_slope * premises.sample_time * memory.gap + 2.0 * errors.rounding
        change = jnp.abs(errors.sigma - memory.sigma)
        flags.append(errors.known & begun & jnp.greater(change, allowed))
    if channel.slides:
        flags.append(is_finite(sample.sliding_margin) & jnp.less(sample.sliding_margin, 0.0))
    seen = memory.seen
    if channel.disturbance is not None:
        seen, beyond = see(
            channel.disturbance, memory.seen, sample.y, sample.y_dot, errors.known, sample.u_p, premises.sample_time
        )
        flags += [beyond.level, beyond.slope]
    gap = jnp.where(errors.known, 1.0, jnp.where(begun, memory.gap + 1.0, 0.0))
    return ChannelMemory(jnp.where(errors.known, errors.sigma, memory.sigma), gap, seen), flags


def is_finite(number: Scalar) -> jax.Array:
    """Whether a number is known: neither infinite nor NaN.

    One comparison covers both cases, because it is false for NaN.
    """
    return jnp.less_equal(jnp.abs(number), float(jnp.finfo(jnp.result_type(float)).max))


def exceeds(number: Scalar, bound: float) -> jax.Array:
    """Whether a known number is beyond a bound.

    A number is known if it is finite. A known number is beyond the bound if its absolute value exceeds the bound.
    """
    return is_finite(number) & jnp.greater(jnp.abs(number), bound)


def is_outside(number: Scalar, interval: Interval, rounding: Scalar) -> jax.Array:
    """Whether a number is outside of an interval.

    Args:
        number: The number.
        interval: Both ends.
        rounding: Bound of the number's rounding error, by which the interval is widened.
    """
    low, high = interval
    return jnp.less(number, low - rounding) | jnp.greater(number, high + rounding)


def plane_norm(x: Scalar, y: Scalar) -> Scalar:
    """The norm of a vector of the plane.

    x and y are the components of the vector.
    """
    return jnp.sqrt(x * x + y * y)


def any_of(flags: Sequence[jax.Array]) -> jax.Array:
    """Whether at least one flag is raised."""
    raised = flags[0]
    for flag in flags[1:]:
        raised = raised | flag
    return raised


def flag_word(flags: Sequence[jax.Array]) -> jax.Array:
    """The flags as the bits of a number, the first one lowest."""
    word = jnp.zeros((), jnp.uint32)
    for bit, flag in enumerate(flags):
        word = word | jnp.where(flag, jnp.asarray(1 << bit, jnp.uint32), jnp.zeros((), jnp.uint32))
    return word
