"""Colours of what is known of a point of a sweep: proved, no draw fails, some fail, or all fail."""

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
"""Colour and meaning of each standing; what a proof covers follows the first."""


def standing_of(proved: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The index in :data:`STANDINGS`, from what is proved and the share of draws that fail."""
    return np.select([proved, share == 0.0, share < 1.0], [0, 1, 2], 3)


def standing_colours() -> ListedColormap:
    """One colour for each standing."""
    return ListedColormap([colour for colour, _ in STANDINGS])


def standing_words(covered: str) -> list[str]:
    """The meaning of each standing, where a proof is for ``covered``."""
    proved, *texts = [text for _, text in STANDINGS]
    return [f"{proved} for {covered}", *texts]


def standing_keys(covered: str) -> list[Patch]:
    """Legend entries, where a proof is for ``covered``."""
    colours = [colour for colour, _ in STANDINGS]
    pairs = zip(colours, standing_words(covered), strict=True)
    return [Patch(facecolor=colour, label=text) for colour, text in pairs]
