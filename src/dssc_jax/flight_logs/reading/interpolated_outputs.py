"""Outputs that a log interpolates between their readings, as a table that was brought to the rate of a controller.

Between two readings such an output is a straight line, which bends at the readings alone. So its second differences are
0, except for rounding, wherever no reading is near, and this pattern has the period of the readings. No vehicle flies
such lines for a whole flight, and no noise leaves them straight.
"""

import numpy as np

from dssc_jax.core.flag_runs import longest_run

LONGEST_PERIOD = 50  # samples
LEAST_BENDS = 20  # at each place of the period: fewer second differences may be alike by chance
STRAIGHT = 0.1  # share of the smallest bend: on a line, second differences are smaller, as rounding makes them
TINY = 1e-300
LARGE = 0.98  # quantile of all second differences, which are those of bends from here on
LEAST_BEND = 0.1  # share of that quantile
LEAST_STRAIGHT = 0.3  # share of the places of a period that lie on lines
LONGEST_BEND = 2  # samples in a row that bend: more are a curve that comes to rest within each period
LEAST_SIZES = 6  # of bends: fewer are those of a command that switches, or of one response again and again
SAME_SIZE = 1e-3  # share of the largest bend
SWITCHING = 0.95  # share of bends with another sign than the one before: more are those of a command that switches


def bends(values: np.ndarray) -> np.ndarray:
    """The places in a period at which an interpolated output bends; empty if it is not interpolated.

    Of two bends in a row, the first one counts for both, because the reading lies between them.

    Args:
        values: The output, NaN where missing, shape (samples,).

    Returns:
        Whether the output bends at each place of the period, shape (period,); sample k has the place k modulo period.
    """
    second_differences = np.full(len(values), np.nan)
    second_differences[1:-1] = np.diff(values, n=2)
    finite_sizes = np.abs(second_differences[np.isfinite(second_differences)])
    if not finite_sizes.size:
        return np.zeros(0, bool)
    least_bend = LEAST_BEND * float(np.quantile(finite_sizes, LARGE))
    for period in range(2, min(LONGEST_PERIOD, len(values) // LEAST_BENDS) + 1):
        by_place = second_differences[: len(values) // period * period].reshape(-1, period)
        if np.count_nonzero(np.isfinite(by_place), axis=0).min() < LEAST_BENDS - 1:
            break
        is_bend = bent_places(np.nanmedian(np.abs(by_place), axis=0), least_bend)
        is_found = is_bend.any() and are_readings(by_place[:, is_bend].ravel())
        if is_found and not are_steps(second_differences, np.resize(is_bend, len(values))):
            return is_bend & ~np.roll(is_bend, 1)
    return np.zeros(0, bool)


def bent_places(sizes: np.ndarray, least_bend: float) -> np.ndarray:
    """Whether each place of a period bends, if all others lie on straight lines; else no place does. Shape (period,).

    Args:
        sizes: The usual size of the second differences at each place, shape (period,).
        least_bend: The least size of a bend: smaller ones are rounding.
    """
    ordered = np.sort(np.maximum(sizes, STRAIGHT * least_bend))
    # The largest ratio of neighbouring sizes separates the lines from the bends.
    smallest_bend = float(ordered[1 + int(np.argmax(ordered[1:] / np.maximum(ordered[:-1], TINY)))])
    is_bend = sizes >= max(smallest_bend, least_bend)
    if least_bend == 0.0 or not is_bend.any() or np.mean(~is_bend) < LEAST_STRAIGHT:
        return np.zeros(len(sizes), bool)
    is_straight = sizes[~is_bend].max() <= STRAIGHT * sizes[is_bend].min()
    is_short = longest_run(np.tile(is_bend, 2)) <= LONGEST_BEND
    return is_bend & (is_straight and is_short)


def are_readings(changes: np.ndarray) -> bool:
    """Whether bends are those of readings, whose sizes and signs vary.

    Args:
        changes: Second differences at the bends, NaN where missing, shape (n,).
    """
    changes = changes[np.isfinite(changes)]
    sizes = np.abs(changes)
    size_count = len(np.unique(np.round(sizes / (SAME_SIZE * sizes.max()))))
    switching_share = np.mean(np.diff(np.sign(changes)) != 0.0)
    return size_count >= LEAST_SIZES and bool(switching_share < SWITCHING)


def are_steps(changes: np.ndarray, is_bend: np.ndarray) -> bool:
    """Whether neighbouring bends have opposite signs, as at a step. A reading between two samples gives equal signs.

    Args:
        changes: Second differences, NaN where missing, shape (samples,).
        is_bend: Whether a sample is at a bend, shape (samples,).
    """
    products = (changes[:-1] * changes[1:])[is_bend[:-1] & is_bend[1:]]
    return bool(np.median(products[np.isfinite(products)]) < 0.0) if np.isfinite(products).any() else False
