"""What is said of a logged command that follows from the analysed controller's: a multiple, a delay, an offset."""

import numpy as np
import pytest

from dssc_jax.flight_logs.hints.command_hints import best_shift, command_hint, rate_hint, stuck_spans
from dssc_jax.flight_logs.reading.reader import Column

DT = 0.02


def command(seed=0):
    """A command with what a controller makes of noise, shape (500,)."""
    random = np.random.default_rng(seed)
    return np.sin(DT * np.arange(500)) + 0.1 * random.normal(size=500)


@pytest.mark.parametrize("shift", [-4, -1, 1, 3, 20])
def test_a_command_at_other_times_is_told(shift):
    replayed = command()
    logged = np.roll(replayed, shift)
    logged[100:105] = np.nan
    side = "later" if shift > 0 else "earlier"
    hint = command_hint(logged, replayed, DT, "N")
    assert hint.code == "shifted-command"
    assert hint.text.startswith(f"is {abs(shift) * DT:.3g} s {side} than the analysed")
    assert best_shift(logged, replayed, 25)[0] == shift


def test_an_offset_and_a_multiple_are_told():
    """However small the offset, if it is all of the difference."""
    replayed = command()
    rounded = np.round(replayed + 0.02, 4)
    assert command_hint(rounded, replayed, DT, "N").text.startswith("lies 0.02 N beside what the analysed")
    assert command_hint(replayed + 9.81, replayed, DT, "N").text.startswith("lies 9.81 N beside what the analysed")
    assert command_hint(2.5 * replayed, replayed, DT, "N").text.startswith("is 2.5 times what the analysed")


@pytest.mark.parametrize("hold", [2, 5, 10])
def test_a_command_of_a_slower_clock_is_told(hold):
    replayed = command()
    rows = np.arange(500)
    logged = replayed[np.maximum(rows - (rows - 3) % hold, 0)]
    assert command_hint(logged, replayed, DT, "N").text.startswith(
        f"is what the analysed controller gives every {hold * DT}"
    )
    assert command_hint(logged, logged, DT, "N") is None


def test_another_controller_is_told():
    replayed = command()
    rate = np.gradient(np.sin(3.0 * DT * np.arange(500)), DT)
    text = command_hint(replayed + 0.1 * rate, replayed, DT, "N").text
    assert text.startswith("is not what the analysed controller gives for the logged measurements: they differ by 0.")
    assert command_hint(np.zeros(500), replayed, DT, "N").text.startswith("is not what the analysed")


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("length", [5, 15, 40])
def test_a_command_that_sticks_is_told_with_its_times(seed, length):
    """To a log's resolution, with missing values, and at a limit before."""
    replayed = np.clip(1.5 * command(seed), -1.2, 1.2)
    logged = np.round(replayed, 4)
    logged[10:14] = np.nan
    assert command_hint(logged, replayed, DT, "N") is None
    logged[325 : 325 + length] = logged[325]
    end = DT * (324 + length)
    text = command_hint(logged, replayed, DT, "N").text
    assert text.startswith(f"repeats one value from 6.5 s to {end:.4g} s of the study, where the analysed controller's")


@pytest.mark.parametrize("seed", range(10))
def test_limits_rest_and_other_controllers_do_not_stick(seed):
    replayed = command(seed)
    rows = np.arange(500)
    limited = np.clip(3.0 * replayed, -1.0, 1.0)
    relay = np.sign(np.sin(0.05 * rows))
    late_relay = np.sign(np.sin(0.05 * rows - 0.05))
    coarse = np.round(replayed, 0)
    resting = np.where(rows < 100, 0.0, replayed)
    for logged, analysed in (
        (limited, limited),
        (limited, np.clip(3.0 * replayed + 0.5 * np.exp(-0.02 * rows), -1.0, 1.0)),
        (late_relay, relay),
        (coarse, replayed),
        (resting, resting),
        (np.full(500, 0.5), replayed),
    ):
        assert stuck_spans(logged, analysed) == []


@pytest.mark.parametrize("seed", range(10))
def test_the_same_command_is_not(seed):
    """The same one to a log's resolution; one with another first state; nothing at all."""
    replayed = command(seed)
    time = DT * np.arange(500)
    for logged in (
        replayed,
        np.round(replayed, 3),
        replayed + 0.5 * np.exp(-time),
        np.full(500, np.nan),
    ):
        assert command_hint(logged, replayed, DT, "N") is None
    assert command_hint(9.81 + 1e-4 * command(seed + 100), 9.81 + 1e-4 * replayed, DT, "N") is None  # rounded
    assert "beside" in command_hint(np.full(500, 1e300), replayed, DT, "N").text  # and no warning of NumPy


@pytest.mark.parametrize(("sample_time", "is_told"), [(0.02, False), (0.025, False), (0.04, True), (0.1, True)])
def test_a_command_of_a_faster_controller_is_told(sample_time, is_told):
    """A study at half the rate of the flight's controller gave a gain 2.7 % too large, without the reason."""
    random = np.random.default_rng(0)
    times = 0.02 * np.arange(400)
    for rows in (1, 4):  # a log may have more rows than the controller has commands
        fine = 0.02 / rows * np.arange(400 * rows)
        command = Column(fine, np.repeat(random.normal(size=len(times)), rows))
        hint = rate_hint(command, sample_time)
        assert (hint is not None and hint.text.startswith("changes every 0.02 s")) == is_told
    assert rate_hint(Column(times, np.ones(len(times))), 0.1) is None


def test_single_commands_that_the_controller_did_not_give_are_told():
    replayed = command()
    logged = replayed + 1e-4 * np.random.default_rng(1).normal(size=500)
    logged[[120, 300]] += [50.0, -20.0]
    text = command_hint(logged, replayed, DT, "N").text
    assert text.startswith(
        "has single values that the analysed controller does not give, at 2.4 s and 6 s of the study"
    )
    kick = replayed.copy()
    kick[120] += 50.0
    hint = command_hint(kick, 0.9 * kick, DT, "N")  # of a jump that both answer
    assert hint is None or "single values" not in hint.text


def test_many_spikes_are_told_by_the_first_ones():
    replayed = command()
    logged = replayed.copy()
    logged[20:340:40] = 0.0
    logged[20:340:40] -= 8.0
    text = command_hint(logged, replayed, DT, "N").text
    assert "at 0.4 s and 1.2 s and 2 s and 5 more times of the study" in text


@pytest.mark.parametrize("rows", [1, 2])
def test_an_interpolated_command_is_told_with_the_time_between_commands(rows):
    """A command every 0.1 s in a table of 50 rows a second, or of 100."""
    nodes = np.random.default_rng(4).normal(size=101)
    times = DT / rows * np.arange(500 * rows)
    lines = Column(times, np.interp(times, 0.1 * np.arange(101), nodes))
    for sample_time in (DT, 0.1):
        text = rate_hint(lines, sample_time).text
        assert text.startswith("is a straight line from one command to the next, 0.1 s apart: the log was interpolated")
    held = Column(times, nodes[np.floor(times / 0.1 + 1e-9).astype(int)])
    assert rate_hint(held, DT) is None
