"""Flights with another value of one number of the analysed controller: the number is named, with its factor."""

import numpy as np
import pytest

from dssc_jax.flight_logs.hints.other_gains import numbers_of_controller
from dssc_jax.flight_logs.reading.reader import Column
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.closed_loop import PID, TIME, Pid, fly, study_of


def hint_of(log):
    """The hint about the command."""
    hints = replay_log(study_of(), log).hints.all()
    return hints.get("u_total")


@pytest.mark.parametrize(
    ("gains", "name", "factor"),
    [
        (Pid(k_p=9.0), "k_p", 1.5),
        (Pid(k_p=4.2), "k_p", 0.7),
        (Pid(k_i=1.5), "k_i", 1.5),
        (Pid(k_d=4.5), "k_d", 1.5),
        (Pid(filter=0.08), "filter", 4.0),
    ],
)
def test_a_gain_is_named_with_its_factor(gains, name, factor):
    hint = hint_of(fly(gains=gains))
    assert hint.code == "another-command"
    value = getattr(gains, name)
    words = f"{factor:g} times its controller.{name}, {value:g} in place of {getattr(PID, name):g}, to "
    assert words in hint.text


def test_a_gain_is_named_by_commands_with_three_digits():
    log = fly(gains=Pid(k_p=9.0))
    command = log.columns["u_total"]
    rounded = command._replace(value=np.round(command.value, 2))
    assert " times its controller.k_p, 9" in hint_of(log._replace(columns=log.columns | {"u_total": rounded})).text


def test_two_gains_are_no_single_one():
    assert "The cause is open" in hint_of(fly(gains=Pid(k_p=9.0, k_d=4.5))).text


def test_a_factor_of_all_commands_is_that_of_the_command():
    assert hint_of(fly(factor=1.35)).text.startswith("is 1.35 times what the analysed controller gives")


def test_noise_that_the_controller_never_saw_is_no_gain():
    log = fly()
    noisy = log.columns["y"].value + 0.02 * np.random.default_rng(5).normal(size=len(TIME))
    hint = hint_of(log._replace(columns=log.columns | {"y": Column(TIME, noisy)}))
    assert "The cause is open" in hint.text


def test_numbers_of_a_controller_are_those_that_may_change():
    numbers = numbers_of_controller(study_of(), 0)
    assert numbers["controller.k_p"] == PID.k_p
    assert "controller.derivative_weight" not in numbers  # 0, of which there is no factor
    assert not any(name.startswith("plant") for name in numbers)
