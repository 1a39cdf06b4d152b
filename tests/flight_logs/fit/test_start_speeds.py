"""Flights that begin with another speed than the study: place and speed are proposed, and no other fault is one."""

from types import SimpleNamespace

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import FitRefused
from dssc_jax.flight_logs.fit.start_speeds import shifted_residual
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

TIME = DT * np.arange(400)
TOLD = "y begins with a speed of "


@pytest.fixture(scope="module")
def predictions():
    """Compiled predictions, which all flights share."""
    return {}


def said(y, u, predictions):
    """All that a fit says."""
    try:
        return [doubt.text for doubt in fit_log(linear(), log_of(y, u), predictions=predictions).doubts]
    except FitRefused as refusal:
        return str(refusal).split(". ")


@pytest.mark.parametrize("begin", [(0.5, 0.6), (0.5, -0.2), (0.8, 0.4)])
def test_place_and_speed_are_proposed(predictions, begin):
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    y = output(1.1, 0.8, u, begin) + 0.005 * random.normal(size=400)
    texts = said(y, u, predictions)
    (text,) = [text for text in texts if text.startswith(TOLD)]
    speed, deviation = float(text.split()[6]), float(text.split()[8])
    assert abs(speed - begin[1]) < 4.0 * deviation
    assert deviation < 0.02
    proposal = " ".join(texts).partition("Set plant.initial = [")[2].partition("]")[0]
    np.testing.assert_allclose([float(part) for part in proposal.split(", ")], begin, atol=0.03)
    assert not any(text.startswith("y begins at ") for text in texts)


@pytest.mark.parametrize(
    "fault",
    [
        np.zeros(400),
        0.045 * np.sin(2.0 * np.pi * TIME / 3.0),
        np.cumsum(0.01 * np.random.default_rng(1).normal(size=400)),
        0.3 * (TIME > 4.0),
    ],
)
def test_another_fault_is_no_speed(predictions, fault):
    """A wave, a drift and a jump of the output, and none."""
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    y = output(1.1, 0.8, u) + 0.005 * random.normal(size=400) + fault
    assert not any(text.startswith(TOLD) for text in said(y, u, predictions))


def test_a_shift_in_time_explains_what_the_predicted_rate_does():
    """Half a sample late; the numbers of a fit take a part. A speed that decays is no shift."""
    noise = 0.002 * np.random.default_rng(8).normal(size=400)
    predicted = np.sin(2.0 * TIME) + 0.3 * TIME
    slope = TIME * predicted
    late = -0.5 * DT * np.gradient(predicted, TIME) + 0.01 * slope + noise
    decaying = 0.1 * (1.0 - np.exp(-TIME / 2.0)) + noise
    residuals = []
    for residual in (late, decaying):
        readings = SimpleNamespace(times=TIME, values=predicted + residual)
        columns = np.column_stack([residual, slope, np.ones(400)])  # the third number is kept by its law
        problem = SimpleNamespace(readings=[readings], columns=lambda x, rows=columns: [rows], fitted=[0])
        residuals.append(shifted_residual(problem, SimpleNamespace(x=np.zeros(2))))
    assert residuals[0] < 1.1 * np.std(noise)
    assert residuals[1] > 5.0 * np.std(noise)
