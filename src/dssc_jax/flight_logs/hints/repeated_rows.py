"""Rows of a log that a logger has written again: the row before with a later time, or a block of earlier rows.

All signals of a row have to agree with those of the other row. Only rows with a noisy output count, because such values
do not come back by chance.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.flight_logs.reading.reader import Column
from dssc_jax.flight_logs.signal_warnings import Hint

LEAST_ROWS = 50
LEAST_BLOCK = 8  # rows of a block that is copied
MOST_DOUBLED = 0.3  # share of the rows that repeat the one before: more are those of a table that holds its values
MOST_COPIED = 1.0 / 3.0  # share of the rows: more are those of a periodic flight
DIFFERENT = 0.5  # share of the values of y in a block that differ: fewer are those of a coarse scale
TURNING = 0.1  # share of its changes with another sign than the one before: fewer are those of a periodic flight
CHANCE = 5e-3  # probability of as many equal rows by rounding
MOST_DECIMALS = 16
SAME_STEP = 0.02  # of a step: closer, a value is a multiple of it
NAMED = 3  # rows whose times are reported


def common_rows(columns: Mapping[str, Column]) -> tuple[np.ndarray, np.ndarray] | None:
    """The times of a table's rows, shape (n,), and their values, shape (n, signals), y first; None: there is no y.

    Args:
        columns: The logged signals; those that have other times than y are left out.
    """
    outputs = [name for name in columns if name == "y" or name.endswith("_y")]
    if not outputs:
        return None
    time = columns[outputs[0]].time
    others = [name for name in columns if name not in outputs]
    values = [columns[name].value for name in (*outputs, *others) if np.array_equal(columns[name].time, time)]
    return time, np.column_stack(values)


def repeated_rows_hint(columns: Mapping[str, Column]) -> Hint | None:
    """The hint about rows that a log repeats while its clock goes on; None if it certainly repeats none.

    Args:
        columns: The logged signals.
    """
    table = common_rows(columns)
    if table is None or len(table[0]) < LEAST_ROWS or table[1].shape[1] < 2:
        return None
    time, values = table
    is_doubled = doubled_rows(time, values)
    kept = time[~is_doubled]
    block = copied_block(values[~is_doubled])
    if block is not None:
        text = (
            f"goes on while {block.length:,} rows from {kept[block.source]:.6g} s on are written again from "
            f"{kept[block.copy]:.6g} s on, with the same values of all signals: the logger has copied them. Fit a part "
            "of the log without the copy"
        )
        return Hint("repeated-rows", text)
    count = int(np.count_nonzero(is_doubled))
    if not count or count > MOST_DOUBLED * len(time) or stats.poisson.sf(count - 1, equal_by_chance(values)) > CHANCE:
        return None
    rows = np.flatnonzero(is_doubled)
    moments = " and ".join(f"{moment:.6g} s" for moment in time[rows[:NAMED]])
    if count > NAMED:
        moments += f" and {count - NAMED:,} more times"
    noun = "row repeats" if count == 1 else "rows repeat"
    text = (
        f"goes on while {count:,} {noun} all values of the row before, at {moments}: the logger has written them "
        "twice. Leave such rows out; if the clock counts rows, the later ones are late"
    )
    return Hint("repeated-rows", text)


def doubled_rows(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Whether each row repeats all values of the row before at a later time, while y changes around it, shape (n,).

    Args:
        time: Times of the rows [s], shape (n,).
        values: Values of all signals, y first, shape (n, signals).
    """
    sizes = np.abs(np.diff(values[:, 0]))
    usual = float(np.median(sizes))
    is_equal = (values[1:] == values[:-1]).all(axis=1) & (np.diff(time) > 0.0)
    around = np.zeros(len(sizes))
    around[1:-1] = np.where(np.minimum(sizes[:-2], sizes[2:]) > 0.0, sizes[:-2] + sizes[2:], 0.0)
    return np.append(False, is_equal & (around > usual))


def equal_by_chance(values: np.ndarray) -> float:
    """The number of rows that rounding alone may make equal to the row before, by the signal with the finest digits.

    A change by normal noise is within half a digit of 0 with a probability of 0.27 times the digit over the median size
    of the change. The larger factor 0.5 is taken.

    Args:
        values: Values of all signals, shape (n, signals).
    """
    expected = []
    for column in values.T:
        usual = float(np.median(np.abs(np.diff(column))))
        expected.append(0.5 * len(column) * resolution(column) / usual if usual > 0.0 else np.inf)
    return min(expected)


def resolution(values: np.ndarray) -> float:
    """The last decimal digit of values, or the step of which all are multiples, if larger; 0 if no digits are lost."""
    digit = 0.0
    for decimals in range(MOST_DECIMALS):
        with np.errstate(over="ignore", invalid="ignore"):  # digits of huge values overflow, and are none
            rounded = np.round(values, decimals)
        if np.isfinite(rounded).all() and np.allclose(rounded, values, rtol=1e-13, atol=0.0):
            digit = 10.0**-decimals
            break
    levels = np.unique(values)
    if len(levels) < 2:
        return np.inf
    step = float(np.diff(levels).min())
    multiples = (levels - levels[0]) / step
    return max(digit, step) if np.abs(multiples - np.round(multiples)).max() < SAME_STEP else digit


class CopiedBlock(NamedTuple):
    """A block of rows that a table has twice.

    Args:
        source: Index of the first row of the block.
        copy: Index of the first row of the later copy.
        length: Number of rows of the block.
    """

    source: int
    copy: int
    length: int


def copied_block(values: np.ndarray) -> CopiedBlock | None:
    """The longest block with a noisy y that is copied to later rows; None if none is, or too many rows are repeated.

    Args:
        values: Values of all signals, shape (n, signals).
    """
    _, numbers = np.unique(values, axis=0, return_inverse=True)
    numbers = np.ravel(numbers)
    first_row = np.full(numbers.max() + 1, -1)
    sources = np.full(len(numbers), -1)
    for row, number in enumerate(numbers.tolist()):
        sources[row] = first_row[number]
        if first_row[number] < 0:
            first_row[number] = row
    goes_on = (sources[:-1] >= 0) & (np.diff(sources) == 1)
    begins, ends = flag_runs(goes_on)
    if not begins.size:
        return None
    longest = int(np.argmax(ends - begins))
    length = int(ends[longest] - begins[longest]) + 1
    target = int(begins[longest])
    if length < LEAST_BLOCK or np.count_nonzero(goes_on) > MOST_COPIED * len(values):
        return None
    y = values[target : target + length, 0]
    is_noisy = np.mean(np.diff(np.sign(np.diff(y))) != 0.0) >= TURNING
    is_varied = len(np.unique(y)) > DIFFERENT * length
    return CopiedBlock(int(sources[target]), target, length) if is_noisy and is_varied else None
