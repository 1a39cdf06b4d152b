"""One sample of the closed loop for one draw: measure, control, integrate plant and unmodelled dynamics."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.closed_loop.between_samples.held_parts import Advance, HeldParts
from dssc_jax.closed_loop.between_samples.hold import between_samples
from dssc_jax.closed_loop.control import (
    ControlResult,
    ControlState,
    control,
    is_angle,
    measure,
    principal_value,
    unwrap,
)
from dssc_jax.closed_loop.estimates import measurements_for_sensors, next_estimate
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.metrics.instants import Instant, Sample
from dssc_jax.closed_loop.plant_inputs import actuate, plant_input, receive_command
from dssc_jax.closed_loop.readings import (
    continuous_outputs,
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

FAR_BELOW = 1e-4
"""A state has diverged if its sum exceeds the root of the largest number times this factor.

The factor leaves room for large numbers that cancel in the sum.
"""


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
        signal: The last value of the output as a measured signal, continuous in time [rad]; () if the output is no
            angle, or is no measured signal.
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
        """States of all disturbances: one of each channel, then one of each named input."""
        of_channels = tuple(channel.disturbance for channel in self.channels)
        return (*of_channels, *self.inputs)


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


def held_parts(loop: Loop) -> HeldParts:
    """The parts of a loop that move between two samples, while the commands are held."""
    return HeldParts(
        plant=loop.mimo_plant,
        unmodelled=loop.unmodelled,
        variations=tuple(model.variation for model in (*loop.disturbance, *loop.inputs)),
        integrator=loop.integrator,
        sample_time=loop.sample_time,
        substeps=loop.substeps,
    )


def held_between_samples(loop: Loop, params: LoopParams) -> Advance:
    """Return the function that advances plant and unmodelled dynamics by a sample.

    Call ``held_between_samples`` before the time loop, so that matrices of exact solutions are computed once for a
    draw.
    """
    return between_samples(held_parts(loop), params.plant, params.unmodelled)


def all_finite(state: LoopState) -> Scalar:
    """Whether the loop's state has not diverged: its numbers have a sum so small that squares of signals stay finite.

    One sum costs less than a test of each number, and an infinite or NaN number makes the sum infinite or NaN. Words of
    memory, such as those of a controller in C, are no numbers and are left out. The commands that reach the plant are
    left out because they follow from other states.
    """
    state = state._replace(channels=tuple(channel._replace(reaching=0.0) for channel in state.channels))
    largest = float(jnp.finfo(jnp.result_type(float)).max)
    real_leaves = [leaf for leaf in jax.tree.leaves(state) if not is_word(leaf)]
    numbers = [jnp.sum(leaf) if jnp.ndim(leaf) else leaf for leaf in real_leaves]
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
        params: Parameters of the models.
        key: The draw's random key.
        channel: The channel's state before the sample.
        i: Index of the channel.
        measurement: The plant's output.
        signals: Readings of the measured signals.
        reference: The desired output.
        k: Index of the sample.

    Returns:
        The channel's next state, in which the unmodelled dynamics are not yet advanced, and the inputs and outputs of
        the channel's flight computer.
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
        u_previous: The robust command of the previous sample; not read at sample 0.
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
        e_dot=error.sigma - l0 * error.e,  # sigma = e' + l_0 e (10)
        y_measured=controlled.sensed.y,
        y_dot_measured=controlled.sensed.y_dot,
    )


def next_input_states(
    loop: Loop, params: LoopParams, key: jax.Array, states: tuple[State, ...], k: Scalar, t: Scalar
) -> tuple[State, ...]:
    """States of the disturbances at the plant's named inputs after sample k.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        states: States of these disturbances before the sample.
        k: Index of the sample.
        t: Time of the sample [s].
    """
    next_states = []
    for i, name in enumerate(loop.input_names):
        input_key = loop.key_at(key, "input", name, k + 1)
        next_states.append(loop.inputs[i].step(params.inputs[i], states[i], input_key, t, loop.sample_time))
    return tuple(next_states)


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
        params: Parameters of the models.
        key: The draw's random key.
        state: The state at the sample.
        k: Index of the sample.
        advance: Result of :func:`held_between_samples`, from before the time loop; None: computed here.
        additions: Signals that are added to the commands of the channels, before the unmodelled dynamics; None: nothing
            is added.

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
    inputs = next_input_states(loop, params, key, state.inputs, k, t)
    disturbances = (*(channel.disturbance for channel in channels), *inputs)

    def drive_at(plant: State, actuation: Signals, time: Scalar) -> PlantInput[Signals]:
        """The plant's input at a time within the sample.

        Args:
            plant: The plant's state at that time.
            actuation: The command of each channel that reaches the plant at that time.
            time: The time [s].
        """
        return plant_input(loop, params, disturbances, wind, plant, actuation, time, condition)

    plant, next_unmodelled = advance(drive_at, state.plant, unmodelled_states, held_commands, t)
    plant, estimate = next_estimate(loop, params, key, plant, state.estimate, k + 1)
    drive = drive_at(state.plant, actuate(loop, params, unmodelled_states, held_commands), t)
    info = loop.mimo_plant.monitor(params.plant, state.plant, drive)
    reaching = actuate(loop, params, next_unmodelled, held_commands)
    for i, channel in enumerate(channels):
        signal = outputs[i].y if has_measured_angle(loop, i) else ()
        channels[i] = channel._replace(unmodelled=next_unmodelled[i], reaching=reaching[i], signal=signal)
    next_state = as_arrays(LoopState(plant, wind, tuple(channels), inputs, signal_sensors, estimate))
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
