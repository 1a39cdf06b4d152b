"""Logs that begin under a command, and within a flight: the actuator or the start is told, and no constant."""

import numpy as np
import pytest
from scipy import linalg

from dssc_jax.flight_logs.fit.begun_actuators import prediction_from_equilibrium, steady_gain
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.prediction import prediction
from dssc_jax.flight_logs.fit.refusals import Unexplained
from tests.flight_logs.closed_loop import DT, Axis, Pid, fly, study_of
from tests.flight_logs.fit.test_fit import log_of

MU = 0.2
SLOW = Pid(k_p=2.1, k_i=0.7, k_d=1.6, filter=0.06)


def lagged_study(**changes):
    """The study of the axis with a lag of the actuator."""
    return study_of(SLOW, unmodelled={"kind": "lag", "mu": {"uniform": [0.1, 0.3]}}, **changes)


def exact_output(commands, first):
    """The output of k_p = 1.1, a_p = 0.8 behind a lag that begins at a value, by a matrix exponential."""
    held = linalg.expm(DT * np.array([[0, 1, 0, 0], [0, -0.8, 1.1, 0], [0, 0, -1 / MU, 1 / MU], [0, 0, 0, 0]]))
    state = np.array([0.0, 0.0, first])
    outputs = []
    for command in commands:
        outputs.append(state[0])
        state = (held @ np.append(state, command))[:3]
    return np.array(outputs)


def held_commands(seed):
    """Commands that begin at 2 and change every tenth sample, shape (300,)."""
    random = np.random.default_rng(seed)
    return np.repeat(np.append(2.0, random.normal(size=29)), 10)


def test_the_prediction_is_that_of_an_actuator_in_equilibrium():
    study = lagged_study()
    names = ("plant.k_p", "plant.a_p", "unmodelled.mu")
    commands = held_commands(1)
    assert steady_gain(study) == pytest.approx(1.0, rel=1e-12)
    predict = prediction_from_equilibrium(prediction(study, names, len(commands)), 2.0, 1.0)
    found, _ = predict(np.array([1.1, 0.8, MU]), commands[None, :])
    np.testing.assert_allclose(found[0], exact_output(commands, 2.0), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("table", "gain"),
    [
        ({"kind": "none"}, None),
        ({"kind": "saturation", "limit": 1.0}, None),
        ({"kind": "transfer_function", "mu": 0.1, "numerator": [1.0, 0.5], "denominator": [1.0, 3.0, 1.0]}, 1.0),
    ],
)
def test_the_steady_gain_is_that_of_a_linear_actuator_with_a_memory(table, gain):
    found = steady_gain(study_of(SLOW, unmodelled=table))
    assert found == (None if gain is None else pytest.approx(gain, rel=1e-12))


def test_a_limit_that_is_not_reached_does_not_hide_it():
    """The limit stands before the lag, and only every third output is logged."""
    commands = held_commands(2)
    noise = 0.002 * np.random.default_rng(3).normal(size=len(commands))
    elements = [{"kind": "saturation", "limit": 5.0}, {"kind": "lag", "mu": {"uniform": [0.1, 0.3]}}]
    log = log_of(exact_output(commands, 2.0) + noise, commands)
    y = log.columns["y"]
    sparse = log._replace(columns=log.columns | {"y": y._replace(time=y.time[::3], value=y.value[::3])})
    with pytest.raises(Unexplained, match=r"begins at 2 m/s, and the actuator seems .*plant\.k_p is 1\.(09|1\d)"):
        fit_log(study_of(SLOW, actuator=elements), sparse)


@pytest.mark.parametrize("first", [0.0, 2.0])
def test_an_actuator_that_has_followed_the_first_command_is_told(first):
    commands = held_commands(2)
    noise = 0.002 * np.random.default_rng(3).normal(size=len(commands))
    log = log_of(exact_output(commands, first) + noise, commands)
    try:
        told = [doubt.text for doubt in fit_log(lagged_study(), log).doubts]
    except Unexplained as refusal:
        told = [str(refusal)]
    assert any("begins at 2 m/s, and the actuator seems to have followed it" in text for text in told) == (first == 2.0)


def test_a_log_that_begins_within_a_flight_has_another_start_and_no_constant():
    """The integral of the controller makes a constant beside the replay, which the vehicle did answer."""
    log = fly(axis=Axis(actuator=MU, wind=0.2), gains=SLOW)
    cut = 150
    columns = {
        name: column._replace(time=column.time[:-cut], value=column.value[cut:]) for name, column in log.columns.items()
    }
    wind = {"kind": "constant", "value": {"normal": [0.0, 0.3]}}
    with pytest.raises(Unexplained) as refusal:
        fit_log(lagged_study(disturbance=wind), log._replace(columns=columns))
    assert "begins with a speed of" in str(refusal.value)
    assert "has a constant of" not in str(refusal.value)
