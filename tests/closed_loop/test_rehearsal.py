"""Faults in parts that users wrote are told by the part, the function and the line."""

import inspect
import math
import re
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.closed_loop.repeatability import first_difference
from dssc_jax.core.errors import ConfigError
from dssc_jax.types import Command, Controller, Measurement, Plant, Sensor
from tests.conftest import UNCERTAIN

RANDOM = np.random.default_rng()


class Params(NamedTuple):
    """A pendulum has none."""


class Swing(NamedTuple):
    """Angle and rate."""

    angle: float
    rate: float


class Gains(NamedTuple):
    """The error's pole."""

    l0: float = 1.0


def derivative(params, state, drive, t):
    return Swing(state.rate, drive.command - jnp.sin(state.angle))


def misspelled(params, state, drive, t):
    return Swing(state.speed, 0.0)


def branching(params, state, drive, t):
    return Swing(state.rate, 0.0) if state.angle > 0.0 else Swing(0.0, 0.0)


def gusty(params, state, drive, t):
    return Swing(state.rate, drive.command - jnp.sin(state.angle) + RANDOM.normal())


def gusty_in_three_axes(params, state, drive, t):
    gust = jnp.dot(jnp.asarray(RANDOM.normal(size=3)), jnp.array([1.0, 2.0, 3.0]) * state.rate)
    return Swing(state.rate, drive.command - jnp.sin(state.angle) + gust)


def of_python(params, state, drive, t):
    return Swing(state.rate, -math.sin(state.angle))


PLANT = Plant(
    Params, lambda params: Swing(0.1, 0.0), derivative, lambda p, at, u: Measurement(at.angle, at.rate), lambda p: 1.0
)
CONTROLLER = Controller(
    Gains, lambda gains, seen, wanted: 0.0, lambda g, state, y, r, dt: (state, Command(-y.y, 0.0), ())
)

PLANTS = {
    "a name that is not there": (PLANT._replace(derivative=misspelled), "`derivative` fails in line .*'speed'"),
    "a Python branch": (PLANT._replace(derivative=branching), "`derivative` fails in line .*jnp.where"),
    "a function of math": (PLANT._replace(derivative=of_python), "`derivative` fails in line .*jax.numpy"),
    "a random number": (PLANT._replace(derivative=gusty), "`derivative` gives other values when the same call is"),
    "random numbers in an array": (
        PLANT._replace(derivative=gusty_in_three_axes),
        "`derivative` gives other values when the same call is repeated",
    ),
    "a plain tuple": (
        PLANT._replace(derivative=lambda p, at, u, t: (at.rate, at.angle)),
        r"`derivative` must return .* as Swing\(angle=number, rate=number\), got \(number, number\)",
    ),
    "an array": (
        PLANT._replace(derivative=lambda p, at, u, t: Swing(jnp.ones(2), at.rate)),
        r"got Swing\(angle=array of shape \(2,\), rate=number\)",
    ),
    "a measurement of one number": (
        PLANT._replace(measure=lambda p, at, u: at.angle),
        "`measure` must return .*got number",
    ),
    "a function of other arguments": (PLANT._replace(derivative=lambda p, at: at), "does not fit the loop: TypeError"),
    "a projection that loses the type": (
        PLANT._replace(project=lambda p, at: tuple(at)),
        "`project` must return the state",
    ),
}
CONTROLLERS = {
    "no info": (lambda g, state, y, r, dt: (state, Command(0.0, 0.0)), r"`step` must return \(state, command, info\)"),
    "a number as command": (lambda g, state, y, r, dt: (state, -y.y, ()), r"`step` must return the command as Command"),
    "another state": (
        lambda g, state, y, r, dt: ((state, state), Command(0.0, 0.0), ()),
        "`step` must return the state",
    ),
    "an info of one number": (lambda g, state, y, r, dt: (state, Command(0.0, 0.0), y.y), "must report a NamedTuple"),
}


def study(monkeypatch, **parts):
    """The study with these objects as its parts."""
    changes = {}
    for slot, part in parts.items():
        monkeypatch.setitem(globals(), slot.upper(), part)
        changes[slot] = {"kind": f"{__name__}:{slot.upper()}"}
    return dj.Study.from_table({**UNCERTAIN, "sweep": {}, **changes})


@pytest.mark.parametrize("fault", PLANTS)
def test_plants_function_is_named(fault, monkeypatch):
    plant, rule = PLANTS[fault]
    with pytest.raises(ConfigError, match=rule) as caught:
        study(monkeypatch, plant=plant, controller=CONTROLLER)
    assert "plant" in caught.value.where


def test_line_is_that_of_the_fault(monkeypatch):
    with pytest.raises(ConfigError) as caught:
        study(monkeypatch, plant=PLANT._replace(derivative=misspelled), controller=CONTROLLER)
    first = inspect.getsourcelines(misspelled)[1]
    assert re.search(rf"line {first + 1} of .*{re.escape(__name__.rpartition('.')[2])}\.py", caught.value.rule)


@pytest.mark.parametrize("fault", CONTROLLERS)
def test_controllers_function_is_named(fault, monkeypatch):
    step, rule = CONTROLLERS[fault]
    with pytest.raises(ConfigError, match=rule) as caught:
        study(monkeypatch, plant=PLANT, controller=CONTROLLER._replace(step=step))
    assert "controller" in caught.value.where


def without_state(reading):
    """A sensor whose step gives this reading of a measurement."""
    return Sensor(Params, lambda p, m, key: (), lambda p, state, m, key, t, dt: (state, reading(m)))


SENSORS = {
    "a random number": (without_state(lambda m: Measurement(m.y + RANDOM.normal(), m.y_dot)), "gives other values"),
    "a name that is not there": (
        without_state(lambda m: Measurement(m.nothing, 0.0)),
        "`step` fails in line .*nothing",
    ),
    "another state": (
        Sensor(Params, lambda p, m, key: m.y, lambda p, state, m, key, t, dt: ((state, state), m)),
        r"`step` must return the state as number, got \(number, number\)",
    ),
    "an array": (
        without_state(lambda m: Measurement(m.y * jnp.ones(3), m.y_dot)),
        r"`step` must return the reading as .* got Measurement\(y=array of shape \(3,\)",
    ),
    "no state": (
        Sensor(Params, lambda p, m, key: (), lambda p, state, m, key, t, dt: m.y),
        r"`step` must return \(state, reading\), got number",
    ),
}


@pytest.mark.parametrize("fault", SENSORS)
@pytest.mark.parametrize("place", ["sensor", "sensor.x1"])
def test_sensors_of_outputs_and_of_measured_signals_are_named(place, fault, monkeypatch):
    sensor, rule = SENSORS[fault]
    monkeypatch.setitem(globals(), "SENSOR", sensor)
    chosen = {"kind": f"{__name__}:SENSOR"}
    table = chosen if place == "sensor" else {"measures": ["x1"], "x1": chosen}
    with pytest.raises(ConfigError, match=rule) as caught:
        dj.Study.from_table({**UNCERTAIN, "sweep": {}, "differentiator": {"kind": "none"}, "sensor": table})
    assert re.search(rf"{re.escape(place)}$", caught.value.where)


class Low(NamedTuple):
    """A running minimum within a nested state."""

    peak: float
    low: tuple


@pytest.mark.parametrize("infinity", [math.inf, -math.inf, np.float64("nan"), (0.0, math.inf)])
def test_a_start_that_is_not_finite_is_refused_with_its_field(infinity, monkeypatch):
    def init(gains, seen, wanted):
        constant = jnp.asarray(infinity) if isinstance(infinity, tuple) else infinity
        return Low(seen.y, (0.0, constant))

    controller = CONTROLLER._replace(init=init, step=lambda g, state, y, r, dt: (state, Command(-y.y, 0.0), ()))
    with pytest.raises(ConfigError, match=r"`init` starts low\.1 at ") as caught:
        study(monkeypatch, plant=PLANT, controller=controller)
    assert caught.value.where.endswith("controller")
    plant = PLANT._replace(init=lambda params: Swing(0.1, -jnp.inf))
    with pytest.raises(ConfigError, match=r"plant: `init` starts rate at -inf"):
        study(monkeypatch, plant=plant, controller=CONTROLLER)


def relu(params, state, drive, t):
    bounded = jax.custom_jvp(lambda x: jnp.minimum(x, 2.0))
    bounded.defjvp(lambda primals, tangents: (bounded(*primals), tangents[0]))
    return Swing(state.rate, bounded(jax.nn.relu(drive.command)) - jnp.sin(state.angle))


@pytest.mark.parametrize("slopes", [derivative, relu])
def test_parts_without_fault_pass(slopes, monkeypatch):
    plant = PLANT._replace(derivative=slopes)
    assert study(monkeypatch, plant=plant, controller=CONTROLLER).loop.plant is plant


@pytest.mark.parametrize("slopes", [gusty, gusty_in_three_axes])
def test_only_the_part_that_is_not_pure_is_named(slopes, monkeypatch):
    with pytest.raises(ConfigError) as caught:
        study(monkeypatch, plant=PLANT._replace(derivative=slopes), controller=CONTROLLER)
    assert "plant" in caught.value.where
    assert "controller" not in caught.value.where


def test_values_of_an_enclosing_trace_are_no_difference():
    """As where a recorded reference is an argument of the program that rehearses the loop."""

    def enclosing(x):
        record = x * jnp.arange(3.0)
        assert first_difference(lambda: lambda: jnp.dot(record, jnp.ones(3))) is None
        return x

    jax.jit(enclosing)(1.0)


def test_keys_of_random_numbers_are_compared():
    """A key that a user's module holds is the same in both traces; one that is drawn anew is not."""
    key = jax.random.key(7)
    assert first_difference(lambda: lambda: jax.random.normal(key)) is None
    assert first_difference(lambda: lambda: jax.random.normal(jax.random.key(RANDOM.integers(1 << 30)))) is not None
