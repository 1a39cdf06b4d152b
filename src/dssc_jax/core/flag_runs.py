"""Runs of true flags, such as consecutive samples at which a condition holds."""

import numpy as np


def flag_runs(flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find where each run of consecutive true flags begins and ends.

    Args:
        flags: Shape (n,).

    Returns:
        The position at which each run begins, and the position after its end, shape (runs,) each.

    Example:
        >>> [ends.tolist() for ends in flag_runs(np.array([True, False, True, True]))]
        [[0, 2], [1, 4]]
    """
    steps = np.diff(np.concatenate([[0], flags.astype(int), [0]]))  # 1 where a run begins, -1 after its end
    return np.flatnonzero(steps > 0), np.flatnonzero(steps < 0)


def longest_run(flags: np.ndarray) -> int:
    """Return the length of the longest run of true flags, shape (n,); 0 if no flag is true."""
    begins, ends = flag_runs(flags)
    return int(np.max(ends - begins, initial=0))
