"""Figures of searches: a tuning with every fresh draw's cost before and after, and the search for the worst draw."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.levels import law_axis, level_of
from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, styled, title
from dssc_jax.results.analysis import Analysis

PROVED_NUMBERS = ("proved_error", "proved_up_to")
"""Proved numbers that a tuning may optimise, as variables of its dataset."""


@styled
def tuning(tuned: Analysis) -> Figure:
    """Plot objective and violation along the search, and the fresh draws' costs.

    Args:
        tuned: The return value of :func:`dssc_jax.tune`.
    """
    summary = tuned.summary()
    figure = Figure(figsize=SLIDE, layout="constrained")
    left, right = figure.subplots(1, 2)
    history(left, tuned)
    costs(right, tuned, summary["verdict"])
    config = tuned.study.config
    title(figure, f"{config.description or config.name}: {cost_text(summary['objective'])}")
    return figure


def cost_text(objective: Mapping[str, Any]) -> str:
    """The objective in words."""
    weights = objective["costs"].items()
    total = " + ".join(name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights)
    names = {"mean": "mean", "worst": "soft worst", "cvar": f"CVaR {100 * objective['level']:g} %"}
    return f"{names[objective['aggregate']]} of {total}"


def history(ax: Axes, tuned: Analysis) -> None:
    """Draw the objective on training and validation draws, and the largest violation of a limit."""
    looks = {name: tuned.dataset[name].values for name in ("step", "objective", "validation", "validation_violation")}
    proved = next((tuned.dataset[name] for name in PROVED_NUMBERS if name in tuned.dataset), None)
    if proved is None:
        ax.plot(looks["step"], looks["objective"], "o-", color=BLUE, label="training draws")
        ax.plot(looks["step"], looks["validation"], "s--", color=GREEN, label="validation draws")
        ax.set(xlabel="step", ylabel="objective")
    else:
        ax.step(looks["step"], proved.values, "o-", where="post", color=BLUE, label="proved, by improvement")
        ax.set(xlabel="step", ylabel=f"{proved.attrs['long_name']} [{proved.attrs['units']}]")
    right = ax.twinx()
    right.grid(False)
    missed = 100.0 * looks["validation_violation"]
    right.plot(looks["step"], missed, ":", color=RED, label="violation, validation draws")
    right.set(ylabel="largest violation of a limit [%]", ylim=(0.0, max(5.0, 1.1 * max(missed, default=0.0))))
    lines = [*ax.get_lines(), *right.get_lines()]
    ax.legend(lines, [str(line.get_label()) for line in lines], frameon=False, loc="best")


def costs(ax: Axes, tuned: Analysis, verdict: Mapping[str, Any]) -> None:
    """Draw distribution functions of the fresh draws' costs, and the aggregates."""
    for name, colour, aggregate in zip(("start", "tuned"), (GREY, ORANGE), verdict["objective"], strict=True):
        cost = tuned.dataset[f"cost_{name}"].values
        values = np.sort(np.where(np.isnan(cost), np.inf, cost))
        ax.step(values, np.arange(1, len(values) + 1) / len(values), where="post", color=colour, label=name)
        if aggregate is not None:
            ax.axvline(aggregate, color=colour, linestyle="--", label=f"objective, {name}: {aggregate:.4g}")
    ax.set(xlabel="cost of a draw", ylabel=f"share of {verdict['draws']} fresh draws", ylim=(-0.03, 1.03))
    ax.legend(frameon=False, loc="best")


@styled
def falsification(falsified: Analysis) -> Figure:
    """Plot slacks along the search and over the draws' distances, and where the worst draw lies within its laws.

    Args:
        falsified: The return value of :func:`dssc_jax.falsify`.
    """
    summary, data = falsified.summary(), falsified.dataset
    figure = Figure(figsize=SLIDE, layout="constrained")
    axes = figure.subplot_mosaic([["search", "levels"], ["distance", "levels"]])
    slack = np.where(np.isfinite(data["slack"]), data["slack"], np.nan)
    search, distance, levels = (axes[name] for name in ("search", "distance", "levels"))
    search.plot(data["simulations"], slack, ".", color=GREY, markersize=4, label="each simulation")
    search.step(data["simulations"], np.fmin.accumulate(slack), where="post", color=BLUE, label="worst so far")
    search.set(xlabel="simulations")
    distance.plot(data["distance"], slack, ".", color=GREY, markersize=4)
    if within := summary["within"]:
        text = f"limit: holds {100.0 * within['mass']:.4g} % of all draws"
        distance.axvline(within["distance"], color="black", linestyle=":", label=text)
    for name, point, marker in marked(falsified):
        distance.plot(data["distance"][point], slack[point], marker, color=RED, label=name, clip_on=False)
    distance.set(xlabel="distance from the median draw [sigma]", xlim=(0.0, None))
    for ax in (search, distance):
        ax.axhline(0.0, color=RED, linestyle="--", label="failure below" if ax is search else None)
        ax.set(ylabel="slack / bound")
        ax.legend(fontsize="small", framealpha=0.85)
    laws = falsified.study.laws
    at = [level_of(laws[name], np.array([value]))[0] for name, value in summary["witness"].items()]
    levels.plot(at, range(len(at)), "o", color=RED)
    law_axis(levels, list(laws), "the worst draw")
    title(figure, f"{summary['study']}: {falsified.headline}")
    return figure


def marked(falsified: Analysis) -> Iterator[tuple[str, int, str]]:
    """The worst draw and the likeliest failure: name, index and marker."""
    slack, distance = (falsified.dataset[name].values for name in ("slack", "distance"))
    yield "worst draw", int(np.argmin(slack)), "o"
    if (slack < 0.0).any():
        yield "likeliest failure", int(np.argmin(np.where(slack < 0.0, distance, np.inf))), "D"
