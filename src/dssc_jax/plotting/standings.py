"""The standing of a point of a sweep with its colour: proved, no draw fails, some draws fail, or all fail."""

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from dssc_jax.plotting.style import BLUE, RED, SKY, YELLOW

STANDINGS = (
    (BLUE, "proved"),
    (SKY, "survives: not proved, no draw fails"),
    (YELLOW, "unknown: some draws fail"),
    (RED, "fails in every draw"),
)
"""Colour and meaning of each standing; the scope of the proofs is appended to the first meaning."""


def standing_of(proved: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The index in :data:`STANDINGS` of each point.

    Args:
        proved: Whether each point is proved, of any shape.
        share: Share of draws that fail at each point, of the same shape.
    """
    no_draw_fails = share == 0.0
    some_draws_pass = share < 1.0
    return np.select([proved, no_draw_fails, some_draws_pass], [0, 1, 2], default=3)


def standing_colours() -> ListedColormap:
    """A colour map with one colour for each standing."""
    return ListedColormap([colour for colour, _ in STANDINGS])


def standing_words(covered: str) -> list[str]:
    """The meaning of each standing.

    Args:
        covered: What the proofs cover, in words, such as the plants.
    """
    proved, *meanings = [meaning for _, meaning in STANDINGS]
    return [f"{proved} for {covered}", *meanings]


def standing_handles(covered: str) -> list[Patch]:
    """A legend entry for each standing.

    Args:
        covered: What the proofs cover, in words, as for :func:`standing_words`.
    """
    handles = []
    for (colour, _), text in zip(STANDINGS, standing_words(covered), strict=True):
        handles.append(Patch(facecolor=colour, label=text))
    return handles
