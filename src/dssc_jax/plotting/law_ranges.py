"""Figure of the failure probability over all laws whose arguments lie within ranges."""

from typing import Protocol

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.core.json_types import JsonObject
from dssc_jax.plotting.style import BLUE, GREY, ORANGE, RED, SLIDE, styled, title
from dssc_jax.study import Study

APART = 0.08  # distance of two intervals side by side


class PlottedLawRanges(Protocol):
    """What the figure takes from :class:`dssc_jax.LawRanges`."""

    study: Study
    dataset: xr.Dataset
    limit: float

    def summary(self) -> JsonObject:
        """The answer in plain numbers."""
        ...


@styled
def law_ranges(ranges: PlottedLawRanges) -> Figure:
    """Plot the failure probability of the best and the worst law, and where in the ranges these laws lie.

    Args:
        ranges: The return value of :func:`dssc_jax.law_ranges`.
    """
    summary = ranges.summary()
    data = ranges.dataset
    arguments = data.sizes["argument"]
    figure = Figure(figsize=(SLIDE[0], max(SLIDE[1], 2.0 + 0.4 * arguments)), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.6))
    for place, name in enumerate(("lowest", "highest")):
        extreme = summary[name]
        fresh = extreme["fresh_failures"] / summary["fresh_draws"]
        for shift, colour, value, interval, text in (
            (-APART, BLUE, extreme["probability"], extreme["interval"], "by the weights"),
            (APART, ORANGE, fresh, extreme["fresh_interval"], "new draws"),
        ):
            low, high = interval
            left.plot([place + shift] * 2, [low, high], color=colour, linewidth=3, label="" if place else text)
            left.plot(place + shift, value, "o", color=colour)
    left.axhline(ranges.limit, color=RED, linewidth=1.2, label=f"{100 * ranges.limit:g} % may fail")
    left.set_xticks([0, 1], ["best law", "worst law"])
    left.set(xlim=(-0.5, 1.5), ylabel="failure probability", ylim=(0.0, None))
    left.yaxis.set_major_formatter(PercentFormatter(1.0))
    left.legend(frameon=False)
    rows = np.arange(arguments)
    width = data["high"].values - data["low"].values
    right.hlines(rows, 0.0, 1.0, color=GREY, linewidth=4, alpha=0.4)
    for name, marker, colour in (("at_lowest", "D", BLUE), ("at_highest", "o", RED)):
        share = (data[name].values - data["low"].values) / width
        right.plot(share, rows, marker, color=colour, label=f"{name.removeprefix('at_')} failure probability")
    labels = []
    for label, low, high in zip(data["argument"].values, data["low"].values, data["high"].values, strict=True):
        labels.append(f"{label}\n{low:.4g} to {high:.4g}")
    right.set_yticks(rows, labels)
    right.set(ylim=(arguments - 0.5, -0.5), xticks=[0.0, 1.0], xticklabels=["low end", "high end"])
    right.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    config = ranges.study.config
    level = f"{100 * summary['confidence']:g} % confidence, {summary['draws']} draws of the mixture"
    title(figure, f"{config.description or config.name}\n{level}")
    return figure
