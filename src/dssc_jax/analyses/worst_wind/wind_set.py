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
        """Winds within the bounds that follow any winds as fast as the rate allows, shape (n, size, 3).

        Args:
            winds: The winds to follow [m/s], shape (n, size, 3).
        """
        followed = np.array(winds, float)
        norms = np.linalg.norm(followed[..., :2], axis=-1, keepdims=True)
        followed[..., :2] *= np.minimum(1.0, self.limits.speed / np.where(norms > 0.0, norms, 1.0))
        followed[..., 2] = np.clip(followed[..., 2], -self.limits.vertical, self.limits.vertical)
        if self.limits.rate is None:
            return followed
        for place in range(1, self.grid.size):
            change = followed[:, place] - followed[:, place - 1]
            lengths = np.linalg.norm(change[:, :2], axis=1, keepdims=True)
            change[:, :2] *= np.minimum(1.0, self.step / np.where(lengths > 0.0, lengths, 1.0))
            change[:, 2] = np.clip(change[:, 2], -self.step, self.step)
            followed[:, place] = followed[:, place - 1] + change
        return followed

    def resonant_winds(self) -> np.ndarray:
        """Winds that swing along a line with a period, shape (n, size, 3); the vertical wind swings or is constant.

        The lines divide half a circle. The periods are even in the logarithm, from two intervals to twice the flight.
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
        """The wind at its bounds that swings along a horizontal line [m/s], shape (size, 3).

        Args:
            swing: Horizontal wind along the line relative to its bound, over time, shape (size,).
            angle: Direction of the line [rad].
            lift: Vertical wind relative to its bound, over time, shape (size,).
        """
        horizontal = self.limits.speed * swing
        vertical = self.limits.vertical * lift
        return np.column_stack([horizontal * np.cos(angle), horizontal * np.sin(angle), vertical])

    def random_winds(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random winds that switch at random times to random extremes [m/s], shape (count, size, 3).

        The mean time between two switches is random, too, from an interval to the whole flight.
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
        """The winds of the set that maximise the scalar product with slopes [m/s], shape (n, size, 3).

        They are the worst winds of a linear loop, whose signal has these slopes.

        Args:
            slopes: Derivatives of a signal by the winds, shape (n, size, 3).
            current_winds: Winds that stay where a slope is 0 and the rate is not bounded, shape (n, size, 3).
        """
        if self.limits.rate is not None:
            return np.stack([self._extreme_spline(slope) for slope in slopes])
        norms = np.linalg.norm(slopes[..., :2], axis=-1, keepdims=True)
        winds = np.array(current_winds)
        horizontal = self.limits.speed * slopes[..., :2] / np.where(norms > 0.0, norms, 1.0)
        winds[..., :2] = np.where(norms > 0.0, horizontal, current_winds[..., :2])
        vertical = self.limits.vertical * np.sign(slopes[..., 2])
        winds[..., 2] = np.where(slopes[..., 2] != 0.0, vertical, current_winds[..., 2])
        return winds

    def _extreme_spline(self, slope: np.ndarray) -> np.ndarray:
        """Knots of the spline with a bounded rate that maximises the scalar product with a slope, shape (size, 3).

        Two linear programs find the knots, with a polygon in place of the circle of horizontal winds.

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
        """Normals of a polygon's sides over their distance from the centre, shape (SIDES, 2).

        The corners of the polygon lie on the circle of radius 1.
        """
        angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
        return np.column_stack([np.cos(angles), np.sin(angles)]) / np.cos(np.pi / SIDES)

    def _extreme_knots(self, slope: np.ndarray, bound: float, normals: np.ndarray) -> np.ndarray:
        """Knots that maximise the scalar product with a slope, by a linear program, shape (size, components).

        The polygon scaled by the bound contains each knot. The polygon scaled by the largest step contains the
        difference of two neighbours.

        Args:
            slope: Derivatives by the knots, shape (size, components).
            bound: Bound of a knot [m/s].
            normals: Normals of the polygon's sides, over their distances from the centre, shape (sides, components).
        """
        count = self.grid.size
        identity = sparse.eye_array(count)
        differences = identity.tocsr()[1:] - identity.tocsr()[:-1]
        constraints = sparse.vstack([sparse.kron(identity, normals), sparse.kron(differences, normals)])
        largest = np.repeat([bound, self.step], [count * len(normals), (count - 1) * len(normals)])
        scale = np.abs(slope).max() or 1.0  # 1 for a slope of 0
        costs = -slope.ravel() / scale  # linprog minimises
        solution = linprog(costs, A_ub=constraints.tocsr(), b_ub=largest, bounds=(None, None), method="highs")
        return solution.x.reshape(slope.shape)
