"""A rank test of a curve against n independent curves, exact for any law of the curves.

A statistic of each curve is computed in a way that does not depend on the order of the n + 1 curves. If the tested
curve has the law of the others, the n + 1 statistics are exchangeable, so that its rank among them is uniform (G. A.
Barnard, J. Royal Statistical Society B 25 (1963) 294; for curves, M. Myllymäki and others, J. Royal Statistical Society
B 79 (2017) 381-404). Nothing is assumed of how the values of a curve depend on each other.

A curve has several signals over time. The statistic is the extreme rank length of the same article, with signals in
place of points: a curve is extreme if few others depart as far in any of its signals. So all signals count alike, even
beside a signal in which all curves have spikes. With many signals, many curves are the most extreme in some signal. The
gap to the second curve then decides between them (U. Hahn, Scandinavian Journal of Statistics 42 (2015) 1060-1083:
continuous ranks).
"""

from typing import NamedTuple

import numpy as np

FLOOR = 0.05  # least unit of departures, as a share of the root mean square of the spread over time
LEAST_SPREAD = 1e-6  # share of a signal's size below which curves count as equal
ROUNDING = 1e-12  # share of the largest signal's size below which a signal counts as rounding


def spread_signals(curves: np.ndarray, tested: np.ndarray) -> np.ndarray:
    """Whether each signal has spread: at least two of all n + 1 curves differ from the pointwise median in this signal.

    A signal without spread, or one as small as the rounding of the other signals, is left out, because rounding alone
    would decide its ranks. The selection does not depend on the order of the curves, so the test remains exact.

    Args:
        curves: Shape (n, signals, times). NaN: the curve has ended.
        tested: Shape (signals, times). NaN: missing, and left out of all curves.

    Returns:
        Booleans, shape (signals,).
    """
    has_spread = np.zeros(len(tested), bool)
    rounding = ROUNDING * median_sizes(np.concatenate([curves, tested[None]])).max()
    for signal, is_measured in enumerate(np.isfinite(tested)):
        if is_measured.any():
            distance, size = distances_from_median(curves[:, signal, is_measured], tested[signal, is_measured])
            threshold = max(LEAST_SPREAD * size, rounding)
            has_spread[signal] = np.count_nonzero(distance.max(axis=1) > threshold) >= 2
    return has_spread


def median_sizes(curves: np.ndarray) -> np.ndarray:
    """Size of each signal: median over the curves of the largest absolute value over time, shape (signals,).

    Args:
        curves: Shape (n, signals, times); values that are not finite do not count.
    """
    finite = np.where(np.isfinite(curves), np.abs(curves), 0.0)
    return np.median(finite.max(axis=2), axis=0)


def distances_from_median(curves: np.ndarray, tested: np.ndarray) -> tuple[np.ndarray, float]:
    """Distances of all n + 1 curves of a signal from their pointwise median, and the size of the median.

    Args:
        curves: Curves of the draws, shape (n, times); not finite after a curve's end.
        tested: Tested curve, finite, shape (times,).

    Returns:
        - Distances, infinite where a curve has ended, the tested curve last, shape (n + 1, times).
        - Largest absolute value of the median.
    """
    pooled = np.concatenate([curves, tested[None]])
    pooled = np.where(np.isfinite(pooled), pooled, np.nan)
    centre = np.nanmedian(pooled, axis=0)
    distance = np.abs(pooled - centre)
    distance[np.isnan(distance)] = np.inf
    return distance, float(np.abs(centre).max())


def largest_departures(curves: np.ndarray, tested: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest departure of each curve in each signal, and all departures of the tested curve.

    A departure is the distance from the pointwise median, in units of the pointwise median absolute deviation. Where
    the curves hardly differ, the unit is a floor (:data:`FLOOR`, :data:`LEAST_SPREAD`). Medians are taken over all
    n + 1 curves, which makes the test exact. Signals without spread (:func:`spread_signals`) are left out.

    Args:
        curves: Shape (n, signals, times). NaN: the curve has ended, which counts as infinitely far.
        tested: Shape (signals, times). NaN: missing, and left out of all curves.

    Returns:
        - Largest departures, the tested curve last, NaN in a signal without spread, shape (n + 1, signals).
        - Departures of the tested curve, NaN where missing or without spread, shape (signals, times).

    Raises:
        ValueError: No value of the tested curve is finite.
    """
    is_measured = np.isfinite(tested)
    if not is_measured.any():
        raise ValueError("nothing of the tested curve is known")
    largest = np.full((len(curves) + 1, len(tested)), np.nan)
    departures_of_tested = np.full(tested.shape, np.nan)
    for signal in np.flatnonzero(spread_signals(curves, tested)):
        times = is_measured[signal]
        distance, size = distances_from_median(curves[:, signal, times], tested[signal, times])
        finite_distance = np.where(np.isinf(distance), np.nan, distance)
        spread = np.nanmedian(finite_distance, axis=0)
        typical_spread = np.sqrt(np.mean(spread**2))
        if typical_spread == 0.0:  # most curves are equal at every time
            typical_spread = np.sqrt(np.nanmean(finite_distance**2))
        floor = max(FLOOR * typical_spread, LEAST_SPREAD * size)
        departures = distance / np.maximum(spread, floor)
        largest[:, signal] = departures.max(axis=1)
        departures_of_tested[signal, times] = departures[-1]
    return largest, departures_of_tested


def departure_ranks(largest: np.ndarray) -> np.ndarray:
    """Rank of each curve in each signal: the number of curves, including itself, that depart at least as far.

    Args:
        largest: Largest departures, NaN in a signal without spread, shape (n + 1, signals).

    Returns:
        Ranks from 1, the most extreme, to n + 1, shape (n + 1, signals that have spread).
    """
    columns = []
    for departures in columns_with_spread(largest):
        nearer = np.searchsorted(np.sort(departures), departures)  # curves that depart less
        columns.append(len(departures) - nearer)
    return np.array(columns, int).reshape(len(columns), len(largest)).T  # also without a column


def columns_with_spread(largest: np.ndarray) -> list[np.ndarray]:
    """Largest departures, shape (n + 1,), in each signal that has spread."""
    return [departures for departures in largest.T if not np.isnan(departures).any()]


def continuous_ranks(largest: np.ndarray) -> np.ndarray:
    """Ranks of the curves in each signal, in which the most extreme curve ranks below 1 by its lead.

    The ranks are those of :func:`departure_ranks`, except for a curve that is alone at the first rank. Such a curve has
    the rank exp(-g). The gap g is the lead of the first curve over the second, divided by the distance from the second
    to the last.

    Args:
        largest: Largest departures, NaN in a signal without spread, shape (n + 1, signals).

    Returns:
        Shape (n + 1, signals that have spread).
    """
    ranks = departure_ranks(largest).astype(float)
    for column, departures in enumerate(columns_with_spread(largest)):
        first = int(np.argmax(departures))
        if ranks[first, column] != 1.0:
            continue
        second_departure = float(np.max(np.delete(departures, first)))
        with np.errstate(divide="ignore", invalid="ignore"):
            gap = (departures[first] - second_departure) / (second_departure - float(departures.min()))
        ranks[first, column] = np.exp(-gap) if np.isfinite(gap) else 0.0
    return ranks


def extremeness(largest: np.ndarray) -> np.ndarray:
    """Statistic of each curve for the rank test, larger for a more extreme curve, shape (n + 1,).

    Curves are compared by their smallest continuous rank over the signals, then by their second smallest, and so on.
    Curves with equal ranks are compared by their largest departure. The statistic is the place in this order, 0 for the
    least extreme curve; NaN if no signal has spread.

    Args:
        largest: Largest departures, NaN in a signal without spread, shape (n + 1, signals).

    Example:
        >>> extremeness(np.array([[1.0, 9.0], [3.0, 7.0], [2.0, 8.0]]))
        array([2., 1., 0.])
    """
    ranks = np.sort(continuous_ranks(largest), axis=1)
    if not ranks.shape[1]:
        return np.full(len(largest), np.nan)
    keys = np.column_stack([ranks, -np.nanmax(largest, axis=1)])
    _, place = np.unique(keys, axis=0, return_inverse=True)  # 0: the most extreme
    return float(place.max()) - place.reshape(-1)


def rank_p_value(statistics: np.ndarray) -> float:
    """P-value of the last of n + 1 exchangeable statistics: the share of all that are at least as large.

    Example:
        >>> rank_p_value(np.array([1.0, 5.0, 2.0, 4.0]))
        0.5
    """
    return float(np.mean(statistics >= statistics[-1]))


class Yardstick(NamedTuple):
    """Median and spread of curves, as the unit of departures of further curves.

    Args:
        middle: Pointwise median, shape (signals, times).
        spread: Pointwise median absolute deviation or a floor, shape (signals, times); NaN for a signal without spread.
    """

    middle: np.ndarray
    spread: np.ndarray

    @classmethod
    def of(cls, curves: np.ndarray) -> "Yardstick":
        """Median and spread of curves; a signal has no spread if all of its curves are equal up to rounding.

        Args:
            curves: Shape (n, signals, times); at least one must be finite at each time.
        """
        finite = np.where(np.isfinite(curves), curves, np.nan)
        middle = np.nanmedian(finite, axis=0)
        distance = np.abs(finite - middle)
        spread = np.nanmedian(distance, axis=0)
        size = np.abs(middle).max(axis=1, keepdims=True)
        floor = FLOOR * np.sqrt(np.mean(spread**2, axis=1, keepdims=True))
        spread = np.maximum(spread, np.maximum(floor, LEAST_SPREAD * size))
        threshold = np.maximum(LEAST_SPREAD * size[:, 0], ROUNDING * median_sizes(curves).max())
        has_no_spread = np.nanmax(distance, axis=(0, 2)) <= threshold
        spread[has_no_spread] = np.nan
        return cls(middle, spread)

    def largest_departure(self, curve: np.ndarray, is_measured: np.ndarray) -> float:
        """Largest distance of a curve from the median, in units of the spread; infinite if the curve has ended.

        Args:
            curve: Shape (signals, times).
            is_measured: Which values to compare, shape (signals, times); at least one must have spread.
        """
        is_compared = is_measured & np.isfinite(self.spread)
        departures = np.abs(curve - self.middle)[is_compared] / self.spread[is_compared]
        return float(np.where(np.isfinite(departures), departures, np.inf).max())
