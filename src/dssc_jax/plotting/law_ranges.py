"""Figure of the failure probability over all laws whose arguments lie within ranges."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.core.json_types import JsonObject
from dssc_jax.plotting.style import BLUE, GREY, ORANGE, RED, SLIDE, study_title, styled, title
from dssc_jax.results.analysis import Analysis

OFFSET = 0.08
"""Distance of two intervals side by side from their common place."""


@styled
def law_ranges(ranges: Analysis) -> Figure:
    """Plot the failure probability of the best and the worst law, and where these laws lie within the ranges.

    Args:
        ranges: The return value of :func:`dssc_jax.law_ranges`.
    """
    summary = ranges.summary()
    arguments = ranges.dataset.sizes["argument"]
    figure = Figure(figsize=(SLIDE[0], max(SLIDE[1], 2.0 + 0.4 * arguments)), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.6))
    probability_panel(left, summary)
    argument_panel(right, ranges.dataset)
    level = f"{100 * summary['confidence']:g} % confidence, {summary['draws']} draws of the mixture"
    title(figure, f"{study_title(ranges.study)}\n{level}")
    return figure


def probability_panel(ax: Axes, summary: JsonObject) -> None:
    """Draw the failure probability under the best and the worst law, by the draws' weights and by new draws."""
    for place, name in enumerate(("lowest", "highest")):
        extreme = summary[name]
        fresh_share = extreme["fresh_failures"] / summary["fresh_draws"]
        for shift, colour, value, interval, text in (
            (-OFFSET, BLUE, extreme["probability"], extreme["interval"], "by the weights"),
            (OFFSET, ORANGE, fresh_share, extreme["fresh_interval"], "new draws"),
        ):
            low, high = interval
            ax.plot([place + shift] * 2, [low, high], color=colour, linewidth=3, label="" if place else text)
            ax.plot(place + shift, value, "o", color=colour)
    limit = summary["limit"]
    ax.axhline(limit, color=RED, linewidth=1.2, label=f"{100 * limit:g} % may fail")
    ax.set_xticks([0, 1], ["best law", "worst law"])
    ax.set(xlim=(-0.5, 1.5), ylabel="failure probability", ylim=(0.0, None))
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    ax.legend(frameon=False)


def argument_panel(ax: Axes, data: xr.Dataset) -> None:
    """Draw the arguments of the best and the worst law, each as a share of its range."""
    lows = data["low"].values
    highs = data["high"].values
    rows = np.arange(len(lows))
    ax.hlines(rows, 0.0, 1.0, color=GREY, linewidth=4, alpha=0.4)
    for name, marker, colour in (("at_lowest", "D", BLUE), ("at_highest", "o", RED)):
        share = (data[name].values - lows) / (highs - lows)
        ax.plot(share, rows, marker, color=colour, label=f"{name.removeprefix('at_')} failure probability")
    labels = []
    for name, low, high in zip(data["argument"].values, lows, highs, strict=True):
        labels.append(f"{name}\n{low:.4g} to {high:.4g}")
    ax.set_yticks(rows, labels)
    ax.set(ylim=(len(rows) - 0.5, -0.5), xticks=[0.0, 1.0], xticklabels=["low end", "high end"])
    ax.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
