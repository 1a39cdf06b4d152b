"""Commands with a constant that the vehicle did not answer: told before what resembles it."""

import re

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import Unexplained
from dssc_jax.flight_logs.replay import replay_log
from dssc_jax.flight_logs.signal_warnings import joined_warnings, signal_warnings
from tests.flight_logs.closed_loop import A_P, K_P, Axis, fly, study_of, with_command

HOVER = 14.7
LAGGING = {"disturbance": {"kind": "constant", "value": {"normal": [0.0, 0.3]}}}
LAGGING |= {"unmodelled": {"kind": "lag", "mu": {"uniform": [0.02, 0.1]}}}


def refusal(study, log):
    """The causes that a refused fit names, between the sizes of the residual and the general advice."""
    with pytest.raises(Unexplained) as problem:
        fit_log(study, log)
    return str(problem.value).partition("% is accepted. ")[2].partition(". Compare the log's columns")[0]


@pytest.mark.parametrize("offset", [HOVER, 1.0])
def test_the_thrust_at_hover_is_told_first_and_no_lag(offset):
    """A lag that begins at rest falls under the whole thrust, which looks late."""
    study = study_of(**LAGGING)
    log = with_command(fly(axis=Axis(actuator=0.05)), offset=offset)
    replay = replay_log(study, log)
    fitted = fit_log(study, log, replay=replay)
    warnings = joined_warnings(signal_warnings(replay.hints.all()), fitted.doubts)
    assert [warning.code for warning in warnings] == ["command-offset", "large-residual"]
    text = warnings[0].text
    assert f"has a constant of {offset:.4g} m/s that the vehicle did not answer" in text
    assert text.endswith(f"Give the column of u_total an offset of -{offset:.4g}")
    assert float(re.search(r"falls from \S+ to (\S+) m rms", text)[1]) < 0.0021


def test_a_refusal_tells_the_constant_in_place_of_a_wind():
    text = refusal(study_of(), with_command(fly(), offset=HOVER))
    assert text.startswith("u_total has a constant of 14.7 m/s")
    assert "constant force" not in text


@pytest.mark.parametrize(("start", "offset"), [((0.4, 0.5), 0.5), ((0.4, 0.5), 0.02), ((0.0, 0.1), HOVER)])
def test_the_start_is_told_after_the_constant_with_its_true_values(start, offset):
    text = refusal(study_of(), with_command(fly(axis=Axis(start=start)), offset=offset))
    assert text.startswith(f"u_total has a constant of {offset:.4g} m/s")
    proposal = re.search(r"Set plant.initial = \[(\S+), (\S+)\]", text).groups()
    np.testing.assert_allclose([float(part) for part in proposal], start, atol=0.003)


def test_what_an_integral_holds_against_a_wind_is_such_a_constant():
    """The log begins in flight, and the study lacks the wind."""
    log = fly(axis=Axis(wind=-0.05 * K_P), integral=0.05)
    text = refusal(study_of(), log)
    assert text.startswith("u_total has a constant of 0.05 m/s that the vehicle did not answer")
    assert "where an integral held a steady wind before the log began" in text
    assert text.endswith("an offset of -0.05")


def test_a_wind_that_the_study_lacks_is_no_constant():
    fitted = fit_log(study_of(), fly(axis=Axis(wind=0.02)))
    assert "command-offset" not in [doubt.code for doubt in fitted.doubts]
    assert "missing-force" in [doubt.code for doubt in fitted.doubts]


def test_an_integral_without_a_wind_flew():
    """The vehicle answered the constant of its command."""
    fitted = fit_log(study_of(), fly(integral=0.05))
    assert fitted.doubts == ()
    np.testing.assert_allclose(fitted.estimates, [K_P, A_P], atol=0.01)
