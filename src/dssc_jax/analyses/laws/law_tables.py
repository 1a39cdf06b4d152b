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
DIRECTIONS = {1: "larger", -1: "smaller", 0: "not clear"}
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
    sizes, shifted = shift.curves()
    log_widths, widened = widening.curves()
    worst = dict(zip(draws.study.laws, shift.largest.worst.amounts, strict=True))
    columns: dict[str, Column] = law_columns(draws, shift.draws, widening.draws, bounds, limit)
    part = np.array([worst[name] for name in draws.names])
    columns |= knowledge_columns(draws, shift.draws.confidence, limit)
    columns["worst_shift"] = (TABLE, part, unit_and_meaning(DEVIATIONS, "part in the worst shift of all means"))
    for curve, prefix, dimension in ((shifted, "shifted", "size"), (widened, "widened", "width")):
        columns[prefix] = (dimension, curve[:, 0], unit_and_meaning("1", "worst failure probability"))
        columns[f"{prefix}_limit"] = (dimension, curve[:, 1], unit_and_meaning("1", "its upper limit"))
        guarantee = unit_and_meaning("1", "upper limit whatever draws fail")
        columns[f"{prefix}_guaranteed"] = (dimension, curve[:, 2], guarantee)
    coordinates = {
        TABLE: (TABLE, np.array(draws.names), {"long_name": "uncertain number"}),
        "size": ("size", sizes, unit_and_meaning(DEVIATIONS, "shift of all means")),
        "width": ("width", np.exp(log_widths), unit_and_meaning("1", "relative width of all laws")),
    }
    return xr.Dataset(columns, coords=coordinates, attrs={"title": draws.study.name})


def law_columns(
    draws: ScoredDraws, shifts: WeightedDraws, widenings: WeightedDraws, bounds: AnyFailures, limit: float
) -> dict[str, Column]:
    """Columns of the dataset for changes of one law while all others are right.

    Args:
        draws: The draws of the result with their scores.
        shifts: The draws, weighted for shifts of means.
        widenings: The draws, weighted for widenings of laws.
        bounds: Bounds that hold whatever set of draws fails.
        limit: Largest failure probability allowed.
    """
    table = np.empty((len(draws.names), 5))
    for row, name in zip(table, draws.names, strict=True):
        free = draws.free([name])
        shift = largest_change(replace(shifts, free=free), limit)
        widening = largest_change(replace(widenings, free=free), limit)
        row[0] = max(shift.bound, bounds.largest_shift(free, limit))
        row[1] = np.nan if shift.estimate is None else shift.estimate
        row[2] = failing_direction(shifts, free)
        row[3] = max(float(np.exp(widening.bound)), bounds.largest_widening(free, limit) or 1.0)
        row[4] = np.nan if widening.estimate is None else np.exp(widening.estimate)
    return {
        "shift": (TABLE, table[:, 0], unit_and_meaning(DEVIATIONS, "shift of the mean, with confidence")),
        "shift_estimate": (TABLE, table[:, 1], unit_and_meaning(DEVIATIONS, "shift of the mean, estimate")),
        "towards": (TABLE, table[:, 2].astype(int), {"long_name": "1: larger values fail, -1: smaller ones, 0: none"}),
        "widening": (TABLE, table[:, 3], unit_and_meaning("1", "relative width, with confidence")),
        "widening_estimate": (TABLE, table[:, 4], unit_and_meaning("1", "relative width, estimate")),
    }


def knowledge_columns(draws: ScoredDraws, confidence: float, limit: float) -> dict[str, Column]:
    """Columns of the dataset for the value of knowing each number, and for its levels in failed draws.

    Args:
        draws: The draws of the result with their scores.
        confidence: Confidence of the intervals.
        limit: Largest failure probability allowed.
    """
    laws = list(draws.study.laws)
    columns: dict[str, list[float]] = {name: [] for name in (*KNOWLEDGE, *FAILING, *MEDIAN_ENDS)}
    for name in draws.names:
        levels = special.ndtr(draws.scores[:, laws.index(name)])
        part = part_information(levels, draws.failed, limit, confidence)
        knowledge = (0, *[np.nan] * (len(KNOWLEDGE) - 1))
        if part is not None:
            knowledge = (part.parts, part.removed, *part.removed_interval, part.changes, *part.changes_interval)
        failing = levels[draws.failed]
        quantiles = np.quantile(failing, list(FAILING.values())) if failing.size else [np.nan] * len(FAILING)
        ends = median_ends(failing, confidence)
        for column, number in zip(columns.values(), (*knowledge, *quantiles, *ends), strict=True):
            column.append(float(number))
    meanings = dict(KNOWLEDGE)
    for name, quantile in FAILING.items():
        meanings[name] = f"level of the law below which {100 * quantile:g} % of the failed draws lie"
    for name in MEDIAN_ENDS:
        meanings[name] = "an end of the interval of the median level in failed draws"
    return {
        name: (TABLE, np.array(columns[name]), unit_and_meaning("1", meaning)) for name, meaning in meanings.items()
    }


def median_ends(levels: np.ndarray, confidence: float) -> tuple[float, float]:
    """The exact interval of the median level in failed draws; NaN if too few draws failed.

    Args:
        levels: Levels of a law in the failed draws, shape (failures,).
        confidence: Confidence of the interval.
    """
    if not levels.size:
        return np.nan, np.nan
    low, high = quantile_interval(levels, 0.5, confidence)
    return (float(low), float(high)) if np.isfinite(low) and np.isfinite(high) else (np.nan, np.nan)


def failing_direction(shifts: WeightedDraws, free: np.ndarray) -> int:
    """1 if the mean score of the failed draws is clearly above 0, -1 if it is clearly below, else 0.

    Args:
        shifts: The weighted draws with their scores.
        free: Whether each law is considered, shape (laws,).
    """
    failing = shifts.scores[shifts.failed][:, free]
    total = float(failing.sum())
    return int(np.sign(total)) if abs(total) > CLEAR * np.sqrt(failing.size) else 0
