"""Figure of a tuning: the way there, and every fresh draw's cost before and after."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, styled, title

if TYPE_CHECKING:
    from dssc_jax.analyses.tuning import Tuned


@styled
def tuning(found: "Tuned") -> Figure:
    """Objective and violation along the search, and the fresh draws' costs.

    Args:
        found: What :func:`dssc_jax.tune` returned.
    """
    figure = Figure(figsize=SLIDE, layout="constrained")
    left, right = figure.subplots(1, 2)
    way(left, found)
    costs(right, found)
    title(figure, f"{found.study.config.description or found.study.name}: {cost_text(found)}")
    return figure


def cost_text(found: "Tuned") -> str:
    """The objective as one reads it."""
    table = found.plan.table
    total = " + ".join(name if weight == 1.0 else f"{weight:g} {name}" for name, weight in table.objective.items())
    aggregate = {"mean": "mean", "worst": "soft worst", "cvar": f"CVaR {100 * table.level:g} %"}[table.aggregate]
    return f"{aggregate} of {total}"


def way(ax: Axes, found: "Tuned") -> None:
    """Objective on training and validation draws, and the largest violation of a limit."""
    steps = [row["step"] for row in found.history]
    ax.plot(steps, [row["objective"] for row in found.history], "o-", color=BLUE, label="training draws")
    ax.plot(steps, [row["validation"] for row in found.history], "s--", color=GREEN, label="validation draws")
    ax.set(xlabel="step", ylabel="objective")
    beside = ax.twinx()
    beside.grid(False)
    missed = [100.0 * row["validation_violation"] for row in found.history]
    beside.plot(steps, missed, ":", color=RED, label="violation, validation draws")
    beside.set(ylabel="largest violation of a limit [%]", ylim=(0.0, max(5.0, 1.1 * max(missed, default=0.0))))
    lines = [*ax.get_lines(), *beside.get_lines()]
    ax.legend(lines, [str(line.get_label()) for line in lines], frameon=False, loc="best")


def costs(ax: Axes, found: "Tuned") -> None:
    """Distribution functions of the fresh draws' costs, and the aggregates."""
    for name, colour, aggregate in zip(("start", "tuned"), (GREY, ORANGE), found.verdict.objective, strict=True):
        values = np.sort(np.where(np.isnan(found.costs[name]), np.inf, found.costs[name]))
        ax.step(values, np.arange(1, len(values) + 1) / len(values), where="post", color=colour, label=name)
        if np.isfinite(aggregate):
            ax.axvline(aggregate, color=colour, linestyle="--", label=f"objective, {name}: {aggregate:.4g}")
    ax.set(xlabel="cost of a draw", ylabel=f"share of {found.verdict.draws} fresh draws", ylim=(-0.03, 1.03))
    ax.legend(frameon=False, loc="best")
