"""Figure of sensitivities."""

import textwrap
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, ORANGE, SLIDE, styled, title
from dssc_jax.results.analysis import Analysis

OFFSET = 0.13
"""Distance of a factor's marks, one for each sensitivity, from the factor's row."""
QUANTITY_COLOURS = (BLUE, ORANGE)
"""Colour of each sensitivity of a factor, such as first-order and total index."""


@styled
def sensitivity(indices: Analysis) -> Figure:
    """Plot the sensitivity of failure and of the headline metric to each factor, with intervals.

    Args:
        indices: The return value of :func:`dssc_jax.sensitivity`.
    """
    summary = indices.summary()
    names = summary["headline"]
    factors = summary["factors"]
    shares = all(quantity["share"] for quantity in summary["quantities"].values())
    figure = Figure(figsize=(SLIDE[0], max(3.0, 1.8 + 0.55 * len(factors))), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(names), sharey=True))
    for ax, name in zip(panels, names, strict=True):
        output = summary["outputs"][name]
        ax.set_title(textwrap.fill(name, 40), parse_math=False)
        ax.axvline(0.0, color="black", linewidth=0.8)
        ax.set_xlabel("share of the variance" if shares else f"change of {name}", parse_math=False)
        if output is None:
            reason = textwrap.fill(f"no answer; it {summary['reasons'][name]}", 40)
            ax.text(0.5, 0.5, reason, transform=ax.transAxes, ha="center")
        else:
            factor_rows(ax, output, summary["quantities"])
    panels[0].set_yticks(range(len(factors)), factors)
    panels[0].set_ylim(len(factors) - 0.5, -0.5)
    legends = [ax.get_legend_handles_labels() for ax in panels]
    handles, labels = max(legends, key=lambda legend: len(legend[0]))  # a panel without an answer has none
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    subject = f"{summary['study']}: {summary['title']} from {summary['simulations']} simulations"
    title(figure, f"{subject}, {100 * summary['confidence']:g} % intervals")
    return figure


def factor_rows(
    ax: Axes, output: Mapping[str, Mapping[str, object]], quantities: Mapping[str, Mapping[str, str]]
) -> None:
    """Draw the sensitivities of an output with their intervals, one row for each factor.

    Args:
        ax: Axes to draw into.
        output: Sensitivities by factor. In each factor, the key of a quantity gives its value, and the key followed by
            ``_interval`` gives its interval.
        quantities: Attributes of each quantity, by the quantity's key; ``legend`` is the text of the legend.
    """
    factors = list(output.values())
    count = len(quantities)
    offsets = OFFSET * (2.0 * np.arange(count) - count + 1.0)  # symmetric about the factor's row
    for (name, quantity), colour, offset in zip(quantities.items(), QUANTITY_COLOURS, offsets, strict=False):
        value = np.array([factor[name] for factor in factors])
        low, high = np.array([factor[f"{name}_interval"] for factor in factors]).T
        rows = np.arange(len(factors)) + offset
        distances = np.maximum([value - low, high - value], 0.0)
        ax.errorbar(value, rows, xerr=distances, fmt="o", color=colour, capsize=3, label=quantity["legend"])
