"""Bisection between values at which a condition holds and values at which it does not."""

from collections.abc import Callable

import numpy as np


def bisect(
    holds: Callable[[np.ndarray], bool | np.ndarray],
    inside: float | np.ndarray,
    outside: float | np.ndarray,
    halvings: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Halve intervals, all at once, so that each one encloses a point at which its condition ceases to hold.

    Args:
        holds: Tells whether the condition holds at the middle of each interval; argument and result have the shape of
            ``inside``.
        inside: The end of each interval at which the condition holds; a number, or shape (n,).
        outside: The other end of each interval, at which the condition fails; same shape, above or below ``inside``.
        halvings: Number of halvings.

    Returns:
        The ends of the halved intervals: first those at which the condition holds, then the others.

    Example:
        >>> inside, outside = bisect(lambda x: x**2 < 2.0, 1.0, 2.0, halvings=20)
        >>> float(inside) < 2.0**0.5 <= float(outside) < float(inside) + 1e-6
        True
    """
    held_at = np.asarray(inside)
    failed_at = np.asarray(outside)
    for _ in range(halvings):
        middle = 0.5 * (held_at + failed_at)
        is_held = holds(middle)
        held_at = np.where(is_held, middle, held_at)
        failed_at = np.where(is_held, failed_at, middle)
    return held_at, failed_at
