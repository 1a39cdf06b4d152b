"""Commands that a log has filtered, or by another clock than its measurements."""

import numpy as np
import pytest

from dssc_jax.flight_logs.hints.command_courses import course_hint
from dssc_jax.flight_logs.hints.command_hints import command_hint
from dssc_jax.flight_logs.hints.conversions import rms
from tests.flight_logs.hints.test_command_hints import DT, command

ROWS = np.arange(500)


def deviation(values):
    """Deviation from the median."""
    return rms(values - np.median(values))


@pytest.mark.parametrize("time", [0.04, 0.1, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_a_filtered_command_is_told_with_its_lag(time, seed):
    replayed = 3.0 * command(seed) + np.sign(np.sin(0.1 * ROWS))
    logged = [replayed[0]]
    for value in replayed[1:]:
        logged.append(logged[-1] + (1.0 - np.exp(-DT / time)) * (value - logged[-1]))
    hint = command_hint(np.array(logged), replayed, DT, "N")
    assert hint.code == "filtered-command"
    assert f"behind a first-order lag of {time:g} s" in hint.text


@pytest.mark.parametrize("rate", [0.97, 0.985, 1.02])
def test_a_command_by_another_clock_is_told_with_its_rate(rate):
    replayed = np.sin(0.15 * ROWS) + np.sign(np.sin(0.04 * ROWS))
    hint = command_hint(np.interp(rate * ROWS, ROWS, replayed), replayed, DT, "N")
    assert hint.code == "clock-rate"
    assert f"at {rate:g} times the logged times" in hint.text


@pytest.mark.parametrize("seed", range(5))
def test_other_commands_are_neither(seed):
    replayed = command(seed)
    for logged in (
        command(seed + 20),
        1.5 * replayed + 0.3 * np.sin(0.3 * ROWS),
        np.clip(replayed, -0.5, 0.5),
        replayed + np.gradient(replayed),
        np.full(500, 0.1),
    ):
        assert course_hint(logged, replayed, DT, deviation(logged)) is None
