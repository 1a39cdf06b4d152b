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
"""Shares of the swing and of a constant in the vertical component of a resonant wind."""
SIDES = 16
"""Sides of the polygon that replaces the circle if the rate is bounded; its corners lie on the circle."""


class Limits(NamedTuple):
    """Bounds of a wind in plain numbers.

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
        """Winds within the bounds that follow any winds as fast as the rate allows, shape (n, size, 3) both."""
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
        for period in periods:
            for phase in PHASES:
                # half an interval ahead: no vector lies on a change of sign
                swing = np.sign(np.sin(2.0 * np.pi * ((times + 0.5 * self.grid.interval) / period + phase)))
                for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
                    winds += [self._swinging_wind(swing, angle, lift) for lift in LIFTS]
        return self.follow(np.stack(winds))

    def _swinging_wind(self, swing: np.ndarray, angle: float, lift: tuple[float, float]) -> np.ndarray:
        """The wind at its bounds that swings along a line, shape (size, 3).

        Args:
            swing: Signs of the horizontal wind over time, shape (size,).
            angle: Direction of the line [rad].
            lift: Shares of the swing and of a constant in the vertical wind.
        """
        horizontal = self.limits.speed * swing
        vertical = self.limits.vertical * (lift[0] * swing + lift[1])
        return np.column_stack([horizontal * np.cos(angle), horizontal * np.sin(angle), vertical])

    def random_winds(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random winds that switch at random times to random extremes, shape (count, size, 3).

        The mean time between two switches is random, too, from one interval to the whole flight.
        """
        places = self.grid.size
        chances = np.exp(rng.uniform(-np.log(places), 0.0, (count, 1)))
        switches = rng.random((count, places)) < chances
        switches[:, 0] = True
        latest = np.maximum.accumulate(np.where(switches, np.arange(places), 0), axis=1)
        angles = np.take_along_axis(rng.uniform(0.0, 2.0 * np.pi, (count, places)), latest, axis=1)
        sides = np.take_along_axis(rng.choice([-1.0, 1.0], (count, places)), latest, axis=1)
        horizontal = self.limits.speed
        winds = np.stack([horizontal * np.cos(angles), horizontal * np.sin(angles), self.limits.vertical * sides], 2)
        return self.follow(winds)

    def extreme_winds(self, slopes: np.ndarray, current_winds: np.ndarray) -> np.ndarray:
        """The winds of the set that maximise the scalar product with slopes, shape (n, size, 3).

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
        """The spline with a bounded rate that maximises the scalar product with a slope, shape (size, 3) both.

        Two linear programs find its knots, with a polygon in place of the circle of horizontal winds.
        """
        horizontal = self._extreme_knots(slope[:, :2], self.limits.speed, self._polygon)
        vertical = self._extreme_knots(slope[:, 2:], self.limits.vertical, np.array([[1.0], [-1.0]]))
        return self.follow(np.concatenate([horizontal, vertical], axis=1)[None])[0]  # the solver's tolerance

    @cached_property
    def _polygon(self) -> np.ndarray:
        """Normals of the polygon's sides over their distance from the centre, for a circle of radius 1; (SIDES, 2)."""
        angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
        return np.column_stack([np.cos(angles), np.sin(angles)]) / np.cos(np.pi / SIDES)

    def _extreme_knots(self, slope: np.ndarray, bound: float, normals: np.ndarray) -> np.ndarray:
        """Knots that maximise the scalar product with a slope, shape (size, components) both, by a linear program.

        Each knot lies in a polygon, and the difference of two neighbours in that polygon scaled by the largest step.

        Args:
            slope: Derivatives by the knots.
            bound: Scale of the polygon for the knots.
            normals: Normals of the sides of the polygon, over their distances from the centre, shape (sides,
                components).
        """
        count = self.grid.size
        identity = sparse.eye_array(count)
        differences = identity.tocsr()[1:] - identity.tocsr()[:-1]
        rows = sparse.vstack([sparse.kron(identity, normals), sparse.kron(differences, normals)])
        largest = np.repeat([bound, self.step], [count * len(normals), (count - 1) * len(normals)])
        scale = np.abs(slope).max() or 1.0
        solution = linprog(-slope.ravel() / scale, A_ub=rows.tocsr(), b_ub=largest, bounds=(None, None), method="highs")
        return solution.x.reshape(slope.shape)
