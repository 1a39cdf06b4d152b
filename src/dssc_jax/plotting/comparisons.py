"""Figure of a comparison: every controller's failure probability, and the paired differences."""

from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.style import BLUE, GREY, ORANGE, SLIDE, styled, title
from dssc_jax.results.analysis import Analysis

OFFSET = 0.18
"""Distance of a controller's marks, for given and for tuned gains, from the controller's row."""


class FailureEstimate(TypedDict):
    """Failure probability of a controller with the bounds of its interval."""

    probability: float
    interval: Sequence[float]


class PairedDifference(TypedDict):
    """Failure probability of controller ``a`` minus that of ``b``, with the bounds of its interval."""

    a: str
    b: str
    difference: float
    interval: Sequence[float]


@styled
def comparison(compared: Analysis) -> Figure:
    """Plot each controller's failure probability, and its difference from the first controller on the same draws.

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
        shift = OFFSET * (2 * index - len(contests) + 1)  # 0 for one contest; -OFFSET and OFFSET for two
        probability_panel(left, contest["controllers"], colour, text, shift)
        rows = list(contest["controllers"])
        difference_panel(right, contest["pairs"], rows, names[0], colour, shift)
    right.axvline(0.0, color=GREY, linewidth=1.0)
    left.set(xlabel="failure probability, 95 % interval", xlim=(-0.03, 1.03))
    left.set(yticks=range(len(names)), yticklabels=names)
    right.set_xlabel(f"minus that of {names[0]} on the same draws, 95 % interval")
    left.invert_yaxis()
    for ax in (left, right):
        ax.xaxis.set_major_formatter(PercentFormatter(1.0))
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    required = "; ".join(summary["requirements"]) or "the draw stays finite"
    title(figure, f"{summary['study']}, {summary['draws']} draws: {required}")
    return figure


def probability_panel(
    ax: Axes, controllers: Mapping[str, FailureEstimate], colour: str, text: str, shift: float
) -> None:
    """Draw each controller's failure probability with its Clopper-Pearson interval.

    Args:
        ax: Axes to draw into.
        controllers: Estimates by controller, from the top row down.
        colour: Colour of the marks.
        text: Legend of the marks.
        shift: Distance of the marks from the controllers' rows.
    """
    estimates = list(controllers.values())
    share = np.array([estimate["probability"] for estimate in estimates])
    ends = np.array([estimate["interval"] for estimate in estimates]).T
    rows = np.arange(len(estimates)) + shift
    ax.errorbar(share, rows, xerr=np.abs(ends - share), fmt="o", color=colour, capsize=3, label=text)


def difference_panel(
    ax: Axes, pairs: Sequence[PairedDifference], rows: Sequence[str], first: str, colour: str, shift: float
) -> None:
    """Draw the failure probability of each controller minus that of the first, with its interval.

    Args:
        ax: Axes to draw into.
        pairs: Differences of all pairs of controllers.
        rows: Controllers, from the top row down.
        first: The controller with which the others are compared.
        colour: Colour of the marks.
        shift: Distance of the marks from the controllers' rows.
    """
    for pair in pairs:
        if pair["a"] != first:
            continue
        difference = -pair["difference"]  # the pair is the first controller minus the other
        high, low = (-bound for bound in pair["interval"])
        row = rows.index(pair["b"]) + shift
        distances = [[difference - low], [high - difference]]
        ax.errorbar([difference], [row], xerr=distances, fmt="o", color=colour, capsize=3)
