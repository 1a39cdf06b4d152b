"""The software of a flight computer in one channel: differentiator and controller, with unwrapped angles.

An angle passes from the plant to the controller in four forms:

1. The sensor sees the angle continuous in time: shifted by whole turns to within pi of its last value.
2. The flight computer receives the principal value of the sensor's reading, in (-pi, pi], as autopilots give it.
3. The flight computer makes the reading continuous again before the differentiator.
4. The controller's reference is shifted by whole turns to within pi of the measurement, so that the error is wrapped.

Steps 3 and 4 are part of :func:`control`, hence of the generated C. Metrics count the wrapped error.
"""

from typing import NamedTuple

from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.numerics import turned_near, wrap_angle
from dssc_jax.core.signals import (
    Command,
    Info,
    Measurement,
    Measurements,
    PlantInput,
    ReferencePoint,
    ReferencePoints,
    Scalar,
    Signals,
    State,
)


class ControlState(NamedTuple):
    """State of the flight computer's software in one channel.

    Args:
        differentiator: State of the differentiator.
        controller: State of the controller.
        reading: The last reading of an angle, continuous in time [rad]; () if the output is no angle.
    """

    differentiator: State
    controller: State
    reading: State = ()


class ControlResult(NamedTuple):
    """Inputs and outputs of the flight computer in one channel at one sample.

    Args:
        reading: The sensor's reading; an angle in (-pi, pi].
        sensed: The controller's measurement, after the differentiator; an angle is continuous in time.
        reference: The controller's reference; for an angle it lies within pi of the measurement.
        command: The command.
        info: The controller's info.
    """

    reading: Measurement
    sensed: Measurement
    reference: ReferencePoint
    command: Command
    info: Info


def measure(
    loop: Loop,
    params: LoopParams,
    plant: State,
    references: ReferencePoints,
    drive: PlantInput[Signals] | None = None,
) -> Measurements:
    """The plant's outputs, before sensors; an angle is shifted by whole turns to lie within pi of its reference.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        plant: The plant's state.
        references: The desired outputs.
        drive: The plant's input just before; None: commands and disturbances are 0.
    """
    if drive is None:
        drive = loop.zero_input(params.plant)
    measurements = loop.mimo_plant.measure(params.plant, plant, drive)
    return tuple(near_reference(loop, i, measurement, references[i]) for i, measurement in enumerate(measurements))


def is_angle(loop: Loop, i: int) -> bool:
    """Whether the output of channel i is an angle, which may have any number of turns."""
    return loop.channels[i] in loop.plant.angles


def near_reference(loop: Loop, i: int, measurement: Measurement, reference: ReferencePoint) -> Measurement:
    """The measurement of channel i; an angle [rad] is shifted by whole turns to lie within pi of the reference.

    Args:
        loop: The models and the clock.
        i: Index of the channel.
        measurement: The plant's output.
        reference: The desired output.
    """
    return measurement._replace(y=turned_near(measurement.y, reference.y)) if is_angle(loop, i) else measurement


def unwrap(loop: Loop, i: int, measurement: Measurement, previous: State) -> Measurement:
    """The measurement of channel i; an angle is shifted by whole turns to lie within pi of its previous value.

    The result is continuous in time, unless the angle turns by more than pi within a sample. Sensors and
    differentiators need this, because a jump by a whole turn would disturb their memory.

    Args:
        loop: The models and the clock.
        i: Index of the channel.
        measurement: The measurement at this sample.
        previous: The angle at the previous sample [rad]; not read if the output is no angle.
    """
    if not is_angle(loop, i):
        return measurement
    continuous = turned_near(measurement.y, previous)
    return measurement._replace(y=continuous)


def principal_value(loop: Loop, i: int, measurement: Measurement) -> Measurement:
    """The reading that the sensor of channel i sends to the flight computer: an angle is wrapped to (-pi, pi].

    Args:
        loop: The models and the clock.
        i: Index of the channel.
        measurement: The sensor's reading, continuous in time.
    """
    return measurement._replace(y=wrap_angle(measurement.y)) if is_angle(loop, i) else measurement


def initial_control(
    loop: Loop, params: LoopParams, i: int, reading: Measurement, reference: ReferencePoint
) -> ControlState:
    """The state of differentiator and controller of channel i at the first sample, before their first step.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        i: Index of the channel.
        reading: The sensor's first reading.
        reference: The desired output.
    """
    differentiator, sensed, desired = first_signals(loop, params, i, reading, reference)
    controller = loop.controller[i].init(params.controller[i], sensed, desired)
    return ControlState(differentiator, controller, reading.y if is_angle(loop, i) else ())


def first_signals(
    loop: Loop, params: LoopParams, i: int, reading: Measurement, reference: ReferencePoint
) -> tuple[State, Measurement, ReferencePoint]:
    """State of channel i's differentiator before its first step, and the controller's two inputs in that step.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        i: Index of the channel.
        reading: The sensor's reading.
        reference: The desired output.

    Returns:
        The differentiator's state, the controller's measurement, and the controller's reference.
    """
    of_channel = reading._replace(signals=())
    differentiator = loop.differentiator[i].init(params.differentiator[i], of_channel)
    _, sensed = loop.differentiator[i].step(params.differentiator[i], differentiator, of_channel, loop.sample_time)
    sensed = sensed._replace(signals=required_signals(loop, i, reading.signals))
    return differentiator, sensed, reference_near_measurement(loop, i, reference, sensed)


def required_signals(loop: Loop, i: int, readings: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    """The readings that the controller of channel i asks for, in the order in which it asks.

    Args:
        loop: The models and the clock.
        i: Index of the channel.
        readings: The reading of each measured signal of the study.

    Returns:
        The readings asked for; all of them if the controller asks for none by name.
    """
    requested_signals = loop.controller[i].signals
    if not requested_signals:
        return readings
    measured_names = [signal.name for signal in loop.measures]
    return tuple(readings[measured_names.index(signal.name)] for signal in requested_signals)


def reference_near_measurement(loop: Loop, i: int, reference: ReferencePoint, sensed: Measurement) -> ReferencePoint:
    """The controller's reference; for an angle [rad], it is shifted by whole turns to lie within pi of the measurement.

    The reference is shifted, and not the measurement. Otherwise a controller that differentiates its measurement would
    see a jump where the reference crosses pi, or steps by more than half a turn.

    Args:
        loop: The models and the clock.
        i: Index of the channel.
        reference: The desired output.
        sensed: The controller's measurement.
    """
    if not is_angle(loop, i):
        return reference
    near_measurement = turned_near(reference.y, sensed.y)
    return reference._replace(y=near_measurement)


def control(
    loop: Loop, params: LoopParams, i: int, state: ControlState, reading: Measurement, reference: ReferencePoint
) -> tuple[ControlState, ControlResult]:
    """Run differentiator and controller of channel i at one sample: all that a flight computer runs.

    Reading and reference of an angle may have any number of turns. The reading is made continuous in time before the
    differentiator, and the error is wrapped before the controller.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        i: Index of the channel.
        state: State of differentiator and controller.
        reading: The sensor's reading.
        reference: The desired output.

    Returns:
        The next state, and the controller's inputs and outputs.
    """
    dt = loop.sample_time
    seen = unwrap(loop, i, reading, state.reading)
    of_channel = seen._replace(signals=())
    differentiator, sensed = loop.differentiator[i].step(params.differentiator[i], state.differentiator, of_channel, dt)
    sensed = sensed._replace(signals=required_signals(loop, i, reading.signals))
    desired = reference_near_measurement(loop, i, reference, sensed)
    controller, command, info = loop.controller[i].step(params.controller[i], state.controller, sensed, desired, dt)
    next_state = ControlState(differentiator, controller, seen.y if is_angle(loop, i) else ())
    return next_state, ControlResult(reading, sensed, desired, command, info)


def transfer_control(
    loop: Loop, params: LoopParams, i: int, reading: Measurement, reference: ReferencePoint, command: Scalar
) -> ControlState | None:
    """The state of channel i whose first step gives ``command`` at this sample, for a bumpless start.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        i: Index of the channel.
        reading: The sensor's reading at this sample.
        reference: The desired output at this sample.
        command: The command that the first step must give.

    Returns:
        The state; None if the controller offers no such start.
    """
    transfer = loop.controller[i].transfer
    if transfer is None:
        return None
    differentiator, sensed, desired = first_signals(loop, params, i, reading, reference)
    controller = transfer(params.controller[i], sensed, desired, command, loop.sample_time)
    return ControlState(differentiator, controller, reading.y if is_angle(loop, i) else ())
