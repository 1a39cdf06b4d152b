"""The difference of a curve from a set of independent curves, with a p-value that is exact for any law of the curves.

One number is computed for each curve, in a way that does not depend on the order of the curves, the tested one among
them. If the tested curve has the law of the others, all n + 1 numbers are exchangeable, so that its rank among them is
uniform (G. A. Barnard, J. Royal Statistical Society B 25 (1963) 294; for curves, M. Myllymäki and others, J. Royal
Statistical Society B 79 (2017) 381-404). Nothing is assumed of how the values of a curve depend on each other.

The number is the curve's place in the order of extreme rank lengths of the same article, with a signal in the place
of a point: a curve is extreme where few others depart as far in one of its signals. So every signal counts alike, also
beside one in which all curves have spikes. With many signals, many curves are the first in one of them; how far such a
curve is beyond the second one decides between them (U. Hahn, Scandinavian Journal of Statistics 42 (2015) 1060-1083:
continuous ranks).
"""

from typing import NamedTuple

import numpy as np

FLOOR = 0.05  # of the root mean square over time of a signal's spread: least spread by which departures are measured
LEAST_SPREAD = 1e-6  # share of a signal's size: curves that differ by less are the same
ROUNDING = 1e-12  # share of the largest signal's size: a signal that is no larger is rounding


def spread_signals(curves: np.ndarray, tested: np.ndarray) -> np.ndarray:
    """Signals in which at least two of all n + 1 curves differ from their pointwise median.

    In the other signals the curves are the same but for one. A rank there tells nothing: rounding alone would decide
    it. Nor does a signal tell anything whose curves are rounding beside the other signals. Which signals these are does
    not depend on the order of the curves, so the test remains exact.

    Args:
        curves: Shape (n, signals, times). NaN: the curve has ended.
        tested: Shape (signals, times). NaN: missing, and left out of all curves.

    Returns:
        Shape (signals,).
    """
    spread = np.zeros(len(tested), bool)
    rounding = ROUNDING * usual_sizes(np.concatenate([curves, tested[None]])).max()
    for signal, is_measured in enumerate(np.isfinite(tested)):
        if is_measured.any():
            distance, size = distances_from_median(curves[:, signal, is_measured], tested[signal, is_measured])
            least = max(LEAST_SPREAD * size, rounding)
            spread[signal] = np.count_nonzero(distance.max(axis=1) > least) >= 2
    return spread


def usual_sizes(curves: np.ndarray) -> np.ndarray:
    """The median over all curves of their largest absolute value, by signal; shapes (n, signals, times), (signals,)."""
    finite = np.where(np.isfinite(curves), np.abs(curves), 0.0)
    return np.median(finite.max(axis=2), axis=0)


def distances_from_median(curves: np.ndarray, tested: np.ndarray) -> tuple[np.ndarray, float]:
    """Distances of all n + 1 curves of a signal from their pointwise median, that of the finite values.

    Args:
        curves: Curves of the draws, shape (n, times); not finite after a curve's end.
        tested: The tested curve, finite, shape (times,).

    Returns:
        The distances, infinite where a curve has ended, shape (n + 1, times), those of the tested curve in the last
        row; the largest absolute value of the median.
    """
    pooled = np.concatenate([curves, tested[None]])
    pooled = np.where(np.isfinite(pooled), pooled, np.nan)
    centre = np.nanmedian(pooled, axis=0)
    distance = np.abs(pooled - centre)
    distance[np.isnan(distance)] = np.inf
    return distance, float(np.abs(centre).max())


def largest_departures(curves: np.ndarray, tested: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest departure of each curve from the median of all in each signal, and the tested curve's departures.

    A departure is the distance from the pointwise median in units of the pointwise median absolute deviation, or of
    a floor where the curves hardly differ. Medians are those of all n + 1 curves, which makes the test exact. Signals
    without spread (:func:`spread_signals`) are left out.

    Args:
        curves: Shape (n, signals, times). NaN: the curve has ended, which counts as infinitely far.
        tested: Shape (signals, times). NaN: missing, and left out of all curves.

    Returns:
        Largest departure of each curve, the tested one last, NaN in a signal without spread, shape (n + 1, signals);
        departures of the tested curve, NaN where missing or without spread, shape (signals, times).

    Raises:
        ValueError: nothing of the tested curve is known.
    """
    is_measured = np.isfinite(tested)
    if not is_measured.any():
        raise ValueError("nothing of the tested curve is known")
    largest = np.full((len(curves) + 1, len(tested)), np.nan)
    departures_of_tested = np.full(tested.shape, np.nan)
    for signal in np.flatnonzero(spread_signals(curves, tested)):
        at = is_measured[signal]
        distance, size = distances_from_median(curves[:, signal, at], tested[signal, at])
        finite = np.where(np.isinf(distance), np.nan, distance)
        spread = np.nanmedian(finite, axis=0)
        scale = np.sqrt(np.mean(spread**2)) or np.sqrt(np.nanmean(finite**2))
        departures = distance / np.maximum(spread, max(FLOOR * scale, LEAST_SPREAD * size))
        largest[:, signal] = departures.max(axis=1)
        departures_of_tested[signal, at] = departures[-1]
    return largest, departures_of_tested


def departure_ranks(largest: np.ndarray) -> np.ndarray:
    """The number of curves that depart at least as far as each curve in each signal, itself among them.

    Args:
        largest: Largest departures, NaN in a signal without spread, shape (n + 1, signals).

    Returns:
        Ranks from 1, the most extreme, to n + 1, shape (n + 1, signals that have spread).
    """
    columns = []
    for departures in largest.T:
        if not np.isnan(departures).any():
            columns.append(len(departures) - np.searchsorted(np.sort(departures), departures))
    return np.array(columns, int).reshape(len(columns), len(largest)).T


def continuous_ranks(largest: np.ndarray) -> np.ndarray:
    """The ranks by :func:`departure_ranks`, with a share of 1 for the curve that is alone at the first rank.

    The share is exp(-g), where g is its gap from the second curve over that curve's distance from the last one.

    Args:
        largest: Largest departures, NaN in a signal without spread, shape (n + 1, signals).
    """
    ranks = departure_ranks(largest).astype(float)
    signals = [departures for departures in largest.T if not np.isnan(departures).any()]
    for column, departures in enumerate(signals):
        first = int(np.argmax(departures))
        second = float(np.max(np.delete(departures, first)))
        if ranks[first, column] == 1.0:
            with np.errstate(divide="ignore", invalid="ignore"):
                gap = (departures[first] - second) / (second - float(departures.min()))
            ranks[first, column] = np.exp(-gap) if np.isfinite(gap) else 0.0
    return ranks


def extremeness(largest: np.ndarray) -> np.ndarray:
    """Numbers that order curves by how few others depart as far in one of their signals, then in the next one.

    Curves are compared by their ranks, the least one first; those of equal ranks by their largest departure.

    Args:
        largest: Largest departures, NaN in a signal without spread, shape (n + 1, signals).

    Returns:
        Shape (n + 1,), larger for a more extreme curve; NaN without a signal that has spread.

    Example:
        >>> extremeness(np.array([[1.0, 9.0], [3.0, 7.0], [2.0, 8.0]]))
        array([2., 1., 0.])
    """
    ranks = np.sort(continuous_ranks(largest), axis=1)
    if not ranks.shape[1]:
        return np.full(len(largest), np.nan)
    keys = np.column_stack([ranks, -np.nanmax(largest, axis=1)])
    _, order = np.unique(keys, axis=0, return_inverse=True)
    return float(order.max()) - order.reshape(-1)


def rank_p_value(statistics: np.ndarray) -> float:
    """The share of numbers that are at least as large as the last one: p <= x has a probability of at most x.

    Example:
        >>> rank_p_value(np.array([1.0, 5.0, 2.0, 4.0]))
        0.5
    """
    return float(np.mean(statistics >= statistics[-1]))


class Yardstick(NamedTuple):
    """The middle and the spread of curves, from draws that are not compared themselves.

    Args:
        middle: Pointwise median, shape (signals, times).
        spread: Pointwise median absolute deviation, or a floor, shape (signals, times); NaN: a signal without spread.
    """

    middle: np.ndarray
    spread: np.ndarray

    @classmethod
    def of(cls, curves: np.ndarray) -> "Yardstick":
        """The yardstick of some curves, shape (n, signals, times), of which at least one runs at each time."""
        finite = np.where(np.isfinite(curves), curves, np.nan)
        middle = np.nanmedian(finite, axis=0)
        distance = np.abs(finite - middle)
        spread = np.nanmedian(distance, axis=0)
        size = np.abs(middle).max(axis=1, keepdims=True)
        floor = FLOOR * np.sqrt(np.mean(spread**2, axis=1, keepdims=True))
        spread = np.maximum(spread, np.maximum(floor, LEAST_SPREAD * size))
        least = np.maximum(LEAST_SPREAD * size[:, 0], ROUNDING * usual_sizes(curves).max())
        constant = np.nanmax(distance, axis=(0, 2)) <= least
        spread[constant] = np.nan
        return cls(middle, spread)

    def largest_departure(self, curve: np.ndarray, is_measured: np.ndarray) -> float:
        """The largest distance of a curve from the middle, in units of the spread; infinite where it has ended.

        Args:
            curve: Shape (signals, times).
            is_measured: Which values are compared, shape (signals, times); at least one has spread.
        """
        is_compared = is_measured & np.isfinite(self.spread)
        departures = np.abs(curve - self.middle)[is_compared] / self.spread[is_compared]
        return float(np.where(np.isfinite(departures), departures, np.inf).max())
