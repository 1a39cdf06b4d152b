"""Figures of margins: the distribution of critical values, and failure along the walk."""

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, named, styled, title
from dssc_jax.results.analysis import Analysis


@styled
def margin(margins: Analysis) -> Figure:
    """Plot critical values of all draws, with their lower tolerance limit, and the degradation curve with its band.

    The result of Theorem 1 for the same walk is given below.

    Args:
        margins: The return value of :func:`dssc_jax.margin`.
    """
    summary = margins.summary()
    figure = Figure(figsize=(SLIDE[0], SLIDE[1] + 0.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    margin_distribution(left, margins, summary)
    curve, walked = summary["degradation"], margins.dataset["value"]
    level = f"{100 * summary['confidence']:g} % band over all values together"
    right.fill_between(curve["value"], curve["lower"], curve["upper"], color=RED, alpha=0.2, label=level)
    right.plot(curve["value"], curve["probability"], "o-", color=RED, label="failed draws")
    right.set(xlabel=named(summary["parameter"], walked.attrs), ylabel="failure probability", ylim=(-0.03, 1.03))
    right.yaxis.set_major_formatter(PercentFormatter(1.0))
    for ax in (left, right):
        set_walk(ax, summary)
    certificate(left, summary)
    for ax in (left, right):  # above: inside, the lines leave no room
        ax.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    config = margins.study.config
    title(figure, f"{config.description or config.name}: {'; '.join(summary['criterion'])}")
    return figure


def set_walk(ax: Axes, summary: Mapping[str, Any]) -> None:
    """Set the axis along the walk, starting at its safe end."""
    ax.set_xscale("log" if summary["log"] else "linear")
    ax.set_xlim(*summary["bounds"])


def margin_distribution(ax: Axes, margins: Analysis, summary: Mapping[str, Any]) -> None:
    """Draw the share of draws that have failed by each value of the walk; censored draws are before and beyond it."""
    (start, end), critical = summary["bounds"], margins.dataset["critical"].values
    steps = np.sort(critical[~np.isnan(critical)])
    steps = steps if end > start else steps[::-1]
    draws, before = critical.size, summary["fail_at_start"]
    x = np.concatenate([[start], steps, [end]])
    y = np.concatenate([[before], before + np.arange(1, len(steps) + 1) / draws, [before + len(steps) / draws]])
    ax.step(x, y, where="post", color=BLUE, label=f"{draws} draws")
    lines = (("median", "median", ":"), ("lower_tolerance", "95 % of draws pass, confidence 95 %", "--"))
    for name, text, style in lines:
        if summary[name] is not None:
            colour = ORANGE if name == "lower_tolerance" else GREY
            ax.axvline(summary[name], color=colour, linestyle=style, label=f"{text}: {summary[name]:.3g}")
    ax.set(xlabel=named(summary["parameter"], margins.dataset["critical"].attrs), ylabel="share of draws at or below")
    if end < start:
        ax.set_ylabel("share of draws at or above")
    ax.set_ylim(-0.03, 1.03)
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def certificate(ax: Axes, summary: Mapping[str, Any]) -> None:
    """Mark the ends of the certified and of the proved range, or draw an arrow if the former is off the axis."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    figure.supxlabel(textwrap.fill(summary["certificate"], 105), fontsize=12, color=GREEN, parse_math=False)
    if summary["proof"] is not None and (proved := summary["proof"]["proved_up_to"]) is not None:
        ax.axvline(proved, color=GREEN, linewidth=3.0, label=f"proved as far as {proved:.3g}, for all plants")
    value, bounds = summary["certified"], summary["bounds"]
    if value is None:
        return
    text = f"certified as far as {value:.3g}"
    if min(bounds) <= value <= max(bounds):
        ax.axvline(value, color=GREEN, linestyle="-.", label=text)
    else:
        place = {"transform": ax.transAxes, "clip_on": False, "linestyle": "", "markersize": 10}
        ax.plot([0.0], [0.02], marker="<", color=GREEN, label=text, **place)
