"""Lengths, turns and derivatives of a path: a cubic spline of position and yaw through waypoints.

A path is a ``CubicSpline`` of x, y, z [m] and psi [rad], whose parameter u [m] is rising from waypoint to waypoint.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from dssc_jax.core.errors import ConfigError

LEG_PARTS = 128  # parts of a leg, on which its length and curvature are taken
GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(5)  # on [-1, 1]
SHARPEST_TURN = 0.5  # cosine of the largest turn of the path between two of its checked points: 60 degrees


def path_speed(path: CubicSpline, u: np.ndarray) -> np.ndarray:
    """|dr/du| at each u: the length of the path per unit of its parameter u.

    Args:
        path: The path.
        u: Parameters, any shape.
    """
    slope = path(u, 1)  # first derivative of x, y, z and psi
    return np.linalg.norm(slope[..., :3], axis=-1)


def path_length(path: CubicSpline, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Length of the path between pairs of near parameters, by Gauss's rule of five points [m].

    Args:
        path: The path.
        start: First parameter of each interval, shape (n,).
        end: Last parameter of each interval, shape (n,).
    """
    half = 0.5 * (end - start)
    parameters = start[:, None] + np.outer(half, 1.0 + GAUSS_NODES)
    return half * (path_speed(path, parameters) @ GAUSS_WEIGHTS)


def nonzero_path_speed(path: CubicSpline, u: np.ndarray) -> np.ndarray:
    """The speed |dr/du| of :func:`path_speed`, but the smallest normal number in place of 0.

    One can therefore divide by the result. Arguments are as for :func:`path_speed`.
    """
    return np.maximum(path_speed(path, u), np.finfo(float).tiny)


def nearest_waypoint(path: CubicSpline, u: float) -> int:
    """The number, from 0, of the waypoint that is nearest to a parameter u of the path."""
    return int(np.abs(path.x - u).argmin())


def check_turns(path: CubicSpline, u: np.ndarray) -> None:
    """Require that the path does not turn back on itself.

    Args:
        path: The path.
        u: Parameters at which the path is checked, rising.

    Raises:
        ConfigError: The direction turns by more than 60 degrees between two of the parameters.
    """
    slope = path(u, 1)[:, :3]
    size = nonzero_path_speed(path, u)
    turn_cosines = np.sum(slope[1:] * slope[:-1], axis=1) / size[1:] / size[:-1]  # from one u to the next
    if turn_cosines.min() < SHARPEST_TURN:
        i = nearest_waypoint(path, float(u[turn_cosines.argmin()]))
        rule = f"the path turns back on itself at waypoint {i}, which no speed allows; put waypoints around the turn"
        raise ConfigError(f"latitude_deg.{i}", rule)


def parameters_at_length(path: CubicSpline, u: np.ndarray, s: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """The parameters at which the path has reached some lengths, shape (m,), by four steps of Newton's method.

    Args:
        path: The path.
        u: Parameters of a grid, rising, shape (n,).
        s: Length of the path up to each parameter of the grid [m], shape (n,).
        distances: The lengths [m], shape (m,).
    """
    # k: the interval of the grid in which each length lies
    k = np.clip(np.searchsorted(s, distances, side="right") - 1, 0, len(u) - 2)
    parameters = u[k] + (distances - s[k]) / (s[k + 1] - s[k]) * (u[k + 1] - u[k])
    for _ in range(4):
        remaining_length = distances - s[k] - path_length(path, u[k], parameters)
        parameters = np.clip(parameters + remaining_length / path_speed(path, parameters), u[k], u[k + 1])
    return parameters


def path_grid(path: CubicSpline) -> tuple[np.ndarray, np.ndarray]:
    """A grid of parameters of the path, and the length of the path up to each [m], shape (n,) each.

    The grid has ``LEG_PARTS`` parts in each leg between two waypoints.
    """
    waypoints = len(path.x)
    legs = np.arange(LEG_PARTS * (waypoints - 1) + 1) / LEG_PARTS  # 0 at the first waypoint, 1 at the second, ..
    grid = np.interp(legs, np.arange(waypoints), path.x)
    lengths = np.concatenate([[0.0], np.cumsum(path_length(path, grid[:-1], grid[1:]))])
    return grid, lengths


def path_derivatives(
    path: CubicSpline, u: np.ndarray, speed: np.ndarray, acceleration: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """First and second time derivatives of position and yaw on the path, shape (n, 4) each.

    They follow by the chain rule, r' = r_u u' and r'' = r_uu u'^2 + r_u u'', from the parameter u(t).

    Args:
        path: The path.
        u: Parameters of the path, shape (n,).
        speed: Speed along the path at each of them [m/s], shape (n,).
        acceleration: Rate of change of the speed [m/s^2], shape (n,).
    """
    size = path_speed(path, u)
    slope = path(u, 1)
    bend = path(u, 2)
    u_dot = speed / size
    u_ddot = (acceleration - np.sum(slope[:, :3] * bend[:, :3], axis=1) / size * u_dot**2) / size
    return slope * u_dot[:, None], bend * u_dot[:, None] ** 2 + slope * u_ddot[:, None]
