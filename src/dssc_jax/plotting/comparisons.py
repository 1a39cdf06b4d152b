"""Figure of a comparison: every controller's failure probability, and the paired differences."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypedDict

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
    """Failure probability of controller ``a`` minus that of controller ``b``, with the bounds of its interval."""

    a: str
    b: str
    difference: float
    interval: Sequence[float]


class Marks(NamedTuple):
    """The marks of one contest of the controllers.

    Args:
        colour: Colour of the marks.
        text: Legend of the marks.
        shift: Vertical distance of the marks from the controllers' rows.
    """

    colour: str
    text: str
    shift: float


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
        marks = Marks(colour, text, shift)
        probability_panel(left, contest["controllers"], marks)
        pairs_with_first = [pair for pair in contest["pairs"] if pair["a"] == names[0]]
        difference_panel(right, pairs_with_first, list(contest["controllers"]), marks)
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


def probability_panel(ax: Axes, controllers: Mapping[str, FailureEstimate], marks: Marks) -> None:
    """Draw each controller's failure probability with its Clopper-Pearson interval.

    Args:
        ax: Axes to draw into.
        controllers: Estimates by controller, from the top row down.
        marks: Colour, legend and place of the marks.
    """
    estimates = list(controllers.values())
    share = np.array([estimate["probability"] for estimate in estimates])
    ends = np.array([estimate["interval"] for estimate in estimates]).T
    rows = np.arange(len(estimates)) + marks.shift
    ax.errorbar(share, rows, xerr=np.abs(ends - share), fmt="o", color=marks.colour, capsize=3, label=marks.text)


def difference_panel(ax: Axes, pairs: Sequence[PairedDifference], controllers: Sequence[str], marks: Marks) -> None:
    """Draw the failure probability of each controller minus that of the first, with its interval.

    The pairs hold the opposite difference, first minus other, so the sign is turned and the bounds are swapped.

    Args:
        ax: Axes to draw into.
        pairs: The first controller's failure probability minus that of each other one.
        controllers: Controllers, from the top row down.
        marks: Colour and place of the marks.
    """
    for pair in pairs:
        low_of_pair, high_of_pair = pair["interval"]
        difference = -pair["difference"]
        low = -high_of_pair
        high = -low_of_pair
        row = controllers.index(pair["b"]) + marks.shift
        distances = [[difference - low], [high - difference]]
        ax.errorbar([difference], [row], xerr=distances, fmt="o", color=marks.colour, capsize=3)
