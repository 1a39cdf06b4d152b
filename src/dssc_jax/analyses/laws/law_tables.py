"""The dataset of how wrong the laws may be: a table of the laws, and curves over changes of all of them."""

from dataclasses import replace
from typing import TypeAlias

import numpy as np
import xarray as xr
from scipy import special

from dssc_jax.analyses.laws.all_changes import AllChanges
from dssc_jax.analyses.laws.answer import DEVIATIONS
from dssc_jax.core.quantities import unit_and_meaning
from dssc_jax.results.scored_draws import ScoredDraws
from dssc_jax.statistics.any_failures import AnyFailures
from dssc_jax.statistics.order import quantile_interval
from dssc_jax.statistics.partition import part_information
from dssc_jax.statistics.worst_changes import WeightedDraws, largest_change

TABLE = "number"
KNOWLEDGE = {
    "parts": "parts of equal probability of a law",
    "removed": "share of the variance of failure that knowing the part removes",
    "removed_low": "its lower limit",
    "removed_high": "its upper limit",
    "changes": "probability that knowing the part changes the decision",
    "changes_low": "its lower limit",
    "changes_high": "its upper limit",
}
"""Columns of what knowing a number is worth, with their meanings."""

FAILING = {"failing_low": 0.05, "failing_median": 0.5, "failing_high": 0.95}
"""Columns of levels in failed draws, with the quantile of each."""

MEDIAN_ENDS = ("failing_median_low", "failing_median_high")
"""Columns of the ends of the interval of the median level in failed draws."""

Column: TypeAlias = tuple[str, np.ndarray, dict[str, str]]
"""Dimension, values and attributes of a variable."""

CLEAR = 2.0  # standard deviations of a mean score that could also be 0
LARGER = 1
SMALLER = -1
NOT_CLEAR = 0
DIRECTIONS = {LARGER: "larger", SMALLER: "smaller", NOT_CLEAR: "not clear"}
"""Which values of a number fail more often, in words, by the sign of their mean score."""


def law_errors_dataset(
    draws: ScoredDraws, shift: AllChanges, widening: AllChanges, bounds: AnyFailures, limit: float
) -> xr.Dataset:
    """The dataset of :class:`dssc_jax.analyses.laws.law_errors.LawErrors`.

    Args:
        draws: The draws of the result with their scores.
        shift: Shifts of all means.
        widening: Widenings of all laws.
        bounds: Bounds that hold whatever set of draws fails.
        limit: Largest failure probability allowed.
    """
    columns = law_columns(draws, shift.draws, widening.draws, bounds, limit)
    columns |= knowledge_columns(draws, shift.draws.confidence, limit)
    worst_shift = dict(zip(draws.study.laws, shift.largest.worst.amounts, strict=True))
    amounts = np.array([worst_shift[name] for name in draws.names])
    columns["worst_shift"] = (TABLE, amounts, unit_and_meaning(DEVIATIONS, "part in the worst shift of all means"))
    sizes, shifted = shift.curves()
    log_widths, widened = widening.curves()
    columns |= curve_columns("shifted", "size", shifted)
    columns |= curve_columns("widened", "width", widened)
    coordinates = {
        TABLE: (TABLE, np.array(draws.names), {"long_name": "uncertain number"}),
        "size": ("size", sizes, unit_and_meaning(DEVIATIONS, "shift of all means")),
        "width": ("width", np.exp(log_widths), unit_and_meaning("1", "relative width of all laws")),
    }
    return xr.Dataset(columns, coords=coordinates, attrs={"title": draws.study.name})


def curve_columns(prefix: str, dimension: str, curves: np.ndarray) -> dict[str, Column]:
    """Columns of the dataset for the three curves of one kind of change of all laws.

    Args:
        prefix: Beginning of the columns' names, ``shifted`` or ``widened``.
        dimension: Name of the dimension along which the change grows.
        curves: The worst failure probability by the weights, its upper limit, and the limit whatever draws fail; shape
            (points, 3).
    """
    probability, upper_limit, guarantee = curves.T
    return {
        prefix: (dimension, probability, unit_and_meaning("1", "worst failure probability")),
        f"{prefix}_limit": (dimension, upper_limit, unit_and_meaning("1", "its upper limit")),
        f"{prefix}_guaranteed": (dimension, guarantee, unit_and_meaning("1", "upper limit whatever draws fail")),
    }


def law_columns(
    draws: ScoredDraws, shifts: WeightedDraws, widenings: WeightedDraws, bounds: AnyFailures, limit: float
) -> dict[str, Column]:
    """Columns of the dataset that tell how far each law alone may change while all other laws are right.

    Args:
        draws: The draws of the result with their scores.
        shifts: The draws, weighted for shifts of means.
        widenings: The draws, weighted for widenings of laws.
        bounds: Bounds that hold whatever set of draws fails.
        limit: Largest failure probability allowed.
    """
    rows = []  # for each law: bound and estimate of the shift, direction, bound and estimate of the width
    for name in draws.names:
        free = draws.free([name])  # this law alone changes
        shift = largest_change(replace(shifts, free=free), limit)
        widening = largest_change(replace(widenings, free=free), limit)
        width = max(float(np.exp(widening.bound)), bounds.largest_widening(free, limit) or 1.0)  # 1: no widening
        rows.append(
            (
                max(shift.bound, bounds.largest_shift(free, limit)),
                np.nan if shift.estimate is None else shift.estimate,
                failing_direction(shifts, free),
                width,
                np.nan if widening.estimate is None else np.exp(widening.estimate),
            )
        )
    shift_bounds, shift_estimates, directions, widths, width_estimates = np.array(rows, dtype=float).T
    return {
        "shift": (TABLE, shift_bounds, unit_and_meaning(DEVIATIONS, "shift of the mean, with confidence")),
        "shift_estimate": (TABLE, shift_estimates, unit_and_meaning(DEVIATIONS, "shift of the mean, estimate")),
        "towards": (TABLE, directions.astype(int), {"long_name": "1: larger values fail, -1: smaller ones, 0: none"}),
        "widening": (TABLE, widths, unit_and_meaning("1", "relative width, with confidence")),
        "widening_estimate": (TABLE, width_estimates, unit_and_meaning("1", "relative width, estimate")),
    }


def knowledge_columns(draws: ScoredDraws, confidence: float, limit: float) -> dict[str, Column]:
    """Columns of the dataset that tell what knowing each number is worth, and which levels it has in failed draws.

    Args:
        draws: The draws of the result with their scores.
        confidence: Confidence of the intervals.
        limit: Largest failure probability allowed.
    """
    laws = list(draws.study.laws)
    rows = []
    for name in draws.names:
        levels = special.ndtr(draws.scores[:, laws.index(name)])
        row = knowledge_of(levels, draws.failed, limit, confidence)
        rows.append(row | failing_levels(levels[draws.failed], confidence))
    meanings = dict(KNOWLEDGE)
    for name, quantile in FAILING.items():
        meanings[name] = f"level of the law below which {100 * quantile:g} % of the failed draws lie"
    for name in MEDIAN_ENDS:
        meanings[name] = "an end of the interval of the median level in failed draws"
    columns = {}
    for name, meaning in meanings.items():
        columns[name] = (TABLE, np.array([row[name] for row in rows]), unit_and_meaning("1", meaning))
    return columns


def knowledge_of(levels: np.ndarray, failed: np.ndarray, limit: float, confidence: float) -> dict[str, float]:
    """What it is worth to know in which part of its law a number lies, as values for the names in :data:`KNOWLEDGE`.

    If too few draws failed, ``parts`` is 0 and the other values are NaN.

    Args:
        levels: Level of the number's law in each draw, shape (n,).
        failed: Whether each draw failed, shape (n,).
        limit: Largest failure probability allowed.
        confidence: Confidence of the intervals.
    """
    information = part_information(levels, failed, limit, confidence)
    if information is None:
        return dict.fromkeys(KNOWLEDGE, np.nan) | {"parts": 0.0}
    removed_low, removed_high = information.removed_interval
    changes_low, changes_high = information.changes_interval
    return {
        "parts": float(information.parts),
        "removed": float(information.removed),
        "removed_low": float(removed_low),
        "removed_high": float(removed_high),
        "changes": float(information.changes),
        "changes_low": float(changes_low),
        "changes_high": float(changes_high),
    }


def failing_levels(levels: np.ndarray, confidence: float) -> dict[str, float]:
    """Quantiles of a number's levels in failed draws, and the ends of the median's interval, by column name.

    The quantiles are NaN if no draw failed, the ends if too few did.

    Args:
        levels: Levels of the number's law in the failed draws, shape (failures,).
        confidence: Confidence of the interval.
    """
    row = dict.fromkeys(FAILING, np.nan)
    if levels.size:
        row = {name: float(np.quantile(levels, quantile)) for name, quantile in FAILING.items()}
    return row | dict(zip(MEDIAN_ENDS, median_ends(levels, confidence), strict=True))


def median_ends(levels: np.ndarray, confidence: float) -> tuple[float, float]:
    """Lower and upper end of the exact interval of the median level in failed draws; NaN if too few draws failed.

    Args:
        levels: Levels of a law in the failed draws, shape (failures,).
        confidence: Confidence of the interval.
    """
    if not levels.size:
        return np.nan, np.nan
    low, high = quantile_interval(levels, 0.5, confidence)
    if not (np.isfinite(low) and np.isfinite(high)):
        return np.nan, np.nan
    return float(low), float(high)


def failing_direction(shifts: WeightedDraws, free: np.ndarray) -> int:
    """Which values of the free numbers fail more often: :data:`LARGER`, :data:`SMALLER` or :data:`NOT_CLEAR`.

    Larger values fail if the mean score of the failed draws is clearly above 0, and smaller ones if it is below.

    Args:
        shifts: The weighted draws with their scores.
        free: Whether each law is considered, shape (laws,).
    """
    failing_scores = shifts.scores[shifts.failed][:, free]
    total = float(failing_scores.sum())
    if abs(total) <= CLEAR * np.sqrt(failing_scores.size):  # the standard deviation of a sum of so many scores
        return NOT_CLEAR
    return LARGER if total > 0.0 else SMALLER
