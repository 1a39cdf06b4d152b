"""Statements about probabilities that hold at the confidence they print."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv

CONFIDENCE = 0.95


def clopper_pearson(failures: ArrayLike, draws: ArrayLike, confidence: float = CONFIDENCE) -> np.ndarray:
    """Exact two-sided interval of a failure probability from independent, identically distributed draws.

    L = B^-1(a/2; k, n-k+1), U = B^-1(1-a/2; k+1, n-k) with a = 1 - confidence; L = 0 at k = 0, U = 1 at k = n.

    Args:
        failures: k, any shape.
        draws: n >= 1, broadcastable.
        confidence: Coverage, in (0, 1).

    Returns:
        Shape (..., 2): lower and upper bound.

    Raises:
        ValueError: k or n is out of range.

    Example:
        >>> clopper_pearson(10, 100).round(6)
        array([0.049005, 0.176223])

    Reference:
        C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404-413.
    """
    k, n = np.broadcast_arrays(np.asarray(failures), np.asarray(draws))
    if np.any(n < 1) or np.any(k < 0) or np.any(k > n):
        raise ValueError(f"needs 0 <= failures <= draws and draws >= 1, got {failures} of {draws}")
    tail = 0.5 * (1.0 - confidence)
    lower = np.where(k > 0, betaincinv(np.maximum(k, 1), n - k + 1, tail), 0.0)
    upper = np.where(k < n, betaincinv(k + 1, np.maximum(n - k, 1), 1.0 - tail), 1.0)
    return np.stack([lower, upper], axis=-1)


def describe_probability(failures: int, draws: int, confidence: float = CONFIDENCE) -> str:
    """One line for people. No failure in n is told by its upper bound, never as 0."""
    low, high = clopper_pearson(failures, draws, confidence)
    level = f"{100 * confidence:g} % Clopper-Pearson"
    if failures == 0:
        return f"no failure in {draws} draws: failure probability <= {high:.3g} ({level})"
    found = f"{failures / draws:.3g} in [{low:.3g}, {high:.3g}]"
    return f"{failures} failures in {draws} draws: failure probability {found} ({level})"
