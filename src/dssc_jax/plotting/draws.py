"""Figures of a run: the distribution of a metric, and failures against uncertain numbers."""

import math
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.plotting.style import (
    BLUE,
    DRAWABLE,
    RED,
    SLIDE,
    SMALL,
    fit_probability,
    label,
    panel,
    set_scale,
    styled,
    title,
)
from dssc_jax.plotting.thinning import spaced_indices
from dssc_jax.results.influence import equal_count_bins, sorted_by_influence
from dssc_jax.results.result import Result, measure_named, most_violated
from dssc_jax.statistics import CONFIDENCE, Replicated, clopper_pearson
from dssc_jax.statistics.order import sorted_draws

MOST_FACTORS = 5  # uncertain numbers with a panel
MOST_MARKED_STEPS = 20  # steps of a distribution function up to which each has a dot


@styled
def failures(result: Result) -> Figure:
    """Plot a run: the distribution of one metric, and the failure probability over the most influential numbers.

    ``[plot]`` of the study may name the metric. Otherwise it is that of the requirement which most draws violate.
    """
    laws = sorted_by_influence(result, drawable_laws(result))[:MOST_FACTORS]
    panels = 1 + len(laws)
    columns = min(3, panels)
    rows = math.ceil(panels / columns)
    height = 4.4 * rows if rows > 1 else SLIDE[1]
    figure = Figure(figsize=(SLIDE[0], height), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for empty in axes[panels:]:
        empty.set_axis_off()
    distribution(result, axes[0], most_violated(result).name)
    factors = axes[1:panels]
    for ax, name in zip(factors, laws, strict=True):
        factor(result, name, ax)
    share_probability_axis(factors, columns)
    failed = result.failed.values
    low, high = result.method.failure_interval(failed)
    count_text = f"{result.study.name}: {failed.sum()} of {failed.size} draws fail"
    interval_text = f"probability in [{low:.3g}, {high:.3g}], 95 % {result.method.name}"
    remark = ""
    if len(laws) < len(result.study.laws):
        remark = f"\nthe {len(laws)} most influential of {len(result.study.laws)} uncertain numbers"
    title(figure, f"{count_text}; {interval_text}{remark}")
    return figure


def share_probability_axis(factors: np.ndarray, columns: int) -> None:
    """Give the panels of all uncertain numbers the same axis of probabilities.

    A panel keeps its labels only if no other of these panels is to its left.

    Args:
        factors: The panels, row by row after another panel, which is the first of the figure.
        columns: Panels of the figure in a row.
    """
    tops = [ax.get_ylim()[1] for ax in factors]
    for position, ax in enumerate(factors, start=1):
        fit_probability(ax, max(tops), margin=0.0)
        has_factor_on_left = position > 1 and position % columns != 0
        if has_factor_on_left:
            ax.set_ylabel("")
            ax.tick_params(labelleft=False)


def require_one_point(result: Result) -> None:
    """Require that a result has a single point.

    All points of a sweep share the same draws, so no interval holds for the draws of several points together.

    Raises:
        ValueError: The result has several points.
    """
    if result.failed.ndim > 1:
        raise ValueError(f"shows one point of a sweep, got all of {', '.join(result.study.axes)}; take Result.at")


def drawable_laws(result: Result) -> list[str]:
    """Names of the uncertain numbers whose drawn values fit on an axis of matplotlib."""
    return [name for name in result.study.laws if np.abs(result.dataset[name].values).max() < DRAWABLE]


@styled
def distribution(result: Result, ax: Axes | None = None, metric: str | None = None) -> Figure:
    """Plot the empirical distribution function of a metric, with the exact interval of each share of draws.

    A draw without a value counts as the worst one (:attr:`Metric.worst`). Where large values are good, as for a
    robustness, the curve therefore starts at the share of such draws; for other metrics it ends below 1. The legend
    tells how many draws lie beyond an end of the axis.

    Args:
        result: A run, or one point of a sweep (:meth:`Result.at`).
        ax: Axes to draw into; None: a new figure.
        metric: Name of the metric; None: the study's headline metric.

    Raises:
        ValueError: The result has several points.
        ConfigError: The result has no such metric.
    """
    require_one_point(result)
    figure, ax = panel(ax)
    measure = measure_named(result, metric)
    steps = steps_of_distribution(result.dataset[measure.name].values, measure.metric.worst)
    if not isinstance(result.method, Replicated):
        interval = clopper_pearson(steps.ranks, steps.draws, result.method.confidence_per_look(CONFIDENCE))
        low, high = interval.T
        ax.fill_between(
            steps.values, low, high, color=BLUE, alpha=0.2, step="post", linewidth=0.0, label="95 % interval"
        )
    marker = "o" if len(steps.values) < MOST_MARKED_STEPS else None
    shares = steps.ranks / steps.draws
    ax.step(steps.values, shares, color=BLUE, where="post", marker=marker, label=steps.omitted_text)
    for limit in metric_bounds(result, measure):
        ax.axvline(limit, color=RED, linestyle="--", label="required")
    if steps.values.size:
        set_scale(ax, steps.values)
    else:
        ax.text(0.5, 0.5, "no finite value", transform=ax.transAxes, ha="center")
    ax.set(xlabel=label(result.dataset[measure.name].attrs), ylabel="share of draws at or below", ylim=(0, 1.02))
    ax.legend(frameon=False)
    return figure


class Steps(NamedTuple):
    """The steps of a distribution function that fit on an axis, at most as many as a picture has columns.

    Args:
        values: The metric at each step, ascending, shape (steps,).
        ranks: Number of draws at or below each value, shape (steps,).
        draws: Number of all draws.
        below: Number of draws below the lowest value that fits on an axis.
        above: Number of draws above the highest value that fits on an axis.
    """

    values: np.ndarray
    ranks: np.ndarray
    draws: int
    below: int
    above: int

    @property
    def omitted_text(self) -> str | None:
        """The legend's text on the draws that lie beyond either end of the axis; None if no draw does."""
        sides = {"left": self.below, "right": self.above}
        texts = [f"{count:,} further {side}" for side, count in sides.items() if count]
        return f"draws; {', '.join(texts)}" if texts else None


def steps_of_distribution(values: np.ndarray, missing: float) -> Steps:
    """Find the steps of the empirical distribution function of a metric.

    Args:
        values: The metric of each draw, shape (draws,).
        missing: Value that replaces NaN.
    """
    sorted_values = sorted_draws(values, missing)
    below, end = np.searchsorted(sorted_values, [-DRAWABLE, DRAWABLE], side="right").tolist()
    drawn = sorted_values[below:end]
    places = spaced_indices(len(drawn)) if len(drawn) else np.array([], int)
    return Steps(
        values=drawn[places],
        ranks=below + 1 + places,
        draws=values.size,
        below=below,
        above=values.size - end,
    )


@styled
def factor(result: Result, name: str, ax: Axes | None = None) -> Figure:
    """Plot the failure probability with its exact interval over one uncertain number, in bins of equal count.

    A number that takes few values, such as one with the law ``choice``, has a bin for each value.

    Args:
        result: A run, or one point of a sweep (:meth:`Result.at`).
        name: The uncertain number's dotted name.
        ax: Axes to draw into; None: a new figure.

    Raises:
        ValueError: The result has several points.
        ConfigError: The number is not uncertain.
    """
    require_one_point(result)
    if name not in result.study.laws:
        raise ConfigError("name", f"'{name}' is no uncertain number of the result; {nearest(name, result.study.laws)}")
    figure, ax = panel(ax, SMALL)
    values = result.dataset[name].values
    failed = result.failed.values
    groups = equal_count_bins(values)  # indices of the draws of each bin
    centres = np.array([np.median(values[group]) for group in groups])
    share = np.array([failed[group].mean() for group in groups])
    distances = None  # from the share to both ends of its interval, which only independent draws have
    top = share
    if result.method.independent:
        intervals = np.stack([result.method.interval(failed[group]) for group in groups])
        distances = np.abs(intervals.T - share)
        top = share + distances[1]
    ax.errorbar(centres, share, distances, fmt="o", color=RED, capsize=3)
    if result.study.laws[name].support[0] > 0.0:
        set_scale(ax, centres)
    if ax.get_xscale() == "linear":
        ax.locator_params(axis="x", nbins=5)
    unit = result.dataset[name].attrs["units"]
    quantity = "failure probability" if result.method.independent else "share of failed draws (no interval)"
    ax.set(xlabel=f"{name}\n[{unit}]", ylabel=quantity)
    fit_probability(ax, float(top.max()))
    return figure


def metric_bounds(result: Result, measure: Measure) -> list[float]:
    """Upper and lower limits of a metric in the study's requirements."""
    limits: list[float] = []
    for requirement in result.study.requirements:
        if requirement.measure.name == measure.name:
            limits += [limit for limit in (requirement.maximum, requirement.minimum) if limit is not None]
    return limits
