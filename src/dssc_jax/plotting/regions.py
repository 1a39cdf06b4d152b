"""Figure of the region of two numbers in which enough of all plants meet the requirements."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from dssc_jax.plotting.style import DARK, GREEN, GREY, RED, named, set_log, styled, title

if TYPE_CHECKING:
    from dssc_jax.analyses.region.safe_region import SafeRegion

COLOURS_OF_VERDICTS = {0: ("at least 95 % pass", GREEN), 1: ("undecided", GREY), 2: ("fewer pass", RED)}
ENCLOSED = "enclosed by pairs that pass, no claim"


def enclosed_cells(verdict: np.ndarray) -> np.ndarray:
    """Cells of the lattice in a square whose corners meet the requirements, and which has no other verdict.

    Args:
        verdict: 0 where the requirements are met, negative where nothing was simulated; shape (m, m).

    Returns:
        Shape (m - 1, m - 1).
    """
    last = len(verdict) - 1
    enclosed, stride = np.zeros((last, last), bool), 1
    while last and last % stride == 0:
        for i, j in np.ndindex(last // stride, last // stride):
            rows, columns = (slice(stride * k, stride * (k + 1) + 1) for k in (i, j))
            square = verdict[rows, columns]
            if not square[::stride, ::stride].any() and square.max() <= 0:
                enclosed[rows.start : rows.stop - 1, columns.start : columns.stop - 1] = True
        stride *= 2
    return enclosed


@styled
def region(safe: "SafeRegion") -> Figure:
    """Plot the verdict of every simulated pair, what lies between those that pass, and what Theorem 1 certifies.

    Args:
        safe: The return value of :func:`dssc_jax.region`.
    """
    data, summary = safe.dataset, safe.summary()
    figure = Figure(figsize=(8.4, 6.2), layout="constrained")
    ax = figure.subplots()
    x, y = np.meshgrid(data["first"].values, data["second"].values, indexing="ij")
    verdict, certified = data["verdict"].values, data["certified"].values
    enclosed = enclosed_cells(verdict)
    if enclosed.any():
        ax.use_sticky_edges = False  # points on the edge are drawn whole
        shade = np.ma.masked_where(~enclosed, np.ones(enclosed.shape))
        ax.pcolormesh(x, y, shade, cmap=ListedColormap([GREEN]), alpha=0.18, linewidth=0.0, rasterized=True)
        ax.fill([], [], color=GREEN, alpha=0.18, linewidth=0.0, label=ENCLOSED)
    if certified.any():
        ax.scatter(x[certified], y[certified], marker="s", s=26, facecolor="none", edgecolor=DARK, linewidth=0.8,
                   label="certified by Theorem 1")  # fmt: skip
    for code, (text, colour) in COLOURS_OF_VERDICTS.items():
        here = verdict == code
        ax.scatter(x[here], y[here], s=13, color=colour, label=f"{text}: {np.count_nonzero(here)} pairs")
    first, second = summary["names"]
    ax.set(xlabel=named(first, data["first"].attrs), ylabel=named(second, data["second"].attrs))
    for which, name, log in zip("xy", safe.table, safe.log, strict=True):
        if log:
            set_log(ax, data[name].values, which)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    config = safe.study.config
    level = f"{100 * summary['confidence']:g} % confidence for all pairs together, {summary['draws']} draws"
    title(figure, f"{config.description or config.name}\n{level}")
    return figure
