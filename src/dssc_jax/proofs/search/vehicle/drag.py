"""Bounds of the part of the drag that the linear channels' damping does not contain, and of the torques by drag.

They are in floating point. docs/vehicle_proofs.md has the formulas; comments here give the symbols.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.search.vehicle.attitude import Attitude, Signals
from dssc_jax.proofs.search.vehicle.channels import Damping
from dssc_jax.proofs.search.vehicle.rotors import Rotors
from dssc_jax.proofs.vehicle_problem import VehicleProblem

DRAG_POINTS = 65
"""Number of values of |v|, and of |r|, in the grid on which the largest drag is taken."""
DRAG_ROOM = 1.004
"""Factor that widens the largest drag at the points, for the space between them and for the verifier's enclosure."""


class DragCoefficients(NamedTuple):
    """Coefficients of the drag over mass.

    Args:
        quadratic: k, the coefficient of the structure's drag, which grows with the square of the air speed [1/m].
        linear: Coefficient of the propellers' drag, which is proportional to the air speed [1/s].
    """

    quadratic: float
    linear: float


@dataclass(frozen=True)
class DragBounds:
    """Bounds of the drag that damping does not contain, and of the torques by drag.

    Args:
        plane: D_h + x_h, bound of the sum of c v and the drag over mass in the plane [m/s^2].
        vertical: D_z + x_z, bound of this sum along z [m/s^2].
        torque_h: tau_h, bound of the torque across body z over inertia [rad/s^2].
        torque_z: tau_z, bound of the torque along body z over inertia [rad/s^2].
    """

    plane: float
    vertical: float
    torque_h: float
    torque_z: float


def drag_of(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, rotors: Rotors, damping: Damping
) -> DragBounds:
    """Bounds of the drag of structure and propellers, less the channels' damping, and of the torques on the body.

    The torques come from the propellers' drag and from the rotors' spin: gyroscopic, and by spinning up.

    Args:
        problem: The vehicle.
        bounds: Bounds of the signals.
        attitude: Bounds of the attitude.
        rotors: Bounds of the rotors.
        damping: Damping by drag in the linear channels.
    """
    wind_h, wind_z = problem.wind  # W and W_z
    speed_h = bounds["x"]["speed"]
    speed_z = bounds["z"]["e_dot"]
    air_speed_h = speed_h + wind_h  # V_h
    air_speed_z = speed_z + wind_z  # V_z
    air_speed = math.hypot(air_speed_h, air_speed_z)  # V_r
    lightest = problem.mass[0]  # M_-
    drag_h, drag_z = problem.structure_drag
    k_h = drag_h / lightest
    k_z = drag_z / lightest
    k_p = problem.propeller_drag
    linear = k_p * rotors.sum / lightest  # k_p o_S/M_-
    s = attitude.tilt
    tilt_drag = abs(k_h - k_z) * air_speed
    half_spread = 0.5 * problem.rotors * rotors.spread  # n w_o/2
    rotation_drag = k_p * problem.arm * half_spread * attitude.rate / lightest
    plane = drag_in_plane(speed_h, wind_h, DragCoefficients(k_h, linear), air_speed_z, damping.plane)  # D_h
    vertical = drag_along(speed_z, wind_z, DragCoefficients(k_z, linear), air_speed_h, damping.vertical)  # D_z
    torque = k_p * problem.arm * (half_spread * air_speed + problem.arm * rotors.sum * attitude.rate)
    (j_x, _), (j_y, _), (j_z, _) = problem.inertia  # the lower ends
    return DragBounds(
        plane=plane + tilt_drag * (s * air_speed_h + air_speed_z) * s + rotation_drag,
        vertical=vertical + tilt_drag * (s**2 * air_speed_z + s * air_speed_h) + rotation_drag,
        torque_h=(torque + problem.rotor_inertia * half_spread * attitude.rate_h) / min(j_x, j_y),
        torque_z=(torque + problem.rotor_inertia * rotors.spin_up) / j_z,
    )


def drag_in_plane(speed_bound: float, wind: float, drag: DragCoefficients, across: float, c: float) -> float:
    """D_h, the largest |c v - x r| [m/s^2] over vectors of the plane: the part of the drag x r beyond the damping c v.

    v is the vehicle's velocity with |v| <= ``speed_bound``, and r = v - w its velocity relative to a wind w with |w| <=
    ``wind``. x lies between k |r| and k (|r|^2 + across^2)^(1/2) + linear.

    Args:
        speed_bound: Bound of |v| [m/s].
        wind: Bound of |w| [m/s].
        drag: Coefficients of the drag over mass.
        across: Bound of the air's relative speed perpendicular to the plane [m/s].
        c: Damping [1/s].
    """
    speed = np.linspace(0.0, speed_bound, DRAG_POINTS)[:, None]
    # up to |r| = wind - |v| > 0, r may have any direction; there the largest |c v - x r| grows with |r|
    slowest = np.abs(wind - speed)
    fastest = wind + speed
    air_speed = slowest + (fastest - slowest) * np.linspace(0.0, 1.0, DRAG_POINTS)
    # |c v - x r| is largest where v'r is smallest; |v - r| <= wind bounds v'r from below
    product = np.maximum(-speed * air_speed, 0.5 * (speed**2 + air_speed**2 - wind**2))
    return largest_drag(speed, air_speed, product, drag, across, c)


def drag_along(speed_bound: float, wind: float, drag: DragCoefficients, across: float, c: float) -> float:
    """D_z, the largest |c v - x r| [m/s^2] over numbers v and r along z, with the symbols of :func:`drag_in_plane`.

    Args:
        speed_bound: Bound of |v| [m/s].
        wind: Bound of the vertical wind [m/s].
        drag: Coefficients of the drag over mass.
        across: Bound of the air's relative speed in the plane [m/s].
        c: Damping [1/s].
    """
    v = np.linspace(-speed_bound, speed_bound, 4 * DRAG_POINTS)
    r = v - wind  # by symmetry the wind has one sign
    return largest_drag(np.abs(v), np.abs(r), v * r, drag, across, c)


def largest_drag(
    speed: np.ndarray, air_speed: np.ndarray, product: np.ndarray, drag: DragCoefficients, across: float, c: float
) -> float:
    """The largest |c v - x r| over some points and both ends of x, widened by ``DRAG_ROOM`` [m/s^2].

    Args:
        speed: |v| at the points [m/s].
        air_speed: |r| at the points [m/s].
        product: v'r at the points [m^2/s^2].
        drag: Coefficients of the drag over mass.
        across: Bound of the air's relative speed across v and r [m/s].
        c: Damping [1/s].
    """
    least_x = drag.quadratic * air_speed
    largest_x = drag.quadratic * np.sqrt(air_speed**2 + across**2) + drag.linear
    largest_square = 0.0
    for x in (least_x, largest_x):
        square = (x * air_speed) ** 2 + (c * speed) ** 2 - 2.0 * c * x * product  # |c v - x r|^2
        largest_square = max(largest_square, float(np.max(square)))
    return DRAG_ROOM * math.sqrt(max(largest_square, 0.0))
