"""Cells, colour limits and contours of maps over two axes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.typing import LineStyleType

from dssc_jax.plotting.style import DARK

MOST_VECTOR_CELLS = 2500
"""Largest number of cells of a map that is written as vector graphics."""
OUTLINE: list[AbstractPathEffect] = [withStroke(linewidth=3.0, foreground=DARK)]
"""Dark rim of white lines, which makes them visible on every colour of a map, and in its legend."""


def largest_colour(share: np.ndarray) -> float:
    """Upper end of a map's colour scale: the largest probability if it is above 0 and below one half, else 1.

    Args:
        share: Share of failed draws in each cell.
    """
    largest = float(share.max())
    return largest if 0.0 < largest < 0.5 else 1.0


def needs_bitmap(values: np.ndarray) -> bool:
    """Whether a map has so many cells that it is written as a bitmap rather than as vector graphics."""
    return values.size > MOST_VECTOR_CELLS


def cell_edges(values: np.ndarray, logarithmic: bool) -> np.ndarray:
    """Edges of the cells around increasing values: half way between neighbours, and equally far beyond both ends.

    A single value gets a cell of width 1, or from e^(-1/2) to e^(1/2) times the value on a logarithmic axis.

    Args:
        values: Centres of the cells, shape (n,).
        logarithmic: Whether half way is meant on a logarithmic axis.

    Returns:
        The edges, shape (n + 1,).
    """
    centres = np.log(values) if logarithmic else values
    half_distances = np.diff(centres) / 2.0 if len(centres) > 1 else np.array([0.5])
    start = centres[0] - half_distances[0]
    inner = centres[:-1] + half_distances[: len(centres) - 1]
    end = centres[-1] + half_distances[-1]
    edges = np.concatenate(([start], inner, [end]))
    return np.exp(edges) if logarithmic else edges


def capped_limits(finite: np.ndarray, cap: float | None) -> tuple[float, float] | None:
    """Limits of a map's colours that end at a cap.

    The cap keeps a few huge values from hiding the differences between all others.

    Args:
        finite: Finite values of the map.
        cap: Upper limit of the colours; None: no limit.

    Returns:
        The lowest and the highest value with its own colour; None if the cap is not within the values.
    """
    if cap is None or finite.size == 0:
        return None
    lowest = float(finite.min())
    is_within = lowest < cap < finite.max()
    return (lowest, cap) if is_within else None


def contour(ax: Axes, x: np.ndarray, y: np.ndarray, z: np.ndarray, level: float, style: LineStyleType) -> None:
    """Draw a white contour line of a map where its values cross a level.

    Args:
        ax: Axes of the map.
        x: Values along the horizontal axis, shape (n,).
        y: Values along the vertical axis, shape (m,).
        z: Values of the map, shape (m, n). Infinity and NaN count as far above the level, minus infinity as far below.
        level: The level.
        style: Style of the line.
    """
    if min(z.shape) < 2:
        return
    is_crossed = np.nanmin(z) < level < np.nanmax(z)
    if not is_crossed:
        return
    finite = z[np.isfinite(z)]
    distance = 1e3 * (float(np.abs(finite - level).max(initial=abs(level))) or 1.0)
    finite_z = np.nan_to_num(z, nan=level + distance, posinf=level + distance, neginf=level - distance)
    lines = ax.contour(x, y, finite_z, levels=(level,), colors="white", linewidths=1.8, linestyles=style)
    lines.set_path_effects(OUTLINE)
