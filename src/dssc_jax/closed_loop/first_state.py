"""The loop's state before the first sample of a draw: plant, sensors, flight computers, disturbances and wind."""

import jax

from dssc_jax.closed_loop.beginning import begin_controller, begin_plant
from dssc_jax.closed_loop.control import initial_control, is_angle, measure, principal_value
from dssc_jax.closed_loop.estimates import measurements_for_sensors, start_estimate
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.plant_inputs import actuate, plant_input
from dssc_jax.closed_loop.readings import continuous_outputs, first_readings, has_measured_angle, signal_values
from dssc_jax.closed_loop.sample import ChannelState, LoopState
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import Measurements, State


def initial_state(loop: Loop, params: LoopParams, key: jax.Array) -> LoopState:
    """The loop's state before the first sample.

    The command before t = 0 is 0, and the unmodelled dynamics are at rest under this command.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
    """
    true_plant = begin_plant(loop, params, key)
    references = loop.mimo_reference.at(params.reference, 0.0)
    at_rest = tuple(model.init(p) for model, p in zip(loop.unmodelled, params.unmodelled, strict=True))
    reaching = actuate(loop, params, at_rest, (0.0,) * len(loop.channels))
    wind = loop.wind.init(params.wind, loop.key_at(key, "wind", "", 0))
    disturbances, inputs = initial_disturbances(loop, params, key)
    condition = loop.condition(params, 0.0)
    drive = plant_input(loop, params, (*disturbances, *inputs), wind, true_plant, reaching, 0.0, condition)
    exact = measure(loop, params, true_plant, references, drive)
    plant, estimate = start_estimate(loop, params, key, true_plant)
    measurements = measurements_for_sensors(loop, params, plant, references, drive, exact)
    sensors, channel_readings = first_channel_readings(loop, params, key, measurements)
    # a measured angle begins in the turn of its channel's reading, so that a controller of both sees one angle
    outputs = continuous_outputs(loop, exact, tuple(reading.y for reading in channel_readings))
    values = signal_values(loop, params, true_plant, outputs, drive)
    signal_sensors, signals = first_readings(loop, params, key, values)
    channels = []
    for i in range(len(loop.channels)):
        wrapped_reading = channel_readings[i]._replace(signals=signals)
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
    return as_arrays(LoopState(plant, wind, tuple(channels), inputs, signal_sensors, estimate))


def initial_disturbances(loop: Loop, params: LoopParams, key: jax.Array) -> tuple[tuple[State, ...], tuple[State, ...]]:
    """States at t = 0 of the disturbances of each channel, and of the disturbances at each named input of the plant.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
    """
    disturbances = []
    for model, p, name in zip(loop.disturbance, params.disturbance, loop.channels, strict=True):
        disturbances.append(model.init(p, loop.key_at(key, "disturbance", name, 0)))
    inputs = []
    for model, p, name in zip(loop.inputs, params.inputs, loop.input_names, strict=True):
        inputs.append(model.init(p, loop.key_at(key, "input", name, 0)))
    return tuple(disturbances), tuple(inputs)


def first_channel_readings(
    loop: Loop, params: LoopParams, key: jax.Array, measurements: Measurements
) -> tuple[tuple[State, ...], Measurements]:
    """State of each channel's sensor before the first sample, and the sensor's reading at that sample.

    A controller starts from this reading, and not from the plant's output. An angle is in (-pi, pi].

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        measurements: The plant's outputs at t = 0, true or estimated.
    """
    sensors = []
    readings = []
    for i, name in enumerate(loop.channels):
        sensor = loop.sensor[i].init(params.sensor[i], measurements[i], loop.key_at(key, "sensor", name, 0))
        first_key = loop.key_at(key, "sensor", name, 1)  # as at sample 0 of the time loop
        _, reading = loop.sensor[i].step(params.sensor[i], sensor, measurements[i], first_key, 0.0, loop.sample_time)
        sensors.append(sensor)
        readings.append(principal_value(loop, i, reading))
    return tuple(sensors), tuple(readings)
