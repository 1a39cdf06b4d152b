"""Outputs behind a low pass that the study lacks: told with its time constant, and what it is, where a log shows it."""

import re

import numpy as np
import pytest
from scipy import signal

from dssc_jax.flight_logs.fit.filtered_outputs import filtered, lies_behind_rate
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.fitted_numbers import numbers_to_fit
from dssc_jax.flight_logs.fit.missing_parts import FILTERED_OUTPUT, lacking_parts
from dssc_jax.flight_logs.fit.reading_noise import reading_noise
from dssc_jax.flight_logs.reading.reader import Column
from tests.flight_logs.fit.test_fit import DT, linear, log_of

FINE = 20  # steps of integration in a sample
K_P, A_P = 1.1, 0.8
LAG = 0.05
PLANT = {"kind": "normal_form", "k_p": {"uniform": [0.5, 1.5]}, "a_p": {"normal": [1.0, 0.2]}}


def flight(seed, speed=0.0, lags=(LAG, LAG), actuator=0.0):
    """The log of x'' = -A_P x' + K_P z by small steps, with white noise; z is the command, or behind a lag.

    Args:
        seed: Of command and noise.
        speed: Speed at the start.
        lags: Time constants of the low passes of y and of y' [s]; 0: there is none.
        actuator: Time constant of the actuator [s]; 0: there is none.
    """
    random = np.random.default_rng(seed)
    u = np.repeat(random.normal(size=40), 10)
    step = DT / FINE
    true = np.array([0.5, speed])
    shown = true.copy()
    thrust = 0.0
    shares = np.array([-np.expm1(-step / lag) if lag else 1.0 for lag in lags])
    rows = []
    for command in u:
        rows.append(shown.copy())
        for _ in range(FINE):
            thrust += (command - thrust) * (-np.expm1(-step / actuator) if actuator else 1.0)
            middle = true[1] + 0.5 * step * (K_P * thrust - A_P * true[1])
            true = true + step * np.array([middle, K_P * thrust - A_P * middle])
            shown += shares * (true - shown)
    y, y_dot = np.transpose(rows) + np.array([[0.001], [0.002]]) * random.normal(size=(2, len(u)))
    log = log_of(y, u)
    return log._replace(columns=log.columns | {"y_dot": Column(log.columns["y"].time, y_dot)})


def study_at(speed, **changes):
    """A study that begins with a speed."""
    return linear(plant={**PLANT, "initial": [0.5, speed]}, **changes)


def told(log, speed=0.0, **changes):
    """The code and the text of the part that a fit tells; no delay is told beside it."""
    doubts = fit_log(study_at(speed, **changes), log).doubts
    assert not any(doubt.code.startswith("delayed") for doubt in doubts)
    (doubt,) = [doubt for doubt in doubts if "would explain part of the residual of y" in doubt.text]
    return doubt.code, doubt.text


def size_in(text, words):
    """The number behind some words [s]."""
    return float(re.search(f"{words} of (\\S+) s", text)[1])


def test_a_lag_of_the_sensor_is_told_on_a_flight_that_begins_at_speed():
    code, text = told(flight(2, speed=0.8), speed=0.8)
    assert code == "filtered-output"
    assert size_in(text, "lag of the sensor") == pytest.approx(LAG, abs=0.002)
    assert 'Give the study that lag with a law (sensor, kind = "lag")' in text
    assert "lag of the actuator" not in text


def test_a_lag_of_the_actuator_is_none_of_the_sensor_on_such_a_flight():
    code, text = told(flight(2, speed=0.8, lags=(0.0, 0.0), actuator=LAG), speed=0.8)
    assert code == "missing-lag"
    assert "lag of the sensor" not in text


@pytest.mark.parametrize(("lags", "actuator"), [((LAG, LAG), 0.0), ((0.0, 0.0), LAG)])
def test_from_rest_both_lags_are_told(lags, actuator):
    """They give the same output, and the same y'."""
    code, text = told(flight(2, lags=lags, actuator=actuator))
    assert code == "missing-lag"
    for words in ("lag of the actuator", "lag of the sensor"):
        assert size_in(text, words) == pytest.approx(LAG, abs=0.002)
    assert "explains it equally well" in text
    assert "This flight does not tell which of the two lags it is" in text
    assert 'For the other one: Give the study that lag with a law (sensor, kind = "lag")' in text


def test_a_low_pass_of_the_output_alone_is_told_by_the_logged_derivative():
    code, text = told(flight(2, lags=(LAG, 0.0)))
    assert code == "filtered-output"
    assert size_in(text, "a low pass of y alone") == pytest.approx(LAG, abs=0.002)
    assert "lies as much behind the integral of the logged y_dot" in text
    assert "lag of the" not in text


def test_a_study_with_the_lag_estimates_it():
    study = study_at(0.8, sensor={"kind": "lag", "mu": {"uniform": [0.02, 0.2]}})
    assert "sensor.mu" in numbers_to_fit(study, ())
    fitted = fit_log(study, flight(2, speed=0.8))
    assert fitted.doubts == ()
    for estimate, deviation, truth in zip(fitted.estimates, fitted.deviations, (K_P, A_P, LAG), strict=True):
        assert abs(estimate - truth) < 4.0 * deviation
        assert deviation < 0.02 * truth


def test_a_study_with_the_lag_lacks_none_and_has_no_noise_by_it():
    study = study_at(0.0, sensor={"kind": "lag", "mu": LAG})
    assert FILTERED_OUTPUT in lacking_parts(linear())
    assert FILTERED_OUTPUT not in lacking_parts(study)
    assert reading_noise(study, np.random.default_rng(0).normal(size=(1, 400))) == (0.0,)


def test_the_filter_is_the_lag_of_lines_between_samples():
    values = np.random.default_rng(1).normal(size=50)
    times = np.arange(50.0)
    _, exact, _ = signal.lsim(([1.0], [3.0, 1.0]), values - values[0], times)
    np.testing.assert_allclose(filtered(values, 3.0), values[0] + exact, atol=1e-12)
    np.testing.assert_allclose(filtered(values, 1e-3), values, atol=0.01)


def test_an_output_lies_behind_its_rate_only_where_the_log_has_one():
    rows = DT * np.arange(400)
    integral, rate = np.sin(2.0 * rows), 2.0 * np.cos(2.0 * rows) + np.cos(7.0 * rows)
    integral = integral + np.sin(7.0 * rows) / 7.0
    behind = filtered(integral, LAG / DT)
    assert lies_behind_rate({"y": behind, "y_dot": rate}, LAG / DT)
    assert not lies_behind_rate({"y": integral, "y_dot": rate}, LAG / DT)
    assert not lies_behind_rate({"y": behind}, LAG / DT)
    assert not lies_behind_rate({"y": behind, "y_dot": np.where(rows < 1.0, np.nan, rate)}, LAG / DT)
