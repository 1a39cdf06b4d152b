"""Derivatives of metrics by numbers at which the program has two branches, against differences."""

import jax
import pytest

import dssc_jax as dj

TABLE = {
    "name": "late",
    "draws": 1,
    "loop": {"duration": 1.0, "sample_time": 0.02},
    "plant": {"kind": "normal_form", "k_p": 1.0, "a_p": 1.0, "initial": [1.0, 0.0]},
    "controller": {"kind": "pid", "k_p": 6.0, "k_i": 2.0, "k_d": 3.0, "filter": 0.05},
}
STEP = 1e-6
CASES = [
    ({"unmodelled": {"kind": "delay", "samples": 2.0}}, "unmodelled.samples", 2.0),
    ({"actuator": [{"kind": "delay", "samples": 1.0}]}, "actuator.0.samples", 1.0),
    ({"disturbance": {"kind": "step", "value": 1.0, "at": 0.54}}, "disturbance.at", 0.54),
]


@pytest.mark.parametrize(("changes", "name", "value"), CASES)
def test_the_derivative_on_the_grid_of_samples_is_that_of_a_larger_number(changes, name, value):
    lane = dj.lane(dj.Study.from_table(TABLE | changes))
    numbers, index = lane.example

    def error_rms(x):
        return lane({**numbers, name: x}, index)["error_rms"]

    difference = (error_rms(value + STEP) - error_rms(value)) / STEP
    assert jax.jit(jax.grad(error_rms))(value) == pytest.approx(float(difference), rel=1e-3)
