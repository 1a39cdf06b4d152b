"""Swept parameters that affect no requirement, and the influence of uncertain parameters on failure."""

from operator import itemgetter

import numpy as np
import xarray as xr

from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.results.result import Result, headline_measure
from dssc_jax.statistics.order import upper_quantiles

IDLE_CHANGE = 0.01
"""Relative change of a metric's quantiles along an axis, up to which the axis counts as without effect."""
QUANTILES = (0.05, 0.5, 0.95)  # levels
MAX_BINS = 8
MIN_DRAWS_PER_BIN = 5


def idle_axes(result: Result) -> list[str]:
    """List the swept parameters that affect no requirement.

    Along the axis of such a parameter, with the other swept numbers fixed, no draw changes between pass and fail. No
    quantile (5, 50, 95 %) of a required metric changes by more than 1 %. If the study has no requirements, the headline
    metric takes the place of the required ones.
    """
    axes = [name for name in result.study.axes if result.dataset.sizes.get(name, 1) > 1]
    return [name for name in axes if is_idle(result, name)]


def is_idle(result: Result, axis: str) -> bool:
    """Whether a swept parameter affects no requirement, as :func:`idle_axes` defines it."""
    failed = result.failed
    failed_at_first_value = failed.isel({axis: 0})
    if bool((failed != failed_at_first_value).any()):
        return False
    measures = {requirement.measure.name: requirement.measure for requirement in result.study.requirements}
    if not measures:
        headline = headline_measure(result.study)
        measures = {headline.name: headline}
    return all(largest_change_of(result, measure, axis) <= IDLE_CHANGE for measure in measures.values())


def largest_change_of(result: Result, measure: Measure, axis: str) -> float:
    """Compute the largest relative change of a measure's quantiles along an axis; see :func:`largest_change`."""
    return largest_change(result.dataset[measure.name], axis, measure.metric.worst)


def largest_change(metric: xr.DataArray, axis: str, missing: float = np.inf) -> float:
    """Compute the largest relative change of a metric's quantiles along an axis.

    The change is relative to the quantile's largest magnitude along the axis, with the other axes fixed. It is infinite
    if a quantile is finite at some values of the axis only.

    Args:
        metric: Value of the metric in each draw at each point.
        axis: Name of the axis.
        missing: Value in place of NaN, which stands for a draw without a value.
    """
    metric_values = metric.transpose(axis, ..., "draw").values
    quantiles = upper_quantiles(metric_values, QUANTILES, missing)  # shape (levels, values of the axis, ...)
    finite = np.isfinite(quantiles)
    partly_finite = finite.any(axis=1) != finite.all(axis=1)
    if partly_finite.any():
        return float("inf")
    quantiles = np.where(finite, quantiles, 0.0)
    spread = np.ptp(quantiles, axis=1)
    scale = np.max(np.abs(quantiles), axis=1)
    relative_changes = np.divide(spread, scale, out=np.zeros_like(spread), where=scale > 0.0)
    return float(np.max(relative_changes, initial=0.0))


def idle_text(result: Result) -> str:
    """State which axes of a sweep affect no requirement; empty if every axis affects a requirement."""
    return "; ".join(idle_axis_text(result, name) for name in idle_axes(result))


def idle_axis_text(result: Result, axis: str) -> str:
    """State that an axis affects no requirement, and which metric changes most along the axis, if any changes."""
    changes = {measure.name: largest_change_of(result, measure, axis) for measure in result.study.measures}
    if max(changes.values()) <= IDLE_CHANGE:
        limit = f"{100 * IDLE_CHANGE:g} %"
        return f"over {axis} no verdict changes, and no quantile (5, 50, 95 %) of a metric by more than {limit}"
    metric, change = max(changes.items(), key=itemgetter(1))
    extent = f"by {change:.0%}" if np.isfinite(change) else "in some draws from finite to infinite"
    return f"{axis} is idle here: no verdict and no required metric changes over it (most changes {metric}, {extent})"


def equal_count_bins(values: np.ndarray) -> list[np.ndarray]:
    """Split the draws into bins of nearly equal size by increasing value; return the indices of each bin's draws.

    Draws of equal values share a bin. If there are only a few different values, as with the law ``choice``, each value
    has a bin of its own.

    Args:
        values: Value of the number in each draw, shape (draws,).

    Example:
        >>> [draws.tolist() for draws in equal_count_bins(np.array([1.0, 0.5, 1.0, 1.0, 0.5]))]
        [[1, 4], [0, 2, 3]]
    """
    order = np.argsort(values, kind="stable")
    first_places = np.flatnonzero(np.diff(values[order], prepend=-np.inf))  # of each value, in sorted order
    few_repeat = len(first_places) <= MAX_BINS and 2 * len(first_places) <= values.size
    cuts = first_places[1:] if few_repeat else equal_count_cuts(first_places, values.size)
    return np.split(order, cuts)


def equal_count_cuts(first_places: np.ndarray, draws: int) -> np.ndarray:
    """Places in the sorted draws at which the second and all further bins begin.

    The bins are of nearly equal size, and draws of equal values stay together.

    Args:
        first_places: Place in the sorted draws at which each different value begins, ascending from 0.
        draws: Number of draws.
    """
    bins = max(1, min(MAX_BINS, draws // MIN_DRAWS_PER_BIN))
    sizes = [len(places) for places in np.array_split(np.arange(draws), bins)]
    ends = np.append(first_places, draws)
    cuts = np.cumsum(sizes)[:-1]
    after = np.searchsorted(ends, cuts)  # the next value begins at the cut or after it
    above = ends[after]
    below = ends[np.maximum(after - 1, 0)]
    nearest = np.unique(np.where(above - cuts <= cuts - below, above, below))
    return nearest[(nearest > 0) & (nearest < draws)]


def influence(result: Result, name: str) -> float:
    """Estimate the share of the variance of failure that an uncertain number explains, in [0, 1].

    The share is the correlation ratio over bins of the number, minus the share that as many bins explain by chance. If
    no draw or every draw fails, the ranks of the headline metric take the place of failure. A draw without a value of
    this metric then counts as the metric's worst value.

    Args:
        result: A run, or a point of a sweep (:meth:`Result.at`).
        name: The uncertain number's dotted name.
    """
    outcome = result.failed.values.astype(float)
    if outcome.min() == outcome.max():
        measure = headline_measure(result.study)
        outcome = mean_ranks(result.dataset[measure.name].values, measure.metric.worst)
    bins = equal_count_bins(result.dataset[name].values)
    squares = float(np.sum((outcome - outcome.mean()) ** 2))
    if squares == 0.0 or len(bins) < 2:
        return 0.0
    explained_squares = sum(len(draws) * (outcome[draws].mean() - outcome.mean()) ** 2 for draws in bins)
    explained_by_chance = (len(bins) - 1) / max(1, outcome.size - 1)
    return float(max(0.0, explained_squares / squares - explained_by_chance))


def mean_ranks(values: np.ndarray, missing: float) -> np.ndarray:
    """Rank the draws from 0 on by increasing value; equal values share the mean of their ranks.

    Args:
        values: Value of each draw, shape (draws,).
        missing: Value in place of NaN.

    Example:
        >>> mean_ranks(np.array([5.0, np.nan, 7.0, np.nan]), -np.inf)
        array([2. , 0.5, 3. , 0.5])
    """
    complete = np.where(np.isnan(values), missing, values)
    sorted_values = np.sort(complete)
    first, end = (np.searchsorted(sorted_values, complete, side=side) for side in ("left", "right"))
    return 0.5 * (first + end - 1)


def sorted_by_influence(result: Result, names: list[str]) -> list[str]:
    """Sort uncertain numbers by their influence on failure, the most influential first."""
    return sorted(names, key=lambda name: -influence(result, name))
