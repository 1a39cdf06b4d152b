"""Times that are no seconds: the message names the unit, and the scale that makes seconds of it."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.reading.columns import TimeSource
from dssc_jax.flight_logs.reading.coverage import time_unit_text
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from tests.flight_logs.fit.test_fit import DT, linear

TIME = DT * np.arange(400)
BEGIN = 1.7e9  # s since 1970


SECONDS = TimeSource()


def log_at(time, clock=SECONDS):
    """A log of both signals at some times."""
    signals = {"y": Column(time, np.sin(TIME)), "u_total": Column(time, np.cos(3.0 * TIME))}
    return FlightLog("flight", signals, float(time[0]), clock=clock)


@pytest.mark.parametrize(("unit", "size"), [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)])
def test_times_since_1970_are_named_with_their_scale(unit, size):
    """By comparison and fit, also where the log is so rare that the time between values tells no unit."""
    told = (
        rf'its times are {unit} since 1970. They must be in seconds: give time = {{ column = "t", scale = {1 / size:g}'
    )
    log = log_at(size * (BEGIN + TIME))
    with pytest.raises(ConfigError, match=told):
        dj.compare_log(linear(draws=19), log)
    with pytest.raises(ConfigError, match=told):
        fit_log(linear(), log)
    with pytest.raises(ConfigError, match=told):
        fit_log(linear(), log_at(size * (BEGIN + 3600.0 * TIME)))


def test_seconds_since_1970_are_seconds():
    assert time_unit_text(log_at(BEGIN + TIME), DT) == ""


def test_a_scale_that_is_wrong_is_corrected():
    """Microseconds, which a table of columns takes for milliseconds."""
    log = log_at(1e3 * TIME, TimeSource("time_us", 1e-3))
    assert (
        'are its times in milliseconds? They must be in seconds: give time = { column = "time_us", scale = 1e-06 }'
        in (time_unit_text(log, DT))
    )
