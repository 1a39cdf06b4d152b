"""One sample of the closed loop for one draw: measure, control, integrate plant and unmodelled dynamics."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.closed_loop.beginning import begin_controller, begin_plant
from dssc_jax.closed_loop.control import (
    Controlled,
    ControlState,
    control,
    initial_control,
    is_angle,
    measure,
    principal_value,
    unwrap,
)
from dssc_jax.closed_loop.estimates import measurements_for_sensors, renewed_estimate, start_estimate
from dssc_jax.closed_loop.held_parts import Advance, HeldParts
from dssc_jax.closed_loop.hold import between_samples
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.metrics import Instant, Sample
from dssc_jax.closed_loop.readings import first_readings, read_signals, signal_values
from dssc_jax.core.events import condition_at
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

FAR_BELOW = 1e-4  # the root of the largest number: large numbers may cancel in the sum of a state


class ChannelState(NamedTuple):
    """State of one channel's parts, its last robust command, what reaches the plant, and two angles.

    Args:
        controller: State of the controller.
        sensor: State of the sensor.
        differentiator: State of the differentiator.
        unmodelled: State of the unmodelled dynamics.
        disturbance: State of the disturbance.
        u: The last robust command.
        reaching: The command that reaches the plant, just before the sample.
        angle: The plant's last output, continuous in time [rad]; (), if the output is no angle.
        reading: The last reading, continuous in time [rad]; (), if the output is no angle.
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

    @property
    def control(self) -> ControlState:
        """The part of the state that a flight computer holds."""
        return ControlState(self.differentiator, self.controller, self.reading)


class LoopState(NamedTuple):
    """State of plant, wind, every channel, disturbances at named inputs, sensors of signals, and the estimator."""

    plant: State
    wind: State
    channels: tuple[ChannelState, ...]
    inputs: tuple[State, ...] = ()
    signals: tuple[State, ...] = ()
    estimate: State = ()

    @property
    def disturbances(self) -> tuple[State, ...]:
        """State of the disturbance of each channel, then of each named input."""
        return (*(channel.disturbance for channel in self.channels), *self.inputs)


class Recorded(NamedTuple):
    """One sample of a recorded trajectory.

    Args:
        instant: The input of the metrics.
        measurements: The plant's own, before sensors.
        references: The desired outputs.
        finite: Whether the state after the sample is finite.
        broken: Whether the plant's model is no longer valid.
        grounded: Whether it has flown into the ground; False: there is none.
        controlled: What each channel's controller saw and gave.
    """

    instant: Instant
    measurements: Measurements
    references: ReferencePoints
    finite: Scalar
    broken: Scalar
    grounded: Scalar | bool
    controlled: tuple[Controlled, ...]


def initial_state(loop: Loop, params: LoopParams, key: jax.Array) -> LoopState:
    """State at t = 0: unmodelled dynamics are at rest, and their command before it was 0."""
    plant = begin_plant(loop, params, key)
    references = loop.mimo_reference.at(params.reference, 0.0)
    zeros = (0.0,) * len(loop.channels)
    at_rest = tuple(model.init(p) for model, p in zip(loop.unmodelled, params.unmodelled, strict=True))
    reaching = actuate(loop, params, at_rest, zeros)
    wind = loop.wind.init(params.wind, jax.random.fold_in(loop.key(key, "wind"), 0))
    disturbances = []
    for i, name in enumerate(loop.channels):
        stream_key = loop.key(key, "disturbance", name)
        disturbances.append(loop.disturbance[i].init(params.disturbance[i], jax.random.fold_in(stream_key, 0)))
    inputs = []
    for model, p, name in zip(loop.inputs, params.inputs, loop.input_names, strict=True):
        inputs.append(model.init(p, jax.random.fold_in(loop.key(key, "input", name), 0)))
    condition = condition_at(loop.events, params.events, 0.0, loop.sample_time, loop.rotors)
    drive = plant_input(loop, params, (*disturbances, *inputs), wind, plant, reaching, 0.0, condition)
    exact = measure(loop, params, plant, references, drive)
    signal_sensors, signals = first_readings(loop, params, key, signal_values(loop, params, plant, exact, drive))
    plant, estimate = start_estimate(loop, params, key, plant)
    measurements = measurements_for_sensors(loop, params, plant, references, drive, exact)
    channels = []
    for i, name in enumerate(loop.channels):
        stream_key = loop.key(key, "sensor", name)
        sensor = loop.sensor[i].init(params.sensor[i], measurements[i], jax.random.fold_in(stream_key, 0))
        # the controller starts from what it will measure at the first sample, not from the plant's own output
        first = jax.random.fold_in(stream_key, 1)
        _, reading = loop.sensor[i].step(params.sensor[i], sensor, measurements[i], first, 0.0, loop.sample_time)
        wrapped_reading = principal_value(loop, i, reading)._replace(signals=signals)
        control = initial_control(loop, params, i, wrapped_reading, references[i])
        channels.append(
            ChannelState(
                controller=begin_controller(loop, params, key, i, control.controller),
                sensor=sensor,
                differentiator=control.differentiator,
                unmodelled=at_rest[i],
                disturbance=disturbances[i],
                u=0.0,
                reaching=reaching[i],
                angle=measurements[i].y if is_angle(loop, i) else (),
                reading=control.reading,
            )
        )
    return as_arrays(LoopState(plant, wind, tuple(channels), tuple(inputs), signal_sensors, estimate))


def held_parts(loop: Loop) -> HeldParts:
    """The parts of a loop that move between the samples."""
    return HeldParts(
        plant=loop.mimo_plant,
        unmodelled=loop.unmodelled,
        variations=tuple(model.variation for model in (*loop.disturbance, *loop.inputs)),
        integrator=loop.integrator,
        sample_time=loop.sample_time,
        substeps=loop.substeps,
    )


def held_between_samples(loop: Loop, params: LoopParams) -> Advance:
    """The function that advances a draw between two samples; to be called before the time loop."""
    return between_samples(held_parts(loop), params.plant, params.unmodelled)


def actuate(loop: Loop, params: LoopParams, unmodelled: tuple[State, ...], commands: Signals) -> Signals:
    """The commands after the unmodelled dynamics, as received by the plant."""
    parts = zip(loop.unmodelled, params.unmodelled, unmodelled, commands, strict=True)
    return tuple(model.output(p, z, u) for model, p, z, u in parts)


def sampled_command(
    loop: Loop, params: LoopParams, key: jax.Array, unmodelled: State, i: int, command: Scalar, k: Scalar
) -> State:
    """State of the unmodelled dynamics of channel i after they have received the command of sample k."""
    fresh = jax.random.fold_in(loop.key(key, "unmodelled", loop.channels[i]), k + 1)
    return loop.unmodelled[i].sample(params.unmodelled[i], unmodelled, command, fresh, loop.sample_time)


def plant_input(
    loop: Loop,
    params: LoopParams,
    input_states: tuple[State, ...],
    wind: State,
    plant: State,
    actuation: Signals,
    t: Scalar,
    condition: State = None,
) -> PlantInput[Signals]:
    """The plant's input at a stage of the integrator: commands, disturbances at the stage's plant state, and wind.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        input_states: State of the disturbance of each channel, then of each named input.
        wind: State of the wind.
        plant: State of the plant.
        actuation: The commands that reach it.
        t: Time [s].
        condition: What events have made of the plant in this sample.
    """
    references = loop.mimo_reference.at(params.reference, t)
    measurements = measure(loop, params, plant, references)
    disturbances = []
    for i, model in enumerate(loop.disturbance):
        sigma = tracking_error(measurements[i], references[i], params.controller[i].l0).sigma
        disturbances.append(model.value(params.disturbance[i], input_states[i], measurements[i], sigma, t))
    first = tracking_error(measurements[0], references[0], params.controller[0].l0).sigma
    inputs = []
    for model, p, state in zip(loop.inputs, params.inputs, input_states[len(loop.disturbance) :], strict=True):
        inputs.append(model.value(p, state, measurements[0], first, t))
    return PlantInput(actuation, tuple(disturbances), loop.wind.value(params.wind, wind, t), tuple(inputs), condition)


def all_finite(state: LoopState) -> Scalar:
    """Whether the sum of the whole state is finite, and so small that metrics can sum the squares of signals.

    What reaches the plant follows from the rest of the state, and is left out.
    """
    state = state._replace(channels=tuple(channel._replace(reaching=0.0) for channel in state.channels))
    largest = float(jnp.finfo(jnp.result_type(float)).max)
    numbers = [leaf for leaf in jax.tree.leaves(state) if not is_word(leaf)]
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
) -> tuple[ChannelState, Controlled]:
    """Run sensor, differentiator and controller of channel i at sample k, and advance its disturbance's state.

    The sensor sees an angle that is continuous in time. ``signals`` are the readings of the measured signals.
    """
    t = k * loop.sample_time
    dt = loop.sample_time
    name = loop.channels[i]
    measurement = unwrap(loop, i, measurement, channel.angle)
    sensor, reading = loop.sensor[i].step(
        params.sensor[i],
        channel.sensor,
        measurement,
        jax.random.fold_in(loop.key(key, "sensor", name), k + 1),
        t,
        dt,
    )
    wrapped_reading = principal_value(loop, i, reading)._replace(signals=signals)
    state, controlled = control(loop, params, i, channel.control, wrapped_reading, reference)
    disturbance = loop.disturbance[i].step(
        params.disturbance[i],
        channel.disturbance,
        jax.random.fold_in(loop.key(key, "disturbance", name), k + 1),
        t,
        dt,
    )
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
    controlled: Controlled,
    u_previous: Scalar,
    input_gain: Scalar,
    l0: Scalar,
) -> Sample:
    """The signals of one channel at sample k, for metrics."""
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
    added: Signals | None = None,
) -> tuple[LoopState, Recorded]:
    """Advance the loop by sample k: measure, control, integrate.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        key: The draw's random key.
        state: The state at the sample.
        k: Index of the sample.
        advance: :func:`held_between_samples` of these parameters, computed before the time loop; None: computed here.
        added: Signals added to the commands of the channels, before the unmodelled dynamics.
    """
    advance = advance or held_between_samples(loop, params)
    dt = loop.sample_time
    t = k * dt
    references = loop.mimo_reference.at(params.reference, t)
    reaching = tuple(channel.reaching for channel in state.channels)
    condition = condition_at(loop.events, params.events, t, dt, loop.rotors)
    arriving_drive = plant_input(loop, params, state.disturbances, state.wind, state.plant, reaching, t, condition)
    measurements = measure(loop, params, state.plant, references, arriving_drive)
    values = signal_values(loop, params, state.plant, measurements, arriving_drive)
    signal_sensors, signals = read_signals(loop, params, key, state.signals, values, k)
    sensor_inputs = measurements_for_sensors(loop, params, state.plant, references, arriving_drive, measurements)
    gains = loop.mimo_plant.input_gain(params.plant)
    channels = []
    samples = []
    commands = []
    outputs = []
    for i, channel in enumerate(state.channels):
        reference = references[i]
        next_channel, controlled = control_channel(
            loop, params, key, channel, i, sensor_inputs[i], signals, reference, k
        )
        l0 = params.controller[i].l0
        error = tracking_error(measurements[i], reference, l0)
        samples.append(metric_sample(loop, k, error, reference, controlled, channel.u, gains[i], l0))
        command = controlled.command
        total = command.total if added is None else command.total + added[i]
        sampled = sampled_command(loop, params, key, channel.unmodelled, i, total, k)
        channels.append(next_channel._replace(unmodelled=sampled))
        commands.append(total)
        outputs.append(controlled)
    wind = loop.wind.step(params.wind, state.wind, jax.random.fold_in(loop.key(key, "wind"), k + 1), t, dt)
    held_commands = as_arrays(tuple(commands))
    sampled = tuple(channel.unmodelled for channel in channels)
    held_inputs = []
    for model, p, previous, name in zip(loop.inputs, params.inputs, state.inputs, loop.input_names, strict=True):
        held_inputs.append(model.step(p, previous, jax.random.fold_in(loop.key(key, "input", name), k + 1), t, dt))
    intermediate_state = LoopState(state.plant, wind, tuple(channels), tuple(held_inputs))

    def drive_at(plant: State, actuation: Signals, time: Scalar) -> PlantInput[Signals]:
        return plant_input(loop, params, intermediate_state.disturbances, wind, plant, actuation, time, condition)

    plant, unmodelled = advance(drive_at, state.plant, sampled, held_commands, t)
    plant, estimate = renewed_estimate(loop, params, key, plant, state.estimate, k + 1)
    drive = drive_at(state.plant, actuate(loop, params, sampled, held_commands), t)
    info = loop.mimo_plant.monitor(params.plant, state.plant, drive)
    arriving = actuate(loop, params, unmodelled, held_commands)
    for i, channel in enumerate(channels):
        channels[i] = channel._replace(unmodelled=unmodelled[i], reaching=arriving[i])
    next_state = as_arrays(LoopState(plant, wind, tuple(channels), intermediate_state.inputs, signal_sensors, estimate))
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
        controlled=tuple(outputs),
    )
