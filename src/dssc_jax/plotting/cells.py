"""Cells, colour limits and contours of maps over two axes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.typing import LineStyleType

from dssc_jax.plotting.style import DARK

MOST_VECTOR_CELLS = 2500
OUTLINE: list[AbstractPathEffect] = [withStroke(linewidth=3.0, foreground=DARK)]
"""White lines have a dark rim, so that they are seen on every colour, and in the legend as in the map."""


def map_top(share: np.ndarray) -> float:
    """Upper end of a map's colours: the largest probability if it is below one half, else 1."""
    largest = float(share.max())
    return largest if 0.0 < largest < 0.5 else 1.0


def needs_bitmap(values: np.ndarray) -> bool:
    """Whether a map has so many cells that it is written as one bitmap."""
    return values.size > MOST_VECTOR_CELLS


def cell_edges(values: np.ndarray, logarithmic: bool) -> np.ndarray:
    """Edges of cells around increasing values: half way between neighbours, and as far beyond both ends.

    Args:
        values: Shape (n,).
        logarithmic: Whether half way is meant on a logarithmic axis.

    Returns:
        Shape (n + 1,).
    """
    centres = np.log(values) if logarithmic else values
    half = np.diff(centres) / 2.0 if len(centres) > 1 else np.array([0.5])
    start = centres[0] - half[0]
    inner = centres[:-1] + half[: len(centres) - 1]
    end = centres[-1] + half[-1]
    edges = np.concatenate(([start], inner, [end]))
    return np.exp(edges) if logarithmic else edges


def capped_limits(finite: np.ndarray, cap: float | None) -> tuple[float, float] | None:
    """Colour limits that end at a cap, so that a diverging corner does not flatten the other colours.

    Args:
        finite: The finite values of a map.
        cap: Upper limit of the colours; None: no limit.

    Returns:
        Lowest and highest coloured value; None if the cap is not within the values.
    """
    if cap is None or not finite.size or not finite.min() < cap < finite.max():
        return None
    return float(finite.min()), cap


def contour(ax: Axes, x: np.ndarray, y: np.ndarray, z: np.ndarray, level: float, style: LineStyleType) -> None:
    """Draw a white contour if the level is crossed; infinities and NaN count as far above it."""
    if min(z.shape) < 2 or not np.nanmin(z) < level < np.nanmax(z):
        return
    finite_z = np.where(np.isfinite(z), z, 1e3 * abs(level))
    lines = ax.contour(x, y, finite_z, levels=(level,), colors="white", linewidths=1.8, linestyles=style)
    lines.set_path_effects(OUTLINE)
