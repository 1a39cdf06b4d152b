"""The set of winds on a grid within bounds: candidates of a search, and the extreme wind in a direction."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from dssc_jax.analyses.worst_wind.flights import WindGrid

DIRECTIONS = 8
"""Number of lines along which resonant winds swing."""
PERIODS = 16
"""Number of periods of resonant winds."""
PHASES = (0.0, 0.25)
"""Phases of resonant winds, in periods."""
LIFTS = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Vertical components of resonant winds: (share that swings, share that is constant), relative to the bound."""
SIDES = 16
"""Sides of the polygon that replaces the circle if the rate is bounded; its corners lie on the circle."""


class Limits(NamedTuple):
    """Bounds of a wind, the same at all times.

    Args:
        speed: Bound of the norm of the horizontal wind [m/s].
        vertical: Bound of |w_z| [m/s].
        rate: Bound of |w'|, horizontal and vertical [m/s^2]; None: the wind may jump.
    """

    speed: float
    vertical: float
    rate: float | None


def bounded_vectors(vectors: np.ndarray, horizontal: float, vertical: float) -> np.ndarray:
    """Vectors with the horizontal part shortened to a bound and the vertical part clipped to another, shape (..., 3).

    Args:
        vectors: Vectors (x, y, z), shape (..., 3).
        horizontal: Bound of the norm of (x, y).
        vertical: Bound of |z|.
    """
    bounded = np.array(vectors, float)
    norms = np.linalg.norm(bounded[..., :2], axis=-1, keepdims=True)
    bounded[..., :2] *= np.minimum(1.0, horizontal / np.where(norms > 0.0, norms, 1.0))
    bounded[..., 2] = np.clip(bounded[..., 2], -vertical, vertical)
    return bounded


@dataclass(frozen=True)
class WindSet:
    """All winds on a grid within bounds, a convex set.

    Args:
        limits: The bounds.
        grid: Times at which a wind has a vector; smooth if the rate is bounded.
    """

    limits: Limits
    grid: WindGrid

    @property
    def step(self) -> float:
        """Bound of the change from one vector to the next [m/s]; infinite without a bound of the rate."""
        return np.inf if self.limits.rate is None else self.limits.rate * self.grid.interval

    def follow(self, winds: np.ndarray) -> np.ndarray:
        """Winds within the bounds that follow given winds as fast as the rate allows [m/s], shape (n, size, 3).

        Args:
            winds: The winds to follow [m/s], shape (n, size, 3).
        """
        followed = bounded_vectors(winds, self.limits.speed, self.limits.vertical)
        if self.limits.rate is None:
            return followed
        for place in range(1, self.grid.size):
            previous = followed[:, place - 1]
            change = bounded_vectors(followed[:, place] - previous, self.step, self.step)
            followed[:, place] = previous + change
        return followed

    def resonant_winds(self) -> np.ndarray:
        """Winds that swing periodically along a horizontal line [m/s], shape (n, size, 3).

        The vertical wind swings with them or is constant. The lines divide half a circle evenly. The periods are evenly
        spaced in the logarithm, from two intervals to twice the flight.
        """
        times = np.arange(self.grid.size) * self.grid.interval
        periods = np.geomspace(2.0 * self.grid.interval, 2.0 * times[-1] + self.grid.interval, PERIODS)
        winds = []
        middles = times + 0.5 * self.grid.interval  # at the middle of its interval, no vector is on a change of sign
        for period in periods:
            for phase in PHASES:
                swing = np.sign(np.sin(2.0 * np.pi * (middles / period + phase)))
                for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
                    for swinging_share, constant_share in LIFTS:
                        lift = swinging_share * swing + constant_share
                        winds.append(self._swinging_wind(swing, angle, lift))
        return self.follow(np.stack(winds))

    def _swinging_wind(self, swing: np.ndarray, angle: float, lift: np.ndarray) -> np.ndarray:
        """One wind that swings along a horizontal line between the bounds [m/s], shape (size, 3).

        Args:
            swing: Horizontal wind along the line over time, relative to the bound of the speed, shape (size,).
            angle: Direction of the line [rad].
            lift: Vertical wind over time, relative to its bound, shape (size,).
        """
        horizontal = self.limits.speed * swing
        vertical = self.limits.vertical * lift
        return np.column_stack([horizontal * np.cos(angle), horizontal * np.sin(angle), vertical])

    def random_winds(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random winds that switch at random times to random extremes [m/s], shape (count, size, 3).

        The mean time between two switches is random for each wind, from one interval to the whole flight.
        """
        size = self.grid.size
        chances = np.exp(rng.uniform(-np.log(size), 0.0, (count, 1)))  # of a switch at each time, from 1/size to 1
        switches = rng.random((count, size)) < chances
        switches[:, 0] = True
        latest = np.maximum.accumulate(np.where(switches, np.arange(size), 0), axis=1)  # place of the latest switch
        angles = np.take_along_axis(rng.uniform(0.0, 2.0 * np.pi, (count, size)), latest, axis=1)
        vertical_signs = np.take_along_axis(rng.choice([-1.0, 1.0], (count, size)), latest, axis=1)
        x = self.limits.speed * np.cos(angles)
        y = self.limits.speed * np.sin(angles)
        z = self.limits.vertical * vertical_signs
        return self.follow(np.stack([x, y, z], axis=2))

    def extreme_winds(self, slopes: np.ndarray, current_winds: np.ndarray) -> np.ndarray:
        """The winds of the set with the largest scalar products with slopes [m/s], shape (n, size, 3).

        They are the worst winds for a linear loop whose signal has these slopes.

        Args:
            slopes: Derivatives of a signal by the winds, shape (n, size, 3).
            current_winds: The present winds [m/s], shape (n, size, 3). If the rate is not bounded, they stay where a
                slope is 0.
        """
        if self.limits.rate is not None:
            return np.stack([self._extreme_spline(slope) for slope in slopes])
        horizontal_slopes = slopes[..., :2]
        vertical_slopes = slopes[..., 2]
        norms = np.linalg.norm(horizontal_slopes, axis=-1, keepdims=True)
        horizontal = self.limits.speed * horizontal_slopes / np.where(norms > 0.0, norms, 1.0)
        vertical = self.limits.vertical * np.sign(vertical_slopes)
        winds = np.array(current_winds)
        winds[..., :2] = np.where(norms > 0.0, horizontal, current_winds[..., :2])
        winds[..., 2] = np.where(vertical_slopes != 0.0, vertical, current_winds[..., 2])
        return winds

    def _extreme_spline(self, slope: np.ndarray) -> np.ndarray:
        """Knots of the spline with a bounded rate that maximises the scalar product with a slope, shape (size, 3).

        One linear program finds the horizontal components, with a polygon in place of the circle that bounds them, and
        another the vertical component.

        Args:
            slope: Derivatives of a signal by the knots, shape (size, 3).
        """
        horizontal = self._extreme_knots(slope[:, :2], self.limits.speed, self._polygon)
        interval_normals = np.array([[1.0], [-1.0]])  # of the interval [-1, 1], a polygon of one dimension
        vertical = self._extreme_knots(slope[:, 2:], self.limits.vertical, interval_normals)
        knots = np.concatenate([horizontal, vertical], axis=1)
        return self.follow(knots[None])[0]  # cuts off what the solver's tolerance allows beyond the bounds

    @cached_property
    def _polygon(self) -> np.ndarray:
        """Normals of the sides of a regular polygon, each divided by its side's distance from the centre.

        The shape is (SIDES, 2). The corners of the polygon lie on the circle of radius 1. A point x is inside if
        n.x <= 1 for each row n.
        """
        angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
        return np.column_stack([np.cos(angles), np.sin(angles)]) / np.cos(np.pi / SIDES)

    def _extreme_knots(self, slope: np.ndarray, bound: float, normals: np.ndarray) -> np.ndarray:
        """Knots that maximise the scalar product with a slope, by a linear program, shape (size, components).

        The constraints are that each knot lies in the polygon scaled by the bound, and the difference of neighbouring
        knots in the polygon scaled by the largest step.

        Args:
            slope: Derivatives of the signal by the knots, shape (size, components).
            bound: Bound of a knot [m/s].
            normals: Normals of the polygon's sides, each divided by its side's distance from the centre, shape
                (sides, components).
        """
        count = self.grid.size
        identity = sparse.eye_array(count)
        differences = identity.tocsr()[1:] - identity.tocsr()[:-1]
        # for each knot, then for each difference, a row for each side of the polygon
        constraints = sparse.vstack([sparse.kron(identity, normals), sparse.kron(differences, normals)])
        largest = np.repeat([bound, self.step], [count * len(normals), (count - 1) * len(normals)])
        scale = np.abs(slope).max() or 1.0  # 1 for a slope of 0
        costs = -slope.ravel() / scale  # linprog minimises
        solution = linprog(costs, A_ub=constraints.tocsr(), b_ub=largest, bounds=(None, None), method="highs")
        return solution.x.reshape(slope.shape)
