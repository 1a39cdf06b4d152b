"""Bounds of the drag, less the damping of the linear channels, and of its torques, in floating point.

docs/vehicle_proofs.md has the formulas.
"""

import math
from dataclasses import dataclass

import numpy as np

from dssc_jax.proofs.search.vehicle.attitude import Attitude, Signals
from dssc_jax.proofs.search.vehicle.rotors import Rotors
from dssc_jax.proofs.vehicle_problem import VehicleProblem

DRAG_POINTS = 65
"""Points of |v| and of |r| at which drag is compared."""
DRAG_ROOM = 1.004
"""Widening of drag's largest value, for what lies between the points and for the verifier's enclosure."""


@dataclass(frozen=True)
class DragBounds:
    """Bounds of drag and of its torques.

    Args:
        plane: Of the drag over mass in the plane, less its damping [m/s^2].
        vertical: Of the same along z [m/s^2].
        torque_h: Of the torque across body z over inertia [rad/s^2].
        torque_z: Of the torque along body z over inertia [rad/s^2].
    """

    plane: float
    vertical: float
    torque_h: float
    torque_z: float


def drag_of(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, rotors: Rotors, damping: tuple[float, float]
) -> DragBounds:
    """Bounds of the drag of structure and propellers, and of its torque and the rotors' gyroscopic one.

    Args:
        problem: The vehicle.
        bounds: Bounds of the signals.
        attitude: Bounds of the attitude.
        rotors: Bounds of the rotors.
        damping: Damping of drag in the linear channels of the plane and of z [1/s].
    """
    wind_h, wind_z = problem.wind
    speed_h, speed_z = bounds["x"]["speed"], bounds["z"]["e_dot"]
    air_speed_h, air_speed_z = speed_h + wind_h, speed_z + wind_z
    air_speed = math.hypot(air_speed_h, air_speed_z)
    lightest = problem.mass[0]
    k_h, k_z = (k / lightest for k in problem.structure_drag)
    k_p = problem.propeller_drag
    linear = k_p * rotors.sum / lightest
    s = attitude.tilt
    tilt_drag = abs(k_h - k_z) * air_speed
    half_spread = 0.5 * problem.rotors * rotors.spread
    rotation_drag = k_p * problem.arm * half_spread * attitude.rate / lightest
    plane = drag_in_plane(speed_h, wind_h, (k_h, linear), air_speed_z, damping[0])
    vertical = drag_along(speed_z, wind_z, (k_z, linear), air_speed_h, damping[1])
    torque = k_p * problem.arm * (half_spread * air_speed + problem.arm * rotors.sum * attitude.rate)
    smallest_inertia = min(problem.inertia[0][0], problem.inertia[1][0])
    return DragBounds(
        plane=plane + tilt_drag * (s * air_speed_h + air_speed_z) * s + rotation_drag,
        vertical=vertical + tilt_drag * (s**2 * air_speed_z + s * air_speed_h) + rotation_drag,
        torque_h=(torque + problem.rotor_inertia * half_spread * attitude.rate_h) / smallest_inertia,
        torque_z=(torque + problem.rotor_inertia * rotors.spin_up) / problem.inertia[2][0],
    )


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
