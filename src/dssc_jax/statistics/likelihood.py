"""Likelihood of a draw, from its standard normal scores.

The score of a value is the standard normal quantile at the level of the value in its law. So scores have the standard
normal law, whatever the laws of the numbers; the scores of correlated numbers are made independent. The draws within a
distance k of the median draw form the smallest region of the scores with its probability.
"""

from typing import NamedTuple

import numpy as np
from scipy import special


class Likelihood(NamedTuple):
    """How likely a draw is, by the distance of its scores from the most likely draw, whose scores are all 0.

    Args:
        distance: Euclidean norm k of the independent standard normal scores; the draw lies "at k sigma".
        numbers: Number of uncertain numbers.
    """

    distance: float
    numbers: int

    @property
    def log_density(self) -> float:
        """Logarithm -k^2/2 of the density of the scores, relative to the density at the mode."""
        return -0.5 * self.distance**2

    @property
    def mass(self) -> float:
        """Probability that another draw lies at most as far from the mode."""
        return float(mass_within(self.distance, self.numbers))


def mass_within(distance: np.ndarray | float, numbers: int) -> np.ndarray:
    """Probability that independent standard normal scores have at most a distance from 0, by the chi-square law.

    Args:
        distance: Largest Euclidean norm of the scores, any shape.
        numbers: Number of scores.
    """
    return special.gammainc(0.5 * numbers, 0.5 * np.square(distance))


def distance_of_mass(mass: float, numbers: int) -> float:
    """Distance from 0 within which independent standard normal scores lie with probability ``mass``.

    The function is the inverse of :func:`mass_within`.

    Args:
        mass: Probability, in [0, 1).
        numbers: Number of scores.
    """
    return float(np.sqrt(2.0 * special.gammaincinv(0.5 * numbers, mass)))
