"""What keeps a search from a proof."""

from enum import StrEnum


class Obstacle(StrEnum):
    """The step of a proof that fails.

    * ``ORIGIN``: stability at sigma = e = 0.
    * ``DECAY``: a common quadratic function that decreases for all gains of the smallest region.
    * ``REGION``: an invariant set that holds the start and stays in a region whose gains it allows.
    * ``GAIN``: bounds of the signals that imply themselves.
    * ``SLIDING``: an equivalent control within rho.
    * ``VERIFIER``: the verifier's check of what the search found.
    """

    ORIGIN = "origin"
    DECAY = "decay"
    REGION = "region"
    GAIN = "gain"
    SLIDING = "sliding"
    VERIFIER = "verifier"
