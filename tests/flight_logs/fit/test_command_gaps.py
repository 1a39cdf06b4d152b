"""Commands that are logged at half the controller's rate: reconstructions, estimates by SciPy's plant, and warnings."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.command_gaps import EARLY, HELD, LATE, is_rare, reconstructions
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import NotIdentifiable, Unexplained
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

TRUTH = (1.1, 0.8)
SAMPLES = 400


def smooth(step=5.0, jump=0.0, at=200):
    """A command of two sines, which jumps at a sample."""
    time = DT * np.arange(SAMPLES)
    return np.sin(step * time) + 0.5 * np.sin(1.7 * time) + jump * (np.arange(SAMPLES) >= at)


def flown(command, seed=3):
    return output(*TRUTH, command) + 0.002 * np.random.default_rng(seed).normal(size=SAMPLES)


def thinned(command, first=0):
    """Every second value."""
    values = np.full(SAMPLES, np.nan)
    values[first::2] = command[first::2]
    return values


def log_at_half_the_rate(y, command, first=0):
    time = DT * np.arange(SAMPLES)
    return FlightLog("flight", {"y": Column(time, y), "u_total": Column(time[first::2], command[first::2])}, 0.0)


def doubt_of(fitted):
    return "".join(doubt.text for doubt in fitted.doubts if "more often than the log" in doubt.text)


def test_straight_lines_between_values_and_jumps():
    """By hand: a ramp of slope 1, a jump of 20 between the third and the fourth value, and a long gap."""
    values = np.full(30, np.nan)
    values[0:12:2] = [0.0, 2.0, 4.0, 26.0, 28.0, 30.0]
    values[20:30:2] = [40.0, 42.0, 44.0, 46.0, 48.0]
    late, early, held = reconstructions([values])
    assert [late.text, early.text, held.text] == [LATE, EARLY, HELD]
    np.testing.assert_array_equal(late.commands[0, :8], [0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 26.0, 27.0])
    np.testing.assert_array_equal(early.commands[0, :8], [0.0, 1.0, 2.0, 3.0, 4.0, 26.0, 26.0, 27.0])
    np.testing.assert_array_equal(held.commands[0, :8], [0.0, 0.0, 2.0, 2.0, 4.0, 4.0, 26.0, 26.0])
    for found in (late, early, held):
        np.testing.assert_array_equal(found.commands[0, 10:20], 30.0)  # longer than 2.5 usual gaps


@pytest.mark.parametrize(
    ("command", "rare"),
    [
        (thinned(smooth()), True),
        (smooth(), False),
        (thinned(np.repeat(smooth()[::4], 4)), False),  # a controller as slow shows its staircase
        (thinned(np.ones(SAMPLES)), False),
        (np.where(np.arange(SAMPLES) % 20 == 7, np.nan, smooth()), False),  # a message is lost now and then
    ],
)
def test_which_commands_are_rare(command, rare):
    assert is_rare(command) == rare
    assert len(reconstructions([command])) == (2 if rare else 1)  # without a jump


def test_every_second_command_of_a_smooth_one():
    """The estimates are those of the whole log, and the warning says what was taken; held commands would miss."""
    command = smooth()
    y = flown(command)
    complete = fit_log(linear(), log_of(y, command))
    fitted = fit_log(linear(), log_at_half_the_rate(y, command))
    assert (np.abs(fitted.estimates - complete.estimates) < 2.0 * complete.deviations).all()
    assert (np.abs(fitted.estimates - TRUTH) < 4.0 * fitted.deviations).all()
    assert fitted.between == LATE
    assert "straight lines" in doubt_of(fitted)
    assert "(u_total)" in doubt_of(fitted)
    shifted = output(*TRUTH, np.repeat(command[::2], 2))
    assert np.abs(shifted - output(*TRUTH, command)).max() > 0.005  # several times the noise


def test_a_refusal_names_rare_commands():
    """Commands that jump at every sample, of which the log has every fourth one, describe no flight."""
    command = 3.0 * np.random.default_rng(1).normal(size=SAMPLES)
    time = DT * np.arange(SAMPLES)
    columns = {"y": Column(time, flown(command)), "u_total": Column(time[::4], command[::4])}
    with pytest.raises(Unexplained, match=r"more often than the log has them \(u_total\)\. Between two") as refused:
        fit_log(linear(), FlightLog("flight", columns, 0.0))
    assert "rare-command" in [cause.code for cause in refused.value.causes]


@pytest.mark.parametrize(("at", "taken"), [(200, LATE), (201, EARLY)])
def test_the_flight_tells_when_a_command_jumped(at, taken):
    """A jump at a logged sample, or at one that the log lacks."""
    command = smooth(jump=3.0, at=at)
    fitted = fit_log(linear(), log_at_half_the_rate(flown(command), command))
    assert fitted.between == taken
    assert (np.abs(fitted.estimates - TRUTH) < 4.0 * fitted.deviations).all()


def test_a_controller_of_half_the_rate_is_held():
    """Its command changes at every second sample only: straight lines would be 10 ms early."""
    command = np.repeat(smooth()[::2], 2)
    fitted = fit_log(linear(), log_at_half_the_rate(flown(command), command))
    assert fitted.between == HELD
    assert (np.abs(fitted.estimates - TRUTH) < 4.0 * fitted.deviations).all()


def test_reconstructions_that_noise_hides_widen_the_intervals():
    """Much noise: both courses describe the flight, and the estimates' difference is in the intervals."""
    command = smooth(step=1.0)
    y = output(*TRUTH, command) + 0.1 * np.random.default_rng(4).normal(size=SAMPLES)
    study = linear(plant={**linear().table["plant"], "a_p": {"normal": [1.0, 1.0]}})
    lines = fit_log(study, log_of(y, reconstructions([thinned(command)])[0].commands[0]), ["plant.k_p"])
    held = fit_log(study, log_of(y, np.repeat(command[::2], 2)), ["plant.k_p"])
    fitted = fit_log(study, log_at_half_the_rate(y, command), ["plant.k_p"])
    expected = np.hypot(lines.deviations, lines.estimates - held.estimates)
    np.testing.assert_allclose(fitted.deviations, expected, rtol=0.02)


def test_why_nothing_is_identified():
    """Noise that hides the law's spread is named, with its size and what to do."""
    random = np.random.default_rng(5)
    command = np.repeat(random.normal(size=40), 10)
    narrow = {**linear().table["plant"], "k_p": {"lognormal": [np.log(1.1), 1e-4]}, "a_p": 0.8}
    y = output(*TRUTH, command) + 0.3 * random.normal(size=SAMPLES)
    with pytest.raises(NotIdentifiable) as refusal:
        fit_log(linear(plant=narrow), log_of(y, command))
    text = str(refusal.value)
    assert "identifies none of plant.k_p: their laws are narrower" in text
    slopes = (output(1.1001, 0.8, command) - output(1.0999, 0.8, command)) / 0.0002
    ratio = 0.3 / np.sqrt(slopes @ slopes) / 1.1e-4
    told = float(text.partition("plant.k_p (")[2].partition(" times")[0])
    assert told == pytest.approx(ratio, rel=0.1)
    noise = float(text.partition("noise of the residual (")[2].partition(" ")[0])
    assert noise == pytest.approx(0.3, rel=0.1)
    assert "wider law" in text


@pytest.mark.parametrize("is_held", [True, False])
def test_an_interpolated_command_is_held_if_the_vehicle_held_it(is_held):
    """Straight lines are half a period early where the controller holds each command; the flight tells."""
    nodes = np.random.default_rng(6).normal(size=81)
    lines = np.interp(np.arange(SAMPLES), 5.0 * np.arange(81), nodes)
    held = np.repeat(nodes[:80], 5)
    fitted = fit_log(linear(), log_of(flown(held if is_held else lines), lines))
    assert (fitted.between == HELD) == is_held
    assert (np.abs(fitted.estimates - TRUTH) < 4.0 * fitted.deviations).all()
