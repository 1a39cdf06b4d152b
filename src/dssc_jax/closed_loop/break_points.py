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

from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.loop import Loop, LoopParams, signal_name
from dssc_jax.closed_loop.sample import measure, step
from dssc_jax.core.contracts import NoParams, Reference, Sensor
from dssc_jax.core.signals import Measurement, Params, ReferencePoint, ReferencePoints, Scalar, State
from dssc_jax.models.disturbances import NO_DISTURBANCE
from dssc_jax.models.wind import NO_WIND


class BreakPoint(StrEnum):
    """A place at which a channel's loop is broken: its command, its measurement of y, or its measurement of y'.

    A break at ``output`` opens the path of y alone, and a break at ``rate`` opens the path of y' alone. Breaking both
    at once is the same as breaking at ``input``, because both paths lead to the channel's one command.
    """

    INPUT = "input"  # the command
    OUTPUT = "output"  # the measurement of y
    RATE = "rate"  # the measurement of y'


def place_names(channels: Sequence[str]) -> list[str]:
    """Name of each break point: all points of the first channel, then of the next.

    Names are such as ``input`` for a loop of one channel without a name, and ``x input`` for a channel x.
    """
    return [place_name(channel, point) for channel in channels for point in BreakPoint]


def place_name(channel: str, point: BreakPoint) -> str:
    """Name of a channel's break point, such as ``x input``; ``input`` alone if the channel's name is empty."""
    return f"{channel} {point}".strip()


class BreakPointSensorParams(NamedTuple):
    """Parameters of a sensor at a break point (:func:`with_addition`).

    Args:
        params: Parameters of the sensor without the addition.
        addition: Signals that are added to the y and y' of the plant before the sensor reads them.
    """

    params: Params
    addition: Measurement


def with_addition(sensor: Sensor) -> Sensor:
    """A sensor that reads the plant's measurement plus the addition in its :class:`BreakPointSensorParams`.

    The signal that is added at a break point thus enters the loop as a parameter of the sensor.
    """

    def sense(
        p: BreakPointSensorParams, z: State, m: Measurement, key: jax.Array, t: Scalar, dt: Scalar
    ) -> tuple[State, Measurement]:
        """The sensor's next state and its reading of the sum.

        Args:
            p: Parameters of the sensor, and the addition.
            z: State of the sensor.
            m: The plant's measurement.
            key: Random key of this call.
            t: Time [s].
            dt: Sample time T_s [s].
        """
        return sensor.step(p.params, z, Measurement(m.y + p.addition.y, m.y_dot + p.addition.y_dot), key, t, dt)

    return Sensor(BreakPointSensorParams, lambda p, m, key: sensor.init(p.params, m, key), sense)


def undisturbed(loop: Loop, params: LoopParams) -> tuple[Loop, LoopParams]:
    """The loop and its parameters at a constant reference, without disturbances, wind and sensor noise.

    Such a loop can rest at an equilibrium, and is linearised there.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
    """
    desired = constant_reference(loop, params)
    undisturbed_loop = replace(
        loop,
        reference=Reference(NoParams, lambda params, t: desired),
        wind=NO_WIND,
        disturbance=(NO_DISTURBANCE,) * len(loop.channels),
        inputs=(NO_DISTURBANCE,) * len(loop.inputs),
    )
    undisturbed_params = params._replace(
        reference=NoParams(),
        wind=NoParams(),
        sensor=tuple(map(without_noise, params.sensor)),
        disturbance=(NoParams(),) * len(loop.channels),
        inputs=(NoParams(),) * len(loop.inputs),
        signal_sensor=tuple(map(without_noise, params.signal_sensor)),
    )
    return undisturbed_loop, undisturbed_params


def constant_reference(loop: Loop, params: LoopParams) -> ReferencePoint | ReferencePoints:
    """The constant desired outputs at which a loop is linearised.

    A loop of several channels keeps the outputs that its plant has at t = 0, where a vehicle hovers. A loop of one
    channel has the constant level of the study's reference (``Reference.level``), or 0 if the reference has none.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
    """
    if len(loop.channels) > 1:
        origin = (ReferencePoint(0.0, 0.0, 0.0),) * len(loop.channels)
        outputs = measure(loop, params, loop.plant.init(params.plant), origin)
        return tuple(ReferencePoint(output.y, 0.0, 0.0) for output in outputs)
    level = 0.0 if loop.reference.level is None else loop.reference.level(params.reference)
    return ReferencePoint(level, 0.0, 0.0)


def without_noise(sensor: Params) -> Params:
    """The parameters of a sensor with every standard deviation, a field that ends in ``_std``, set to 0."""
    deviations = [name for name in getattr(sensor, "_fields", ()) if name.endswith("_std")]  # () without parameters
    return sensor._replace(**dict.fromkeys(deviations, 0.0))


def sample_map(
    loop: Loop, params: LoopParams, key: jax.Array, k: Scalar
) -> Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    """Return one sample of the loop as a function of its state and of signals that are added at the break points.

    The Jacobian of this function is the linearised loop.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        k: Index of the sample.

    Returns:
        ``(state, additions) -> (state after the sample, signals)``, all vectors. The state is the flattened
        :class:`~dssc_jax.closed_loop.sample.LoopState`. ``additions`` and ``signals`` have one element for each break
        point, in the order of :func:`place_names`. The signals are those before the addition.
    """
    _, state_from_vector = ravel_pytree(initial_state(loop, params, key))
    loop_with_inputs = replace(
        loop,
        sensor=tuple(map(with_addition, loop.sensor)),
        signal_sensor=tuple(map(with_addition, loop.signal_sensor)),
    )
    places = measured_places(loop.channels)

    def sample(state: jax.Array, additions: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The state after the sample, and the signal at each break point before the addition."""
        at_input, at_output, at_rate = additions.reshape(len(loop.channels), len(BreakPoint)).T
        sensors = []
        for i, sensor in enumerate(params.sensor):
            sensors.append(BreakPointSensorParams(sensor, Measurement(at_output[i], at_rate[i])))
        signal_sensors = []
        for signal, sensor in zip(loop.measures, params.signal_sensor, strict=True):
            addition = additions[places[signal.name]] if signal.name in places else 0.0
            signal_sensors.append(BreakPointSensorParams(sensor, Measurement(addition, 0.0)))
        with_inputs = params._replace(sensor=tuple(sensors), signal_sensor=tuple(signal_sensors))
        next_state, recorded = step(
            loop_with_inputs, with_inputs, key, state_from_vector(state), k, additions=tuple(at_input)
        )
        break_point_signals = []
        for channel, measurement in zip(recorded.instant.channels, recorded.measurements, strict=True):
            break_point_signals.append((channel.u_total, measurement.y, measurement.y_dot))
        return ravel_pytree(next_state)[0], jnp.asarray(break_point_signals).reshape(-1)

    return sample


def measured_places(channels: Sequence[str]) -> dict[str, int]:
    """Index of the break point at each channel's y and y', by the name of the measured signal, such as ``x_y``.

    A controller may also read y or y' as a measured signal. Additions at the break point must then enter there, too.
    """
    names = place_names(channels)
    places = {}
    for channel in channels:
        for signal, point in (("y", BreakPoint.OUTPUT), ("y_dot", BreakPoint.RATE)):
            places[signal_name(channel, signal)] = names.index(place_name(channel, point))
    return places


def start_state(loop: Loop, params: LoopParams, key: jax.Array) -> jax.Array:
    """The state after the first sample, as a vector: the start of a flight along which the loop is linearised.

    A flight for linearisation does not start at the state before that sample, because controllers may treat the first
    sample unlike all others.
    """
    state, _ = step(loop, params, key, initial_state(loop, params, key), 0)
    vector, _ = ravel_pytree(state)
    return vector
