"""Rows that a logger has written twice, and blocks that it has copied; honest logs repeat none."""

import numpy as np
import pytest

from dssc_jax.flight_logs.hints.repeated_rows import repeated_rows_hint
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.fit.test_fit import linear

DT = 0.02


def table(seed=0, rows=300, decimals=7):
    """The rows of a flight, y and u, with noise in y, rounded."""
    random = np.random.default_rng(seed)
    y = np.sin(DT * np.arange(rows)) + 0.01 * random.normal(size=rows)
    return np.round(np.column_stack([y, -2.0 * y]), decimals)


def columns_of(values):
    """The columns of rows, whose clock goes on."""
    time = DT * np.arange(len(values))
    return {"y": Column(time, values[:, 0]), "u_total": Column(time, values[:, 1])}


def told(values):
    """What is said of rows; empty if nothing is."""
    hint = repeated_rows_hint(columns_of(values))
    return "" if hint is None else hint.text


def test_rows_that_are_written_twice_are_told():
    rows = np.sort(np.append(np.arange(300), [50, 120, 123, 200]))
    text = told(table()[rows])
    assert "rows repeat all values of the row before, at 2.44 s and 2.52 s" in text
    single = told(np.insert(table(), 80, table()[79], axis=0))
    assert single.startswith("goes on while 1 row repeats all values of the row before, at 1.6 s:")


def test_a_block_that_is_copied_is_told():
    values = table()
    copied = np.concatenate([values[:200], values[100:140], values[200:]])
    text = told(copied)
    assert text.startswith("goes on while 40 rows from 2 s on are written again from 4 s on, with the same values")
    overwritten = values.copy()
    overwritten[200:240] = values[100:140]
    assert "40 rows from 2 s on are written again from 4 s on" in told(overwritten)


def test_a_comparison_warns_of_them():
    values = np.insert(table(), 80, table()[79], axis=0)
    replay = replay_log(linear(), FlightLog("flight", columns_of(values), 0.0))
    assert "repeated-rows" in [warning.code for warning in replay.warnings]


@pytest.mark.parametrize("seed", range(10))
def test_honest_logs_repeat_none(seed):
    """Fine and coarse digits, rest before the start, values that are held, a periodic flight without noise."""
    values = table(seed)
    rows = np.arange(300)
    at_rest = np.where(rows[:, None] < 100, 0.0, values)
    period = np.round(np.sin(2.0 * np.pi * rows / 50.0), 6)
    for honest in (
        values,
        table(seed, decimals=4),
        table(seed, decimals=3),
        table(seed, decimals=2),
        table(seed, decimals=1),
        at_rest,
        values[rows // 5 * 5],
        values[rows // 2 * 2],
        np.column_stack([period, period]),
        np.zeros((300, 2)),
        np.round(np.exp(-0.05 * rows[:, None]) * [1.0, -2.0], 4),
    ):
        assert told(honest) == ""
    assert repeated_rows_hint({"y": columns_of(values)["y"]}) is None
    assert repeated_rows_hint({"u_total": columns_of(values)["u_total"]}) is None
