"""What keeps a search from a proof."""

from enum import StrEnum


class Obstacle(StrEnum):
    """The step of a proof that fails.

    Args:
        ORIGIN: Stability at sigma = e = 0.
        DECAY: A common quadratic function that decreases for all gains of the smallest region.
        REGION: An invariant set that holds the start and stays in a region whose gains it allows.
        GAIN: Bounds of the signals that imply themselves.
        SLIDING: An equivalent control within rho.
        VERIFIER: The verifier's check of what the search found.
    """

    ORIGIN = "origin"
    DECAY = "decay"
    REGION = "region"
    GAIN = "gain"
    SLIDING = "sliding"
    VERIFIER = "verifier"
