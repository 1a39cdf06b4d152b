"""How unlike a set of independent curves another curve is, with a p-value that is exact for any law of the curves.

One number is computed for each curve, in a way that does not depend on the order of the curves, the tested one among
them. If the tested curve has the law of the others, all n + 1 numbers are exchangeable, so that its rank among them is
uniform (G. A. Barnard, J. Royal Statistical Society B 25 (1963) 294; for curves, M. Myllymäki and others, J. Royal
Statistical Society B 79 (2017) 381-404). Nothing is assumed of how the values of a curve depend on each other.
"""

import numpy as np

FLOOR = 0.05  # of the root mean square over time of a signal's spread: least spread by which departures are measured
LEAST_SPREAD = 1e-6  # of a signal's size: the same where no curve differs from another


def largest_departures(curves: np.ndarray, tested: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest departure of each curve from the median of all, and the tested curve's departures.

    A departure is the distance from the pointwise median in units of the pointwise median absolute deviation, or of
    a floor where the curves hardly differ. Medians are those of all n + 1 curves, which makes the test exact.

    Args:
        curves: Shape (n, signals, times). NaN: the curve has ended, which counts as infinitely far.
        tested: Shape (signals, times). NaN: missing, and left out of all curves.

    Returns:
        Largest departure of each curve, the tested one last, shape (n + 1,); departures of the tested curve, NaN where
        missing, shape (signals, times).

    Raises:
        ValueError: nothing of the tested curve is known.
    """
    known = np.isfinite(tested)
    if not known.any():
        raise ValueError("nothing of the tested curve is known")
    statistics, own = np.zeros(len(curves) + 1), np.full(tested.shape, np.nan)
    for signal in np.flatnonzero(known.any(axis=1)):
        at = known[signal]
        pooled = np.concatenate([curves[:, signal, at], tested[None, signal, at]])
        pooled = np.where(np.isfinite(pooled), pooled, np.nan)
        centre = np.nanmedian(pooled, axis=0)
        spread = np.nanmedian(np.abs(pooled - centre), axis=0)
        size = np.abs(centre).max()
        floor = max(FLOOR * np.sqrt(np.mean(spread**2)), LEAST_SPREAD * size, np.finfo(float).tiny)
        departures = np.abs(pooled - centre) / np.maximum(spread, floor)
        departures[np.isnan(departures)] = np.inf
        statistics = np.maximum(statistics, departures.max(axis=1))
        own[signal, at] = departures[-1]
    return statistics, own


def rank_p_value(statistics: np.ndarray) -> float:
    """The share of numbers that are at least as large as the last one: p <= x has a probability of at most x.

    Example:
        >>> rank_p_value(np.array([1.0, 5.0, 2.0, 4.0]))
        0.5
    """
    return float(np.mean(statistics >= statistics[-1]))
