"""Missing messages in a log: found by the log's own rate, told in words, and refused by a fit."""

import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.reading.gaps import Gap, gap_text, gaps_of, log_gaps
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

TIME = 0.02 * np.arange(500) + np.random.default_rng(3).uniform(0.0, 0.004, 500)
SINE = np.sin(TIME)


def without(time, value, begin, end):
    kept = (time <= begin) | (time >= end)
    return Column(time[kept], value[kept])


def test_a_gap_is_found_by_the_rate_of_the_signal():
    """Half a second of 10 s is a gap at 50 Hz, three messages are none, and at 1 Hz nothing is missing."""
    column = without(TIME, SINE, 4.001, 4.5)
    ((begin, end),) = gaps_of(column, 0.0, 10.0)
    assert begin == TIME[TIME <= 4.001].max()
    assert end == TIME[TIME >= 4.5].min()
    assert gaps_of(without(TIME, SINE, 4.001, 4.061), 0.0, 10.0) == []
    slow = Column(TIME[::50], SINE[::50])
    assert gaps_of(slow, 0.0, 10.0) == []
    assert len(gaps_of(without(slow.time, slow.value, 2.5, 7.5), 0.0, 10.0)) == 1


def test_signals_without_a_rate_or_a_change_have_no_gap():
    """Messages at changes only come at any time; a value that stays is right while it is held."""
    gaps = np.random.default_rng(5).exponential(1.0, 60)
    assert gaps_of(Column(np.cumsum(gaps), np.arange(60.0)), 0.0, 60.0) == []
    steps = np.where(TIME < 6.0, 1.0, 2.0)
    assert gaps_of(without(TIME, steps, 3.0, 4.0), 0.0, 10.0) == []
    assert len(gaps_of(without(TIME, steps, 5.5, 6.5), 0.0, 10.0)) == 1


def test_a_moving_signal_has_a_gap_even_where_it_comes_back_to_its_value():
    middle = 0.5 * (TIME[TIME <= 4.7][-1] + TIME[TIME >= 5.3][0])
    wave = np.cos(TIME - middle)
    column = without(TIME, wave, 4.7, 5.3)
    before, after = column.value[column.time <= 4.7][-1], column.value[column.time >= 5.3][0]
    assert abs(after - before) < 1e-3 * np.ptp(wave)
    assert len(gaps_of(column, 0.0, 10.0)) == 1


def test_a_late_begin_and_an_early_end_are_gaps():
    (begin, end), (last, until) = gaps_of(Column(TIME[50:400], SINE[50:400]), 0.0, 9.9)
    assert (begin, until) == (0.0, 9.9)
    assert (end, last) == (TIME[50], TIME[399])


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_a_jump_of_the_clock_is_told_from_missing_messages(noise):
    """The signals go on as if no time had passed; one that rests, or noise, leaves it open."""
    value = SINE + noise * np.random.default_rng(1).normal(size=500)
    missing = {"y": without(TIME, value, 4.0, 4.6), "y_ref": without(TIME, np.zeros(500), 4.0, 4.6)}
    time = np.where(TIME > 4.0, TIME + 0.6, TIME)
    jumped = {"y": Column(time, value), "y_ref": Column(time, np.zeros(500))}
    beside = {"y": jumped["y"], "u_total": Column(TIME, value)}
    noisy = {"y": Column(time, value + 0.2 * np.random.default_rng(2).normal(size=500))}
    for columns, is_told in ((missing, False), (jumped, True), (beside, False), (noisy, False)):
        log = FlightLog("flight", columns, 0.0)
        text = gap_text(log, log_gaps(log, ["y"], 9.0), DT)
        assert text.startswith("messages are missing for 0.")
        assert ("or the clock jumped, as the signals go on as if no time had passed, and" in text) == is_told


def test_gaps_of_several_signals_are_told_as_one():
    columns = {"x_u_total": without(TIME, SINE, 4.0, 4.5), "y_u_total": without(TIME, SINE, 4.2, 4.7)}
    log = FlightLog("flight", columns, 0.0)
    (gap,) = log_gaps(log, columns, 9.9)
    assert gap.signals == ("x_u_total", "y_u_total")
    assert gap.end - gap.begin == pytest.approx(0.7, abs=0.05)
    text = gap_text(log, (gap._replace(begin=4.01, end=4.72),), 0.02)
    assert "0.71 s from 4.01 s on (x_u_total, y_u_total)" in text
    assert "loop.duration = 4, or the part after with a start of 4.72 s and a law of the initial state" in text
    many = gap_text(log, tuple(Gap(float(k), k + 0.5, ("x_u_total",)) for k in range(1, 6)), 0.02)
    assert "and 2 more times" in many


def test_a_fit_refuses_a_gap_unless_it_is_allowed():
    """40 of 400 commands are missing, over changes; outputs may be missing."""
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    log = log_of(output(1.1, 0.8, u) + 0.01 * random.normal(size=400), u)
    time = DT * np.arange(400)
    gap = log.columns | {"u_total": without(time, u, 3.99, 4.79)}
    with pytest.raises(ConfigError, match=r"0\.82 s from 3\.98 s on \(u_total\).*loop\.duration = 3\.98"):
        fit_log(linear(), log._replace(columns=gap))
    allowed = fit_log(linear(), log._replace(columns=gap), allow_damaged=True)
    assert any("lack messages for up to 0.82 s" in doubt.text for doubt in allowed.doubts)
    blind = log.columns | {"y": without(time, log.columns["y"].value, 3.99, 4.79)}
    assert fit_log(linear(), log._replace(columns=blind)).doubts == ()
