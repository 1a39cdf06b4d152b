"""Figure of the failure probability over all laws whose arguments lie within ranges."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
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
    """Draw the failure probability under the best and the worst law.

    Each probability is drawn twice: from the weights of the draws, and from new draws.
    """
    handles = []
    for place, name in enumerate(("lowest", "highest")):
        extreme = summary[name]
        fresh_share = extreme["fresh_failures"] / summary["fresh_draws"]
        handles = [
            *draw_interval(ax, place - OFFSET, extreme["probability"], extreme["interval"], BLUE, "by the weights"),
            *draw_interval(ax, place + OFFSET, fresh_share, extreme["fresh_interval"], ORANGE, "new draws"),
        ]
    limit = summary["limit"]
    handles.append(ax.axhline(limit, color=RED, linewidth=1.2, label=f"{100 * limit:g} % may fail"))
    ax.set_xticks([0, 1], ["best law", "worst law"])
    ax.set(xlim=(-0.5, 1.5), ylabel="failure probability", ylim=(0.0, None))
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    ax.legend(handles=handles, frameon=False)  # the marks of both laws are alike


def draw_interval(
    ax: Axes, place: float, probability: float, interval: Sequence[float], colour: str, text: str
) -> list[Line2D]:
    """Draw a probability as a dot on its interval, which is a vertical line.

    Args:
        ax: Axes to draw into.
        place: Place on the horizontal axis.
        probability: The probability.
        interval: Lower and upper bound of the probability.
        colour: Colour of dot and line.
        text: Legend of the line.

    Returns:
        The line.
    """
    lines = ax.plot([place, place], interval, color=colour, linewidth=3, label=text)
    ax.plot(place, probability, "o", color=colour)
    return lines


def argument_panel(ax: Axes, data: xr.Dataset) -> None:
    """Draw the arguments of the laws with the lowest and the highest failure probability, as shares of their ranges.

    Args:
        ax: Axes to draw into.
        data: The ends ``low`` and ``high`` of each argument's range, and its values ``at_lowest`` and ``at_highest``.
    """
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
