"""Recorded disturbances and winds whose values lie off the grid of samples, or closer together than the steps."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.design.fast_records import record_warnings
from tests.exponentials import exponential

T_S = 0.1
SAMPLES = 30
TABLE = {
    "name": "load",
    "draws": 1,
    "loop": {"duration": SAMPLES * T_S, "sample_time": T_S, "substeps": 8},
    "plant": {"kind": "normal_form", "k_p": 1.0, "a_p": 1.0},
    "controller": {"kind": "state_feedback", "k_1": 4.0, "k_2": 1.5},
}
COARSE = {"time": [0.0, 0.33, 0.71, 1.234, 2.0], "value": [1.0, -1.0, 2.0, 0.0, 0.5]}
FAST = {"time": (np.arange(61) * T_S / 2).tolist(), "value": np.resize([1.0, -1.0], 61).tolist()}


def study_with(record, rule, **changes):
    return dj.Study.from_table(TABLE | {"disturbance": {"kind": "record", "interpolation": rule, **record}} | changes)


def exact_outputs(record, steps=100):
    """y at the samples, by a matrix exponential for each of many steps with the record held over each."""
    held = exponential(np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 0.0]]) * T_S / steps)
    x, outputs = np.zeros(2), []
    for sample in range(SAMPLES):
        outputs.append(x[0])
        command = -4.0 * x[0] - 1.5 * x[1]
        for step in range(steps):
            t = (sample + (step + 0.5) / steps) * T_S
            d = record["value"][np.searchsorted(record["time"], t, side="right") - 1]
            x = (held @ [*x, command + d])[:2]
    return np.array(outputs)


@pytest.mark.parametrize(("record", "bound"), [(COARSE, 2.5e-3), (FAST, 1.5e-2)])
def test_a_held_record_acts_through_its_mean(record, bound):
    """What remains is what moves within a sample: with the value at the sample, 0.037 and 0.27."""
    outputs = dj.simulate(study_with(record, "hold"))["y"].values[:SAMPLES]
    np.testing.assert_allclose(outputs, exact_outputs(record), atol=bound)


def test_a_record_finer_than_the_samples_or_steps_gives_a_warning():
    assert record_warnings(study_with(COARSE, "hold")) == []
    assert "0.05 s apart, closer than T_s = 0.1 s" in record_warnings(study_with(FAST, "hold"))[0]
    assert record_warnings(study_with(FAST, "linear")) == []
    coarse_steps = {"loop": TABLE["loop"] | {"substeps": 1}}
    assert (
        "closer than the steps of integration, 0.1 s" in record_warnings(study_with(FAST, "linear", **coarse_steps))[0]
    )
    on_grid = {"time": (np.arange(61) * T_S).tolist(), "value": FAST["value"]}
    assert record_warnings(study_with(on_grid, "linear", **coarse_steps)) == []
    assert record_warnings(study_with(on_grid, "hold")) == []


def test_a_held_wind_acts_through_its_mean():
    """As a wind in a table does, whose rows are the record's."""
    table = {key: TABLE[key] for key in ("name", "draws")}
    table |= {"loop": {"duration": 1.0, "sample_time": 0.02}, "plant": {"kind": "uav"}}
    table |= {"controller": {"kind": "pid", "k_p": 1.0}}
    times, still = [0.0, 0.105, 0.333], [0.0, 0.0, 0.0]
    rows = {"x": [0.0, 5.0, -3.0], "y": still, "z": still}
    held = {"kind": "record", "interpolation": "hold", "time": times, **rows}
    winds = (held, {"kind": "piecewise", "times": times, **rows})
    outputs = [dj.simulate(dj.Study.from_table(table | {"wind": wind}))["x_y"] for wind in winds]
    np.testing.assert_allclose(*outputs, atol=1e-12)
    assert np.abs(outputs[0]).max() > 1e-4
