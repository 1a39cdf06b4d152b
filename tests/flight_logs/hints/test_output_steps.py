"""Outputs in whose column the reference or the error stands."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.hints.output_steps import RESET, WRAPPED, step_cause
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.fit.test_fit import DT, linear

PULSES = {"kind": "pulses", "size": 2.0, "period": 6.0, "width": 3.0, "at": 1.0}


@pytest.fixture(scope="module")
def flight():
    """A study of pulses, and the signals of a draw with noise of the readings."""
    study = linear(draws=1, reference=PULSES)
    run = dj.simulate(study, 0)
    random = np.random.default_rng(3)
    signals = {name: run[name].values.copy() for name in ("y", "y_dot", "y_ref", "u_total")}
    signals["y"] += 0.01 * random.normal(size=400)
    signals["y_dot"] += 0.02 * random.normal(size=400)
    return study, signals


def log_of_signals(signals, begin=0.0):
    time = begin + DT * np.arange(400)
    return FlightLog("flight", {name: Column(time, values) for name, values in signals.items()}, begin)


def test_an_output_that_is_exchanged_with_its_reference_refuses_a_fit(flight):
    study, signals = flight
    assert not replay_log(study, log_of_signals(signals)).hints.all()
    exchanged = signals | {"y": signals["y_ref"], "y_ref": signals["y"]}
    for names in (("y", "y_ref", "u_total"), ("y", "y_dot", "y_ref", "u_total")):
        log = log_of_signals({name: exchanged[name] for name in names})
        hints = replay_log(study, log).hints
        assert hints.all()["y"].text == "looks exchanged with y_ref: it is the study's reference"
        assert not hints.others
        with pytest.raises(ConfigError, match="y looks exchanged with y_ref"):
            fit_log(study, log)


@pytest.mark.parametrize(
    ("sign", "words"),
    [
        (-1.0, "each time by minus the step of its reference: is it the error y - y_ref in place of y?"),
        (1.0, "each time by the step of its reference: is it the reference, or the error y_ref - y, in place of y?"),
    ],
)
@pytest.mark.parametrize("begin", [0.0, 52.3])
def test_an_output_that_is_the_error_is_told(flight, sign, words, begin):
    """By its jumps, which the rate does not have."""
    study, signals = flight
    log = log_of_signals(signals | {"y": signals["y"] + sign * signals["y_ref"]}, begin)
    assert replay_log(study, log, commands=False).hints.jumps["y"].text.endswith(f"and y_dot has no such peak: {words}")


def test_a_jump_beside_the_reference_is_a_reset(flight):
    study, signals = flight
    log = log_of_signals(signals | {"y": signals["y"] + np.where(np.arange(400) < 220, 0.0, 0.5)})
    assert "a reset of the estimator that the log" in replay_log(study, log, commands=False).hints.jumps["y"].text


def test_steps_of_a_residual_are_compared_at_times_of_the_study(flight):
    """A fit finds them without a rate, and their sizes have its noise."""
    study = flight[0]
    assert "the error y - y_ref" in step_cause(study, 0, [1.0, 4.0], [-1.9, 2.1])
    assert "is it the reference" in step_cause(study, 0, [1.0, 4.0], [1.9, -2.1])
    assert step_cause(study, 0, [1.0, 5.0], [-1.9, 2.1]) == step_cause(study, 0, [2.0], [0.1]) == RESET


def test_steps_by_a_turn_are_those_of_a_wrapped_angle(flight):
    study = flight[0]
    angle = study.override({"units": {"output": "rad"}})
    assert step_cause(angle, 0, [1.2, 5.0], [-6.2, 6.33]) == WRAPPED
    assert step_cause(angle, 0, [1.2, 5.0], [-6.2, 1.0]) == step_cause(study, 0, [1.2, 5.0], [-6.2, 6.33]) == RESET


def test_steps_by_a_turn_are_told_without_the_unit_of_an_angle(flight):
    """Two or more, each nearly a turn; one alone, or a rough one, is a reset."""
    study = flight[0]
    assert (
        step_cause(study, 0, [1.2, 5.0], [-6.27, 6.29]) == step_cause(study, 0, [1.2, 5.0], [359.0, 361.0]) == WRAPPED
    )
    assert step_cause(study, 0, [1.2], [-6.28]) == step_cause(study, 0, [1.2, 5.0], [-6.28, 360.0]) == RESET
