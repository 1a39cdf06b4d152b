"""One sample of the closed loop as a function for linearisation, with an input and an output at each break point.

The function is the step that the simulation runs: sensors, sampled controllers, unmodelled dynamics, and the plant's
integrator over one sample. The loop stays closed. At each break point a signal is added, and the signal before the sum
is read; the loop transfer function at that point follows exactly from this pair.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.loop import Loop, LoopParams, signal_name
from dssc_jax.closed_loop.sample import initial_state, measure, step
from dssc_jax.core.contracts import NoParams, Reference, Sensor
from dssc_jax.core.signals import Measurement, Params, ReferencePoint, Scalar, State
from dssc_jax.models.disturbances import NO_DISTURBANCE
from dssc_jax.models.wind import NO_WIND


class BreakPoint(StrEnum):
    """A place at which a channel's loop is broken: the command, the measurement of y, or that of y'.

    A break at ``output`` or ``rate`` changes the measurement of y or of y' alone. A break of both at once would be the
    same as one at ``input``, because the channel has one command.
    """

    INPUT = "input"
    OUTPUT = "output"
    RATE = "rate"


def place_names(channels: Sequence[str]) -> list[str]:
    """Name of each break point in the order of the channels: ``input``, or ``x input`` where channels have names."""
    return [place_name(channel, point) for channel in channels for point in BreakPoint]


def place_name(channel: str, point: BreakPoint) -> str:
    """Name of a break point of a channel."""
    return f"{channel} {point}".strip()


class AdditionParams(NamedTuple):
    """Parameters of a sensor, and a measurement that is added to its input where the loop is broken."""

    params: Params
    addition: Measurement


def with_addition(sensor: Sensor) -> Sensor:
    """A sensor that reads the sum of the plant's measurement and the addition in its parameters."""

    def sense(
        p: AdditionParams, z: State, m: Measurement, key: jax.Array, t: Scalar, dt: Scalar
    ) -> tuple[State, Measurement]:
        return sensor.step(p.params, z, Measurement(m.y + p.addition.y, m.y_dot + p.addition.y_dot), key, t, dt)

    return Sensor(AdditionParams, lambda p, m, key: sensor.init(p.params, m, key), sense)


def undisturbed(loop: Loop, params: LoopParams) -> tuple[Loop, LoopParams]:
    """The loop at a constant reference, without disturbances, wind and sensor noise.

    The reference of a plant of one channel is its constant level (``Reference.level``), or 0; that of several channels
    is their outputs at t = 0: hover.
    """
    channels = range(len(loop.channels))
    origin = tuple(ReferencePoint(0.0, 0.0, 0.0) for _ in channels)
    desired: ReferencePoint | tuple[ReferencePoint, ...]
    if len(loop.channels) > 1:
        start = measure(loop, params, loop.plant.init(params.plant), origin)
        desired = tuple(ReferencePoint(m.y, 0.0, 0.0) for m in start)
    else:
        level = 0.0 if loop.reference.level is None else loop.reference.level(params.reference)
        desired = ReferencePoint(level, 0.0, 0.0)
    fixed = Reference(NoParams, lambda params, t: desired)
    quiet = tuple(NO_DISTURBANCE for _ in channels)
    inputs = tuple(NO_DISTURBANCE for _ in loop.inputs)
    undisturbed_loop = replace(loop, reference=fixed, wind=NO_WIND, disturbance=quiet, inputs=inputs)
    undisturbed_params = params._replace(
        reference=NoParams(),
        wind=NoParams(),
        sensor=tuple(map(without_noise, params.sensor)),
        disturbance=tuple(NoParams() for _ in channels),
        inputs=tuple(NoParams() for _ in loop.inputs),
        signal_sensor=tuple(map(without_noise, params.signal_sensor)),
    )
    return undisturbed_loop, undisturbed_params


def without_noise(sensor: Params) -> Params:
    """The parameters of a sensor with every standard deviation, a field that ends in ``_std``, set to 0."""
    deviations = [name for name in getattr(sensor, "_fields", ()) if name.endswith("_std")]
    return sensor._replace(**dict.fromkeys(deviations, 0.0))


def sample_map(
    loop: Loop, params: LoopParams, key: jax.Array, k: Scalar
) -> Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    """One sample of the loop as a function of its state and of signals that are added at the break points.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        key: The draw's random key.
        k: Index of the sample.

    Returns:
        ``(state, additions) -> (state after the sample, signals before the sums)``, all vectors. The state is the
        flattened :class:`~dssc_jax.closed_loop.sample.LoopState`; break points are in the order of :func:`place_names`.
    """
    _, unravel = ravel_pytree(initial_state(loop, params, key))
    loop_with_inputs = replace(
        loop,
        sensor=tuple(map(with_addition, loop.sensor)),
        signal_sensor=tuple(map(with_addition, loop.signal_sensor)),
    )
    places = measured_places(loop.channels)

    def sample(state: jax.Array, additions: jax.Array) -> tuple[jax.Array, jax.Array]:
        signals = additions.reshape(len(loop.channels), len(BreakPoint))
        sensors = []
        for i, sensor in enumerate(params.sensor):
            sensors.append(AdditionParams(sensor, Measurement(signals[i, 1], signals[i, 2])))
        signal_sensors = []
        for signal, sensor in zip(loop.measures, params.signal_sensor, strict=True):
            addition = additions[places[signal.name]] if signal.name in places else 0.0
            signal_sensors.append(AdditionParams(sensor, Measurement(addition, 0.0)))
        with_inputs = params._replace(sensor=tuple(sensors), signal_sensor=tuple(signal_sensors))
        next_state, recorded = step(
            loop_with_inputs, with_inputs, key, unravel(state), k, additions=tuple(signals[:, 0])
        )
        break_point_signals = []
        for channel, measurement in zip(recorded.instant.channels, recorded.measurements, strict=True):
            break_point_signals.append((channel.u_total, measurement.y, measurement.y_dot))
        return ravel_pytree(next_state)[0], jnp.asarray(break_point_signals).reshape(-1)

    return sample


def measured_places(channels: Sequence[str]) -> dict[str, int]:
    """Index of the break point at y and y' of each channel, by the name of y or y' as a measured signal."""
    names = place_names(channels)
    places = {}
    for channel in channels:
        for signal, point in (("y", BreakPoint.OUTPUT), ("y_dot", BreakPoint.RATE)):
            places[signal_name(channel, signal)] = names.index(place_name(channel, point))
    return places


def start_state(loop: Loop, params: LoopParams, key: jax.Array) -> jax.Array:
    """The state after the first sample as a vector; controllers may treat the first sample unlike all others."""
    return ravel_pytree(step(loop, params, key, initial_state(loop, params, key), 0)[0])[0]
