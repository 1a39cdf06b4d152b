"""Remainders: the vehicle's deviations from its linear channels, under bounds of its signals, in floating point.

The formulas are those of docs/vehicle_proofs.md, in their order.
"""

from dataclasses import dataclass

from dssc_jax.proofs.search.vehicle.attitude import Attitude, Signals, attitude_of
from dssc_jax.proofs.search.vehicle.channels import GRAVITY
from dssc_jax.proofs.search.vehicle.drag import DragBounds, drag_of
from dssc_jax.proofs.search.vehicle.rotors import Moments, Rotors, inertia_ratios, moments_of, rotors_of
from dssc_jax.proofs.vehicle_problem import VehicleProblem


@dataclass(frozen=True)
class Couplings:
    """Bounds of the signals by which the channels of a moving vehicle are coupled.

    Args:
        alpha_gap: Bound of |alpha - alpha_0| [m/s^2].
        wanted_gap: Bound of |a_h - alpha_0| [m/s^2].
        lift_gap: Bound of |a_z - z_m''| [m/s^2].
        yaw_gap: Bound of |psi' - psi_m'| [rad/s].
        lift: Bound of |z_m''| [m/s^2].
        yaw: Bound of |psi_m'| [rad/s].
    """

    alpha_gap: float
    wanted_gap: float
    lift_gap: float
    yaw_gap: float
    lift: float
    yaw: float


def remainders_of(
    problem: VehicleProblem,
    bounds: Signals,
    damping: tuple[float, float],
    earlier: Rotors | None = None,
    couplings: Couplings | None = None,
) -> tuple[Signals, Rotors]:
    """Bounds of the remainders, by channel and name, and of the rotors, under bounds of the signals.

    Args:
        problem: The vehicle.
        bounds: Bounds of the signals, in a cell of time.
        damping: Damping of drag in the plane and along z [1/s].
        earlier: The rotors in the cells before; None in the first one.
        couplings: Bounds of the couplings; None: the problem has no moving reference.

    Raises:
        OutOfRange: The vehicle may leave the range of the theorem.
    """
    attitude = attitude_of(problem, bounds)
    moments = moments_of(problem, attitude)
    rotors = rotors_of(problem, bounds, attitude, moments, earlier)
    drag = drag_of(problem, bounds, attitude, rotors, damping)
    if problem.rotor_lag:
        torque_x, torque_psi = torques_with_lag(problem, bounds, attitude, drag)
    else:
        torque_x, torque_psi = torques_without_lag(problem, bounds, attitude, drag, couplings)
    remainders = {
        "x": {"force": plane_force(problem, attitude, drag, couplings), "torque": torque_x},
        "z": {"force": problem.thrust_deviation * attitude.achieved_lift + drag.vertical},
        "psi": {"torque": torque_psi},
    }
    if problem.rotor_lag:
        for name, lag_remainder in lag_remainders(problem, bounds, attitude, moments, rotors).items():
            remainders[name]["lag"] = lag_remainder
    return remainders, rotors


def plane_force(problem: VehicleProblem, attitude: Attitude, drag: DragBounds, couplings: Couplings | None) -> float:
    """The remainder ``force`` of x and y: lift, a deviating thrust, and drag [m/s^2]."""
    k = problem.thrust_deviation
    tilt_force = (1.0 + k) * GRAVITY * attitude.tilt * (attitude.secant - 1.0)
    force = tilt_force + k * attitude.achieved_lift * attitude.tangent
    force += lift_force(attitude, couplings)
    return force + k * GRAVITY * attitude.tilt + drag.plane


def lift_force(attitude: Attitude, couplings: Couplings | None) -> float:
    """Bound of the horizontal force over mass of the lift on a tilted vehicle, without its known part [m/s^2]."""
    if couplings is None:
        return attitude.achieved_lift * attitude.tangent
    gap_force = couplings.lift_gap * GRAVITY * attitude.tilt + couplings.lift * couplings.alpha_gap
    return attitude.achieved_lift * attitude.tilt * (attitude.secant - 1.0) + gap_force / GRAVITY


def lag_remainders(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, moments: Moments, rotors: Rotors
) -> dict[str, float]:
    """The remainders ``lag`` by channel, with a rotor lag: what a thrust's slope has besides that of a linear lag."""
    j_x, j_y, j_z = problem.believed_inertia
    n = problem.rotors
    arm_term = GRAVITY * problem.arm * n * rotors.defect / (2.0 * min(j_x, j_y))
    turn_of_thrust = (GRAVITY + attitude.achieved_lift) * attitude.tangent * attitude.euler_rate
    spin_term = problem.torque_coefficient * n * rotors.defect / (2.0 * j_z)
    return {
        "x": moments.plane / problem.rotor_lag + attitude.yaw_rate * bounds["x"]["gamma"] + arm_term,
        "z": n * rotors.defect / problem.believed_mass + turn_of_thrust,
        "psi": moments.yaw / problem.rotor_lag + spin_term,
    }


def turn_of_plane(attitude: Attitude, yaw_acceleration: float) -> float:
    """Bound of the part of b'' that comes from the turn of the plane by psi [rad/s^2]."""
    s = attitude.tilt
    return yaw_acceleration * s + 2.0 * attitude.yaw_rate * attitude.tilt_rate + attitude.yaw_rate**2 * s


def coupled_torque(problem: VehicleProblem, bounds: Signals, attitude: Attitude, couplings: Couplings | None) -> float:
    """Bound of a_0 g r_2, by a desired tilt that is not linear, and of a_1 psi' Q alpha, by the turn of the plane.

    With a moving reference their known parts are left out.
    """
    a_0, a_1 = problem.stiffness, problem.damping
    if couplings is None:
        return a_0 * GRAVITY * attitude.tilt_defect + GRAVITY * a_1 * attitude.yaw_rate * attitude.tilt
    demand = bounds["x"]["wanted"]
    desired_tangent = demand / (GRAVITY - attitude.lift)
    tilt_term = GRAVITY * desired_tangent**3 / 3.0 + attitude.lift**2 * desired_tangent / GRAVITY
    lift_term = (couplings.lift_gap * demand + couplings.lift * couplings.wanted_gap) / GRAVITY
    yaw_term = couplings.yaw_gap * GRAVITY * attitude.tilt + couplings.yaw * couplings.alpha_gap
    return a_0 * (tilt_term + lift_term) + a_1 * yaw_term


def torques_without_lag(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, drag: DragBounds, couplings: Couplings | None
) -> tuple[float, float]:
    """The remainders ``torque`` of x and y and of psi, without a rotor lag.

    m_h and m_z bound what the angular acceleration across and along body z deviates by [rad/s^2].
    """
    delta = problem.turn_deviation
    s, t = attitude.tilt, attitude.tangent
    tilt_demand, yaw_demand = attitude.tilt_demand, attitude.yaw_demand
    rate_h, rate_z = attitude.rate_h, attitude.rate_z
    x, y, z = problem.inertia
    l_h = max((z[1] + y[1]) / x[0], (z[1] + x[1]) / y[0])
    l_z = (x[1] + y[1]) / z[0]
    m_h = delta * (tilt_demand + s * yaw_demand + attitude.frame_h + l_h * rate_h * rate_z) + drag.torque_h
    m_z = delta * (yaw_demand + s * tilt_demand + attitude.frame_z + l_z * rate_h**2 / 2.0) + drag.torque_z
    yaw = t * m_h + attitude.secant * m_z
    plane = GRAVITY * (turn_of_plane(attitude, yaw_demand + yaw) + (1.0 + s * t) * m_h + t * m_z)
    return plane + coupled_torque(problem, bounds, attitude, couplings), yaw


def torques_with_lag(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, drag: DragBounds
) -> tuple[float, float]:
    """The remainders ``torque`` of x and y and of psi, with a rotor lag.

    mu_h and mu_z bound the believed angular acceleration that the rotors achieve, m_h and m_z what the true one
    deviates by, across and along body z [rad/s^2].
    """
    delta = problem.turn_deviation
    s, t = attitude.tilt, attitude.tangent
    rate_h, rate_z = attitude.rate_h, attitude.rate_z
    i_h, i_z = inertia_ratios(problem.inertia)
    mu_h = bounds["x"]["gamma"] / GRAVITY
    mu_z = bounds["psi"]["gamma"]
    m_h = delta * mu_h + drag.torque_h + i_h * rate_h * rate_z + attitude.frame_h
    m_z = delta * mu_z + drag.torque_z + i_z * rate_h**2 / 2.0 + attitude.frame_z
    yaw = t * mu_h + (attitude.secant - 1.0) * mu_z + t * m_h + attitude.secant * m_z
    turn = turn_of_plane(attitude, mu_z + yaw) + s * t * mu_h + t * mu_z
    return GRAVITY * (turn + (1.0 + s * t) * m_h + t * m_z), yaw
