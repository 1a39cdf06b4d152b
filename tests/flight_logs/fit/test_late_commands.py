"""Commands that act later than they are logged, with a force from the start, so that late outputs explain nothing."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.prediction import prediction
from tests.flight_logs.closed_loop import Axis, Pid, fly, study_of
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

SAMPLES = 400
FORCE = 2.0
LAWS = {"k_p": {"uniform": [0.5, 1.5]}, "a_p": {"normal": [1.0, 0.2]}, "initial": [0.5, 0.0]}
NAMES = ("plant.k_p", "plant.a_p")
SLOW = Pid(k_p=2.1, k_i=0.7, k_d=1.6, filter=0.06)


def forced():
    """The plant of other tests with a constant force."""
    return linear(plant={"kind": "normal_form", **LAWS}, disturbance={"kind": "constant", "value": FORCE})


def flight(seed, late):
    """Commands, and the noisy outputs of a plant that gets them some samples late, by SciPy."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.normal(size=80), 5)
    sources = np.clip(np.arange(SAMPLES) - late, 0, SAMPLES - 1)
    y = output(1.1, 0.8, u[sources] + FORCE)
    return log_of(y + 0.005 * random.normal(size=SAMPLES), u)


@pytest.fixture(scope="module")
def predictions():
    """The compiled simulation of the numbers, which all flights share."""
    return {NAMES: prediction(forced(), NAMES, SAMPLES)}


@pytest.mark.parametrize("late", [-3, 0, 4])
def test_commands_that_act_at_other_times_are_told(predictions, late):
    for seed in range(3):
        fitted = fit_log(forced(), flight(seed, late), NAMES, predictions)
        told = [doubt.text for doubt in fitted.doubts if doubt.text.startswith("u_total acts ")]
        if late == 0:
            assert fitted.doubts == ()
            continue
        (text,) = told
        words = text.split()
        delay, deviation = float(words[2]), float(words[4])
        assert words[6:8] == ["later" if late > 0 else "earlier", "than"]
        assert abs(delay - abs(late) * DT) < 4.0 * deviation
        assert deviation < DT


def test_a_dead_time_behind_a_force_is_that_of_the_command():
    """Outputs at other times explain a part of what the force leaves of it, so that they were told."""
    force = {"kind": "constant", "value": {"normal": [0.0, 0.3]}}
    study = study_of(SLOW, disturbance=force, unmodelled={"kind": "lag", "mu": {"uniform": [0.03, 0.15]}})
    log = fly(axis=Axis(actuator=0.08, wind=0.2, noise=0.003), gains=SLOW)
    command = log.columns["u_total"]
    early = np.append(command.value[2:], command.value[-2:])  # the vehicle got each two samples later
    fitted = fit_log(study, log._replace(columns=log.columns | {"u_total": command._replace(value=early)}))
    codes = [doubt.code for doubt in fitted.doubts]
    (doubt,) = [doubt for doubt in fitted.doubts if doubt.code.startswith("delayed")]
    assert doubt.code == "delayed-command", codes
    delay, deviation = float(doubt.text.split()[2]), float(doubt.text.split()[4])
    assert abs(delay - 0.04) < 3.0 * deviation
