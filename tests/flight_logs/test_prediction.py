"""The prediction of logged outputs in its two forms: XLA's program and the lanes' code."""

import numpy as np

import dssc_jax as dj
from dssc_jax.flight_logs.prediction import prediction, prediction_by_lanes


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
