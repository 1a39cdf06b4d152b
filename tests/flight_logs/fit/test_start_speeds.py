"""Flights that begin with another speed than the study: place and speed are proposed, and no other fault is one."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import FitRefused
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


@pytest.mark.parametrize("samples", [0.5, 3.0])
def test_a_late_output_is_no_speed(predictions, samples):
    """Half a sample, too, which is less than what the search for delays can tell."""
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=20), 20)
    y = np.interp(TIME - samples * DT, TIME, output(1.1, 0.8, u)) + 0.002 * random.normal(size=400)
    assert not any(text.startswith(TOLD) for text in said(y, u, predictions))
