"""The measured signals beside y and y': true values, and readings of their sensors."""

import jax

from dssc_jax.closed_loop.control import is_angle, unwrap
from dssc_jax.closed_loop.loop import Loop, LoopParams, signal_name
from dssc_jax.core.named import signals_in
from dssc_jax.core.signals import Measurement, Measurements, PlantInput, Scalar, Signals, State

STATE = "x"
"""Letter before the number of a plant's state in its name: the first state is x1."""


def has_measured_angle(loop: Loop, i: int) -> bool:
    """Whether the output y of channel i is an angle, and the study also declares this output as a measured signal."""
    output = signal_name(loop.channels[i], "y")
    return is_angle(loop, i) and output in [signal.name for signal in loop.measures]


def continuous_outputs(loop: Loop, measurements: Measurements, previous: Signals | tuple[State, ...]) -> Measurements:
    """The plant's outputs, with each measured angle shifted by whole turns to lie within pi of its previous value.

    The sensor of such an angle therefore sees no jump by a whole turn.

    Args:
        loop: The models and the clock.
        measurements: The plant's outputs.
        previous: For each channel with a measured angle, the angle at the previous sample [rad]; the elements of other
            channels are not read.
    """
    outputs = []
    for i, measurement in enumerate(measurements):
        outputs.append(unwrap(loop, i, measurement, previous[i]) if has_measured_angle(loop, i) else measurement)
    return tuple(outputs)


def signal_values(
    loop: Loop, params: LoopParams, plant: State, measurements: Measurements, drive: PlantInput[Signals]
) -> Signals:
    """True values of the measured signals, in their order.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        plant: The plant's state.
        measurements: The plant's outputs; an angle from :func:`continuous_outputs`.
        drive: The plant's input just before the sample, so that a signal with feedthrough shows the last command.
    """
    if not loop.measures:
        return ()
    values: dict[str, Scalar] = {}
    for channel, measurement in zip(loop.channels, measurements, strict=True):
        values[signal_name(channel, "y")] = measurement.y
        values[signal_name(channel, "y_dot")] = measurement.y_dot
    for number, leaf in enumerate(jax.tree.leaves(plant), start=1):
        values[f"{STATE}{number}"] = leaf
    values |= signals_in(loop.mimo_plant.monitor(params.plant, plant, drive))
    return tuple(values[signal.name] for signal in loop.measures)


def first_readings(
    loop: Loop, params: LoopParams, key: jax.Array, values: Signals
) -> tuple[tuple[State, ...], Signals]:
    """States of the signals' sensors before the first sample, and the sensors' readings at the first sample.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        values: True values of the signals at t = 0.
    """
    states = []
    for i, signal in enumerate(loop.measures):
        first_key = loop.key_at(key, "signal", signal.name, 0)
        exact = Measurement(values[i], y_dot=0.0)  # the sensor of a signal reads one value: no y'
        states.append(loop.signal_sensor[i].init(params.signal_sensor[i], exact, first_key))
    _, readings = read_signals(loop, params, key, tuple(states), values, k=0)
    return tuple(states), readings


def read_signals(
    loop: Loop, params: LoopParams, key: jax.Array, states: tuple[State, ...], values: Signals, k: Scalar
) -> tuple[tuple[State, ...], Signals]:
    """States of the signals' sensors after sample k, and the sensors' readings at sample k.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        states: States of the sensors before the sample.
        values: True values of the signals.
        k: Index of the sample.
    """
    dt = loop.sample_time
    next_states = []
    readings = []
    for i, signal in enumerate(loop.measures):
        sample_key = loop.key_at(key, "signal", signal.name, k + 1)
        exact = Measurement(values[i], y_dot=0.0)
        state, reading = loop.signal_sensor[i].step(params.signal_sensor[i], states[i], exact, sample_key, k * dt, dt)
        next_states.append(state)
        readings.append(reading.y)
    return tuple(next_states), tuple(readings)
