"""Numbers that stand for missing values in a log, such as -9999."""

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.flag_runs import flag_runs

LEAST_REPEATED = 3  # readings of one value that may stand for missing ones
LEAST_OTHERS = 10  # different values of the others: a signal of few levels has none that is far from all others
FAR = 10.0  # factor on the range of the others: a farther value is no reading
OUTSTANDING = 10.0  # factor on the usual change between readings: a farther value than both neighbours is no reading
LONGEST_DROPOUT = 10  # readings of a dropout to 0 or to a customary number; to another value it has one
MOSTLY = 0.8  # share of a placeholder's readings that are so far from their neighbours
NINES = tuple(sign * (10.0**digits - 1.0) for digits in range(2, 10) for sign in (-1.0, 1.0))
BINARY = tuple(value for bits in (15, 16, 31, 32) for value in (2.0**bits - 1.0, -(2.0**bits)))
CUSTOMARY = frozenset((*NINES, *BINARY))
"""Numbers that loggers write for missing values: nines, and the ends of the ranges of integers."""


def placeholder(values: np.ndarray, is_output: bool) -> tuple[float, int] | None:
    """The number that stands for missing values in a column, and how often it occurs; None if there is none.

    The number is the lowest or the highest value, and far from all others. A customary number of :data:`CUSTOMARY`
    counts even if it occurs once. Any other number counts only in an output, which does not jump, and only if it comes
    and goes repeatedly. A value to which an output drops again and again counts as well, wherever it lies. Commands and
    references may jump to a value and back, so that only customary numbers count there.

    Args:
        values: The column's values, in any unit, NaN where missing, shape (rows,).
        is_output: Whether the column is a measured output or the derivative of one.
    """
    finite = values[np.isfinite(values)]
    if is_output:
        dropout = dropout_value(finite)
        if dropout is not None:
            return dropout, int(np.count_nonzero(finite == dropout))
    for value in (float(finite.min()), float(finite.max())) if finite.size else ():
        is_value = finite == value
        count = int(np.count_nonzero(is_value))
        others = np.unique(finite[~is_value])
        if len(others) < LEAST_OTHERS:
            continue
        is_far = float(np.abs(others - value).min()) > FAR * float(np.ptp(others))
        comes_and_goes = is_output and count >= LEAST_REPEATED and len(flag_runs(is_value)[0]) > 1
        if is_far and (value in CUSTOMARY or comes_and_goes):
            return value, count
    return None


def dropout_value(values: np.ndarray) -> float | None:
    """The value to which an output jumps again and again, and from which it soon jumps back; None: there is none.

    Args:
        values: The output's readings, all finite, shape (rows,).
    """
    with np.errstate(over="ignore"):
        changes = np.abs(np.diff(values))
    if len(changes) < LEAST_OTHERS or not changes.any():
        return None
    usual_change = float(np.median(changes[changes > 0.0]))
    begins = np.append(0, np.flatnonzero(changes) + 1)  # of runs of one value
    lengths = np.diff(np.append(begins, len(values)))
    is_jump = changes[begins[1:] - 1] > OUTSTANDING * usual_change
    run_values = values[begins[1:-1]]
    longest = np.where(np.isin(run_values, (0.0, *CUSTOMARY)), LONGEST_DROPOUT, 1)
    is_dropout = is_jump[:-1] & is_jump[1:] & (lengths[1:-1] <= longest)
    drops = run_values[is_dropout]
    candidates, counts = np.unique(drops, return_counts=True)
    if not candidates.size:
        return None
    value = float(candidates[int(np.argmax(counts))])
    repeats = int(np.count_nonzero(values == value))
    dropped = int(lengths[1:-1][is_dropout][drops == value].sum())
    is_usual = counts.max() >= LEAST_REPEATED and dropped >= MOSTLY * repeats
    return value if is_usual else None


def require_no_placeholder(name: str, values: np.ndarray) -> None:
    """Require that no number of a column stands for missing values.

    Args:
        name: The signal.
        values: The column's values, NaN where missing, shape (rows,).

    Raises:
        ConfigError: A number does; the message names it.
    """
    found = placeholder(values, name.endswith(("y", "y_dot")))
    if found is not None:
        value, count = found
        readings = "one reading" if count == 1 else f"{count:,} readings"
        raise ConfigError(name, f"holds {value:g} at {readings}, far from the others: leave such cells empty")
