"""Figures of Sobol indices."""

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.analyses.sensitivity import FAILURE, Indices, Sensitivity
from dssc_jax.plotting.style import BLUE, ORANGE, SLIDE, styled, title
from dssc_jax.results.result import headline_measure

OFFSET = 0.13  # of the two kinds of index from their common row


@styled
def sensitivity(result: Sensitivity) -> Figure:
    """First-order and total indices with their intervals, of failure and of the study's headline metric."""
    names = list(dict.fromkeys((FAILURE, headline_measure(result.study).name)))
    height = max(3.0, 1.8 + 0.55 * len(result.factors))
    figure = Figure(figsize=(SLIDE[0], height), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(names), sharey=True))
    for ax, name in zip(panels, names, strict=True):
        found = result.outputs[name]
        ax.set_title(textwrap.fill(name, 40), parse_math=False)
        ax.axvline(0.0, color="black", linewidth=0.8)
        ax.set_xlabel("share of the variance")
        if found is None:
            why = textwrap.fill(f"no indices; it {result.reasons[name]}", 40)
            ax.text(0.5, 0.5, why, transform=ax.transAxes, ha="center")
        else:
            rows(ax, found)
    panels[0].set_yticks(range(len(result.factors)), result.factors)
    panels[0].set_ylim(len(result.factors) - 0.5, -0.5)
    handles, labels = max((ax.get_legend_handles_labels() for ax in panels), key=lambda pair: len(pair[0]))
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    title(
        figure,
        f"{result.study.name}: Sobol indices from {result.simulations} simulations, "
        f"{100 * result.confidence:g} % intervals",
    )
    return figure


def rows(ax: Axes, found: Indices) -> None:
    """Both kinds of index, a row a factor."""
    kinds = {
        "first order: alone": (found.first, BLUE, -OFFSET),
        "total: with interactions": (found.total, ORANGE, OFFSET),
    }
    for text, (table, colour, offset) in kinds.items():
        value, low, high = table.T
        where = np.arange(len(value)) + offset
        reach = np.maximum([value - low, high - value], 0.0)
        ax.errorbar(value, where, xerr=reach, fmt="o", color=colour, capsize=3, label=text)
