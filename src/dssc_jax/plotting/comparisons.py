"""Figure of a comparison: every controller's failure probability, and the paired differences."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.style import BLUE, GREY, ORANGE, SLIDE, styled, title
from dssc_jax.results.analysis import Analysis

APART = 0.18  # between given and tuned gains of one controller


@styled
def comparison(compared: Analysis) -> Figure:
    """Plot failure probabilities with their intervals, and differences from the first controller, paired by draw.

    Args:
        compared: The return value of :func:`dssc_jax.compare`.
    """
    summary = compared.summary()
    names = list(summary["controllers"])
    figure = Figure(figsize=(SLIDE[0], max(SLIDE[1], 1.6 + 0.5 * len(names))), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    contests = [(summary, BLUE, "given or corresponding gains")]
    if summary["tuned"]:
        contests.append((summary["tuned"], ORANGE, "tuned on equal budgets"))
    for index, (contest, colour, text) in enumerate(contests):
        shift = APART * (2 * index - len(contests) + 1)
        probability_panel(left, contest, colour, text, shift)
        difference_panel(right, contest, names[0], colour, shift)
    right.axvline(0.0, color=GREY, linewidth=1.0)
    left.set(
        xlabel="failure probability, 95 % interval", yticks=range(len(names)), yticklabels=names, xlim=(-0.03, 1.03)
    )
    right.set_xlabel(f"minus that of {names[0]} on the same draws, 95 % interval")
    left.invert_yaxis()
    for ax in (left, right):
        ax.xaxis.set_major_formatter(PercentFormatter(1.0))
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    required = "; ".join(summary["requirements"]) or "the draw stays finite"
    title(figure, f"{summary['study']}, {summary['draws']} draws: {required}")
    return figure


def probability_panel(ax: Axes, contest: dict[str, Any], colour: str, text: str, shift: float) -> None:
    """Draw one dot with its Clopper-Pearson interval for each controller."""
    own = list(contest["controllers"].values())
    share = np.array([one["probability"] for one in own])
    ends = np.array([one["interval"] for one in own]).T
    at = np.arange(len(own)) + shift
    ax.errorbar(share, at, xerr=np.abs(ends - share), fmt="o", color=colour, capsize=3, label=text)


def difference_panel(ax: Axes, contest: dict[str, Any], first: str, colour: str, shift: float) -> None:
    """Draw each controller minus the first, with the interval of the paired difference."""
    rows = list(contest["controllers"])
    for pair in contest["pairs"]:
        if pair["a"] == first:  # the pair is first minus other
            low, high = (-end for end in reversed(pair["interval"]))
            at, middle = rows.index(pair["b"]) + shift, -pair["difference"]
            ax.errorbar([middle], [at], xerr=[[middle - low], [high - middle]], fmt="o", color=colour, capsize=3)
