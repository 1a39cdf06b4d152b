"""Outputs that a log holds between their readings, as the position of a slow receiver in the rows of a fast controller.

A reading that is repeated is none: it is late by up to the time between two of them. A command may rest.
"""

import numpy as np

LEAST_CHANGES = 10  # of an output that is held: fewer do not tell a rate
REGULAR = 0.9  # of the times between two changes that are the usual one, to a sample
DIFFERENT = 0.5  # of the changes that differ in size: fewer are those of a coarse scale


def usual_hold(values: np.ndarray) -> int:
    """The samples from one change of an output to the next; 1 if it is not held.

    Args:
        values: The output, NaN where missing, shape (samples,).
    """
    known = np.flatnonzero(np.isfinite(values))
    differences = np.diff(values[known])
    changes = np.flatnonzero(differences)
    if len(changes) < LEAST_CHANGES:
        return 1
    steps = np.diff(known[changes + 1])
    usual = int(np.median(steps))
    sizes = np.abs(differences[changes])
    different = len(np.unique(np.round(sizes / sizes.max(), 6)))
    is_regular = np.mean(np.abs(steps - usual) <= 1) >= REGULAR
    is_held = usual > int(np.median(np.diff(known))) and is_regular and different > DIFFERENT * len(sizes)
    return usual if is_held else 1


def drop_repeats(values: np.ndarray) -> np.ndarray:
    """An output with NaN in place of every value that repeats the one before."""
    known = np.flatnonzero(np.isfinite(values))
    repeated = known[1:][np.diff(values[known]) == 0.0]
    alone = values.copy()
    alone[repeated] = np.nan
    return alone
