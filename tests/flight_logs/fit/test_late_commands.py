"""Commands that act later than they are logged, with a force from the start, so that late outputs explain nothing."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.prediction import prediction
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

SAMPLES = 400
FORCE = 2.0
LAWS = {"k_p": {"uniform": [0.5, 1.5]}, "a_p": {"normal": [1.0, 0.2]}, "initial": [0.5, 0.0]}
NAMES = ("plant.k_p", "plant.a_p")


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
