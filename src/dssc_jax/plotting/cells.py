"""Cells, colours and contours of maps over two axes."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import AbstractPathEffect, withStroke

from dssc_jax.plotting.style import DARK

FINE = 2500  # a map of more cells is written as an image, not cell by cell
OUTLINE: list[AbstractPathEffect] = [withStroke(linewidth=3.0, foreground=DARK)]
"""White lines have a dark rim, so that they are seen on every colour, and in the legend as in the map."""


def map_top(share: np.ndarray) -> float:
    """Upper end of a map's colours: certainty, or the largest probability if that is below one half."""
    largest = float(share.max())
    return largest if 0.0 < largest < 0.5 else 1.0


def cells(values: np.ndarray) -> dict[str, Any]:
    """How a map's cells are drawn: as one bitmap if there are very many."""
    return {"shading": "nearest", "rasterized": values.size > FINE}


def cell_edges(values: np.ndarray, logarithmic: bool) -> np.ndarray:
    """Edges half way between neighbours, and as far beyond both ends; shape (n + 1,)."""
    x = np.log(values) if logarithmic else values
    half = np.diff(x) / 2.0 if len(x) > 1 else np.array([0.5])
    edges = np.concatenate(([x[0] - half[0]], x[:-1] + half[: len(x) - 1], [x[-1] + half[-1]]))
    return np.exp(edges) if logarithmic else edges


def colour_limits(finite: np.ndarray, cap: float | None) -> dict[str, Any]:
    """Colour limits, such that a diverging corner does not flatten the rest."""
    if cap is None or not finite.size or not finite.min() < cap < finite.max():
        return {}
    return {"vmin": float(finite.min()), "vmax": cap}


def contour(ax: Axes, x: np.ndarray, y: np.ndarray, z: np.ndarray, level: float, style: str) -> None:
    """Draw a white contour if the level is crossed."""
    if min(z.shape) >= 2 and np.nanmin(z) < level < np.nanmax(z):
        shown = np.where(np.isfinite(z), z, 1e3 * abs(level))
        lines = ax.contour(x, y, shown, levels=(level,), colors="white", linewidths=1.8, linestyles=style)
        lines.set_path_effects(OUTLINE)
