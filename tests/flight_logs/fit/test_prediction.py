"""The prediction of logged outputs in its two forms: XLA's program and the lanes' code."""

import numpy as np

import dssc_jax as dj
from dssc_jax.flight_logs.fit.prediction import prediction, prediction_by_lanes


def test_lanes_predict_outputs_and_derivatives_of_xla():
    """Outputs and derivatives by each number agree to rounding for random commands."""
    study = dj.Study.load("motor")
    names = list(study.laws)[:3]
    values = np.array([float(study.laws[name].median) for name in names])
    commands = np.random.default_rng(0).normal(size=(1, 50))
    expected = prediction(study, names, 50)(values, commands)
    found = prediction_by_lanes(study, names, 50)(values, commands)
    for right, left in zip(expected, found, strict=True):
        assert np.abs(right).max() > 0.0
        np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-12)


def test_a_vehicle_that_hovers_exactly_has_derivatives():
    """Commands that are 0 to the last bit: the derivative by the mass is that of central differences."""
    table = {
        "name": "hover",
        "draws": 1,
        "loop": {"duration": 0.2, "sample_time": 0.02, "substeps": 16},
        "plant": {
            "kind": "uav",
            "vehicle": {"kind": "x500", "mass": {"uniform": [2.0, 2.2]}},
            "believed": {"mass": 2.1},
            "inner_loop": {"kind": "px4"},
        },
        "reference": {"kind": "zero"},
        "controller": {"kind": "pid", "k_p": 1.0},
    }
    study = dj.Study.from_table(table)
    predict = prediction(study, ["plant.vehicle.mass"], 10)
    commands = np.zeros((4, 10))
    step = 1e-5
    _, slopes = predict(np.array([2.1]), commands)
    above, _ = predict(np.array([2.1 + step]), commands)
    below, _ = predict(np.array([2.1 - step]), commands)
    difference = (above - below) / (2.0 * step)
    assert np.abs(slopes[0, 2]).max() > 1e-3
    np.testing.assert_allclose(slopes[0], difference, atol=1e-6)
