"""One sample of the closed loop for one draw: measure, control, integrate plant and unmodelled dynamics."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.closed_loop.beginning import begin_controller, begin_plant
from dssc_jax.closed_loop.between_samples.held_parts import Advance, HeldParts
from dssc_jax.closed_loop.between_samples.hold import between_samples
from dssc_jax.closed_loop.control import (
    ControlResult,
    ControlState,
    control,
    initial_control,
    is_angle,
    measure,
    principal_value,
    unwrap,
)
from dssc_jax.closed_loop.estimates import measurements_for_sensors, next_estimate, start_estimate
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.metrics.instants import Instant, Sample
from dssc_jax.closed_loop.plant_inputs import actuate, plant_input, receive_command
from dssc_jax.closed_loop.readings import (
    continuous_outputs,
    first_readings,
    has_measured_angle,
    read_signals,
    signal_values,
)
from dssc_jax.core.numerics import as_arrays, is_word
from dssc_jax.core.signals import (
    Measurement,
    Measurements,
    PlantInput,
    ReferencePoint,
    ReferencePoints,
    Scalar,
    Signals,
    State,
    TrackingError,
    tracking_error,
)

FAR_BELOW = 1e-4  # size of a diverged state over the root of the largest number: large numbers may cancel in a sum


class ChannelState(NamedTuple):
    """State of one channel between two samples.

    Args:
        controller: State of the controller.
        sensor: State of the sensor.
        differentiator: State of the differentiator.
        unmodelled: State of the unmodelled dynamics.
        disturbance: State of the disturbance.
        u: The last robust command.
        reaching: The command that reaches the plant just before the sample.
        angle: The plant's last output, continuous in time [rad]; () if the output is no angle.
        reading: The last reading, continuous in time [rad]; () if the output is no angle.
        signal: The last value of the output as a measured signal, continuous in time [rad]; () if it is no such angle.
    """

    controller: State
    sensor: State
    differentiator: State
    unmodelled: State
    disturbance: State
    u: Scalar
    reaching: Scalar
    angle: State = ()
    reading: State = ()
    signal: State = ()

    @property
    def control(self) -> ControlState:
        """The state of the flight computer's software."""
        return ControlState(self.differentiator, self.controller, self.reading)


class LoopState(NamedTuple):
    """State of the loop between two samples.

    Args:
        plant: State of the plant.
        wind: State of the wind.
        channels: State of every channel.
        inputs: State of the disturbance at each input that the plant names.
        signals: State of the sensor of each measured signal.
        estimate: Memory of the estimator on board; () without one.
    """

    plant: State
    wind: State
    channels: tuple[ChannelState, ...]
    inputs: tuple[State, ...] = ()
    signals: tuple[State, ...] = ()
    estimate: State = ()

    @property
    def disturbances(self) -> tuple[State, ...]:
        """States of the disturbances: that of each channel, then that of each named input."""
        return (*(channel.disturbance for channel in self.channels), *self.inputs)


class Recorded(NamedTuple):
    """One sample of a recorded trajectory.

    Args:
        instant: The input of the metrics.
        measurements: The plant's outputs, before sensors.
        references: The desired outputs.
        finite: Whether the state after the sample is finite.
        broken: Whether the plant's model is no longer valid.
        grounded: Whether the vehicle has flown into the ground; a plain False if there is no ground.
        controlled: Inputs and outputs of each channel's flight computer.
    """

    instant: Instant
    measurements: Measurements
    references: ReferencePoints
    finite: Scalar
    broken: Scalar
    grounded: Scalar | bool
    controlled: tuple[ControlResult, ...]


def initial_state(loop: Loop, params: LoopParams, key: jax.Array) -> LoopState:
    """The loop's state before the first sample; unmodelled dynamics are at rest, with a command of 0 before t = 0."""
    plant = begin_plant(loop, params, key)
    references = loop.mimo_reference.at(params.reference, 0.0)
    at_rest = tuple(model.init(p) for model, p in zip(loop.unmodelled, params.unmodelled, strict=True))
    reaching = actuate(loop, params, at_rest, (0.0,) * len(loop.channels))
    wind = loop.wind.init(params.wind, loop.key_at(key, "wind", "", 0))
    disturbances = []
    for model, p, name in zip(loop.disturbance, params.disturbance, loop.channels, strict=True):
        disturbances.append(model.init(p, loop.key_at(key, "disturbance", name, 0)))
    inputs = []
    for model, p, name in zip(loop.inputs, params.inputs, loop.input_names, strict=True):
        inputs.append(model.init(p, loop.key_at(key, "input", name, 0)))
    condition = loop.condition(params, 0.0)
    drive = plant_input(loop, params, (*disturbances, *inputs), wind, plant, reaching, 0.0, condition)
    exact = measure(loop, params, plant, references, drive)
    true_plant = plant
    plant, estimate = start_estimate(loop, params, key, plant)
    measurements = measurements_for_sensors(loop, params, plant, references, drive, exact)
    sensors = []
    first_channel_readings = []
    for i, name in enumerate(loop.channels):
        sensor = loop.sensor[i].init(params.sensor[i], measurements[i], loop.key_at(key, "sensor", name, 0))
        # the controller starts from its measurement at the first sample, not from the plant's output
        first_key = loop.key_at(key, "sensor", name, 1)
        _, reading = loop.sensor[i].step(params.sensor[i], sensor, measurements[i], first_key, 0.0, loop.sample_time)
        sensors.append(sensor)
        first_channel_readings.append(principal_value(loop, i, reading))
    # a measured angle begins in the turn of its channel's reading, so that a controller of both sees one angle
    outputs = continuous_outputs(loop, exact, tuple(reading.y for reading in first_channel_readings))
    values = signal_values(loop, params, true_plant, outputs, drive)
    signal_sensors, signals = first_readings(loop, params, key, values)
    channels = []
    for i in range(len(loop.channels)):
        wrapped_reading = first_channel_readings[i]._replace(signals=signals)
        control = initial_control(loop, params, i, wrapped_reading, references[i])
        channels.append(
            ChannelState(
                controller=begin_controller(loop, params, key, i, control.controller),
                sensor=sensors[i],
                differentiator=control.differentiator,
                unmodelled=at_rest[i],
                disturbance=disturbances[i],
                u=0.0,
                reaching=reaching[i],
                angle=measurements[i].y if is_angle(loop, i) else (),
                reading=control.reading,
                signal=outputs[i].y if has_measured_angle(loop, i) else (),
            )
        )
    return as_arrays(LoopState(plant, wind, tuple(channels), tuple(inputs), signal_sensors, estimate))


def held_parts(loop: Loop) -> HeldParts:
    """The parts of a loop that move between two samples."""
    return HeldParts(
        plant=loop.mimo_plant,
        unmodelled=loop.unmodelled,
        variations=tuple(model.variation for model in (*loop.disturbance, *loop.inputs)),
        integrator=loop.integrator,
        sample_time=loop.sample_time,
        substeps=loop.substeps,
    )


def held_between_samples(loop: Loop, params: LoopParams) -> Advance:
    """The function that advances plant and unmodelled dynamics by a sample; call it before the time loop."""
    return between_samples(held_parts(loop), params.plant, params.unmodelled)


def all_finite(state: LoopState) -> Scalar:
    """Whether the sum of the state is finite, and so small that metrics can add the squares of signals.

    The commands that reach the plant follow from other states, and are left out. A state that is an array adds the sum
    of its numbers.
    """
    state = state._replace(channels=tuple(channel._replace(reaching=0.0) for channel in state.channels))
    largest = float(jnp.finfo(jnp.result_type(float)).max)
    numbers = [jnp.sum(leaf) if jnp.ndim(leaf) else leaf for leaf in jax.tree.leaves(state) if not is_word(leaf)]
    return jnp.abs(sum(numbers)) < FAR_BELOW * math.sqrt(largest)


def control_channel(
    loop: Loop,
    params: LoopParams,
    key: jax.Array,
    channel: ChannelState,
    i: int,
    measurement: Measurement,
    signals: Signals,
    reference: ReferencePoint,
    k: Scalar,
) -> tuple[ChannelState, ControlResult]:
    """Run sensor, differentiator and controller of channel i at sample k, and advance its disturbance's state.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        key: The draw's random key.
        channel: The channel's state before the sample.
        i: Index of the channel.
        measurement: The plant's output.
        signals: Readings of the measured signals.
        reference: The desired output.
        k: Index of the sample.
    """
    t = k * loop.sample_time
    dt = loop.sample_time
    name = loop.channels[i]
    measurement = unwrap(loop, i, measurement, channel.angle)
    sensor_key = loop.key_at(key, "sensor", name, k + 1)
    sensor, reading = loop.sensor[i].step(params.sensor[i], channel.sensor, measurement, sensor_key, t, dt)
    wrapped_reading = principal_value(loop, i, reading)._replace(signals=signals)
    state, controlled = control(loop, params, i, channel.control, wrapped_reading, reference)
    disturbance_key = loop.key_at(key, "disturbance", name, k + 1)
    disturbance = loop.disturbance[i].step(params.disturbance[i], channel.disturbance, disturbance_key, t, dt)
    next_channel = channel._replace(
        controller=state.controller,
        sensor=sensor,
        differentiator=state.differentiator,
        disturbance=disturbance,
        u=controlled.command.robust,
        angle=measurement.y if is_angle(loop, i) else (),
        reading=state.reading,
    )
    return next_channel, controlled


def metric_sample(
    loop: Loop,
    k: Scalar,
    error: TrackingError,
    reference: ReferencePoint,
    controlled: ControlResult,
    u_previous: Scalar,
    input_gain: Scalar,
    l0: Scalar,
) -> Sample:
    """The signals of one channel at sample k, for metrics.

    Args:
        loop: The models and the clock.
        k: Index of the sample.
        error: The true tracking error.
        reference: The desired output.
        controlled: Inputs and outputs of the channel's flight computer.
        u_previous: The robust command of the previous sample.
        input_gain: The plant's input gain k_p in this channel.
        l0: Error pole l_0 of the controller [1/s].
    """
    command = controlled.command
    return Sample(
        k=k,
        dt=loop.sample_time,
        e=error.e,
        sigma=error.sigma,
        sigma_measured=tracking_error(controlled.sensed, controlled.reference, l0).sigma,
        u=command.robust,
        u_previous=jnp.where(k == 0, command.robust, u_previous),
        u_total=command.total,
        k_p=input_gain,
        info=controlled.info,
        reference=reference,
        e_dot=error.sigma - l0 * error.e,
        y_measured=controlled.sensed.y,
        y_dot_measured=controlled.sensed.y_dot,
    )


def step(
    loop: Loop,
    params: LoopParams,
    key: jax.Array,
    state: LoopState,
    k: Scalar,
    advance: Advance | None = None,
    additions: Signals | None = None,
) -> tuple[LoopState, Recorded]:
    """Advance the loop by sample k: measure, control, and integrate to the next sample.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        key: The draw's random key.
        state: The state at the sample.
        k: Index of the sample.
        advance: Result of :func:`held_between_samples`, from before the time loop; None: computed here.
        additions: Signals added to the commands of the channels, before the unmodelled dynamics; None: none.

    Returns:
        The state at the next sample, and the signals of this one.
    """
    advance = advance or held_between_samples(loop, params)
    dt = loop.sample_time
    t = k * dt
    references = loop.mimo_reference.at(params.reference, t)
    reaching = tuple(channel.reaching for channel in state.channels)
    condition = loop.condition(params, t)
    drive_before = plant_input(loop, params, state.disturbances, state.wind, state.plant, reaching, t, condition)
    measurements = measure(loop, params, state.plant, references, drive_before)
    outputs = continuous_outputs(loop, measurements, tuple(channel.signal for channel in state.channels))
    values = signal_values(loop, params, state.plant, outputs, drive_before)
    signal_sensors, signals = read_signals(loop, params, key, state.signals, values, k)
    sensor_inputs = measurements_for_sensors(loop, params, state.plant, references, drive_before, measurements)
    gains = loop.mimo_plant.input_gain(params.plant)
    channels = []
    samples = []
    commands = []
    control_results = []
    for i, channel in enumerate(state.channels):
        reference = references[i]
        next_channel, controlled = control_channel(
            loop, params, key, channel, i, sensor_inputs[i], signals, reference, k
        )
        l0 = params.controller[i].l0
        error = tracking_error(measurements[i], reference, l0)
        samples.append(metric_sample(loop, k, error, reference, controlled, channel.u, gains[i], l0))
        total = controlled.command.total if additions is None else controlled.command.total + additions[i]
        unmodelled = receive_command(loop, params, key, channel.unmodelled, i, total, k)
        channels.append(next_channel._replace(unmodelled=unmodelled))
        commands.append(total)
        control_results.append(controlled)
    wind = loop.wind.step(params.wind, state.wind, loop.key_at(key, "wind", "", k + 1), t, dt)
    held_commands = as_arrays(tuple(commands))
    unmodelled_states = tuple(channel.unmodelled for channel in channels)
    inputs = []
    for model, p, previous, name in zip(loop.inputs, params.inputs, state.inputs, loop.input_names, strict=True):
        inputs.append(model.step(p, previous, loop.key_at(key, "input", name, k + 1), t, dt))
    disturbances = (*(channel.disturbance for channel in channels), *inputs)

    def drive_at(plant: State, actuation: Signals, time: Scalar) -> PlantInput[Signals]:
        return plant_input(loop, params, disturbances, wind, plant, actuation, time, condition)

    plant, next_unmodelled = advance(drive_at, state.plant, unmodelled_states, held_commands, t)
    plant, estimate = next_estimate(loop, params, key, plant, state.estimate, k + 1)
    drive = drive_at(state.plant, actuate(loop, params, unmodelled_states, held_commands), t)
    info = loop.mimo_plant.monitor(params.plant, state.plant, drive)
    reaching = actuate(loop, params, next_unmodelled, held_commands)
    for i, channel in enumerate(channels):
        signal = outputs[i].y if has_measured_angle(loop, i) else ()
        channels[i] = channel._replace(unmodelled=next_unmodelled[i], reaching=reaching[i], signal=signal)
    next_state = as_arrays(LoopState(plant, wind, tuple(channels), tuple(inputs), signal_sensors, estimate))
    is_broken = loop.plant.broken(params.plant, next_state.plant)
    is_grounded = loop.mimo_plant.grounded(params.plant, state.plant, drive, t, dt)
    instant = Instant(t, dt, tuple(samples), info, signals)
    return next_state, Recorded(
        instant=instant,
        measurements=measurements,
        references=references,
        finite=all_finite(next_state),
        broken=is_broken,
        grounded=is_grounded,
        controlled=tuple(control_results),
    )
