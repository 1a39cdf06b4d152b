"""How likely a draw is, from its standard normal scores.

The score of a value is the standard normal quantile at the value's level, so scores have the standard normal law
whatever the laws of the numbers; those of correlated numbers are made independent. The draws within distance k of the
median draw are the region of highest density of the scores, hence their smallest region with its probability.
"""

from typing import NamedTuple

import numpy as np
from scipy import special


class Likelihood(NamedTuple):
    """How likely a draw is.

    Args:
        distance: Distance k of its independent standard normal scores from their mode; a draw lies "at k sigma".
        numbers: Number of uncertain numbers.
    """

    distance: float
    numbers: int

    @property
    def log_density(self) -> float:
        """Logarithm of the scores' density, relative to that at the mode: -k^2/2."""
        return -0.5 * self.distance**2

    @property
    def mass(self) -> float:
        """Probability that a draw lies at most this far from the mode."""
        return float(mass_within(self.distance, self.numbers))


def mass_within(distance: np.ndarray | float, numbers: int) -> np.ndarray:
    """Probability that independent standard normal scores lie within a distance of 0: the law chi^2 at its square."""
    return special.gammainc(0.5 * numbers, 0.5 * np.square(distance))


def distance_of_mass(mass: float, numbers: int) -> float:
    """The distance within which independent standard normal scores lie with probability ``mass``."""
    return float(np.sqrt(2.0 * special.gammaincinv(0.5 * numbers, mass)))
