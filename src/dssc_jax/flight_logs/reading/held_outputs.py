"""Outputs that a log holds between their readings, as the position of a slow receiver in the rows of a fast controller.

A repeated value of an output is no new reading: it is late by up to the time between two readings. A command, in
contrast, may repeat a value because it rests.
"""

import numpy as np

from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.flight_logs.reading.reader import Column

LEAST_STUCK = 5  # equal readings in a row of a noisy output: fewer may be chance
CHANCE = 1e-3  # most runs of equal readings that chance gives in a log, by the share of equal ones elsewhere
LEAST_MOVES = 10  # other readings that differ from the one before: fewer do not tell noise
NOISY = 0.9  # share of the other readings that differ from the one before
TURNING = 0.3  # share of their changes that have another sign than the one before: fewer are those of a smooth output
AT_SPEED = 0.5  # share of the usual change between two readings: a smaller one is nearly rest
LEAST_CHANGES = 10  # of an output that is held: fewer do not tell a rate
REGULAR = 0.9  # least share of the times between two changes that are the usual one, to a sample
DIFFERENT = 0.5  # share of the changes that differ in size: fewer are those of a coarse scale


def usual_hold(values: np.ndarray) -> int:
    """The usual number of samples for which an output is held; 1 if it is not held.

    Args:
        values: The output, NaN where missing, shape (samples,).
    """
    finite_rows = np.flatnonzero(np.isfinite(values))
    differences = np.diff(values[finite_rows])
    changes = np.flatnonzero(differences)
    if len(changes) < LEAST_CHANGES:
        return 1
    steps = np.diff(finite_rows[changes + 1])
    usual_step = int(np.median(steps))
    sizes = np.abs(differences[changes])
    distinct_size_count = len(np.unique(np.round(sizes / sizes.max(), 6)))
    is_regular = np.mean(np.abs(steps - usual_step) <= 1) >= REGULAR
    is_slower = usual_step > int(np.median(np.diff(finite_rows)))
    is_held = is_slower and is_regular and distinct_size_count > DIFFERENT * len(sizes)
    return usual_step if is_held else 1


def drop_repeats(values: np.ndarray) -> np.ndarray:
    """A copy of an output with NaN in place of every value that repeats the finite one before, shape (samples,)."""
    finite_rows = np.flatnonzero(np.isfinite(values))
    repeated_rows = finite_rows[1:][np.diff(values[finite_rows]) == 0.0]
    without_repeats = values.copy()
    without_repeats[repeated_rows] = np.nan
    return without_repeats


def stuck_span(column: Column) -> tuple[float, float] | None:
    """The times between which an output sticks to one value, as that of a stuck sensor does [s]; None: it never does.

    A noisy output never repeats a value for long by chance. A smooth output slows down before it rests, so it sticks
    only if it stops and goes on at speed.
    """
    changes = np.diff(column.value)
    begins, ends = flag_runs(changes == 0.0)
    if not begins.size or np.max(ends - begins) + 1 < LEAST_STUCK:
        return None
    longest = int(np.argmax(ends - begins))
    others = np.delete(changes, np.s_[begins[longest] : ends[longest]])
    moves = others[others != 0.0]
    if len(moves) <= max(LEAST_MOVES, NOISY * len(others)):
        return None
    equal_share = 1.0 - (len(moves) - 1) / len(others)
    if len(changes) * equal_share ** int(ends[longest] - begins[longest]) > CHANCE:
        return None
    is_noisy = np.mean(np.diff(np.sign(moves)) != 0.0) >= TURNING
    if not is_noisy and not stops_at_speed(changes, int(begins[longest]), int(ends[longest])):
        return None
    return float(column.time[begins[longest]]), float(column.time[ends[longest]])


def stops_at_speed(changes: np.ndarray, begin: int, end: int) -> bool:
    """Whether an output stops at a usual speed, and goes on at a usual speed.

    Args:
        changes: Changes of the output from one reading to the next, shape (n,).
        begin: Index of the first change that is 0.
        end: Index of the first change after them that is not 0.
    """
    if begin == 0 or end == len(changes):
        return False
    usual_change = float(np.median(np.abs(changes[changes != 0.0])))
    return min(abs(float(changes[begin - 1])), abs(float(changes[end]))) > AT_SPEED * usual_change
