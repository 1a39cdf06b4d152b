"""Flights of one axis with a PID, simulated by small steps without the package, and the study that analyses them."""

from typing import NamedTuple

import numpy as np

import dssc_jax as dj
from dssc_jax.flight_logs.reading.reader import Column, FlightLog

DT = 0.02
SAMPLES = 600
FINE = 20  # steps of integration in a sample
K_P, A_P = 1.1, 0.8
AMPLITUDES, FREQUENCIES, PHASES = (0.6, 0.3), (0.2, 0.55), (0.0, 0.5)
TIME = DT * np.arange(SAMPLES)


class Pid(NamedTuple):
    """Gains of the controller that flies, and the time constant of the derivative's filter."""

    k_p: float = 6.0
    k_i: float = 1.0
    k_d: float = 3.0
    filter: float = 0.02


PID = Pid()


class Axis(NamedTuple):
    """What flies: x'' = -A_P x' + K_P z + wind - drag x' |x'| - friction, with z the command, or behind a lag.

    Args:
        start: Place and speed at the start.
        actuator: Time constant of the actuator [s]; 0: there is none.
        drag: Force at a speed of 1.
        friction: Force of constant size against the speed.
        wind: Constant force.
        gust: Standard deviation of a gust of 0.5 s.
        noise: Standard deviation of the noise of y.
        step: Step to which y is rounded; 0: none.
        rate: Seconds in one second of the log's clock.
    """

    start: tuple[float, float] = (0.0, 0.0)
    actuator: float = 0.0
    drag: float = 0.0
    friction: float = 0.0
    wind: float = 0.0
    gust: float = 0.0
    noise: float = 0.002
    step: float = 0.0
    rate: float = 1.0


AXIS = Axis()


def reference(times):
    """The desired output, a sum of two sines."""
    total = 0.0
    for amplitude, frequency, phase in zip(AMPLITUDES, FREQUENCIES, PHASES, strict=True):
        total = total + amplitude * np.sin(2.0 * np.pi * frequency * times + phase)
    return total


def study_of(gains: Pid = PID, **changes):
    """The study of the axis with laws of both numbers."""
    table = {
        "name": "axis",
        "seed": 1,
        "loop": {"duration": DT * SAMPLES, "sample_time": DT},
        "plant": {
            "kind": "normal_form",
            "k_p": {"uniform": [0.5, 1.8]},
            "a_p": {"normal": [1.0, 0.25]},
            "initial": [0.0, 0.0],
        },
        "reference": {
            "kind": "multisine",
            "amplitudes": list(AMPLITUDES),
            "frequencies": list(FREQUENCIES),
            "phases": list(PHASES),
        },
        "controller": {"kind": "pid", **gains._asdict()},
    }
    return dj.Study.from_table({**table, **changes})


def fly(seed: int = 0, axis: Axis = AXIS, gains: Pid = PID, factor: float = 1.0, integral: float = 0.0) -> FlightLog:
    """The log of a flight: y, y', the reference and the command.

    Args:
        seed: Of noise and gusts.
        axis: What flies.
        gains: Gains of the controller.
        factor: By which all its commands are larger.
        integral: Integral part of its first command.
    """
    random = np.random.default_rng(seed)
    (y, v), thrust, gust = axis.start, 0.0, axis.gust * random.normal()
    derivative, before = 0.0, None
    step = DT * axis.rate / FINE
    decay = np.exp(-DT * axis.rate / 0.5)
    rows = []
    for time in TIME:
        reading = y + axis.noise * random.normal()
        if axis.step:
            reading = axis.step * round(reading / axis.step)
        desired = float(reference(axis.rate * time))
        change = 0.0 if before is None else before - reading
        derivative = (gains.filter * derivative + gains.k_d * change) / (gains.filter + DT)
        command = factor * (gains.k_p * (desired - reading) + integral + derivative)
        integral += DT * gains.k_i * (desired - reading)
        before = reading
        rows.append((reading, v + 0.005 * random.normal(), desired, command))
        for _ in range(FINE):
            thrust += (command - thrust) * (-np.expm1(-step / axis.actuator) if axis.actuator else 1.0)
            push = K_P * thrust + axis.wind + gust - axis.friction * np.tanh(v / 0.005)
            middle = v + 0.5 * step * (push - A_P * v - axis.drag * v * abs(v))
            y += step * middle
            v += step * (push - A_P * middle - axis.drag * middle * abs(middle))
        gust = decay * gust + axis.gust * np.sqrt(1.0 - decay**2) * random.normal()
    names = ("y", "y_dot", "y_ref", "u_total")
    columns = {name: Column(TIME, values) for name, values in zip(names, np.transpose(rows), strict=True)}
    return FlightLog("flight", columns, 0.0)


def with_command(log: FlightLog, scale: float = 1.0, offset: float = 0.0) -> FlightLog:
    """The log with another unit or an offset of its command."""
    command = log.columns["u_total"]
    changed = command._replace(value=scale * command.value + offset)
    return log._replace(columns=log.columns | {"u_total": changed})
