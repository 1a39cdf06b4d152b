"""Bounds of the remainders, the differences of the vehicle from its linear channels, in floating point.

docs/vehicle_proofs.md has the formulas in the same order; comments give the symbols.
"""

from dataclasses import dataclass
from typing import NamedTuple

from dssc_jax.proofs.search.vehicle.attitude import Attitude, Signals, attitude_of
from dssc_jax.proofs.search.vehicle.channels import GRAVITY, Damping
from dssc_jax.proofs.search.vehicle.drag import DragBounds, drag_of
from dssc_jax.proofs.search.vehicle.rotors import Moments, Rotors, gyroscopic_factors, moments_of, rotors_of
from dssc_jax.proofs.vehicle_problem import VehicleProblem


@dataclass(frozen=True)
class Couplings:
    """Bounds of a moving vehicle's distances from the motion that its reference needs; they couple the channels.

    alpha_0 = y_m'' + c y_m' is the alpha that the reference needs in the plane.

    Args:
        alpha_gap: G_alpha, bound of |alpha - alpha_0| [m/s^2].
        wanted_gap: G_a, bound of |a_h - alpha_0| [m/s^2].
        lift_gap: G_z, bound of |a_z - z_m''| [m/s^2].
        yaw_gap: G_psi, bound of |psi' - psi_m'| [rad/s].
        lift: A_m, bound of |z_m''| [m/s^2].
        yaw: Psi_m, bound of |psi_m'| [rad/s].
    """

    alpha_gap: float
    wanted_gap: float
    lift_gap: float
    yaw_gap: float
    lift: float
    yaw: float


class Remainders(NamedTuple):
    """Bounds of the remainders, and those of the rotors from which they follow.

    Args:
        channels: Bounds of the remainders ``force``, ``torque`` and ``lag``, by channel and name.
        rotors: Bounds of the rotors.
    """

    channels: Signals
    rotors: Rotors


class Torques(NamedTuple):
    """Bounds of x.torque [m/s^2] and of psi.torque [rad/s^2]."""

    plane: float
    yaw: float


def remainders_of(
    problem: VehicleProblem,
    bounds: Signals,
    damping: Damping,
    earlier_rotors: Rotors | None = None,
    couplings: Couplings | None = None,
) -> Remainders:
    """Bound the remainders and the rotors, while the signals are within their bounds.

    Args:
        problem: The vehicle.
        bounds: Bounds of the signals by which the vehicle's body moves, at all times or in a cell of time.
        damping: Damping by drag.
        earlier_rotors: Bounds of the rotors in the cells before; None in the first one.
        couplings: Bounds of the couplings; None: the vehicle hovers.

    Raises:
        OutOfRange: The vehicle may leave the range of the theorem.
    """
    attitude = attitude_of(problem, bounds)
    moments = moments_of(problem, attitude)
    rotors = rotors_of(problem, bounds, attitude, moments, earlier_rotors)
    drag = drag_of(problem, bounds, attitude, rotors, damping)
    if problem.rotor_lag:  # then the vehicle hovers, and there are no couplings
        torques = torques_with_lag(problem, bounds, attitude, drag)
    else:
        torques = torques_without_lag(problem, bounds, attitude, drag, couplings)
    remainders = {
        "x": {"force": plane_force(problem, attitude, drag, couplings), "torque": torques.plane},
        "z": {"force": problem.thrust_deviation * attitude.achieved_lift + drag.vertical},
        "psi": {"torque": torques.yaw},
    }
    if problem.rotor_lag:
        for name, lag_remainder in lag_remainders(problem, bounds, attitude, moments, rotors).items():
            remainders[name]["lag"] = lag_remainder
    return Remainders(remainders, rotors)


def plane_force(problem: VehicleProblem, attitude: Attitude, drag: DragBounds, couplings: Couplings | None) -> float:
    """x.force, bound of |p_h'' - (alpha - c v)| [m/s^2]: the effects of a large tilt, of lift, thrust and drag.

    A known part of a moving vehicle, by :func:`lift_force`, is left out.
    """
    k = problem.thrust_deviation  # the largest |kappa - 1|
    tilt_force = (1.0 + k) * GRAVITY * attitude.tilt * (attitude.secant - 1.0)  # of beta - b
    force = tilt_force + k * attitude.achieved_lift * attitude.tangent  # k Q t
    force += lift_force(attitude, couplings)
    return force + k * GRAVITY * attitude.tilt + drag.plane


def lift_force(attitude: Attitude, couplings: Couplings | None) -> float:
    """Bound of |q beta|, the horizontal force over mass of the lift q on a tilted vehicle [m/s^2].

    For a moving vehicle the known part is subtracted: the result bounds |q beta - z_m'' alpha_0/g|.
    """
    if couplings is None:
        return attitude.achieved_lift * attitude.tangent  # Q t
    gap_force = couplings.lift_gap * GRAVITY * attitude.tilt + couplings.lift * couplings.alpha_gap
    return attitude.achieved_lift * attitude.tilt * (attitude.secant - 1.0) + gap_force / GRAVITY


def lag_remainders(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, moments: Moments, rotors: Rotors
) -> dict[str, float]:
    """x.lag, z.lag and psi.lag, bounds of the differences of the derivatives of gamma, q and gamma_psi from a lag's.

    The speeds of the rotors have the lag, whereas the linear channels have a lag of the thrusts. ``rotors.defect`` is
    zeta, a bound of the difference that this makes in the derivative of a thrust.

    Args:
        problem: The vehicle, with a rotor lag.
        bounds: Bounds of the vehicle's signals.
        attitude: Bounds of the attitude.
        moments: Bounds of the difference of the commanded angular acceleration from that of the linear channels.
        rotors: Bounds of the rotors.

    Returns:
        The bounds [m/s^3; rad/s^3 in psi], by channel.
    """
    j_x, j_y, j_z = problem.believed_inertia
    n = problem.rotors
    arm_term = GRAVITY * problem.arm * n * rotors.defect / (2.0 * min(j_x, j_y))  # g L n zeta/(2 J_nl)
    turn_of_thrust = (GRAVITY + attitude.achieved_lift) * attitude.tangent * attitude.euler_rate  # (g + Q) t T
    spin_term = problem.torque_coefficient * n * rotors.defect / (2.0 * j_z)  # c_tau n zeta/(2 J_nz)
    return {
        "x": moments.plane / problem.rotor_lag + attitude.yaw_rate * bounds["x"]["gamma"] + arm_term,
        "z": n * rotors.defect / problem.believed_mass + turn_of_thrust,
        "psi": moments.yaw / problem.rotor_lag + spin_term,
    }


def turn_of_plane(attitude: Attitude, yaw_acceleration: float) -> float:
    """Bound of the part of b'' that the turn of the plane by yaw causes, where b is the tilt as a vector [rad/s^2].

    The part is psi'' K b + 2 psi' K b' + psi'^2 b, with K a quarter turn in the plane.

    Args:
        attitude: Bounds of |b|, |b'| and |psi'|: ``tilt``, ``tilt_rate`` and ``yaw_rate``.
        yaw_acceleration: psi_2, bound of |psi''| [rad/s^2].
    """
    by_acceleration = yaw_acceleration * attitude.tilt
    by_rates = 2.0 * attitude.yaw_rate * attitude.tilt_rate
    return by_acceleration + by_rates + attitude.yaw_rate**2 * attitude.tilt


def coupled_torque(problem: VehicleProblem, bounds: Signals, attitude: Attitude, couplings: Couplings | None) -> float:
    """Bound of |a_0 g (b_d - a_h/g)| + |a_1 psi' K alpha| [m/s^2], without the known parts of a moving vehicle.

    The first term comes from the nonlinear law of the desired tilt b_d, the second from the turn of the plane by yaw,
    where K is a quarter turn.

    Args:
        problem: The vehicle.
        bounds: Bounds of the vehicle's signals, used with couplings only.
        attitude: Bounds of the attitude.
        couplings: Bounds of the couplings; None: the vehicle hovers.
    """
    a_0 = problem.stiffness
    a_1 = problem.damping
    if couplings is None:
        return a_0 * GRAVITY * attitude.tilt_defect + GRAVITY * a_1 * attitude.yaw_rate * attitude.tilt
    demand = bounds["x"]["wanted"]  # A_h
    desired_tangent = demand / (GRAVITY - attitude.lift)  # t_d
    tilt_term = GRAVITY * desired_tangent**3 / 3.0 + attitude.lift**2 * desired_tangent / GRAVITY
    lift_term = (couplings.lift_gap * demand + couplings.lift * couplings.wanted_gap) / GRAVITY
    yaw_term = couplings.yaw_gap * GRAVITY * attitude.tilt + couplings.yaw * couplings.alpha_gap
    return a_0 * (tilt_term + lift_term) + a_1 * yaw_term


def torques_without_lag(
    problem: VehicleProblem, bounds: Signals, attitude: Attitude, drag: DragBounds, couplings: Couplings | None
) -> Torques:
    """Bound x.torque and psi.torque without a rotor lag.

    m_h and m_z bound the difference of the body's angular acceleration from the wanted one, across and along body z
    [rad/s^2].

    Args:
        problem: The vehicle.
        bounds: Bounds of the vehicle's signals.
        attitude: Bounds of the attitude.
        drag: Bounds of the drag and of its torques.
        couplings: Bounds of the couplings; None: the vehicle hovers.
    """
    delta = problem.turn_deviation  # the largest |nu_i - 1|
    s = attitude.tilt
    t = attitude.tangent
    tilt_demand = attitude.tilt_demand
    yaw_demand = attitude.yaw_demand
    rate_h = attitude.rate_h
    rate_z = attitude.rate_z
    (x_low, x_high), (y_low, y_high), (z_low, z_high) = problem.inertia
    l_h = max((z_high + y_high) / x_low, (z_high + x_high) / y_low)
    l_z = (x_high + y_high) / z_low
    m_h = delta * (tilt_demand + s * yaw_demand + attitude.frame_h + l_h * rate_h * rate_z) + drag.torque_h
    m_z = delta * (yaw_demand + s * tilt_demand + attitude.frame_z + l_z * rate_h**2 / 2.0) + drag.torque_z
    yaw = t * m_h + attitude.secant * m_z  # psi.torque
    turn = turn_of_plane(attitude, yaw_acceleration=yaw_demand + yaw)  # psi_2 = H_psi + psi.torque
    plane = GRAVITY * (turn + (1.0 + s * t) * m_h + t * m_z)
    return Torques(plane + coupled_torque(problem, bounds, attitude, couplings), yaw)


def torques_with_lag(problem: VehicleProblem, bounds: Signals, attitude: Attitude, drag: DragBounds) -> Torques:
    """Bound x.torque and psi.torque with a rotor lag.

    mu is the angular acceleration that the inner loops believe the rotors to achieve; mu_h and mu_z bound it. m_h and
    m_z bound the difference of the body's true angular acceleration from mu. The index h stands for the part across
    body z, the index z for the part along it [rad/s^2].

    Args:
        problem: The vehicle, with a rotor lag.
        bounds: Bounds of the vehicle's signals.
        attitude: Bounds of the attitude.
        drag: Bounds of the drag and of its torques.
    """
    delta = problem.turn_deviation  # the largest |nu_i - 1|
    s = attitude.tilt
    t = attitude.tangent
    rate_h = attitude.rate_h
    rate_z = attitude.rate_z
    factors = gyroscopic_factors(problem.inertia)
    mu_h = bounds["x"]["gamma"] / GRAVITY
    mu_z = bounds["psi"]["gamma"]
    m_h = delta * mu_h + drag.torque_h + factors.across * rate_h * rate_z + attitude.frame_h
    m_z = delta * mu_z + drag.torque_z + factors.along * rate_h**2 / 2.0 + attitude.frame_z
    yaw = t * mu_h + (attitude.secant - 1.0) * mu_z + t * m_h + attitude.secant * m_z  # psi.torque
    turn = turn_of_plane(attitude, yaw_acceleration=mu_z + yaw) + s * t * mu_h + t * mu_z
    return Torques(GRAVITY * (turn + (1.0 + s * t) * m_h + t * m_z), yaw)
