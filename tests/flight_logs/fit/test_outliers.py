"""Readings that stand out of a residual, and outputs that a log holds: what is found, what is not, and what is said."""

import re

import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.outliers import outliers
from dssc_jax.flight_logs.fit.refusals import Unexplained
from dssc_jax.flight_logs.hints.integrals import still_text
from dssc_jax.flight_logs.reading.held_outputs import drop_repeats, stuck_span, usual_hold
from dssc_jax.flight_logs.reading.reader import Column, FlightLog, read_log
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

TIMES = 0.02 * np.arange(400)


@pytest.mark.parametrize("seed", range(20))
def test_noise_and_what_moves_have_no_outliers(seed):
    """White, heavy-tailed and coloured noise; a misfit of a fast step; a residual of nothing."""
    random = np.random.default_rng(seed)
    white = 0.01 * random.normal(size=400)
    step = np.where(TIMES > 4.0, np.exp(-(TIMES - 4.0) / 0.1) * np.sin(20.0 * (TIMES - 4.0)), 0.0)
    for residual in (white, 0.01 * random.standard_t(5, size=400), np.cumsum(white), white + step, 0.0 * white):
        assert outliers(TIMES, residual, 0.0) == []


@pytest.mark.parametrize("seed", range(20))
def test_single_readings_and_jumps_are_found(seed):
    random = np.random.default_rng(seed)
    residual = 0.01 * random.normal(size=400)
    residual[100] += 0.3
    residual[250:] -= 0.4
    single, jump = outliers(TIMES, residual, 0.0)
    assert (single.time, single.lasts) == (pytest.approx(2.0), False)
    assert single.size == pytest.approx(0.3, abs=0.06)
    assert (jump.time, jump.lasts) == (pytest.approx(5.0), True)
    assert jump.size == pytest.approx(-0.4, abs=0.06)
    assert outliers(TIMES, residual, 0.05) == []  # a sensor with that noise


def test_spikes_in_two_of_a_hundred_readings_do_not_hide_each_other():
    random = np.random.default_rng(3)
    residual = 0.005 * random.normal(size=400)
    rows = np.sort(random.choice(np.arange(10, 390, 4), 8, replace=False))
    residual[rows] += 0.4
    found = outliers(TIMES, residual, 0.005)
    np.testing.assert_allclose([outlier.time for outlier in found], TIMES[rows])
    assert not any(outlier.lasts for outlier in found)


def test_a_change_over_a_gap_is_none():
    residual = 0.01 * np.random.default_rng(0).normal(size=400)
    residual[200:] += 1.0
    times = TIMES.copy()
    assert len(outliers(times, residual, 0.0)) == 1
    times[200:] += 1.0
    assert outliers(times, residual, 0.0) == []


def flight(seed=8):
    """A command and a noisy output of known numbers."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.normal(size=40), 10)
    return u, output(1.1, 0.8, u) + 0.01 * random.normal(size=400)


def warnings_of(u, y, names=("plant.k_p",)):
    return "; ".join(doubt.text for doubt in fit_log(linear(), log_of(y, u), names).doubts)


def test_a_fit_tells_them_with_time_and_size():
    u, y = flight()
    assert "stand out" not in warnings_of(u, y)
    spoilt = y.copy()
    spoilt[100] += 3.0
    told = warnings_of(u, spoilt)
    assert re.search(r"single readings of y stand out by (2\.9\d|3|3\.0\d) m at 2 s of the study", told)
    jump = np.where(np.arange(400) >= 300, 1.0, 0.0)
    assert "at 6 s of the study, and what is predicted does not" in warnings_of(u, y + 0.2 * jump)
    with pytest.raises(Unexplained, match=r"y jumps by .* m at 6 s of the study"):
        fit_log(linear(), log_of(y + 0.4 * jump, u), ["plant.k_p"])


def test_a_log_that_is_noisier_than_the_sensor_is_told():
    """As degrees in place of radians are, of a heading that hardly moves."""
    u, y = flight()
    noise = np.random.default_rng(5).normal(size=400)
    for std, told in ((0.01, False), (0.1, True)):
        study = linear(sensor={"kind": "noisy", "position_std": 0.02, "velocity_std": 0.0})
        fitted = fit_log(study, log_of(y + std * noise, u), ["plant.k_p"])
        texts = [doubt.text for doubt in fitted.doubts if "times that of the study's sensor" in doubt.text]
        assert bool(texts) == told


def test_held_outputs_are_taken_where_they_change():
    u, y = flight()
    held = np.repeat(y[::5], 5)
    assert usual_hold(held) == 5
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(drop_repeats(held))), np.arange(0, 400, 5))
    for other in (y, np.round(y, 1), np.round(2.0 * TIMES, 1), np.zeros(400), np.full(400, np.nan)):
        assert usual_hold(other) == 1
    rare = np.where(np.arange(400) % 5 == 0, y, np.nan)
    assert usual_hold(rare) == 1
    names = ("plant.k_p", "plant.a_p")
    taken, expected = (fit_log(linear(), log_of(values, u), names) for values in (held, rare))
    np.testing.assert_allclose(taken.estimates, expected.estimates, rtol=1e-9)
    assert f"y is held for {5 * DT:.3g} s at a time" in "; ".join(doubt.text for doubt in taken.doubts)


def test_a_sensor_that_sticks_is_told():
    """Thirty equal readings among noisy ones; neither the rest of a simulated output nor a coarse scale is that."""
    y = output(1.1, 0.8, flight()[0])
    noisy = y + 0.05 * np.random.default_rng(2).normal(size=400)
    stuck = noisy.copy()
    stuck[100:130] = stuck[100]
    assert stuck_span(Column(TIMES, stuck)) == pytest.approx((TIMES[100], TIMES[129]))
    at_rest = y.copy()
    at_rest[:130] = at_rest[0]
    for other in (noisy, y, at_rest, np.round(noisy, 1), np.repeat(noisy[::20], 20), np.zeros(400)):
        assert stuck_span(Column(TIMES, other)) is None
    log = FlightLog("flight", {"y": Column(TIMES, stuck)}, 0.0)
    told = replay_log(linear(), log, commands=False).hints.factors["y"].text
    assert told.startswith(f"repeats one value from {TIMES[100]:.4g} s to {TIMES[129]:.4g} s of the log")
    later = FlightLog("flight", {"y": Column(TIMES, stuck)}, float(TIMES[130]))  # the part after, as the hint says
    assert "y" not in replay_log(linear(), later, commands=False).hints.factors


def test_a_rate_that_sticks_while_its_output_moves_is_told():
    noise = 0.01 * np.random.default_rng(2).normal(size=(2, len(TIMES)))
    rate = np.cos(TIMES) + noise[0]
    y = np.sin(TIMES) + noise[1]
    rate[100:130] = rate[100]
    assert "repeats one value" in still_text(Column(TIMES, y), Column(TIMES, rate), "y", 0.0, 1e9)
    y[100:130] = y[100]  # nothing moves there: a vehicle on the ground
    assert still_text(Column(TIMES, y), Column(TIMES, rate), "y", 0.0, 1e9) == ""


def test_columns_that_share_a_name_and_cells_that_are_text_are_refused(tmp_path):
    table = tmp_path / "log.csv"
    rows = "".join(f"{DT * k:g},{k},{k}\n" for k in range(30))
    table.write_text(f"t,y,y\n{rows}")
    with pytest.raises(ConfigError, match="has two columns 'y'; rename one of them"):
        read_log(table)
    table.write_text(f"t,y,u_total\n{rows}3,broken,1\n")
    with pytest.raises(ConfigError, match="line 32 has 'broken'"):
        read_log(table)
    table.write_text(f"t,y,u_total\n{rows}")
    assert isinstance(read_log(table).columns["y"], Column)


def test_a_smooth_output_that_sticks_at_speed_is_told_and_one_that_rests_is_not():
    smooth = np.sin(TIMES) + 1e-4 * np.random.default_rng(3).normal(size=len(TIMES))
    stuck = smooth.copy()
    stuck[100:130] = stuck[100]
    assert stuck_span(Column(TIMES, stuck)) == pytest.approx((TIMES[100], TIMES[129]))
    resting = np.concatenate([np.zeros(100), 1.0 - np.cos(TIMES[: len(TIMES) - 100])])
    ended = smooth.copy()
    ended[300:] = ended[300]  # the log goes on after the flight
    for other in (smooth, resting, ended):
        assert stuck_span(Column(TIMES, other)) is None
