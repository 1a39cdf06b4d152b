"""Figure of a rare failure: its probability by each method, and where failures lie within the laws."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.core.json_types import JsonObject
from dssc_jax.plotting.levels import law_axis, level_of
from dssc_jax.plotting.style import BLUE, GREY, ORANGE, RED, SLIDE, set_scale, styled, title
from dssc_jax.results.analysis import Analysis


@styled
def rare(event: Analysis) -> Figure:
    """Plot the failure probability and where failures lie.

    The probability is that of each repeat, of the method, and of plain draws.

    Args:
        event: The return value of :func:`dssc_jax.rare`.
    """
    summary = event.summary()
    figure = Figure(figsize=SLIDE, layout="constrained")
    left, right = figure.subplots(1, 2)
    probability_panel(left, summary)
    for row, (name, levels) in enumerate(summary["where"].items()):
        if levels["failing"] is None:
            continue
        low, middle, high = level_of(event.study.laws[name], np.array(levels["failing"]))
        right.errorbar([middle], [row], xerr=[[middle - low], [high - middle]], fmt="o", color=RED, capsize=3)
    law_axis(right, list(summary["where"]), "5 %, median and 95 % of failures")
    required = "; ".join(summary["requirements"])
    title(figure, f"{summary['study']}: {required}\n{event.headline}")
    return figure


def probability_panel(ax: Axes, summary: JsonObject) -> None:
    """Draw estimates of the failure probability in three rows: of the repeats, of the method, and of plain draws.

    The axis may be logarithmic, so a bound of 0 is drawn below all estimates.
    """
    plain = summary["plain"]
    method_answer = summary["by_method"]
    estimates = np.array(summary["estimates"])  # of the repeats
    rows = ("each repeat" if len(estimates) else "", summary["method"], "plain draws")
    positive = estimates[estimates > 0.0]
    left_end = 0.1 * min([*positive, 1.0 / plain["draws"]])
    ax.plot(positive, np.zeros(len(positive)), ".", color=GREY)
    method_bounds = np.maximum(method_answer["interval"], left_end)
    plain_bounds = np.maximum(plain["interval"], left_end)
    draw_estimate(ax, 1, method_answer["probability"], method_bounds, BLUE)
    draw_estimate(ax, 2, plain["failures"] / plain["draws"], plain_bounds, ORANGE)
    set_scale(ax, np.concatenate([positive, method_bounds, plain_bounds]))
    ax.set(xlabel="failure probability, 95 % intervals", yticks=range(len(rows)), yticklabels=rows)
    ax.set_ylim(len(rows) - 0.5, -0.5)


def draw_estimate(ax: Axes, row: int, probability: float, bounds: np.ndarray, colour: str) -> None:
    """Draw an interval as a horizontal line, and the estimate as a dot on it; an estimate of 0 has no dot.

    Args:
        ax: Axes to draw into.
        row: Row on the vertical axis.
        probability: The estimate.
        bounds: Lower and upper bound, shape (2,).
        colour: Colour of dot and line.
    """
    ax.plot(bounds, [row, row], color=colour)
    if probability:
        ax.plot([probability], [row], "o", color=colour)
