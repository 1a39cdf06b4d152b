"""Figures of Sobol indices."""

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, ORANGE, SLIDE, styled, title
from dssc_jax.results.analysis import Analysis

OFFSET = 0.13  # of the two kinds of index from their common row
INDEX_KINDS = {"first": ("first order: alone", BLUE, -OFFSET), "total": ("total: with interactions", ORANGE, OFFSET)}


@styled
def sensitivity(indices: Analysis) -> Figure:
    """Plot first-order and total indices with their intervals, for failure and the study's headline metric.

    Args:
        indices: The return value of :func:`dssc_jax.sensitivity`.
    """
    summary = indices.summary()
    names, factors = summary["headline"], summary["factors"]
    figure = Figure(figsize=(SLIDE[0], max(3.0, 1.8 + 0.55 * len(factors))), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(names), sharey=True))
    for ax, name in zip(panels, names, strict=True):
        output = summary["outputs"][name]
        ax.set_title(textwrap.fill(name, 40), parse_math=False)
        ax.axvline(0.0, color="black", linewidth=0.8)
        ax.set_xlabel("share of the variance")
        if output is None:
            reason = textwrap.fill(f"no indices; it {summary['reasons'][name]}", 40)
            ax.text(0.5, 0.5, reason, transform=ax.transAxes, ha="center")
        else:
            factor_rows(ax, output)
    panels[0].set_yticks(range(len(factors)), factors)
    panels[0].set_ylim(len(factors) - 0.5, -0.5)
    handles, labels = max((ax.get_legend_handles_labels() for ax in panels), key=lambda pair: len(pair[0]))
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    title(
        figure,
        f"{summary['study']}: Sobol indices from {summary['simulations']} simulations, "
        f"{100 * summary['confidence']:g} % intervals",
    )
    return figure


def factor_rows(ax: Axes, output: Mapping[str, Any]) -> None:
    """Draw both kinds of index, one row for each factor."""
    for part, (text, colour, offset) in INDEX_KINDS.items():
        value = np.array([one[part] for one in output.values()])
        low, high = np.array([one[f"{part}_interval"] for one in output.values()]).T
        where = np.arange(len(value)) + offset
        reach = np.maximum([value - low, high - value], 0.0)
        ax.errorbar(value, where, xerr=reach, fmt="o", color=colour, capsize=3, label=text)
