"""Forces and falls of the gain that begin during a flight: their times, and what a fit by the advice says."""

import re

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.flown_course import Flight
from dssc_jax.flight_logs.fit.refusals import Unexplained
from dssc_jax.flight_logs.fit.sudden_parts import (
    GAIN_STEP,
    WIND_STEP,
    lacking_sudden_parts,
    part_from,
)
from tests.flight_logs.fit.test_fit import DT, linear, log_of
from tests.flight_logs.fit.test_missing_parts import A_P, FINE, K_P, commands_of, flown, no_force, told


@pytest.fixture(scope="module")
def predictions():
    """Compiled predictions, which all flights share."""
    return {}


def test_a_wind_that_begins_late_is_told_though_it_moves_no_estimate(predictions):
    u = commands_of(8)
    wind = -0.05 / K_P * (np.arange(len(u)) >= 300)
    fitted = fit_log(linear(), log_of(flown(no_force, 8, u + wind), u), predictions=predictions)
    (doubt,) = told(fitted)
    assert "that begins at 6.002 ± 0.0097 s of the study, " in doubt.text
    assert "and no estimate moves by more than its standard deviation. Give" in doubt.text


@pytest.mark.parametrize(("begin", "size"), [(130, 0.04), (200, -0.03)])
def test_a_wind_that_begins_in_flight_is_told_with_its_time_and_size(predictions, begin, size):
    u = commands_of(8)
    wind = size / K_P * (np.arange(len(u)) >= begin)
    fitted = fit_log(linear(), log_of(flown(no_force, 8, u + wind), u), predictions=predictions)
    (doubt,) = told(fitted)
    assert doubt.code == "missing-force"
    words = doubt.text.split("a constant force (")[1]
    assert abs(float(words.split()[0]) - size / K_P) < 0.005
    assert abs(float(words.split("begins at ")[1].split()[0]) - DT * begin) < 0.1


def test_a_refusal_names_a_wind_that_begins_in_flight(predictions):
    u = commands_of(8)
    wind = 0.1 / K_P * (np.arange(len(u)) >= 130)
    with pytest.raises(Unexplained, match=r"begins at 2\.6 ± 0\.0078 s of the study, which the study lacks"):
        fit_log(linear(), log_of(flown(no_force, 8, u + wind), u), predictions=predictions)


def test_a_study_with_a_force_that_begins_gets_no_second_one():
    both = [WIND_STEP, GAIN_STEP]
    assert lacking_sudden_parts(linear()) == both
    assert lacking_sudden_parts(linear(disturbance={"kind": "constant", "value": {"uniform": [-0.1, 0.1]}})) == both
    assert lacking_sudden_parts(linear(disturbance={"kind": "step", "value": 0.1, "at": 2.0})) == [GAIN_STEP]


def blown(seed, begin, size):
    """The log of a flight with a wind of a size in m/s^2 from a time on, which may lie between two samples."""
    u = commands_of(seed)
    times = DT / FINE * np.arange(FINE * len(u))
    wind = size / K_P * (times > begin - 1e-9)
    return log_of(flown(no_force, seed, u[:, None] + wind.reshape(len(u), FINE)), u)


def refusal(log, predictions):
    """The text with which a fit is refused."""
    with pytest.raises(Unexplained) as refused:
        fit_log(linear(), log, predictions=predictions)
    return str(refused.value)


@pytest.mark.parametrize(("seed", "begin", "size"), [(8, 2.61, 1.0), (11, 3.513, 0.5)])
def test_a_strong_wind_is_told_with_the_time_between_two_samples_and_its_advice_leads_to_a_clean_fit(
    predictions, seed, begin, size
):
    """A force from a whole sample on leaves more than noise of such a wind, so that it would be taken for another."""
    log = blown(seed, begin, size)
    text = refusal(log, predictions)
    time, deviation = (float(word) for word in re.findall(r"begins at (\S+) ± (\S+) s of the study", text)[0])
    assert abs(time - begin) < 4.0 * deviation
    assert deviation < 0.1 * DT
    lower, upper = (float(word) for word in re.findall(r"at = \{ uniform = \[(\S+), (\S+)\] \}", text)[0])
    law = {"kind": "step", "value": {"normal": [0.0, 1.0]}, "at": {"uniform": [lower, upper]}}
    fitted = fit_log(linear(disturbance=law), log)
    assert fitted.doubts == ()
    truth = [K_P, A_P, size / K_P, begin]
    assert (np.abs(fitted.estimates - truth) < 4.0 * fitted.deviations).all()
    told_time = linear(disturbance={**law, "at": time})
    assert fit_log(told_time, log).doubts == ()


def test_a_force_between_two_samples_has_its_mean_over_the_first():
    flight = Flight(np.zeros(4), np.zeros(4), DT)
    for begin, forces in ((1.0, [0.0, 2.0, 2.0, 2.0]), (1.25, [0.0, 1.5, 2.0, 2.0])):
        part = part_from(WIND_STEP, begin, choices=1)
        np.testing.assert_allclose(part.forces_on(flight, 2.0), forces)
        np.testing.assert_array_equal(part.commands(flight, 2.0), flight.commands)
    thrust = Flight(np.full(4, 2.0), np.zeros(4), DT)
    part = part_from(GAIN_STEP, 1.25, choices=1)
    np.testing.assert_allclose(part.commands(thrust, 0.4), [2.0, 1.4, 1.2, 1.2])
    assert part.forces_on(thrust, 0.4) is None


@pytest.mark.parametrize(("seed", "begin", "kept"), [(7, 4.0, 0.8), (4, 2.512, 0.9), (9, 6.0, 0.97), (5, 5.0, 1.2)])
def test_a_gain_that_falls_at_a_moment_is_told_with_its_time_and_share(predictions, seed, begin, kept):
    """As where a blade breaks, or a cell of the battery fails."""
    u = commands_of(seed)
    gains = np.where(DT / FINE * np.arange(FINE * len(u)) > begin - 1e-9, kept, 1.0).reshape(len(u), FINE)
    log = log_of(flown(no_force, seed, gains * u[:, None]), u)
    (doubt,) = told(fit_log(linear(), log, predictions=predictions))
    assert doubt.code == "changing-gain"
    percent, time, deviation = (
        float(word) for word in re.findall(r" by (\S+) %, .* at (\S+) ± (\S+) s of the study", doubt.text)[0]
    )
    assert ("falls" in doubt.text) == (kept < 1.0)
    assert percent == pytest.approx(100.0 * abs(1.0 - kept), abs=0.5)
    assert abs(time - begin) < 4.0 * deviation
    assert deviation < 0.3


def behind_lag(u, lag):
    """Means of the output of a first-order lag over all fine steps, shape (n, FINE)."""
    decay = np.exp(-DT / FINE / lag)
    state = 0.0
    means = []
    for command in np.repeat(u, FINE):
        means.append(command + (state - command) * (1.0 - decay) * lag * FINE / DT)
        state = command + (state - command) * decay
    return np.reshape(means, (len(u), FINE))


@pytest.mark.parametrize("begin", [0.0, 2.61, 5.0])
def test_a_wind_acts_behind_the_actuator(begin):
    """Before a lag of 0.1 s, a force has to begin 0.1 s earlier, and a steady one leaves more than noise."""
    lag, size = 0.1, 0.3
    u = commands_of(8)
    wind = size / K_P * (DT / FINE * np.arange(FINE * len(u)) > begin - 1e-9)
    y = flown(no_force, 8, behind_lag(u, lag) + wind.reshape(len(u), FINE))
    lagging = linear(unmodelled={"kind": "lag", "order": 1, "mu": lag})
    try:
        text = "".join(doubt.text for doubt in told(fit_log(lagging, log_of(y, u))))
    except Unexplained as refused:
        text = str(refused)
    assert float(text.split("onstant force (")[1].split()[0]) == pytest.approx(size / K_P, rel=0.02)
    assert "resemble" not in text
    if begin > 0.0:
        time, deviation = (float(word) for word in re.findall(r"begins at (\S+) ± (\S+) s of the study", text)[0])
        assert abs(time - begin) < 4.0 * deviation
        assert deviation < 0.01
