"""Figures of margins: the distribution of critical values, and failure along the walk."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import TypedDict, cast

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, axis_label, study_title, styled, title
from dssc_jax.results.analysis import Analysis


class MarginSummary(TypedDict):
    """The numbers of a margin's summary that the figures show."""

    parameter: str
    unit: str
    bounds: tuple[float, float]
    log: bool
    criterion: Sequence[str]
    confidence: float
    degradation: Mapping[str, Sequence[float]]
    fail_at_start: float
    median: float | None
    lower_tolerance: float | None
    certified: float | None
    certificate: str
    proof: Mapping[str, float | None] | None


def summary_of(margins: Analysis) -> MarginSummary:
    """The summary of an analysis that :func:`dssc_jax.margin` made, with the types of the summary's entries."""
    return cast("MarginSummary", margins.summary())


@styled
def margin(margins: Analysis) -> Figure:
    """Plot the distribution of the critical values, and the failure probability along the walk with its band.

    The result of Theorem 1 for the same walk is written below both panels.

    Args:
        margins: The return value of :func:`dssc_jax.margin`.
    """
    summary = summary_of(margins)
    figure = Figure(figsize=(SLIDE[0], SLIDE[1] + 0.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    distribution_panel(left, margins.dataset["critical"], summary)
    degradation_panel(right, margins.dataset["value"], summary)
    for ax in (left, right):
        set_walk_axis(ax, summary)
    mark_certificate(left, summary)
    for ax in (left, right):
        ax.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))  # above: lines leave no room inside
    title(figure, f"{study_title(margins.study)}: {'; '.join(summary['criterion'])}")
    return figure


def degradation_panel(ax: Axes, walk_values: xr.DataArray, summary: MarginSummary) -> None:
    """Draw the failure probability along the walk, with a band that holds for all values together.

    Args:
        ax: Axes to draw into.
        walk_values: Values along the walk, for the label of the axis.
        summary: Summary of the margin.
    """
    curve = summary["degradation"]
    level = f"{100 * summary['confidence']:g} % band over all values together"
    ax.fill_between(curve["value"], curve["lower"], curve["upper"], color=RED, alpha=0.2, label=level)
    ax.plot(curve["value"], curve["probability"], "o-", color=RED, label="failed draws")
    ax.set(xlabel=axis_label(summary["parameter"], walk_values.attrs), ylabel="failure probability", ylim=(-0.03, 1.03))
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def set_walk_axis(ax: Axes, summary: MarginSummary) -> None:
    """Set scale and limits of the horizontal axis, which runs from the start of the walk, the safe end, to the end."""
    start, end = summary["bounds"]
    ax.set_xscale("log" if summary["log"] else "linear")
    ax.set_xlim(start, end)


def distribution_panel(ax: Axes, critical: xr.DataArray, summary: MarginSummary) -> None:
    """Draw the distribution function of the critical values along the walk.

    The curve begins above 0 if draws fail at the start of the walk, and ends below 1 if draws pass to its end.

    Args:
        ax: Axes to draw into.
        critical: Critical value of each draw, shape (draws,); NaN if the draw does not begin to fail along the walk.
        summary: Summary of the margin.
    """
    start, end = summary["bounds"]
    draws = critical.size
    failed_at_start = summary["fail_at_start"]
    found_values = critical.values[~np.isnan(critical.values)]  # of the draws that begin to fail along the walk
    steps = in_order_of_walk(found_values, summary)
    shares = failed_at_start + np.arange(1, len(steps) + 1) / draws
    x = np.concatenate([[start], steps, [end]])
    y = np.concatenate([[failed_at_start], shares, [failed_at_start + len(steps) / draws]])
    ax.step(x, y, where="post", color=BLUE, label=f"{draws} draws")
    median = summary["median"]
    if median is not None:
        ax.axvline(median, color=GREY, linestyle=":", label=f"median: {median:.3g}")
    limit = summary["lower_tolerance"]
    if limit is not None:
        text = f"95 % of draws pass, confidence 95 %: {limit:.3g}"
        ax.axvline(limit, color=ORANGE, linestyle="--", label=text)
    side = "above" if end < start else "below"
    ax.set(xlabel=axis_label(summary["parameter"], critical.attrs), ylabel=f"share of draws at or {side}")
    ax.set_ylim(-0.03, 1.03)
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def in_order_of_walk(values: np.ndarray, summary: MarginSummary) -> np.ndarray:
    """Sort values in the order in which the walk meets them: descending if the walk goes down."""
    start, end = summary["bounds"]
    sorted_values = np.sort(values)
    return sorted_values if end > start else sorted_values[::-1]


def mark_certificate(ax: Axes, summary: MarginSummary) -> None:
    """Mark how far Theorem 1 certifies the loop and how far the loop is proved; write the certificate below the figure.

    An arrow at the edge of the axes stands for a certified value outside of the axis.
    """
    figure = ax.get_figure(root=True)
    assert figure is not None
    figure.supxlabel(textwrap.fill(summary["certificate"], 105), fontsize=12, color=GREEN, parse_math=False)
    proof = summary["proof"]
    proved = None if proof is None else proof["proved_up_to"]
    if proof is not None and proved is not None:
        covered = textwrap.fill(str(proof["covered"]), 30)
        ax.axvline(proved, color=GREEN, linewidth=3.0, label=f"proved as far as {proved:.3g}, for {covered}")
    certified = summary["certified"]
    if certified is None:
        return
    text = f"certified as far as {certified:.3g}"
    is_on_axis = min(summary["bounds"]) <= certified <= max(summary["bounds"])
    if is_on_axis:
        ax.axvline(certified, color=GREEN, linestyle="-.", label=text)
    else:
        ax.plot([0.0], [0.02], "<", color=GREEN, markersize=10, label=text, transform=ax.transAxes, clip_on=False)
