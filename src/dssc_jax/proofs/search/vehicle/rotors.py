"""Bounds of the rotors' thrusts and speeds, and of how far a lag keeps them behind their commands, in floating point.

docs/vehicle_proofs.md has the formulas.
"""

import math
from dataclasses import dataclass, replace

from dssc_jax.proofs.problem import Interval
from dssc_jax.proofs.search.vehicle.attitude import Attitude, OutOfRange, Signals
from dssc_jax.proofs.search.vehicle.channels import GRAVITY
from dssc_jax.proofs.vehicle_problem import VehicleProblem

LEAST_ROTORS = 4
"""Number of rotors whose thrusts follow from net thrust and moments."""


@dataclass(frozen=True)
class Rotors:
    """Bounds of the rotors in a time cell; with a lag, those in the cells before still count.

    Args:
        smallest: Lower bound of every thrust [N].
        largest: Upper bound of every thrust [N].
        spread: Bound of the difference of two rotors' speeds [rad/s].
        sum: Bound of the sum of the speeds [rad/s].
        shortfall: d, the bound of how far a thrust is behind its command [N]; 0 without a lag.
        defect: zeta, the bound of the slope of a thrust that a lag of its speed adds to that of a lag of the thrust
            [N/s].
        spin_up: Bound of the sum of the speeds' slopes [rad/s^2].
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
    """Bounds of what the commanded angular acceleration deviates by from the linear channels'.

    Args:
        plane: r_mh, across body z, times g [m/s^2].
        yaw: r_mz, along body z [rad/s^2].
    """

    plane: float
    yaw: float


def inertia_ratios(inertia: tuple[Interval, ...]) -> tuple[float, float]:
    """j_h, the largest |J_z - J_y|/J_x and |J_z - J_x|/J_y, and j_z, the largest |J_x - J_y|/J_z, over intervals."""
    x, y, z = inertia

    def ratio(a: Interval, b: Interval, divisor: Interval) -> float:
        return max(a[1] - b[0], b[1] - a[0]) / divisor[0]

    return max(ratio(z, y, x), ratio(z, x, y)), ratio(x, y, z)


def believed_ratios(problem: VehicleProblem) -> tuple[float, float]:
    """:func:`inertia_ratios` of the inertia that the inner loops believe."""
    return inertia_ratios(tuple((value, value) for value in problem.believed_inertia))


def moments_of(problem: VehicleProblem, attitude: Attitude) -> Moments:
    """Bounds of what the commanded angular acceleration deviates by from m, and from eta_psi."""
    j_h, j_z = believed_ratios(problem)
    s = attitude.tilt
    tilt_demand, yaw_demand = attitude.tilt_demand, attitude.yaw_demand
    coupled_h = attitude.frame_h + j_h * attitude.rate_h * attitude.rate_z
    coupled_z = attitude.frame_z + j_z * attitude.rate_h**2 / 2.0
    turn_terms = problem.damping * attitude.yaw_rate * s + s * yaw_demand + s**2 * tilt_demand / 2.0 + coupled_h
    plane = GRAVITY * (problem.stiffness * attitude.tilt_defect + turn_terms)
    return Moments(plane, s * tilt_demand + s**2 * yaw_demand / 2.0 + coupled_z)


def moment_thrust(problem: VehicleProblem, plane: float, yaw: float) -> float:
    """Bound of the thrust that a rotor adds for commanded angular accelerations [N].

    Args:
        problem: The vehicle.
        plane: Bound of the angular acceleration across body z [rad/s^2].
        yaw: Bound of that along body z [rad/s^2].
    """
    j_x, j_y, j_z = problem.believed_inertia
    n = problem.rotors
    return 2.0 * max(j_x, j_y) * plane / (n * problem.arm) + j_z * yaw / (n * problem.torque_coefficient)


def rotors_of(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, moments: Moments, earlier: Rotors | None
) -> Rotors:
    """Bounds of the rotors under bounds of the signals.

    Args:
        problem: The vehicle.
        bounds: Bounds of the signals.
        attitude: Bounds of the attitude.
        moments: Bounds of what the commanded angular acceleration deviates by.
        earlier: The rotors in the time cells before; None in the first one.

    Raises:
        OutOfRange: A rotor may reach a limit, or may be too far behind its command.
    """
    j_h, j_z = believed_ratios(problem)
    n, k = problem.rotors, problem.thrust_coefficient
    mass = problem.believed_mass
    s = attitude.tilt
    tilt_demand, yaw_demand = attitude.tilt_demand, attitude.yaw_demand
    plane = tilt_demand + s * yaw_demand + attitude.frame_h + j_h * attitude.rate_h * attitude.rate_z
    yaw = yaw_demand + s * tilt_demand + attitude.frame_z + j_z * attitude.rate_h**2 / 2.0
    added_thrust = moment_thrust(problem, plane, yaw)
    smallest = mass * (GRAVITY - attitude.lift) / n - added_thrust
    largest = mass * (GRAVITY + attitude.lift) * attitude.secant / n + added_thrust
    if not (smallest > 0.0 and largest < problem.rotor_limit):
        raise OutOfRange
    if problem.rotor_lag and earlier is not None:
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
    """d, the bound of how far a thrust is behind its command with a rotor lag [N].

    The part that belongs to net thrust and moments follows from the signals ``behind``. With more than four rotors
    there is one in the null space of the allocation, too, so that d is the smaller root of a quadratic equation.

    Args:
        problem: The vehicle, with a rotor lag.
        bounds: Bounds of the signals.
        attitude: Bounds of the attitude.
        moments: Bounds of what the commanded angular acceleration deviates by.
        smallest: Smallest thrust [N].

    Raises:
        OutOfRange: The equation has no root.
    """
    n = problem.rotors
    behind_plane = (bounds["x"]["behind"] + moments.plane) / GRAVITY
    shortfall = moment_thrust(problem, behind_plane, bounds["psi"]["behind"] + moments.yaw)
    shortfall += problem.believed_mass * bounds["z"]["behind"] * attitude.secant / n
    discriminant_deficit = math.sqrt(n - LEAST_ROTORS) * shortfall / (2.0 * smallest)
    if discriminant_deficit >= 1.0:
        raise OutOfRange
    return 2.0 * shortfall / (1.0 + math.sqrt(1.0 - discriminant_deficit))
