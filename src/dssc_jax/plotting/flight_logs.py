"""A logged flight over the range of a study's draws."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, DARK, ORANGE, RED, styled, title
from dssc_jax.plotting.thinning import envelope, thinned
from dssc_jax.results.analysis import Analysis

MOST_SIGNALS = 5  # of one figure


@styled
def log_comparison(comparison: Analysis) -> Figure:
    """Plot the logged signals over the draws, those with the largest departures first, and the test's statistic.

    Bands are the range of all draws and the middle 90 % of them at each time.

    Args:
        comparison: The return value of :func:`dssc_jax.compare_log`.
    """
    data, summary = comparison.dataset, comparison.summary()
    facts = summary["signals"]
    shown = sorted(facts, key=lambda name: -(facts[name]["largest_departure"] or np.inf))[:MOST_SIGNALS]
    figure = Figure(figsize=(11.5, 2.5 * len(shown) + 2.6), layout="constrained")
    axes = figure.subplots(len(shown) + 1, 1)
    for ax, name in zip(axes, shown, strict=False):
        over_draws(ax, data.sel(signal=name), name, facts[name])
    for ax in axes[1 : len(shown)]:
        ax.sharex(axes[0])
    axes[len(shown) - 1].set_xlabel("time [s]")
    handles = {
        text: line for ax in axes[: len(shown)] for line, text in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 5, "fontsize": 10}
    axes[0].legend(list(handles.values()), list(handles), frameon=False, **place)
    statistics_of_curves(axes[-1], data["statistic"].values, summary["p_value"])
    hidden = (
        f"; {len(facts) - len(shown)} signals with smaller departures are not shown" if len(facts) > len(shown) else ""
    )
    config = comparison.study.config
    title(figure, f"{config.description or config.name}: {summary['log']} over {summary['draws']} draws{hidden}")
    return figure


def over_draws(ax: Axes, own: xr.Dataset, name: str, facts: dict[str, Any]) -> None:
    """Draw one signal over the bands of the draws."""
    time = own["t"].values
    for low, high, alpha, text in (("lowest", "highest", 0.18, "all draws"), ("low", "high", 0.3, "90 % of the draws")):
        x, lower, upper = envelope(time, own[low].values, own[high].values)
        ax.fill_between(x, lower, upper, color=BLUE, alpha=alpha, linewidth=0.0, label=text)
    if np.isfinite(own["commanded"].values).any():
        x, y = thinned(time, own["commanded"].values)
        ax.plot(x, y, color=ORANGE, linewidth=1.2, label="analysed controller")
    known = np.isfinite(own["logged"].values)
    ax.plot(*thinned(time[known], own["logged"].values[known]), color=DARK, linewidth=1.2, label="logged")
    if facts["first_outside"] is not None:
        ax.axvline(facts["first_outside"], color=RED, linestyle="--", linewidth=1.2, label="first outside")
    ax.set_ylabel(f"{name} [{facts['unit']}]")


def statistics_of_curves(ax: Axes, statistics: np.ndarray, p_value: float | None) -> None:
    """Draw the share of draws above each value of the statistic, and the log's own."""
    if p_value is None:
        ax.set_axis_off()
        ax.text(0.5, 0.5, "all draws are the same: a rank among them means nothing", ha="center", va="center")
        return
    ordered = np.sort(statistics[:-1])
    ordered = ordered[np.isfinite(ordered)]
    share = 1.0 - np.arange(len(ordered)) / (len(statistics) - 1)
    ax.step(ordered, share, where="pre", color=BLUE, label="share of draws at or above")
    if np.isfinite(statistics[-1]):
        ax.axvline(statistics[-1], color=RED, label=f"the log: p = {p_value:.3g}")
    else:
        ax.plot([], [], color=RED, label=f"the log: beyond all, p = {p_value:.3g}")
    ax.set(xlabel="largest standardised departure of a curve", ylabel="share", xscale="log", ylim=(0.0, 1.02))
    ax.legend(frameon=False, loc="best")
