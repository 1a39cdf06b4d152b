"""Suprema of the drag less its damping, in floating point."""

import math

import numpy as np

DRAG_POINTS = 65
"""Points of |v| and of |r| at which drag is compared."""
DRAG_ROOM = 1.004
"""Widening of drag's largest value, for what lies between the points and for the verifier's enclosure."""


def drag_in_plane(speed_bound: float, wind: float, drag: tuple[float, float], across: float, c: float) -> float:
    """The largest |c v - x r| over the plane's v and r with |v| <= speed_bound and |v - r| <= wind.

    v is the vehicle's velocity and r its velocity against the air. x is the drag over mass and speed: it lies between
    quadratic |r| and quadratic (|r|^2 + across^2)^(1/2) + linear.

    Args:
        speed_bound: Bound of |v| [m/s].
        wind: Bound of the wind [m/s].
        drag: Coefficients of quadratic drag over mass [1/m] and of linear drag over mass [1/s].
        across: Bound of the air's relative speed perpendicular to the plane [m/s].
        c: Damping [1/s].
    """
    speed = np.linspace(0.0, speed_bound, DRAG_POINTS)[:, None]
    # in a wind faster than v, an r of a smaller size may have any direction, and the largest |c v - x r| grows with it
    slowest = np.abs(wind - speed)
    fastest = wind + speed
    air_speed = slowest + (fastest - slowest) * np.linspace(0.0, 1.0, DRAG_POINTS)
    # |v - r| <= wind bounds v r from below
    product = np.maximum(-speed * air_speed, 0.5 * (speed**2 + air_speed**2 - wind**2))
    return largest_drag(speed, air_speed, product, drag, across, c)


def drag_along(speed_bound: float, wind: float, drag: tuple[float, float], across: float, c: float) -> float:
    """The largest |c v - x r| over |v| <= speed_bound, |v - r| <= wind along one axis; see :func:`drag_in_plane`."""
    v = np.linspace(-speed_bound, speed_bound, 4 * DRAG_POINTS)
    r = v - wind
    return largest_drag(np.abs(v), np.abs(r), v * r, drag, across, c)


def largest_drag(
    speed: np.ndarray, air_speed: np.ndarray, product: np.ndarray, drag: tuple[float, float], across: float, c: float
) -> float:
    """The largest |c v - x r| at points with |v| = speed, |r| = air_speed and v r = product, x at both of its ends."""
    quadratic, linear = drag
    largest = 0.0
    for x in (quadratic * air_speed, quadratic * np.sqrt(air_speed**2 + across**2) + linear):
        square = (x * air_speed) ** 2 + (c * speed) ** 2 - 2.0 * c * x * product
        largest = max(largest, float(np.max(square)))
    return DRAG_ROOM * math.sqrt(max(largest, 0.0))
