"""Values of uncertain numbers as levels of their laws, so that numbers with different units share one axis."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from dssc_jax.study import Law

LEVELS = np.linspace(0.0005, 0.9995, 1000)


def level_of(law: Law, values: np.ndarray) -> np.ndarray:
    """The probability of a value at most this large, rounded to a thousandth; shape (n,)."""
    return np.interp(values, law.quantile(LEVELS), LEVELS)


def law_axis(ax: Axes, names: Sequence[str], what: str) -> None:
    """Set up one row for each number, with its law's levels along the horizontal axis."""
    ax.set(xlabel=f"level of the law, {what}", xlim=(-0.03, 1.03), yticks=range(len(names)), yticklabels=list(names))
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.axvline(0.5, color="black", linewidth=0.8)
    ax.xaxis.set_major_formatter(PercentFormatter(1.0))
