"""Values of uncertain numbers as levels of their laws, so that numbers with different units share one axis."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from dssc_jax.study import Law

LEVELS = np.linspace(0.0005, 0.9995, 1000)
"""Levels at which a law is tabulated."""


def level_of(law: Law, values: np.ndarray) -> np.ndarray:
    """The level of each value in a law: the law's distribution function at the value, with an error of about 0.001.

    Args:
        law: The law.
        values: The values, shape (n,).
    """
    return np.interp(values, law.quantile(LEVELS), LEVELS)


def law_axis(ax: Axes, names: Sequence[str], subject: str) -> None:
    """Set up axes with one row for each number, and with the level in the number's law along the horizontal axis.

    Args:
        ax: Axes to set up.
        names: Names of the numbers, from top to bottom.
        subject: What is drawn, for the axis label.
    """
    ax.set(xlabel=f"level of the law, {subject}", xlim=(-0.03, 1.03))
    ax.set(yticks=range(len(names)), yticklabels=list(names))
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.axvline(0.5, color="black", linewidth=0.8)
    ax.xaxis.set_major_formatter(PercentFormatter(1.0))
