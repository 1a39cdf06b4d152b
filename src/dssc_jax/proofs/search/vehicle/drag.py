"""Suprema of the drag less its damping, in floating point."""

import math

import numpy as np

DRAG_POINTS = 65
"""Points of |v| and of |r| at which drag is compared."""
DRAG_ROOM = 1.004
"""Widening of drag's largest value, for what lies between the points and for the verifier's enclosure."""


def drag_in_plane(speed_bound: float, wind: float, drag: tuple[float, float], across: float, c: float) -> float:
    """The largest |-x r + c v| over |v| <= speed_bound, |v - r| <= wind in the plane.

    Args:
        speed_bound: Bound of |v| [m/s].
        wind: Bound of the wind [m/s].
        drag: Coefficients of quadratic drag over mass [1/m] and of linear drag over mass [1/s].
        across: Bound of the air's relative speed across v [m/s].
        c: Damping [1/s].
    """
    a = np.linspace(0.0, speed_bound, DRAG_POINTS)[:, None]
    r = np.abs(wind - a) + (wind + a - np.abs(wind - a)) * np.linspace(0.0, 1.0, DRAG_POINTS)
    along = np.maximum(-a * r, 0.5 * (a**2 + r**2 - wind**2))
    return largest_drag(a, r, along, drag, across, c)


def drag_along(speed_bound: float, wind: float, drag: tuple[float, float], across: float, c: float) -> float:
    """The largest |-x r + c v| over |v| <= speed_bound, |v - r| <= wind along one axis; see :func:`drag_in_plane`."""
    v = np.linspace(-speed_bound, speed_bound, 4 * DRAG_POINTS)
    r = v - wind
    return largest_drag(np.abs(v), np.abs(r), v * r, drag, across, c)


def largest_drag(
    a: np.ndarray, r: np.ndarray, along: np.ndarray, drag: tuple[float, float], across: float, c: float
) -> float:
    """The largest |-x r + c v| at points with |v| = a and v r = along, x at both of its ends."""
    quadratic, linear = drag
    largest = 0.0
    for x in (quadratic * r, quadratic * np.sqrt(r**2 + across**2) + linear):
        square = (x * r) ** 2 + (c * a) ** 2 - 2.0 * c * x * along
        largest = max(largest, float(np.max(square)))
    return DRAG_ROOM * math.sqrt(max(largest, 0.0))
