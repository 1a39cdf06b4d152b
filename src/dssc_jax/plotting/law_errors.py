"""Figure of how far the laws may be wrong."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.style import BLUE, GREY, ORANGE, RED, SLIDE, label, study_title, styled, title
from dssc_jax.results.analysis import Analysis

ROW_GAP = 0.14
"""Distance of the two marks of a law from the law's row."""
AXIS_EXCESS = 1.08
"""End of the axis of shifts, relative to the largest shift."""


@styled
def law_errors(errors: Analysis) -> Figure:
    """Plot the failure probability over changes of all laws, and how far the mean of each law alone may be wrong.

    Args:
        errors: The return value of :func:`dssc_jax.laws`.
    """
    data = errors.dataset
    summary = errors.summary()
    numbers = data.sizes["number"]
    figure = Figure(figsize=(SLIDE[0] + 4.0, max(SLIDE[1], 2.6 + 0.36 * numbers)), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for ax, prefix, dimension in ((left, "shifted", "size"), (middle, "widened", "width")):
        change_panel(ax, data, prefix, dimension, summary["limit"])
    left.set_ylabel("failure probability")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    law_panel(right, data)
    level = f"{100 * summary['confidence']:g} % confidence of each statement, {summary['draws']} draws"
    title(figure, f"{study_title(errors.study)}\n{level}")
    return figure


def change_panel(ax: Axes, data: xr.Dataset, prefix: str, dimension: str, limit: float) -> None:
    """Draw the failure probability over one kind of change of all laws.

    Args:
        ax: Axes to draw into.
        data: Dataset of the analysis.
        prefix: Beginning of the names of the variables, ``shifted`` or ``widened``.
        dimension: Coordinate with the amounts of the change.
        limit: Largest failure probability allowed.
    """
    sizes = data[dimension].values
    worst = data[prefix].values
    upper = data[f"{prefix}_limit"].values
    bound = data[f"{prefix}_guaranteed"].values
    ax.plot(sizes, worst, color=BLUE, label="worst direction, from the draws' weights")
    ax.plot(sizes, upper, "--", color=BLUE, label="its upper limit")
    ax.plot(sizes, bound, color=ORANGE, label="upper limit whatever draws fail")
    ax.axhline(limit, color=RED, linewidth=1.2, label=f"{100 * limit:g} % may fail")
    first_bound = bound[np.isfinite(bound)][:1]  # the others rise steeply to 1, and may leave the panel
    highest = max([limit, *worst[np.isfinite(worst)], *first_bound])
    top = min(1.0, max(2.5 * limit, 1.2 * highest))
    ax.set(xlabel=label(data[dimension].attrs), ylim=(0.0, top))
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def law_panel(ax: Axes, data: xr.Dataset) -> None:
    """Draw how far the mean of each law alone may be wrong.

    The law with the smallest estimated shift is on top. An estimate of NaN means that no shift reaches the limit.
    """
    by_estimate = np.where(np.isnan(data["shift_estimate"].values), np.inf, data["shift_estimate"].values)
    order = np.argsort(by_estimate + 1e-6 * data["shift"].values, kind="stable")  # equal estimates by their bounds
    estimate = data["shift_estimate"].values[order]  # NaN: no shift reaches the limit
    bound = data["shift"].values[order]
    names = [str(name) for name in data["number"].values[order]]
    rows = np.arange(len(names))
    ax.plot(bound, rows + ROW_GAP, "o", color=BLUE, label="with confidence")
    ax.plot(estimate, rows - ROW_GAP, "D", color=GREY, label="estimate")
    for row in rows[np.isnan(estimate)]:
        place = (bound[row], row - ROW_GAP)
        ax.annotate("limit not reached", place, color=GREY, fontsize=10, va="center", ha="right")
    ax.set_yticks(rows, names)
    ax.set_ylim(len(rows) - 0.5, -0.5)  # the first row on top
    ax.set_xlim(0.0, AXIS_EXCESS * max(np.nanmax(estimate, initial=0.0), bound.max(), 0.1))
    ax.set_xlabel("shift of one mean alone\n[standard deviations]")
    ax.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))
