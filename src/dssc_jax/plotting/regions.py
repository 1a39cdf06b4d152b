"""Figure of the region of two numbers in which the requirements are met."""

import itertools
from typing import Protocol

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from dssc_jax.core.json_types import JsonObject
from dssc_jax.plotting.style import DARK, GREEN, GREY, RED, axis_label, set_log, study_title, styled, title
from dssc_jax.study import Study

COLOURS_OF_VERDICTS = {0: ("at least 95 % pass", GREEN), 1: ("undecided", GREY), 2: ("fewer pass", RED)}
"""Legend and colour of each verdict."""
ENCLOSED_LEGEND = "enclosed by pairs that pass, no claim"


class PlottedRegion(Protocol):
    """The attributes of :class:`dssc_jax.SafeRegion` that the figure reads."""

    study: Study
    dataset: xr.Dataset
    log: tuple[bool, bool]

    def summary(self) -> JsonObject:
        """The answer in plain numbers."""
        ...


def enclosed_cells(verdict: np.ndarray) -> np.ndarray:
    """Find the cells of a lattice of pairs that are enclosed by pairs that meet the requirements.

    Squares 1, 2, 4, ... cells wide are tried. All cells of a square are enclosed if its four corners meet the
    requirements and no pair in the square violates them.

    Args:
        verdict: Verdict of each pair, shape (m, m): 0 where the requirements are met, positive where they are violated,
            and negative where nothing was simulated.

    Returns:
        Whether each cell is enclosed, shape (m - 1, m - 1).
    """
    cells = len(verdict) - 1  # along each axis
    enclosed = np.zeros((cells, cells), bool)
    width = 1
    while cells and cells % width == 0:
        for row, column in itertools.product(range(0, cells, width), repeat=2):
            square = verdict[row : row + width + 1, column : column + width + 1]
            corners = square[::width, ::width]
            corners_pass = not corners.any()
            no_pair_fails = square.max() <= 0
            if corners_pass and no_pair_fails:
                enclosed[row : row + width, column : column + width] = True
        width *= 2
    return enclosed


@styled
def region(safe: PlottedRegion) -> Figure:
    """Plot the verdict of each simulated pair, the cells enclosed by pairs that pass, and what Theorem 1 certifies.

    Args:
        safe: The return value of :func:`dssc_jax.region`.
    """
    data = safe.dataset
    summary = safe.summary()
    figure = Figure(figsize=(8.4, 6.2), layout="constrained")
    ax = figure.subplots()
    x, y = np.meshgrid(data["first"].values, data["second"].values, indexing="ij")
    verdict = data["verdict"].values
    certified = data["certified"].values
    shade_enclosed(ax, x, y, enclosed_cells(verdict))
    if certified.any():
        squares = ax.scatter(x[certified], y[certified], marker="s", s=26, facecolor="none", edgecolor=DARK)
        squares.set(linewidth=0.8, label="certified by Theorem 1")
    for code, (text, colour) in COLOURS_OF_VERDICTS.items():
        pairs = verdict == code
        ax.scatter(x[pairs], y[pairs], s=13, color=colour, label=f"{text}: {np.count_nonzero(pairs)} pairs")
    first, second = summary["names"]
    ax.set(xlabel=axis_label(first, data["first"].attrs), ylabel=axis_label(second, data["second"].attrs))
    log_first, log_second = safe.log
    if log_first:
        set_log(ax, data["first"].values, "x")
    if log_second:
        set_log(ax, data["second"].values, "y")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    level = f"{100 * summary['confidence']:g} % confidence for all pairs together, {summary['draws']} draws"
    title(figure, f"{study_title(safe.study)}\n{level}")
    return figure


def shade_enclosed(ax: Axes, x: np.ndarray, y: np.ndarray, enclosed: np.ndarray) -> None:
    """Shade the enclosed cells of a lattice, with a legend entry if there are any.

    Args:
        ax: Axes to draw into.
        x: First number of each pair, shape (m, m).
        y: Second number of each pair, shape (m, m).
        enclosed: Whether each cell is enclosed, shape (m - 1, m - 1).
    """
    if not enclosed.any():
        return
    ax.use_sticky_edges = False  # points on the edge are drawn whole
    shade = np.ma.masked_where(~enclosed, np.ones(enclosed.shape))
    ax.pcolormesh(x, y, shade, cmap=ListedColormap([GREEN]), alpha=0.18, linewidth=0.0, rasterized=True)
    ax.fill([], [], color=GREEN, alpha=0.18, linewidth=0.0, label=ENCLOSED_LEGEND)  # no points: a legend alone
