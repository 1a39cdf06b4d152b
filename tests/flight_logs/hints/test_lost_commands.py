"""Commands that a log repeats for a few samples, or rounds coarsely, without a fit."""

import numpy as np
import pytest

from dssc_jax.flight_logs.hints.command_hints import command_hint, rate_hint
from dssc_jax.flight_logs.hints.lost_commands import lost_commands, replaced_commands
from dssc_jax.flight_logs.hints.rounded_commands import command_rounding
from dssc_jax.flight_logs.reading.reader import Column

DT = 0.02
ROWS = np.arange(500)


def command(seed=0):
    """A command with what a controller makes of noise, shape (500,)."""
    return 2.0 * np.sin(DT * ROWS) + 0.05 * np.random.default_rng(seed).normal(size=500)


def with_losses(values, length):
    """A command that repeats its last value in six spans of some samples."""
    logged = values.copy()
    for begin in (40, 110, 180, 250, 330, 420):
        logged[begin : begin + length] = values[begin - 1]
    return logged


@pytest.mark.parametrize("length", [2, 3, 8])
@pytest.mark.parametrize("seed", range(3))
def test_repeated_commands_are_told_with_their_times(seed, length):
    hint = command_hint(with_losses(np.round(command(seed), 4), length), command(seed), DT, "N")
    assert hint.code == "command-dropouts"
    assert "and at 3 more times of the study, where the analysed controller's command goes on" in hint.text


@pytest.mark.parametrize("seed", range(5))
def test_limits_rounding_and_slow_controllers_lose_nothing(seed):
    replayed = command(seed)
    logged_and_replayed = (
        (np.round(replayed, 1), replayed),
        (np.clip(replayed, -1.5, 1.5), replayed),
        (np.clip(replayed, -1.5, 1.5), np.clip(replayed, -1.5, 1.5)),
        (np.repeat(replayed[::4], 4), replayed),
        (with_losses(replayed, 5), with_losses(replayed, 5)),
        (with_losses(replayed, 5) + 0.1 * command(seed + 20), replayed),
    )
    for logged, analysed in logged_and_replayed:
        assert lost_commands(logged, analysed) == []


@pytest.mark.parametrize("value", [0.0, -1.0, 30.0])
@pytest.mark.parametrize("count", [8, 40])
def test_one_value_in_place_of_commands_is_told_with_its_times(value, count):
    """Few spikes may be told as such; in noise that is large, they are none."""
    replayed = command() + np.random.default_rng(5).normal(size=500)
    logged = np.round(replayed, 6)
    logged[np.random.default_rng(6).choice(np.arange(20, 480), count, replace=False)] = value
    hint = command_hint(logged, replayed, DT, "N")
    assert hint.code in ("command-dropouts", *(["command-spikes"] if count == 8 else []))
    assert count == 8 or hint.text.startswith(f"is {value:g} N at {np.count_nonzero(logged == value)} samples (at ")
    assert replaced_commands(logged, replayed).value == value


@pytest.mark.parametrize("seed", range(5))
def test_limits_dead_zones_switches_and_other_controllers_replace_nothing(seed):
    replayed = command(seed)
    off = replayed.copy()
    for begin in (50, 200, 350):
        off[begin : begin + 60] = 0.0
    logged_and_replayed = (
        (np.clip(replayed, -1.5, 1.95), replayed),
        (np.maximum(replayed, 0.0), replayed),
        (np.where(np.abs(replayed) < 0.3, 0.0, replayed), replayed),
        (off, replayed),
        (2.0 * np.sign(replayed), replayed),
        (np.round(replayed, 1), replayed),
        (np.where(ROWS % 50 == 0, 0.0, 1.2 * command(seed + 20)), replayed),
        (np.full(500, np.nan), replayed),
        (replayed, replayed),
    )
    for logged, analysed in logged_and_replayed:
        assert replaced_commands(logged, analysed) is None


@pytest.mark.parametrize("step", [0.1, 0.2, 0.5])
def test_a_rounded_command_is_told_with_its_step(step):
    replayed = command()
    hint = command_hint(step * np.round(replayed / step), replayed, DT, "N")
    assert hint.code == "rounded-command"
    assert hint.text.startswith(f"is rounded to {step:g} N, and the analysed controller's is not: if only the log")
    assert "leave its column out" in hint.text
    disturbed = command_hint(step * np.round((replayed + 0.1 * np.cos(ROWS)) / step), replayed, DT, "N")
    assert disturbed.code == "rounded-command"


def test_digits_switching_and_a_rounding_controller_are_no_rounding():
    replayed = command()
    for logged, analysed in (
        (np.round(replayed, 2), replayed),
        (2.0 * np.sign(replayed), replayed),
        (np.round(replayed, 1), np.round(replayed, 1)),
        (np.clip(replayed, -1.0, 1.0), replayed),
        (np.full(500, np.nan), replayed),
    ):
        assert command_rounding(logged, analysed) is None


def test_a_command_between_its_limits_is_not_interpolated():
    """The sawtooth of a command that rests at both limits has lines that bend with one period."""
    period = 18
    random = np.random.default_rng(1)
    values = np.where(np.mod(ROWS, period) < 16, np.where(np.mod(ROWS // period, 3) == 0, 1.0, -1.0), 0.0)
    values[np.mod(ROWS, period) >= 16] = random.uniform(-0.9, 0.9, np.count_nonzero(np.mod(ROWS, period) >= 16))
    assert rate_hint(Column(DT * ROWS, values), DT) is None
