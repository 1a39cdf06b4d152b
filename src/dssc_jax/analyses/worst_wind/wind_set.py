"""The winds on a grid that stay within bounds: candidates to begin with, and the extreme one in a given direction."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from dssc_jax.analyses.worst_wind.flights import WindGrid

DIRECTIONS = 8
"""Lines along which a resonant candidate swings."""
PERIODS = 16
PHASES = (0.0, 0.25)  # periods
LIFTS = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Shares of the swing and of a constant in the vertical wind of a resonant candidate."""
SIDES = 16
"""Sides of the polygon that stands for the circle where the rate is bounded; its corners lie on the circle."""


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
    """All winds on a grid within bounds: a convex set.

    Args:
        limits: The bounds.
        grid: Times at which a wind is given; smooth if the rate is bounded.
    """

    limits: Limits
    grid: WindGrid

    @property
    def step(self) -> float:
        """Bound of the change from one vector to the next [m/s]."""
        return np.inf if self.limits.rate is None else self.limits.rate * self.grid.interval

    def within(self, winds: np.ndarray) -> np.ndarray:
        """Winds that follow given ones within the bounds as fast as their rate allows, shape (n, size, 3) both."""
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

    def resonant(self) -> np.ndarray:
        """Winds that swing along a line with a period, shape (n, size, 3); the vertical wind swings or is constant.

        Directions divide half a circle, periods are even in the logarithm from two intervals to twice the flight.
        """
        times = np.arange(self.grid.size) * self.grid.interval
        periods = np.geomspace(2.0 * self.grid.interval, 2.0 * times[-1] + self.grid.interval, PERIODS)
        winds = []
        for period in periods:
            for phase in PHASES:
                # half an interval ahead: no vector lies on a change of sign
                swing = np.sign(np.sin(2.0 * np.pi * ((times + 0.5 * self.grid.interval) / period + phase)))
                winds += [self._swinging(swing, angle, lift) for angle in half_circle() for lift in LIFTS]
        return self.within(np.stack(winds))

    def _swinging(self, swing: np.ndarray, angle: float, lift: tuple[float, float]) -> np.ndarray:
        """The wind that follows a swing of +-1 along a direction, with shares of it in the vertical; (size, 3)."""
        horizontal = self.limits.speed * swing
        vertical = self.limits.vertical * (lift[0] * swing + lift[1])
        return np.column_stack([horizontal * np.cos(angle), horizontal * np.sin(angle), vertical])

    def switching(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Winds that switch to random extremes at random times, shape (count, grid.size, 3).

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
        return self.within(winds)

    def extreme(self, slopes: np.ndarray, current_winds: np.ndarray) -> np.ndarray:
        """The winds that maximise the sum of the products with given slopes, shape (n, size, 3) all.

        Where a slope is 0 and nothing couples the vectors, the present wind is kept.
        """
        if self.limits.rate is not None:
            return np.stack([self._extreme_spline(slope) for slope in slopes])
        norms = np.linalg.norm(slopes[..., :2], axis=-1, keepdims=True)
        extreme_winds = np.array(current_winds)
        horizontal = self.limits.speed * slopes[..., :2] / np.where(norms > 0.0, norms, 1.0)
        extreme_winds[..., :2] = np.where(norms > 0.0, horizontal, current_winds[..., :2])
        vertical = self.limits.vertical * np.sign(slopes[..., 2])
        extreme_winds[..., 2] = np.where(slopes[..., 2] != 0.0, vertical, current_winds[..., 2])
        return extreme_winds

    def _extreme_spline(self, slope: np.ndarray) -> np.ndarray:
        """See :meth:`extreme`: two linear programs, with a polygon in place of the circle; shape (size, 3)."""
        horizontal = self._extreme_knots(slope[:, :2], self.limits.speed, self._polygon)
        vertical = self._extreme_knots(slope[:, 2:], self.limits.vertical, np.array([[1.0], [-1.0]]))
        return self.within(np.concatenate([horizontal, vertical], axis=1)[None])[0]  # the solver's tolerance

    @cached_property
    def _polygon(self) -> np.ndarray:
        """Normals of the polygon's sides over their distance from the centre, for a circle of radius 1."""
        angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
        return np.column_stack([np.cos(angles), np.sin(angles)]) / np.cos(np.pi / SIDES)

    def _extreme_knots(self, slope: np.ndarray, bound: float, normals: np.ndarray) -> np.ndarray:
        """Knots that maximise the sum of the products with slopes, shape (count, components) both.

        Each knot lies in the polygon of the given normals scaled by the bound, each difference in that scaled by the
        largest step.
        """
        count = self.grid.size
        every = sparse.eye_array(count)
        differences = every.tocsr()[1:] - every.tocsr()[:-1]
        rows = sparse.vstack([sparse.kron(every, normals), sparse.kron(differences, normals)])
        largest = np.repeat([bound, self.step], [count * len(normals), (count - 1) * len(normals)])
        scale = np.abs(slope).max() or 1.0
        solution = linprog(-slope.ravel() / scale, A_ub=rows.tocsr(), b_ub=largest, bounds=(None, None), method="highs")
        return solution.x.reshape(slope.shape)


def half_circle() -> np.ndarray:
    """Angles of lines that divide the circle evenly [rad], shape (DIRECTIONS,)."""
    return np.pi * np.arange(DIRECTIONS) / DIRECTIONS
