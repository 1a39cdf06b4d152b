"""The box of a study's uncertain numbers, in coordinates u between -1 and 1."""

from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study
from dssc_jax.study.known_draws import study_of_draw
from dssc_jax.study.laws import Law

MOST_GROWTH = 4.0
GROWTHS = (MOST_GROWTH, 3.0, 2.5, 2.0, 1.75, 1.5, 1.25, 1.1, 1.0)
"""Factors by which the box may grow, largest first; the search takes the first one at which the loop is defined."""


class Side(NamedTuple):
    """The range of one uncertain number: a side of the box, with a coordinate u from -1 (low end) to 1 (high end).

    Args:
        name: Dotted name of the number in the study.
        low: Lower end of the range.
        high: Upper end of the range.
        logarithmic: Whether the coordinate is linear in the logarithm of the number.
        cut: Whether the law of the number has no ends, so that ``sigma`` determines the range (:func:`cut_ends`).
    """

    name: str
    low: float
    high: float
    logarithmic: bool
    cut: bool

    def at(self, u: np.ndarray) -> np.ndarray:
        """Values of the number at coordinates u, of the same shape; u beyond -1 or 1 belongs to a grown box."""
        if self.logarithmic:
            middle = 0.5 * (np.log(self.low) + np.log(self.high))
            half = 0.5 * (np.log(self.high) - np.log(self.low))
            return np.exp(middle + half * u)
        return 0.5 * (self.low + self.high) + 0.5 * (self.high - self.low) * u


class Box(NamedTuple):
    """The box of a study's uncertain numbers: all their values within the ranges, in any combination.

    Correlations are ignored.

    Args:
        sides: The range of each number.
    """

    sides: tuple[Side, ...]

    def values(self, points: np.ndarray) -> Arrays:
        """Values of the uncertain numbers by name, shape (n,) each, at coordinates of shape (n, sides)."""
        return {side.name: side.at(column) for side, column in zip(self.sides, points.T, strict=True)}

    def numbers(self, point: np.ndarray) -> dict[str, float]:
        """The uncertain numbers at one point, shape (sides,), by dotted name."""
        one_row = point[None]
        return {name: float(column[0]) for name, column in self.values(one_row).items()}


def box_of(study: Study, sigma: float) -> Box:
    """The box of a study's uncertain numbers, between the ends of their laws.

    Args:
        study: The study.
        sigma: Number of standard deviations from the median at which laws without ends are cut.

    Raises:
        ConfigError: The study has no uncertain number, or ``sigma`` is not admissible.
    """
    if not sigma > 0.0 or not np.isfinite(sigma):
        raise ConfigError("sigma", f"must be positive and finite, got {sigma:g}")
    if not study.laws:
        raise ConfigError(study.source, "has no uncertain number; `loop_margins` has the margins of one loop")
    sides = []
    for name, law in study.laws.items():
        low, high = law.support
        cut = not (np.isfinite(low) and np.isfinite(high))
        if cut:
            low, high = cut_ends(name, law, sigma)
        sides.append(Side(name, low, high, law.logarithmic, cut))
    return Box(tuple(sides))


def cut_ends(name: str, law: Law, sigma: float) -> tuple[float, float]:
    """The values ``sigma`` standard deviations below and above the median of a law without ends.

    Such a law is ``normal`` or ``lognormal``: symmetric about its median, on a linear or a logarithmic scale. A
    lognormal law has the lower end 0, but is cut below, too, since no number of standard deviations reaches 0.

    Args:
        name: Dotted name of the number.
        law: Its law.
        sigma: Number of standard deviations.

    Raises:
        ConfigError: ``sigma`` is so large that the upper end is not finite, or the lower end of a lognormal law is 0.
    """
    one_deviation_below = law.quantile(norm.cdf(-1.0))
    with np.errstate(over="ignore", under="ignore"):
        low = float(law.spread(one_deviation_below, sigma))
        high = float(law.spread(one_deviation_below, -sigma))  # a negative factor mirrors the value at the median
    if not np.isfinite(high) or (law.logarithmic and not low > 0.0):
        raise ConfigError("sigma", f"cuts {name} at [{low:g}, {high:g}]; take fewer standard deviations")
    return low, high


def grown_box(sides: int, growth: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner, shape (sides,) each, of the box [-1, 1]^sides grown by a factor about its middle."""
    corner = growth * np.ones(sides)
    return -corner, corner


def admissible_growths(study: Study, box: Box) -> list[float]:
    """The factors of :data:`GROWTHS` for which the study accepts the ends of the grown box, the largest first.

    The factor 1, the box itself, is always among these.
    """
    return [growth for growth in GROWTHS if growth == 1.0 or accepts_box(study, box, growth)]


def accepts_box(study: Study, box: Box, growth: float) -> bool:
    """Whether a study accepts the upper and the lower ends of a grown box, for all numbers together and for each alone.

    Args:
        study: The study.
        box: The box of its uncertain numbers.
        growth: Factor by which the box grows about its middle.
    """
    try:
        for end in (growth, -growth):
            numbers = box.numbers(np.full(len(box.sides), end))
            study_of_draw(study, numbers)
            for name, value in numbers.items():
                study_of_draw(study, {name: value})
    except ConfigError:
        return False
    return True
