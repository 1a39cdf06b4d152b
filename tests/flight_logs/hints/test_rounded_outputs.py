"""Outputs that are rounded by more than their noise: what is told, what is not, and which warnings are left out."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.outliers import outlier_doubts, outliers
from dssc_jax.flight_logs.hints.integrals import jumps_beside
from dssc_jax.flight_logs.hints.rounded_outputs import output_rounding
from dssc_jax.flight_logs.reading.reader import Column
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.fit.test_fit import linear, log_of

TIME = 0.02 * np.arange(800)
WAY = 2.0 * (1.0 - np.cos(0.8 * TIME))
STEP = 0.1


def rounded(noise, seed=0, way=WAY):
    """Readings of a way in multiples of a step, with noise before the rounding."""
    return STEP * np.round((way + noise * np.random.default_rng(seed).normal(size=len(way))) / STEP)


@pytest.mark.parametrize("seed", range(10))
def test_a_step_above_the_noise_is_found(seed):
    """Noise of a step, fine digits, a switch between few values and a short log are no coarse rounding."""
    for noise in (0.0, 0.1 * STEP, 0.3 * STEP):
        assert output_rounding(rounded(noise, seed)) == pytest.approx(STEP)
    missing = np.where(np.arange(800) % 7 == 0, np.nan, rounded(0.01, seed))
    assert output_rounding(missing) == pytest.approx(STEP)
    for noise in (STEP, 3.0 * STEP):
        assert output_rounding(rounded(noise, seed)) == 0.0
    noisy = WAY + 0.005 * np.random.default_rng(seed).normal(size=800)
    for values in (noisy, np.round(noisy, 3), np.sign(np.sin(TIME)), rounded(0.0)[:30], np.zeros(800)):
        assert output_rounding(values) == 0.0


def test_a_rounded_output_is_told_and_its_steps_are_no_jumps():
    study = linear(sensor={"kind": "noisy", "position_std": 0.002})
    way = 0.5 * np.cos(2.0 * TIME[:400])
    log = log_of(rounded(0.002, way=way), np.zeros(400))
    hint = replay_log(study, log, commands=False).hints.factors["y"]
    assert (hint.code, hint.text[:28]) == ("rounded-output", "is rounded to 0.1 m, by more")
    sensor = {"kind": "noisy", "position_std": 0.002, "position_resolution": 0.1}
    assert not replay_log(linear(sensor=sensor), log, commands=False).hints.factors
    rate = Column(TIME, 1.6 * np.sin(0.8 * TIME) + 0.001 * np.random.default_rng(1).normal(size=800))
    assert jumps_beside(Column(TIME, rounded(0.0)), rate, -1.0, 100.0) == []
    later = np.where(TIME > 8.0, 1.0, 0.0)
    (jump,) = jumps_beside(Column(TIME, rounded(0.0) + later), rate, -1.0, 100.0)
    assert jump.size == pytest.approx(1.0, abs=0.1)


def doubts(values, way):
    """The doubts of a residual against the true way."""
    readings = SimpleNamespace(channel=0, times=0.02 * np.arange(len(way)), values=values, sensor=0.0)
    residual = (values - way)[:, None]
    problem: Any = SimpleNamespace(study=linear(), readings=[readings], columns=lambda x: [residual])
    return outlier_doubts(problem, np.zeros(1))


@pytest.mark.parametrize(
    "way",
    [
        0.3 * (1.0 - np.cos(0.4 * TIME)),
        0.16 * (1.0 - np.cos(0.4 * TIME)),  # four values
        8.0 * (1.0 - np.cos(0.001 * np.arange(8000))),  # whose deviation is 56 steps
    ],
)
def test_steps_of_rounding_are_told_as_that_and_are_no_outliers_of_a_fit(way):
    """A slow way, whose readings step at a few of its samples; a larger jump is told all the same."""
    values = rounded(0.0, way=way)
    assert outliers(0.02 * np.arange(len(way)), values - way, 0.0)
    (rounding,) = doubts(values, way)
    assert rounding.code == "rounded-output"
    assert rounding.text.startswith("y is rounded to 0.1 m, ")
    with_jump = doubts(values + np.where(np.arange(len(way)) > 350, 1.0, 0.0), way)
    assert "output-jump" in [doubt.code for doubt in with_jump]
