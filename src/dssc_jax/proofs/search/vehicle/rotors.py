"""Bounds of the rotors' thrusts and speeds, and of their differences from their commands by a lag, in floating point.

docs/vehicle_proofs.md has the formulas; comments here give the symbols.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from dssc_jax.proofs.problem import Interval
from dssc_jax.proofs.search.vehicle.attitude import Attitude, OutOfRange, Signals
from dssc_jax.proofs.search.vehicle.channels import GRAVITY
from dssc_jax.proofs.vehicle_problem import VehicleProblem

LEAST_ROTORS = 4
"""Number of rotors whose thrusts follow from net thrust and moments alone."""


@dataclass(frozen=True)
class Rotors:
    """Bounds of the rotors in a time cell; with a lag they also cover the thrusts of the cells before.

    Args:
        smallest: f_min, lower bound of every thrust [N].
        largest: f_max, upper bound of every thrust [N].
        spread: w_o, bound of the difference of two rotors' speeds [rad/s].
        sum: o_S, bound of the sum of the speeds [rad/s].
        shortfall: d, bound of the difference of a thrust from its command [N]; 0 without a lag.
        defect: zeta, bound of the difference of a thrust's derivative, where the speed has the lag, from that of a
            thrust with the same lag [N/s]; 0 without a lag.
        spin_up: Bound of the signed sum of the speeds' derivatives [rad/s^2]; 0 without a lag.
    """

    smallest: float
    largest: float
    spread: float
    sum: float
    shortfall: float
    defect: float
    spin_up: float


@dataclass(frozen=True)
class Moments:
    """Bounds of the difference of the commanded angular acceleration mu_c from that of the linear channels.

    Args:
        plane: r_mh, bound of g times the part across body z [m/s^2].
        yaw: r_mz, bound of the part along body z [rad/s^2].
    """

    plane: float
    yaw: float


class GyroscopicFactors(NamedTuple):
    """Factors of the gyroscopic coupling Omega x J Omega of a body with the inertia J_x, J_y, J_z.

    Args:
        across: The largest |J_z - J_y|/J_x and |J_z - J_x|/J_y, for the part across body z.
        along: The largest |J_x - J_y|/J_z, for the part along body z.
    """

    across: float
    along: float


def gyroscopic_factors(inertia: tuple[Interval, ...]) -> GyroscopicFactors:
    """The factors of the gyroscopic coupling over intervals of the inertia J_x, J_y, J_z."""
    x, y, z = inertia
    (x_low, _), (y_low, _), (z_low, _) = inertia
    return GyroscopicFactors(
        across=max(largest_difference(z, y) / x_low, largest_difference(z, x) / y_low),
        along=largest_difference(x, y) / z_low,
    )


def largest_difference(a: Interval, b: Interval) -> float:
    """The largest |a - b| over two intervals."""
    a_low, a_high = a
    b_low, b_high = b
    return max(a_high - b_low, b_high - a_low)


def believed_factors(problem: VehicleProblem) -> GyroscopicFactors:
    """j_h and j_z, the factors of the gyroscopic coupling with the inertia that the inner loops believe."""
    return gyroscopic_factors(tuple((value, value) for value in problem.believed_inertia))


def moments_of(problem: VehicleProblem, attitude: Attitude) -> Moments:
    """Bounds of the difference of the commanded angular acceleration mu_c from m/g and eta_psi: r_mh and r_mz."""
    j_h, j_z = believed_factors(problem)
    s = attitude.tilt
    tilt_demand = attitude.tilt_demand
    yaw_demand = attitude.yaw_demand
    coupled_h = attitude.frame_h + j_h * attitude.rate_h * attitude.rate_z
    coupled_z = attitude.frame_z + j_z * attitude.rate_h**2 / 2.0
    turn_terms = problem.damping * attitude.yaw_rate * s + s * yaw_demand + s**2 * tilt_demand / 2.0 + coupled_h
    return Moments(
        plane=GRAVITY * (problem.stiffness * attitude.tilt_defect + turn_terms),
        yaw=s * tilt_demand + s**2 * yaw_demand / 2.0 + coupled_z,
    )


def moment_thrust(problem: VehicleProblem, plane: float, yaw: float) -> float:
    """Bound of the thrust that the allocation adds to a rotor for commanded angular accelerations [N].

    Args:
        problem: The vehicle.
        plane: Bound of the angular acceleration across body z [rad/s^2].
        yaw: Bound of the angular acceleration along body z [rad/s^2].
    """
    j_x, j_y, j_z = problem.believed_inertia
    n = problem.rotors
    return 2.0 * max(j_x, j_y) * plane / (n * problem.arm) + j_z * yaw / (n * problem.torque_coefficient)


def rotors_of(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, moments: Moments, earlier: Rotors | None
) -> Rotors:
    """Bounds of the rotors' thrusts and speeds, while the signals are within their bounds.

    Args:
        problem: The vehicle.
        bounds: Bounds of the signals.
        attitude: Bounds of the attitude.
        moments: Bounds of the difference of the commanded angular acceleration from that of the linear channels.
        earlier: Bounds of the rotors in the time cells before; None in the first one.

    Raises:
        OutOfRange: A rotor may reach a limit, or may be too far behind its command.
    """
    j_h, j_z = believed_factors(problem)
    n = problem.rotors
    k = problem.thrust_coefficient
    mass = problem.believed_mass
    s = attitude.tilt
    tilt_demand = attitude.tilt_demand
    yaw_demand = attitude.yaw_demand
    plane = tilt_demand + s * yaw_demand + attitude.frame_h + j_h * attitude.rate_h * attitude.rate_z  # M_h
    yaw = yaw_demand + s * tilt_demand + attitude.frame_z + j_z * attitude.rate_h**2 / 2.0  # M_z
    added_thrust = moment_thrust(problem, plane, yaw)  # d_M
    smallest = mass * (GRAVITY - attitude.lift) / n - added_thrust
    largest = mass * (GRAVITY + attitude.lift) * attitude.secant / n + added_thrust
    if not (smallest > 0.0 and largest < problem.rotor_limit):
        raise OutOfRange
    if problem.rotor_lag and earlier is not None:  # the thrusts follow the commands of earlier cells
        smallest = min(smallest, earlier.smallest)
        largest = max(largest, earlier.largest)
    spread = (math.sqrt(largest) - math.sqrt(smallest)) / math.sqrt(k)
    total = math.sqrt(n * mass * (GRAVITY + max(attitude.lift, attitude.achieved_lift)) * attitude.secant / k)
    rotors = Rotors(smallest, largest, spread, total, shortfall=0.0, defect=0.0, spin_up=0.0)
    if not problem.rotor_lag:
        return rotors
    shortfall = largest_shortfall(problem, bounds, attitude, moments, smallest)
    if n > LEAST_ROTORS and earlier is not None:
        shortfall = max(shortfall, earlier.shortfall)
    defect = shortfall**2 / (4.0 * problem.rotor_lag * smallest)
    spin_up = n * shortfall / (2.0 * problem.rotor_lag * math.sqrt(k * smallest))
    return replace(rotors, shortfall=shortfall, defect=defect, spin_up=spin_up)


def largest_shortfall(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, moments: Moments, smallest: float
) -> float:
    """d, bound of the difference of a thrust from its command with a rotor lag [N].

    d_4, the part of net thrust and moments, follows from the signals ``behind``. With more than four rotors there is
    also a part in the null space of the allocation, which grows with d^2. So d is the smaller root of d = d_4 +
    (n - 4)^(1/2) d^2/(8 f_min).

    Args:
        problem: The vehicle, with a rotor lag.
        bounds: Bounds of the signals.
        attitude: Bounds of the attitude.
        moments: Bounds of the difference of the commanded angular acceleration from that of the linear channels.
        smallest: f_min, the smallest thrust [N].

    Raises:
        OutOfRange: The equation has no root.
    """
    n = problem.rotors
    behind_plane = (bounds["x"]["behind"] + moments.plane) / GRAVITY
    d_4 = moment_thrust(problem, behind_plane, bounds["psi"]["behind"] + moments.yaw)
    d_4 += problem.believed_mass * bounds["z"]["behind"] * attitude.secant / n
    discriminant = 1.0 - math.sqrt(n - LEAST_ROTORS) * d_4 / (2.0 * smallest)
    if discriminant <= 0.0:
        raise OutOfRange
    return 2.0 * d_4 / (1.0 + math.sqrt(discriminant))
