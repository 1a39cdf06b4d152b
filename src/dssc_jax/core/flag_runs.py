"""Runs of true flags, such as the samples in a row at which something holds."""

import numpy as np


def flag_runs(flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first position of each run of true flags, and the position after its last one.

    Args:
        flags: Shape (n,).

    Returns:
        Two arrays of one length, in order; empty where no flag is true.

    Example:
        >>> [ends.tolist() for ends in flag_runs(np.array([True, False, True, True]))]
        [[0, 2], [1, 4]]
    """
    steps = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return np.flatnonzero(steps > 0), np.flatnonzero(steps < 0)


def longest_run(flags: np.ndarray) -> int:
    """The largest number of true flags in a row; 0 where none is true."""
    begins, ends = flag_runs(flags)
    return int(np.max(ends - begins, initial=0))
