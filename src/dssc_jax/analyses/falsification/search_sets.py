"""The sets in which the worst draw is sought: the laws' support, or the draws within a distance of the median draw."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.stats import qmc

from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.sampling import Arrays, inside_cube, mixing, values_at_levels
from dssc_jax.statistics import distance_of_mass
from dssc_jax.study import Study

SEARCH_EDGE = 1e-6  # outermost level of the support: limit of the search in the tails of unbounded laws
MOST_SIGMA = 8.0  # beyond, float64 hardly tells levels near 1 apart
SCORE_STEP = 1e-3  # of a central difference of a law's quantiles, in its score
LEVEL_GAP, SCORE_GAP = 0.25, 0.5  # least distance of two starts: in the largest coordinate; in radii


@dataclass(frozen=True)
class SearchSet(ABC):
    """A set of draws as points of a coordinate space with one coordinate for each law.

    Args:
        study: The study, without a sweep.
    """

    study: Study

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.study.laws)

    @property
    @abstractmethod
    def limits(self) -> tuple[float, float]:
        """Limits of every coordinate."""

    @abstractmethod
    def spread(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Points spread evenly over the set, shape (count, laws); a power of two."""

    @abstractmethod
    def projected(self, points: np.ndarray) -> np.ndarray:
        """The nearest points of the set."""

    @abstractmethod
    def levels(self, points: np.ndarray) -> np.ndarray:
        """The level of each number's law, shape (n, laws)."""

    @abstractmethod
    def scores(self, points: np.ndarray) -> np.ndarray:
        """Independent standard normal scores, shape (n, laws)."""

    @abstractmethod
    def slopes(self, points: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Derivatives with respect to the coordinates from those with respect to the values, shape (n, laws) both."""

    @abstractmethod
    def descended(self, points: np.ndarray, slopes: np.ndarray, stride: np.ndarray) -> np.ndarray:
        """One projected step against the slopes; ``stride``, shape (n,), is relative to the set's size."""

    @abstractmethod
    def separate(self, point: np.ndarray, start: np.ndarray) -> bool:
        """Whether two points are far enough apart to start a search from both."""

    def values(self, points: np.ndarray) -> Arrays:
        """Values of the uncertain numbers, shape (n,) each."""
        return values_at_levels(self.study, self.levels(points))

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Distance of each draw from the median draw in independent scores, shape (n,)."""
        return np.linalg.norm(self.scores(points), axis=1)


@dataclass(frozen=True)
class Support(SearchSet):
    """The support of the laws: a coordinate is the level of a law. Correlations exclude no draw."""

    @property
    def limits(self) -> tuple[float, float]:
        """See :class:`SearchSet`."""
        return SEARCH_EDGE, 1.0 - SEARCH_EDGE

    def spread(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """See :class:`SearchSet`."""
        return self.projected(qmc.Sobol(self.size, rng=rng).random(count))

    def projected(self, points: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        return np.clip(points, *self.limits)

    def levels(self, points: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        return points

    def scores(self, points: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        return np.linalg.solve(mixing(self.study), special.ndtri(points).T).T

    def slopes(self, points: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        half, rates = 0.5 * SEARCH_EDGE, np.empty_like(points)
        for i, law in enumerate(self.study.laws.values()):
            low, high = np.clip(points[:, i] + np.array([[-half], [half]]), half, 1.0 - half)
            rates[:, i] = (law.quantile(high) - law.quantile(low)) / (high - low)
        return gradients * rates

    def descended(self, points: np.ndarray, slopes: np.ndarray, stride: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        largest = np.max(np.abs(slopes), axis=1, keepdims=True)
        return self.projected(points - stride[:, None] * slopes / np.where(largest > 0.0, largest, 1.0))

    def separate(self, point: np.ndarray, start: np.ndarray) -> bool:
        """See :class:`SearchSet`."""
        return bool(np.max(np.abs(point - start)) > LEVEL_GAP)


@dataclass(frozen=True)
class ScoreBall(SearchSet):
    """The draws within a distance of the median draw: a coordinate is an independent standard normal score.

    For normal laws it is an ellipsoid of constant density; correlated numbers have the scores of the Gaussian copula.

    Args:
        radius: The distance k.
    """

    radius: float

    @property
    def limits(self) -> tuple[float, float]:
        """See :class:`SearchSet`."""
        return -self.radius, self.radius

    def spread(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """See :class:`SearchSet`: the median draw, then directions of normal points, and radii for an even density."""
        points = inside_cube(qmc.Sobol(self.size + 1, rng=rng).random(count))
        directions = special.ndtri(points[:, :-1])
        lengths = np.linalg.norm(directions, axis=1)
        scale = self.radius * points[:, -1] ** (1.0 / self.size) / np.where(lengths > 0.0, lengths, 1.0)
        scale[0] = 0.0
        return directions * scale[:, None]

    def projected(self, points: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        lengths = np.linalg.norm(points, axis=1, keepdims=True)
        return points * np.minimum(1.0, self.radius / np.where(lengths > 0.0, lengths, 1.0))

    def levels(self, points: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        return inside_cube(special.ndtr(points @ mixing(self.study).T))

    def scores(self, points: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        return points

    def slopes(self, points: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        matrix = mixing(self.study)
        scores, rates = points @ matrix.T, np.empty_like(points)
        for i, law in enumerate(self.study.laws.values()):
            low, high = (inside_cube(special.ndtr(scores[:, i] + step)) for step in (-SCORE_STEP, SCORE_STEP))
            rates[:, i] = (law.quantile(high) - law.quantile(low)) / (2.0 * SCORE_STEP)
        return (gradients * rates) @ matrix

    def descended(self, points: np.ndarray, slopes: np.ndarray, stride: np.ndarray) -> np.ndarray:
        """See :class:`SearchSet`."""
        lengths = np.linalg.norm(slopes, axis=1)
        scale = self.radius * stride / np.where(lengths > 0.0, lengths, 1.0)
        return self.projected(points - scale[:, None] * slopes)

    def separate(self, point: np.ndarray, start: np.ndarray) -> bool:
        """See :class:`SearchSet`."""
        return bool(np.linalg.norm(point - start) > SCORE_GAP * self.radius)


def search_set(study: Study, sigma: float | None = None, mass: float | None = None) -> SearchSet:
    """The set of draws in which to search.

    Args:
        study: The study, without a sweep.
        sigma: Search within this distance of the median draw.
        mass: Search within the distance that has this probability. Neither: the whole support.

    Raises:
        ConfigError: both are given, or one is out of range.
    """
    if sigma is not None and mass is not None:
        raise ConfigError("within", f"give either sigma or mass, got sigma = {sigma:g} and mass = {mass:g}")
    if mass is not None:
        if not 0.0 < mass < 1.0:
            raise ConfigError("within mass", f"must be a probability in (0, 1), got {mass:g}")
        radius = distance_of_mass(mass, len(study.laws))
        if radius > MOST_SIGMA:
            rule = f"is that of {radius:.3g} sigma for {len(study.laws)} numbers; must be at most {MOST_SIGMA:g} sigma"
            raise ConfigError("within mass", f"{mass!r} {rule}")
        return ScoreBall(study, radius)
    if sigma is None:
        return Support(study)
    if not 0.0 < sigma <= MOST_SIGMA:
        raise ConfigError("within sigma", f"must be in (0, {MOST_SIGMA:g}], got {sigma:g}")
    return ScoreBall(study, sigma)
