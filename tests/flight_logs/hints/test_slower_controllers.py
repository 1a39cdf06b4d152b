"""Controllers that computed at every N-th sample of the study only."""

import numpy as np
import pytest

from dssc_jax.flight_logs.hints.slower_controllers import CommandClock, command_clock
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.hints.test_replayed_columns import DT, GAINS, PULSES, SAMPLES, log_of, study

__all__ = ["study"]


def flown(every, first=0, integrated=None, gains=GAINS, seed=0):
    """The columns of a flight whose controller computes at every N-th sample, by a simulation of its own.

    Args:
        every: Number N.
        first: The first sample with a command.
        integrated: Samples for which the integral counts from one command to the next; None: N.
        gains: Gains of the controller.
        seed: Seed of the sensors' noise.
    """
    random = np.random.default_rng(seed)
    k_1, k_2, k_i = gains
    step = DT * (every if integrated is None else integrated)
    place, speed, integral, u = 0.0, 0.0, 0.0, 0.0
    columns = {name: np.zeros(SAMPLES) for name in ("y", "y_dot", "u_total")}
    for sample in range(SAMPLES):
        y = place + 0.002 * random.normal()
        y_dot = speed + 0.004 * random.normal()
        if sample % every == first:
            u = integral - k_1 * (y - PULSES[sample]) - k_2 * y_dot
            integral -= step * k_i * (y - PULSES[sample])
        for name, value in (("y", y), ("y_dot", y_dot), ("u_total", u)):
            columns[name][sample] = value
        for _ in range(10):
            speed += 0.1 * DT * (-0.33 * speed + 0.53 * u)
            place += 0.1 * DT * speed
    return {**columns, "y_ref": PULSES}


def told(study, columns):
    """The warnings of a replay by code."""
    return {warning.code: warning.text for warning in replay_log(study, log_of(columns)).warnings}


@pytest.mark.parametrize(("every", "first", "words"), [(2, 0, "2nd"), (3, 1, "3rd"), (5, 3, "5th"), (10, 0, "10th")])
def test_a_slower_controller_is_told_with_its_period(study, every, first, words):
    texts = told(study, flown(every, first))
    assert list(texts) == ["slower-controller"]
    assert (
        f"computes at every {words} sample of the study only, each {every * DT:.4g} s, and"
        in texts["slower-controller"]
    )
    assert texts["slower-controller"].endswith(f"set loop.sample_time = {every * DT:.4g}")


@pytest.mark.parametrize("every", [5, 10])
def test_a_loop_that_runs_slower_than_it_believes_is_told(study, every):
    """Its integral grows by the study's sample time from one command to the next."""
    texts = told(study, flown(every, integrated=1))
    assert list(texts) == ["slower-controller"]
    assert "differentiates as if these were 0.02 s" in texts["slower-controller"]


def test_other_gains_at_a_slower_rate_are_no_slower_controller(study):
    texts = told(study, flown(5, gains=(5.0, 4.0, 1.0)))
    assert list(texts) == ["another-command"]
    assert "The cause is open" in texts["another-command"]


@pytest.mark.parametrize("seed", range(3))
def test_the_analysed_controller_is_silent(study, seed):
    assert told(study, flown(1, seed=seed)) == {}


def test_the_clock_of_a_command():
    rows = np.arange(300)
    values = np.random.default_rng(1).normal(size=300)
    held = values[np.maximum(rows - (rows - 3) % 5, 0)]
    assert command_clock(held) == CommandClock(5, 3)
    assert command_clock(np.clip(held, -1.0, 1.0)) == CommandClock(5, 3)  # rests at its limits
    assert command_clock(np.where((rows - 3) % 5 == 0, values, np.nan)) == CommandClock(5, 3)  # not logged between
    assert command_clock(values) is None
    assert command_clock(np.zeros(300)) is None
    jittering = values[np.repeat(rows, np.random.default_rng(2).choice([4, 5, 6], 300))[:300]]
    assert command_clock(jittering) is None
