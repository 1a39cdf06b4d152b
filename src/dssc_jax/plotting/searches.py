"""Figures of searches: a tuning with the costs of fresh draws before and after, and the search for the worst draw."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.levels import law_axis, level_of
from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, study_title, styled, title
from dssc_jax.results.analysis import Analysis

PROVED_NUMBERS = ("proved_error", "proved_up_to")
"""Variables of a tuning's dataset with a proved number that the tuning optimises."""
AGGREGATES = {"mean": "mean", "worst": "soft worst", "cvar": "CVaR"}
"""Name in a title of each aggregate of a tuning's costs over the draws."""


class ObjectiveSummary(TypedDict):
    """Objective of a tuning: weight of each metric, aggregate over the draws, and level of the aggregate."""

    costs: Mapping[str, float]
    aggregate: str
    level: float


class VerdictSummary(TypedDict):
    """Number of fresh draws, and the objective on them at the start and at the result of a tuning."""

    draws: int
    objective: Sequence[float | None]


@styled
def tuning(tuned: Analysis) -> Figure:
    """Plot objective and violation along the search, and the distribution of the fresh draws' costs.

    Args:
        tuned: The return value of :func:`dssc_jax.tune`.
    """
    summary = tuned.summary()
    figure = Figure(figsize=SLIDE, layout="constrained")
    left, right = figure.subplots(1, 2)
    history_panel(left, tuned)
    cost_panel(right, tuned, summary["verdict"])
    title(figure, f"{study_title(tuned.study)}: {objective_text(summary['objective'])}")
    return figure


def objective_text(objective: ObjectiveSummary) -> str:
    """Describe the objective of a tuning, such as ``CVaR 90 % of error_rms + 0.1 command_tv``."""
    terms = []
    for name, weight in objective["costs"].items():
        terms.append(name if weight == 1.0 else f"{weight:g} {name}")
    aggregate = AGGREGATES[objective["aggregate"]]
    if objective["aggregate"] == "cvar":
        aggregate = f"{aggregate} {100 * objective['level']:g} %"
    return f"{aggregate} of {' + '.join(terms)}"


def history_panel(ax: Axes, tuned: Analysis) -> None:
    """Draw the objective along the search, and on a second axis the largest violation of a limit.

    The objective is the proved number if the tuning has one. Otherwise it is drawn on training and on validation draws.
    """
    data = tuned.dataset
    step = data["step"].values
    proved = [data[name] for name in PROVED_NUMBERS if name in data]
    if proved:
        number = proved[0]
        ax.step(step, number.values, "o-", where="post", color=BLUE, label="proved, by improvement")
        ax.set(xlabel="step", ylabel=f"{number.attrs['long_name']} [{number.attrs['units']}]")
    else:
        ax.plot(step, data["objective"].values, "o-", color=BLUE, label="training draws")
        ax.plot(step, data["validation"].values, "s--", color=GREEN, label="validation draws")
        ax.set(xlabel="step", ylabel="objective")
    right = ax.twinx()
    right.grid(False)
    violation = 100.0 * data["validation_violation"].values
    top = max(5.0, 1.1 * np.max(violation, where=np.isfinite(violation), initial=0.0))
    right.plot(step, violation, ":", color=RED, label="violation, validation draws")
    right.set(ylabel="largest violation of a limit [%]", ylim=(0.0, top))
    lines = [*ax.get_lines(), *right.get_lines()]
    labels = [str(line.get_label()) for line in lines]
    ax.legend(lines, labels, frameon=False, loc="best")


def cost_panel(ax: Axes, tuned: Analysis, verdict: VerdictSummary) -> None:
    """Draw the distribution functions of the fresh draws' costs at the start and at the result, with the objectives.

    A draw without a cost counts as infinite, so that the curve ends below 1.
    """
    for name, colour, aggregate in zip(("start", "tuned"), (GREY, ORANGE), verdict["objective"], strict=True):
        cost = tuned.dataset[f"cost_{name}"].values
        sorted_costs = np.sort(np.where(np.isnan(cost), np.inf, cost))
        share = np.arange(1, len(sorted_costs) + 1) / len(sorted_costs)
        ax.step(sorted_costs, share, where="post", color=colour, label=name)
        if aggregate is not None:
            ax.axvline(aggregate, color=colour, linestyle="--", label=f"objective, {name}: {aggregate:.4g}")
    ax.set(xlabel="cost of a draw", ylabel=f"share of {verdict['draws']} fresh draws", ylim=(-0.03, 1.03))
    ax.legend(frameon=False, loc="best")


@styled
def falsification(falsified: Analysis) -> Figure:
    """Plot the slacks along the search and over the draws' distance, and where in the laws the worst draw is.

    Args:
        falsified: The return value of :func:`dssc_jax.falsify`.
    """
    summary = falsified.summary()
    figure = Figure(figsize=SLIDE, layout="constrained")
    axes = figure.subplot_mosaic([["search", "levels"], ["distance", "levels"]])
    search_panel(axes["search"], falsified)
    distance_panel(axes["distance"], falsified, summary["within"])
    levels_panel(axes["levels"], falsified, summary["witness"])
    title(figure, f"{summary['study']}: {falsified.headline}")
    return figure


def levels_panel(ax: Axes, falsified: Analysis, witness: Mapping[str, float]) -> None:
    """Draw where the worst draw lies within each law.

    Args:
        ax: Axes to draw into.
        falsified: The return value of the falsification.
        witness: Numbers of the worst draw by name, in the order of the study's laws.
    """
    laws = falsified.study.laws
    levels = [float(level_of(laws[name], np.array([value]))[0]) for name, value in witness.items()]
    ax.plot(levels, range(len(levels)), "o", color=RED)
    law_axis(ax, list(laws), "the worst draw")


def finite_slack(falsified: Analysis) -> np.ndarray:
    """The slack of each simulation, shape (simulations,); NaN where it is infinite."""
    slack = falsified.dataset["slack"]
    return np.where(np.isfinite(slack), slack, np.nan)


def search_panel(ax: Axes, falsified: Analysis) -> None:
    """Draw the slack of each simulation, and the worst slack so far."""
    slack = finite_slack(falsified)
    simulations = falsified.dataset["simulations"]
    ax.plot(simulations, slack, ".", color=GREY, markersize=4, label="each simulation")
    ax.step(simulations, np.fmin.accumulate(slack), where="post", color=BLUE, label="worst so far")
    ax.axhline(0.0, color=RED, linestyle="--", label="failure below")
    ax.set(xlabel="simulations", ylabel="slack / bound")
    ax.legend(fontsize="small", framealpha=0.85)


def distance_panel(ax: Axes, falsified: Analysis, limit: Mapping[str, float] | None) -> None:
    """Draw the slack of each simulation over the distance of its draw from the median draw.

    Args:
        ax: Axes to draw into.
        falsified: The analysis.
        limit: Largest ``distance`` of the search, and the ``mass``, which is the share of all draws within this
            distance; None: no limit.
    """
    slack = finite_slack(falsified)
    distance = falsified.dataset["distance"]
    ax.plot(distance, slack, ".", color=GREY, markersize=4)
    if limit:
        text = f"limit: holds {100.0 * limit['mass']:.4g} % of all draws"
        ax.axvline(limit["distance"], color="black", linestyle=":", label=text)
    for name, index, marker in marked_draws(falsified):
        ax.plot(distance[index], slack[index], marker, color=RED, label=name, clip_on=False)
    ax.axhline(0.0, color=RED, linestyle="--")
    ax.set(xlabel="distance from the median draw [sigma]", ylabel="slack / bound", xlim=(0.0, None))
    ax.legend(fontsize="small", framealpha=0.85)


def marked_draws(falsified: Analysis) -> Iterator[tuple[str, int, str]]:
    """Yield name, index and marker of the draws to mark: the worst draw, and the failure nearest to the median draw.

    If no draw fails, only the worst draw is marked.
    """
    slack = falsified.dataset["slack"].values
    distance = falsified.dataset["distance"].values
    yield "worst draw", int(np.argmin(slack)), "o"
    if (slack < 0.0).any():
        distance_of_failures = np.where(slack < 0.0, distance, np.inf)
        yield "likeliest failure", int(np.argmin(distance_of_failures)), "D"
