"""The reasons why a search finds no proof."""

from enum import StrEnum


class Obstacle(StrEnum):
    """The condition that a search for a proof cannot meet.

    * ``ORIGIN``: the loop is stable at sigma = e = 0.
    * ``DECAY``: a common quadratic function decreases for all gains of the smallest region.
    * ``REGION``: an invariant set, or bounds of the signals, hold the start and lie in the region of their gains.
    * ``GAIN``: bounds of the signals imply themselves.
    * ``SLIDING``: the equivalent control is within rho.
    * ``VERIFIER``: the verifier accepts the proof that the search found.
    """

    ORIGIN = "origin"
    DECAY = "decay"
    REGION = "region"
    GAIN = "gain"
    SLIDING = "sliding"
    VERIFIER = "verifier"
