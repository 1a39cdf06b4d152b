"""The measured signals beside y and y': their true values, and what their sensors show."""

import jax

from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.named import signals_in
from dssc_jax.core.signals import Measurement, Measurements, PlantInput, Scalar, Signals, State

STATE = "x"
"""The name of the first state is this and 1, and so on."""


def signal_values(
    loop: Loop, params: LoopParams, plant: State, measurements: Measurements, drive: PlantInput[Signals]
) -> Signals:
    """True values of the measured signals.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        plant: The plant's state.
        measurements: Its measurements.
        drive: Its input just before the sample: so a signal through which the command passes shows the last command.
    """
    if not loop.measures:
        return ()
    values: dict[str, Scalar] = {}
    for channel, measurement in zip(loop.channels, measurements, strict=True):
        prefix = f"{channel}_" if channel else ""
        values |= {f"{prefix}y": measurement.y, f"{prefix}y_dot": measurement.y_dot}
    values |= {f"{STATE}{i}": leaf for i, leaf in enumerate(jax.tree.leaves(plant), start=1)}
    values |= signals_in(loop.mimo_plant.monitor(params.plant, plant, drive))
    return tuple(values[signal.name] for signal in loop.measures)


def first_readings(
    loop: Loop, params: LoopParams, key: jax.Array, values: Signals
) -> tuple[tuple[State, ...], Signals]:
    """States of the sensors before the first sample, and what they will show there."""
    states = []
    for i, signal in enumerate(loop.measures):
        first = jax.random.fold_in(loop.key(key, "signal", signal.name), 0)
        states.append(loop.signal_sensor[i].init(params.signal_sensor[i], Measurement(values[i], 0.0), first))
    return tuple(states), read_signals(loop, params, key, tuple(states), values, 0)[1]


def read_signals(
    loop: Loop, params: LoopParams, key: jax.Array, states: tuple[State, ...], values: Signals, k: Scalar
) -> tuple[tuple[State, ...], Signals]:
    """States of the sensors after sample k, and what they show at it."""
    dt = loop.sample_time
    next_states = []
    readings = []
    for i, signal in enumerate(loop.measures):
        stream = jax.random.fold_in(loop.key(key, "signal", signal.name), k + 1)
        true = Measurement(values[i], 0.0)
        state, reading = loop.signal_sensor[i].step(params.signal_sensor[i], states[i], true, stream, k * dt, dt)
        next_states.append(state)
        readings.append(reading.y)
    return tuple(next_states), tuple(readings)
