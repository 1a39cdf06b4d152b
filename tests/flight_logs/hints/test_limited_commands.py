"""Commands at limits that the analysed controller lacks, clipped behind it or within it."""

import numpy as np
import pytest

from dssc_jax.flight_logs.reading.reader import Column
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.closed_loop import DT, PID, TIME, fly, study_of


def hint_of(command):
    """The hint about another command in the log of a flight."""
    log = fly()
    columns = log.columns | {"u_total": Column(TIME, command)}
    return replay_log(study_of(), log._replace(columns=columns)).hints.all().get("u_total")


def limited_command(low, high):
    """The command of a PID with limits and the usual back-calculation, T_t = k_p/k_i, for the logged measurements."""
    columns = fly().columns
    integral, derivative, before = 0.0, 0.0, None
    commands = []
    for y, y_ref in zip(columns["y"].value, columns["y_ref"].value, strict=True):
        change = 0.0 if before is None else before - y
        before = y
        derivative = (PID.filter * derivative + PID.k_d * change) / (PID.filter + DT)
        v = PID.k_p * (y_ref - y) + integral + derivative
        u = min(max(v, low), high)
        integral += DT * PID.k_i * (y_ref - y) + DT * PID.k_i / PID.k_p * (u - v)
        commands.append(u)
    return np.array(commands)


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [(-0.7, 0.5, "from -0.7 to 0.5 m/s"), (-np.inf, 0.6, "at most 0.6 m/s"), (-0.6, np.inf, "at least -0.6 m/s")],
)
def test_a_command_that_is_clipped_behind_the_controller(low, high, words):
    hint = hint_of(np.clip(fly().columns["u_total"].value, low, high))
    assert hint.code == "limited-command"
    assert hint.text.startswith(f"is {words}")
    assert "Its integral goes on at a limit" in hint.text


def test_a_controller_with_limits_that_hold_its_integral_back():
    hint = hint_of(limited_command(-0.4, 0.3))
    assert hint.code == "limited-command"
    assert hint.text.endswith("Give the controller low = -0.4, high = 0.3")


def test_a_study_with_a_saturation_is_not_told_to_have_none():
    log = fly()
    clipped = np.clip(log.columns["u_total"].value, -0.7, 0.5)
    study = study_of(unmodelled={"kind": "saturation", "limit": 0.5, "low": -0.7})
    hint = replay_log(study, log._replace(columns=log.columns | {"u_total": Column(TIME, clipped)})).hints.all()
    assert hint["u_total"].code != "limited-command"


def test_a_command_that_holds_its_largest_value_for_another_reason_is_not_limited():
    command = fly().columns["u_total"].value.copy()
    largest = int(np.argmax(command))
    command[largest : largest + 40] = command[largest]
    assert hint_of(command).code == "stuck-command"
    assert hint_of(fly().columns["u_total"].value) is None
