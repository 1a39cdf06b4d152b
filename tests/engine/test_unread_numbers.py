"""An uncertain number that the code of a user's part does not read is told; it follows from the program."""

from typing import Annotated, NamedTuple

import dssc_jax as dj
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement
from dssc_jax.engine.unread_numbers import unread_numbers
from dssc_jax.types import Sensor
from tests.design.test_plant_checks import TANK, Level

PLANT = "tests.engine.test_unread_numbers"
"""This module, whose plants the studies name."""


def reading(area):
    """A tank whose code reads its area, or another number."""

    def derivative(params, state, drive, t):
        return Level((drive.command - 0.3 * state.h**2) / area(params))

    return TANK._replace(
        derivative=derivative,
        measure=lambda params, state, drive: Measurement(state.h, derivative(params, state, drive, 0.0).h),
        inputs=None,
    )


USED = reading(lambda params: params.area)
USED_WITH_INPUTS = USED._replace(
    inputs=lambda params: (NamedSignal("leak", "m^3/s", "leak"), NamedSignal("rain", "m^3/s", "rain")),
)
LIMITING = reading(lambda params: 2.0 + 0.0 * (params.area > 1e6))
UNUSED = reading(lambda params: 2.0)


class Noise(NamedTuple):
    """A number of a sensor."""

    size: Annotated[float, Quantity("y", "size", at_least=0.0)] = 0.1


EXACT = Sensor(Noise, lambda p, m, key: (), lambda p, state, m, key, t, dt: (state, m))


def study(tank, **changes):
    return dj.Study.from_table(
        {
            "name": "tank",
            "loop": {"duration": 0.1, "sample_time": 0.01},
            "plant": {"kind": f"{PLANT}:{tank}", "area": {"uniform": [1.0, 3.0]}},
            "controller": {"kind": "pid", "k_p": {"uniform": [1.0, 2.0]}},
            **changes,
        }
    )


def test_what_no_result_depends_on_is_found():
    assert unread_numbers(study("USED")) == []
    assert unread_numbers(study("UNUSED")) == ["plant.area"]
    assert unread_numbers(study("LIMITING")) == []


def test_a_parameter_that_is_read_elsewhere_is_found():
    """The plant ignores A, which is the controller's gain, too."""
    parameters = {"A": {"uniform": [1.0, 3.0]}}
    pid = {"kind": "pid", "k_p": "=A"}
    for plant, found in {"UNUSED": ["plant.area"], "USED": []}.items():
        table = {"kind": f"{PLANT}:{plant}", "area": "=A"}
        assert unread_numbers(study(plant, parameters=parameters, plant=table, controller=pid)) == found


def test_uncertain_disturbances_at_several_inputs_are_no_numbers_of_the_plant():
    """Beside a plant of one channel; the second input is not read, which the plant's own checks tell."""
    disturbance = [{"kind": "constant", "value": {"uniform": [0.1, 0.2]}, "input": name} for name in ("leak", "rain")]
    assert unread_numbers(study("USED_WITH_INPUTS", disturbance=disturbance)) == []


def test_sensors_of_measured_signals_are_looked_at():
    sensor = {"measures": ["y"], "y": {"kind": f"{PLANT}:EXACT", "size": {"uniform": [0.1, 0.2]}}}
    assert unread_numbers(study("USED", sensor=sensor)) == ["sensor.y.size"]


def test_parts_of_the_package_are_not_looked_at():
    assert unread_numbers(dj.Study.load("motor")) == []
