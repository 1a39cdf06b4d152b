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
"""Distance of one controller's two marks, for its original and its tuned gains, from their common row."""


class FailureEstimate(TypedDict):
    """Failure probability of one controller, with the ends of its interval."""

    probability: float
    interval: Sequence[float]


class PairedDifference(TypedDict):
    """Failure probability of controller ``a`` minus that of ``b``, with the ends of its interval."""

    a: str
    b: str
    difference: float
    interval: Sequence[float]


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
        shift = OFFSET * (2 * index - len(contests) + 1)
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
    """Draw one dot with its Clopper-Pearson interval for each controller, a little off the controller's row."""
    estimates = list(controllers.values())
    share = np.array([estimate["probability"] for estimate in estimates])
    ends = np.array([estimate["interval"] for estimate in estimates]).T
    rows = np.arange(len(estimates)) + shift
    ax.errorbar(share, rows, xerr=np.abs(ends - share), fmt="o", color=colour, capsize=3, label=text)


def difference_panel(
    ax: Axes, pairs: Sequence[PairedDifference], rows: Sequence[str], first: str, colour: str, shift: float
) -> None:
    """Draw each controller minus the first, with the interval of the paired difference."""
    for pair in pairs:
        if pair["a"] != first:
            continue
        # the pair is the first controller minus another one
        high, low = (-end for end in pair["interval"])
        middle = -pair["difference"]
        row = rows.index(pair["b"]) + shift
        reach = [[middle - low], [high - middle]]
        ax.errorbar([middle], [row], xerr=reach, fmt="o", color=colour, capsize=3)
