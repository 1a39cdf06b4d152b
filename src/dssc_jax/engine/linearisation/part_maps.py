"""Each part of a loop at one operating point, as a function of its state and inputs.

The function allows a comparison of the part's derivative with the effects of small pushes on state and inputs.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax

from dssc_jax.closed_loop.control import measure
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.plant_inputs import actuate, plant_input, receive_command
from dssc_jax.closed_loop.readings import continuous_outputs, signal_values
from dssc_jax.closed_loop.sample import LoopState, Recorded, step
from dssc_jax.core.contracts import Controller, Differentiator, Disturbance, Plant, Sensor, Unmodelled
from dssc_jax.core.signals import (
    Command,
    Measurement,
    Measurements,
    Params,
    PlantInput,
    Scalar,
    Signals,
    State,
    tracking_error,
)
from dssc_jax.engine.linearisation.smooth_parts import INPUTS, SIGNAL_SENSOR, LoopPart


class PartMap(NamedTuple):
    """A part as a function of its state and inputs, with their values at one operating point.

    Args:
        apply: ``(part, params, memory, signals) -> outputs``; the outputs include the part's next state.
        memory: State of the part, which may contain counters; () for the plant and for disturbances.
        signals: Inputs of the part; for the plant also its state.
    """

    apply: Callable[..., object]
    memory: object
    signals: object


class OperatingPoint(NamedTuple):
    """A loop at sample k, with all of its signals.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        state: The loop's state before the sample.
        k: Index of the sample.
        recorded: The signals of the sample.
        commands: The command of each channel.
        drive: The plant's input.
    """

    loop: Loop
    params: LoopParams
    key: jax.Array
    state: LoopState
    k: Scalar
    recorded: Recorded
    commands: Signals
    drive: PlantInput[Signals]

    @property
    def time(self) -> Scalar:
        """The time t = k T_s of the sample [s]."""
        return self.k * self.loop.sample_time

    def stream(self, slot: str, name: str) -> jax.Array:
        """The random key of a part at this sample.

        Args:
            slot: The kind of part, such as ``sensor``.
            name: Name of its channel or signal.
        """
        return self.loop.key_at(self.key, slot, name, self.k + 1)


def part_maps(
    loop: Loop, params: LoopParams, key: jax.Array, state: LoopState, k: Scalar, places: Sequence[LoopPart]
) -> list[PartMap]:
    """Each part in ``places`` as a function of its state and inputs, with their values at sample k.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        state: The loop's state before the sample.
        k: Index of the sample.
        places: The parts.
    """
    _, recorded = step(loop, params, key, state, k)
    commands = tuple(channel.u_total for channel in recorded.instant.channels)
    sampled_commands = []
    for i, channel in enumerate(state.channels):
        sampled_commands.append(receive_command(loop, params, key, channel.unmodelled, i, commands[i], k))
    actuation = actuate(loop, params, tuple(sampled_commands), commands)
    drive = plant_input(loop, params, state.disturbances, state.wind, state.plant, actuation, k * loop.sample_time)
    point = OperatingPoint(loop, params, key, state, k, recorded, commands, drive)
    return [MAPS[place.slot](point, place.channel) for place in places]


def plant_map(at: OperatingPoint, _: int) -> PartMap:
    """The plant: from its state and commands to its derivative, measurements and measured signals.

    A plant belongs to no channel, so the contract's index is not read.
    """

    def apply(
        part: Plant[Measurements, Signals], params: Params, memory: tuple[()], signals: tuple[State, Signals]
    ) -> tuple[State, tuple[Measurements, Signals]]:
        """The derivative of the state, the measurements, and the true values of the measured signals."""
        plant_state, command = signals
        drive = at.drive._replace(command=command)
        slope = part.derivative(params, plant_state, drive, at.time)
        outputs = measure(at.loop, at.params, plant_state, at.recorded.references)
        return slope, (outputs, signal_values(at.loop, at.params, plant_state, outputs, drive))

    return PartMap(apply, memory=(), signals=(at.state.plant, at.drive.command))


def sensor_map(at: OperatingPoint, i: int) -> PartMap:
    """The sensor of channel i: from the plant's output to the reading."""

    def apply(part: Sensor, params: Params, memory: State, signals: Measurement) -> tuple[State, Measurement]:
        """The sensor's next state and its reading."""
        key = at.stream("sensor", at.loop.channels[i])
        return part.step(params, memory, signals, key, at.time, at.loop.sample_time)

    return PartMap(apply, at.state.channels[i].sensor, at.recorded.measurements[i])


def differentiator_map(at: OperatingPoint, i: int) -> PartMap:
    """The differentiator of channel i: from the sensor's reading to the reading with its derivative."""

    def apply(part: Differentiator, params: Params, memory: State, signals: Measurement) -> tuple[State, Measurement]:
        """The differentiator's next state, and the reading with its derivative."""
        return part.step(params, memory, signals, at.loop.sample_time)

    return PartMap(apply, at.state.channels[i].differentiator, at.recorded.controlled[i].reading)


def controller_map(at: OperatingPoint, i: int) -> PartMap:
    """The controller of channel i: from its measurement to its command."""
    controlled = at.recorded.controlled[i]

    def apply(part: Controller, params: Params, memory: State, signals: Measurement) -> tuple[State, Command]:
        """The controller's next state and its command; its info is not fed back, and left out."""
        state, command, _ = part.step(params, memory, signals, controlled.reference, at.loop.sample_time)
        return state, command

    return PartMap(apply, at.state.channels[i].controller, controlled.sensed)


def unmodelled_map(at: OperatingPoint, i: int) -> PartMap:
    """The unmodelled dynamics of channel i: from the command to the outputs at start and end of the sample."""

    def apply(part: Unmodelled, params: Params, memory: State, signals: Scalar) -> tuple[State, Scalar, Scalar]:
        """The state after the sample, and the outputs at its start and end."""
        dt = at.loop.sample_time
        begin = part.sample(params, memory, signals, at.stream("unmodelled", at.loop.channels[i]), dt)
        end = part.step(params, begin, signals, dt)
        return end, part.output(params, begin, signals), part.output(params, end, signals)

    return PartMap(apply, at.state.channels[i].unmodelled, at.commands[i])


def disturbance_map(at: OperatingPoint, i: int) -> PartMap:
    """The disturbance of channel i: from the channel's measurement and sigma to the disturbance's value."""
    return disturbance_from(at, at.state.disturbances[i], i)


def named_input_map(at: OperatingPoint, i: int) -> PartMap:
    """The disturbance at the i-th named input of the plant: from a measurement and sigma to the disturbance's value.

    A named input belongs to no channel; the disturbance sees measurement and sigma of the first one.
    """
    return disturbance_from(at, at.state.inputs[i], channel=0)


def disturbance_from(at: OperatingPoint, state: State, channel: int) -> PartMap:
    """A disturbance whose state is held: from the measurement and sigma of a channel to the disturbance's value.

    Args:
        at: The loop at its operating point.
        state: State of the disturbance.
        channel: Index of the channel.
    """

    def apply(part: Disturbance, params: Params, memory: tuple[()], signals: tuple[Measurement, Scalar]) -> Scalar:
        """The value of the disturbance."""
        measurement, sigma = signals
        return part.value(params, state, measurement, sigma, at.time)

    measurement = at.recorded.measurements[channel]
    error = tracking_error(measurement, at.recorded.references[channel], at.params.controller[channel].l0)
    return PartMap(apply, memory=(), signals=(measurement, error.sigma))


def signal_sensor_map(at: OperatingPoint, i: int) -> PartMap:
    """The sensor of the i-th measured signal: from the signal to its reading."""

    def apply(part: Sensor, params: Params, memory: State, signals: Scalar) -> tuple[State, Scalar]:
        """The sensor's next state and its reading of the signal."""
        key = at.stream("signal", at.loop.measures[i].name)
        measurement = Measurement(signals, y_dot=0.0)  # the sensor of a signal reads one value: no y'
        sensor_state, reading = part.step(params, memory, measurement, key, at.time, at.loop.sample_time)
        return sensor_state, reading.y

    previous_angles = tuple(channel.signal for channel in at.state.channels)
    outputs = continuous_outputs(at.loop, at.recorded.measurements, previous_angles)
    values = signal_values(at.loop, at.params, at.state.plant, outputs, at.drive)
    return PartMap(apply, at.state.signals[i], values[i])


MAPS: dict[str, Callable[[OperatingPoint, int], PartMap]] = {
    "plant": plant_map,
    "sensor": sensor_map,
    "differentiator": differentiator_map,
    "controller": controller_map,
    "unmodelled": unmodelled_map,
    "disturbance": disturbance_map,
    INPUTS: named_input_map,
    SIGNAL_SENSOR: signal_sensor_map,
}
"""The map of a part, by the slot of the loop that contains it."""
