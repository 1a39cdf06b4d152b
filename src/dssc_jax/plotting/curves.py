"""Curves over one axis of a sweep: failure probability and the headline metric."""

import numpy as np
from matplotlib.axes import Axes

from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.plotting.cells import cell_edges
from dssc_jax.plotting.draws import metric_bounds
from dssc_jax.plotting.style import BLUE, GREEN, GREY, RED, axis_label, fit_probability, is_log, label, set_scale
from dssc_jax.plotting.sweep_marks import CERTIFIED_LEGEND, certified_region, mark_study_value
from dssc_jax.plotting.thinning import envelope, thinned
from dssc_jax.results.result import Result
from dssc_jax.statistics.order import upper_quantiles

MOST_MARKED_POINTS = 200  # points of a curve up to which each has a dot
PROVED_LEGEND = "proved, with lag and sampling"


def typical_curve(ax: Axes, result: Result, measure: Measure, axis: str) -> None:
    """Draw the median of a metric along an axis of a sweep, with a band from the 5 % to the 95 % quantile.

    A study with a single draw has no band. If the study asks for a slope, a fitted power law is added.

    Args:
        ax: Axes to draw into.
        result: The sweep.
        measure: The metric.
        axis: Name of the swept number.
    """
    x = result.dataset[axis].values
    low, median, high = quantiles(result, measure)
    name = "simulated"
    if result.study.config.draws > 1:
        name = "median"
        fill_band(ax, x, low, high, BLUE, "5 to 95 % of draws")
    ax.plot(*thinned(x, median), line_format(x), color=BLUE, label=name)
    if len(x) > 1:
        ax.set_xlim(x.min(), x.max())
    if not np.isfinite(median).any():
        ax.text(0.5, 0.5, "no finite median", transform=ax.transAxes, ha="center")
    for limit in metric_bounds(result, measure):
        ax.axhline(limit, color=RED, linestyle="--", label="required")
    set_scale(ax, median[np.isfinite(median)], "y")
    slope_exists = len(x) > 1 and have_logarithms(x) and have_logarithms(median)
    if result.study.config.plot.slope and slope_exists:
        add_slope(ax, x, median)
    ax.set_ylabel(label(result.dataset[measure.name].attrs))
    finish_curve(ax, result, axis)


def fill_band(ax: Axes, x: np.ndarray, low: np.ndarray, high: np.ndarray, colour: str, text: str) -> None:
    """Fill a band between two curves, thinned to as many points as a figure can show.

    Args:
        ax: Axes to draw into.
        x: Places along the axis, shape (n,).
        low: Lower curve, shape (n,).
        high: Upper curve, shape (n,).
        colour: Colour of the band.
        text: Legend of the band.
    """
    points, lower, upper = envelope(x, low, high)
    ax.fill_between(points, lower, upper, color=colour, alpha=0.2, linewidth=0.0, label=text)


def probability_curve(ax: Axes, result: Result, axis: str) -> None:
    """Draw the failure probability along an axis of a sweep, with its interval as a band.

    Args:
        ax: Axes to draw into.
        result: The sweep.
        axis: Name of the swept number.
    """
    x = result.dataset[axis].values
    failed = result.failed.values
    interval = result.method.failure_interval(failed)
    fill_band(ax, x, interval[:, 0], interval[:, 1], RED, f"95 % {result.method.name}")
    ax.plot(*thinned(x, failed.mean(-1)), line_format(x), color=RED, label="failed draws")
    ax.set_ylabel("failure probability")
    fit_probability(ax, float(interval.max()))
    finish_curve(ax, result, axis)


def line_format(x: np.ndarray) -> str:
    """Matplotlib's format of a curve: a line with a dot at each point, or without dots if there are too many points."""
    return "o-" if len(x) <= MOST_MARKED_POINTS else "-"


def finish_curve(ax: Axes, result: Result, axis: str) -> None:
    """Add what all curves share: certified and proved parts of the axis, the study's own value, scale and labels."""
    x = result.dataset[axis].values
    set_scale(ax, x)
    certified = certified_region(result)
    if certified is not None:
        mark_certified(ax, x, certified.values)
    if "proved" in result.dataset:
        mark_proved(ax, x, result.dataset["proved"].values)
    mark_study_value(ax, result, axis, "x")
    ax.set_xlabel(axis_label(axis, result.dataset[axis].attrs))
    ax.legend(frameon=False)


def true_runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end of every run of true values in a mask.

    Args:
        mask: Booleans, shape (n,).

    Returns:
        For each run, its first index and the index after its last.

    Example:
        >>> true_runs(np.array([True, True, False, True]))
        [(0, 2), (3, 4)]
    """
    changes = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return [(int(begin), int(end)) for begin, end in changes.reshape(-1, 2)]


def mark_certified(ax: Axes, x: np.ndarray, certified: np.ndarray) -> None:
    """Hatch the parts of the axis that Theorem 1 certifies, and extend the axis to the edges of its cells.

    Args:
        ax: Axes of the curve.
        x: Values along the axis, shape (n,).
        certified: Whether each value is certified, shape (n,).
    """
    edges = cell_edges(x, is_log(x))
    text: str | None = CERTIFIED_LEGEND  # of the first part only
    for begin, end in true_runs(certified):
        low = float(edges[begin])
        high = float(edges[end])
        ax.axvspan(low, high, fc="none", ec=GREEN, hatch="//", linewidth=0.0, label=text)
        text = None
    ax.set_xlim(edges[0], edges[-1])


def mark_proved(ax: Axes, x: np.ndarray, proved: np.ndarray) -> None:
    """Mark the parts of the axis where the loop is proved, by a bar on the lower edge of the axes.

    Args:
        ax: Axes of the curve.
        x: Values along the axis, shape (n,).
        proved: Whether each value is proved, shape (n,).
    """
    edges = cell_edges(x, is_log(x))
    along_axis = ax.get_xaxis_transform()
    text: str | None = PROVED_LEGEND  # of the first part only
    for begin, end in true_runs(proved):
        ends = edges[[begin, end]]
        ax.plot(ends, [0.0, 0.0], transform=along_axis, color=GREEN, linewidth=7.0, label=text, zorder=0)
        text = None


def quantiles(result: Result, measure: Measure) -> np.ndarray:
    """The 5 %, 50 % and 95 % quantiles of a metric over the draws, shape (3, axes...).

    A draw without a value counts as the worst value of the metric.
    """
    return upper_quantiles(result.dataset[measure.name].values, (0.05, 0.5, 0.95), measure.metric.worst)


def have_logarithms(values: np.ndarray) -> bool:
    """Whether all values are finite and positive."""
    return bool(np.isfinite(values).all() and (values > 0).all())


def fitted_slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope and intercept of log y over log x, fitted by least squares; the slope is the exponent of a power law."""
    slope, intercept = np.polyfit(np.log(x), np.log(y), 1)
    return float(slope), float(intercept)


def add_slope(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Draw the power law fitted to a curve, with its exponent in the legend.

    Args:
        ax: Axes of the curve.
        x: Places along the axis, positive, shape (n,).
        y: Values of the curve, positive, shape (n,).
    """
    slope, intercept = fitted_slope(x, y)
    ax.plot(x, np.exp(intercept) * x**slope, color=GREY, linestyle="--", label=f"fitted slope {slope:.2f}")
