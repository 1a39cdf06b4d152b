"""Sets of draws in which the worst one is searched: the laws' support, or a ball around the median draw.

A point of a set has one coordinate for each uncertain number: the quantile level of its law, or a normal score.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.stats import qmc

from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.sampling import Arrays, inside_cube, score_mixing_matrix, values_at_levels
from dssc_jax.statistics import distance_of_mass
from dssc_jax.study import Study

SEARCH_EDGE = 1e-6  # outermost level of the support: where the search ends in the tails of unbounded laws
MOST_SIGMA = 8.0  # beyond, float64 hardly tells levels near 1 apart
SCORE_STEP = 1e-3  # of a central difference of a law's quantiles, in its score
LEVEL_GAP = 0.25
"""Least difference of two starting points in one of their levels."""
SCORE_GAP = 0.5
"""Least distance of two starting points in a ball, in radii."""


@dataclass(frozen=True)
class SearchSet(ABC):
    """A set of draws in which a search moves. Each draw is a point with one coordinate for each law.

    A subclass decides what the coordinates mean, and what shape the set has.

    Args:
        study: The study, without a sweep.
    """

    study: Study

    @property
    def size(self) -> int:
        """Number of coordinates, one for each uncertain number."""
        return len(self.study.laws)

    @property
    @abstractmethod
    def limits(self) -> tuple[float, float]:
        """Lower and upper limit of every coordinate."""

    @abstractmethod
    def even_points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random points that are spread evenly over the set, shape (count, laws); ``count`` is a power of two."""

    @abstractmethod
    def project(self, points: np.ndarray) -> np.ndarray:
        """Move points to the nearest points of the set, shape (n, laws) both."""

    @abstractmethod
    def levels(self, points: np.ndarray) -> np.ndarray:
        """Quantile levels of the uncertain numbers at some points, shape (n, laws) both."""

    @abstractmethod
    def scores(self, points: np.ndarray) -> np.ndarray:
        """Independent standard normal scores at some points, shape (n, laws) both."""

    @abstractmethod
    def slopes(self, points: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Convert derivatives by the uncertain numbers to derivatives by the coordinates, shape (n, laws) both.

        Args:
            points: The points, shape (n, laws).
            gradients: Derivatives of a slack by the uncertain numbers there.
        """

    @abstractmethod
    def descend(self, points: np.ndarray, slopes: np.ndarray, stride: np.ndarray) -> np.ndarray:
        """Step against the slopes, then project onto the set.

        Args:
            points: Shape (n, laws).
            slopes: Derivatives by the coordinates, shape (n, laws).
            stride: Length of each step relative to the size of the set, shape (n,).
        """

    @abstractmethod
    def are_apart(self, point: np.ndarray, start: np.ndarray) -> bool:
        """Whether two points, shape (laws,) both, are far enough apart to start a search from both."""

    def values(self, points: np.ndarray) -> Arrays:
        """Values of the uncertain numbers at points of shape (n, laws), by name, shape (n,) each."""
        return values_at_levels(self.study, self.levels(points))

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Distance of each point, shape (n, laws), from the median draw in independent scores, shape (n,)."""
        return np.linalg.norm(self.scores(points), axis=1)


@dataclass(frozen=True)
class Support(SearchSet):
    """The support of the laws, a cube: a coordinate is the quantile level of a law. Correlations exclude no draw."""

    @property
    def limits(self) -> tuple[float, float]:
        """The levels 0 and 1, moved inwards by a small edge, since laws without ends have no value at 0 and 1."""
        return SEARCH_EDGE, 1.0 - SEARCH_EDGE

    def even_points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Scrambled Sobol points of the cube, clipped to the limits, shape (count, laws)."""
        sobol = qmc.Sobol(self.size, rng=rng)
        return self.project(sobol.random(count))

    def project(self, points: np.ndarray) -> np.ndarray:
        """Clip each coordinate to its limits, shape (n, laws) both."""
        return np.clip(points, *self.limits)

    def levels(self, points: np.ndarray) -> np.ndarray:
        """The points themselves, whose coordinates are levels, shape (n, laws)."""
        return points

    def scores(self, points: np.ndarray) -> np.ndarray:
        """Independent normal scores, shape (n, laws): the levels' scores with the mixing by the copula undone."""
        mixed_scores = special.ndtri(points)
        return np.linalg.solve(score_mixing_matrix(self.study), mixed_scores.T).T

    def slopes(self, points: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Convert derivatives by the numbers to derivatives by the levels, shape (n, laws).

        The slope of a number over its level is a difference of quantiles. For the arguments see
        :meth:`SearchSet.slopes`.
        """
        half_step = 0.5 * SEARCH_EDGE
        number_slopes = np.empty_like(points)
        for i, law in enumerate(self.study.laws.values()):
            low = np.clip(points[:, i] - half_step, half_step, 1.0 - half_step)
            high = np.clip(points[:, i] + half_step, half_step, 1.0 - half_step)
            number_slopes[:, i] = (law.quantile(high) - law.quantile(low)) / (high - low)
        return gradients * number_slopes

    def descend(self, points: np.ndarray, slopes: np.ndarray, stride: np.ndarray) -> np.ndarray:
        """Step against the slopes, so that the level with the largest slope changes by the stride; then clip.

        For the arguments see :meth:`SearchSet.descend`.
        """
        steepest = np.max(np.abs(slopes), axis=1, keepdims=True)
        return self.project(points - stride[:, None] * slopes / one_for_zero(steepest))

    def are_apart(self, point: np.ndarray, start: np.ndarray) -> bool:
        """Whether at least one level differs by more than :data:`LEVEL_GAP`."""
        return bool(np.max(np.abs(point - start)) > LEVEL_GAP)


@dataclass(frozen=True)
class ScoreBall(SearchSet):
    """The draws within a distance of the median draw, a ball: a coordinate is an independent standard normal score.

    For normal laws the surface of the ball is an ellipsoid of constant density. The scores of correlated numbers are
    those of the Gaussian copula.

    Args:
        radius: The distance k.
    """

    radius: float

    @property
    def limits(self) -> tuple[float, float]:
        """The scores -k and k."""
        return -self.radius, self.radius

    def even_points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """The median draw, then points of even density in the ball, from Sobol points; shape (count, laws).

        Each point has the direction of a standard normal point in d dimensions, and the distance k u^(1/d) from the
        centre, with u uniform in (0, 1). Points with these laws are uniform in the ball.
        """
        points = inside_cube(qmc.Sobol(self.size + 1, rng=rng).random(count))
        uniform = points[:, -1]
        normal_points = special.ndtri(points[:, :-1])
        lengths = np.linalg.norm(normal_points, axis=1)
        scale = self.radius * uniform ** (1.0 / self.size) / one_for_zero(lengths)
        scale[0] = 0.0  # the median draw
        return normal_points * scale[:, None]

    def project(self, points: np.ndarray) -> np.ndarray:
        """Move points outside the ball radially onto its surface, shape (n, laws) both."""
        lengths = np.linalg.norm(points, axis=1, keepdims=True)
        return points * np.minimum(1.0, self.radius / one_for_zero(lengths))

    def levels(self, points: np.ndarray) -> np.ndarray:
        """Quantile levels at points of the ball, shape (n, laws): those of the scores that the copula has mixed."""
        correlated_scores = points @ score_mixing_matrix(self.study).T
        return inside_cube(special.ndtr(correlated_scores))

    def scores(self, points: np.ndarray) -> np.ndarray:
        """The points themselves, whose coordinates are independent scores, shape (n, laws)."""
        return points

    def slopes(self, points: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Convert derivatives by the numbers to derivatives by the independent scores, shape (n, laws).

        The slope of a number over its correlated score is a difference of quantiles; the mixing matrix converts it. For
        the arguments see :meth:`SearchSet.slopes`.
        """
        mixing_matrix = score_mixing_matrix(self.study)
        correlated_scores = points @ mixing_matrix.T
        number_slopes = np.empty_like(points)
        for i, law in enumerate(self.study.laws.values()):
            low = inside_cube(special.ndtr(correlated_scores[:, i] - SCORE_STEP))
            high = inside_cube(special.ndtr(correlated_scores[:, i] + SCORE_STEP))
            number_slopes[:, i] = (law.quantile(high) - law.quantile(low)) / (2.0 * SCORE_STEP)
        return (gradients * number_slopes) @ mixing_matrix

    def descend(self, points: np.ndarray, slopes: np.ndarray, stride: np.ndarray) -> np.ndarray:
        """Step straight against the slopes, over the distance stride times radius; then project onto the ball.

        For the arguments see :meth:`SearchSet.descend`.
        """
        lengths = np.linalg.norm(slopes, axis=1)
        scale = self.radius * stride / one_for_zero(lengths)
        return self.project(points - scale[:, None] * slopes)

    def are_apart(self, point: np.ndarray, start: np.ndarray) -> bool:
        """Whether the distance between two points exceeds :data:`SCORE_GAP` times the radius of the ball."""
        return bool(np.linalg.norm(point - start) > SCORE_GAP * self.radius)


def one_for_zero(lengths: np.ndarray) -> np.ndarray:
    """Replace lengths of 0 by 1, so that dividing a vector of length 0 by its length gives 0 instead of NaN."""
    return np.where(lengths > 0.0, lengths, 1.0)


def search_set(study: Study, sigma: float | None = None, mass: float | None = None) -> SearchSet:
    """The set of draws in which to search: the draws within a distance of the median draw, or all draws.

    With neither ``sigma`` nor ``mass`` the set is the whole support of the laws.

    Args:
        study: The study, without a sweep.
        sigma: Distance from the median draw, in (0, 8].
        mass: Probability of the draws within the distance, in (0, 1), instead of the distance.

    Raises:
        ConfigError: Both are given, or one is out of range.
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
