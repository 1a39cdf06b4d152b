"""A law of a number that the code of a user's part does not read is told; it follows from the program."""

import dssc_jax as dj
from dssc_jax.core.signals import Measurement
from dssc_jax.engine.unused_laws import unused_laws
from tests.design.test_plant_checks import TANK, Level

PLANT = "tests.engine.test_unused_laws"
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
LIMITING = reading(lambda params: 2.0 + 0.0 * (params.area > 1e6))
UNUSED = reading(lambda params: 2.0)


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
    assert unused_laws(study("USED")) == []
    assert unused_laws(study("UNUSED")) == ["plant.area"]
    assert unused_laws(study("LIMITING")) == []
    named = {"parameters": {"A": {"uniform": [1.0, 3.0]}}, "plant": {"kind": f"{PLANT}:UNUSED", "area": "=A"}}
    assert unused_laws(study("UNUSED", **named)) == ["parameters.A"]
    shared = named | {"controller": {"kind": "pid", "k_p": "=A"}}
    assert unused_laws(study("UNUSED", **shared)) == []


def test_parts_of_the_package_are_not_looked_at():
    assert unused_laws(dj.Study.load("motor")) == []
