"""Bounds of the remainders, the differences of the vehicle from its linear channels, from bounds of its signals.

Every number is rounded up. docs/vehicle_proofs.md has the formulas in the same order; comments give the symbols.
"""

from collections.abc import Mapping
from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls
from dssc_jax.proofs.verifier.vehicle.attitude import Attitude, attitude_of
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import SignalBalls
from dssc_jax.proofs.verifier.vehicle.drag import DragBounds, drag_of
from dssc_jax.proofs.verifier.vehicle.flight import Coupling
from dssc_jax.proofs.verifier.vehicle.ranges import Ranges
from dssc_jax.proofs.verifier.vehicle.rotors import RotorLag, Rotors, rotor_lag_of, rotors_of


class TurningRemainders(NamedTuple):
    """Bounds of the remainders of the vehicle's turns: ``torque`` and, with a rotor lag, ``lag``.

    Args:
        plane: x.torque [m/s^2] and x.lag [m/s^3], by name.
        yaw: psi.torque [rad/s^2] and psi.lag [rad/s^3], by name.
    """

    plane: Balls
    yaw: Balls


class Remainders(NamedTuple):
    """Bounds of the remainders, and those of the tilt and the rotors from which they follow.

    Args:
        channels: Bounds of the remainders ``force``, ``torque`` and ``lag``, by channel and name.
        constant: k g, bound of the constant o of the channel z [m/s^2].
        tilt: beta, bound of the tilt [rad].
        rotors: Bounds of the rotors' thrusts and speeds.
        shortfall: d, bound of the difference of a thrust from its command [N]; 0 without a rotor lag.
    """

    channels: dict[str, Balls]
    constant: arb
    tilt: arb
    rotors: Rotors
    shortfall: arb


def remainders_of(
    problem: VehicleProblem,
    ranges: Ranges,
    bounds: SignalBalls,
    dampings: Mapping[str, float],
    earlier: Remainders | None = None,
    coupling: Coupling | None = None,
) -> Remainders:
    """(V3) Bounds of the remainders, without their known parts, while the signals stay within their bounds.

    Args:
        problem: The certificate's problem.
        ranges: Extremes over the problem's intervals.
        bounds: Bounds of the signals by which the vehicle's body moves, by channel and name.
        dampings: c, the damping by drag in the linear channels of x and z [1/s].
        earlier: Remainders in the time cell before; None in the first one.
        coupling: Bounds of a moving vehicle's distances from the motion that its reference needs; such a vehicle has no
            rotor lag. None: the vehicle hovers, and no part of the remainders is known.

    Raises:
        Rejected: The vehicle may leave the range of the theorem.
    """
    attitude = attitude_of(problem, ranges, bounds)
    earlier_rotors = None if earlier is None else earlier.rotors
    earlier_shortfall = None if earlier is None else earlier.shortfall
    rotors = rotors_of(problem, ranges, attitude, earlier_rotors)
    lag = rotor_lag_of(problem, ranges, bounds, attitude, rotors, earlier_shortfall)
    drag = drag_of(problem, ranges, bounds, dampings, attitude, rotors, lag)
    if problem["rotor_lag"] == 0:
        turning = torques_without_lag(problem, ranges, bounds, attitude, drag, coupling)
    else:
        turning = torques_with_lag(problem, ranges, bounds, attitude, drag, lag)
    channels = {
        "x": {"force": plane_force(ranges, attitude, drag, coupling)} | turning.plane,
        "z": vertical_remainders(problem, ranges, attitude, drag, lag),
        "psi": turning.yaw,
    }
    constant = (ranges.thrust_deviation * ranges.gravity).upper()
    return Remainders(channels, constant, attitude.tilt, rotors, lag.shortfall)


def plane_force(ranges: Ranges, attitude: Attitude, drag: DragBounds, coupling: Coupling | None) -> arb:
    """x.force, bound of |p_h'' - (alpha - c v)| [m/s^2]: the effects of a large tilt, of lift, thrust and drag.

    A known part of a moving vehicle, by :func:`lift_force`, is left out.
    """
    g = ranges.gravity
    k = ranges.thrust_deviation  # the largest |kappa - 1|
    s = attitude.tilt
    thrust_force = (1 + k) * g * s * (attitude.secant - 1) + k * g * s + k * attitude.achieved_lift * attitude.tangent
    force = thrust_force + drag.drag_h + drag.tilted_h + lift_force(ranges, attitude, coupling)
    return force.upper()


def lift_force(ranges: Ranges, attitude: Attitude, coupling: Coupling | None) -> arb:
    """Bound of |q beta|, the horizontal force over mass of the lift q on a tilted vehicle [m/s^2].

    For a moving vehicle the known part is subtracted: the result bounds |q beta - z_m'' alpha_0/g|.
    """
    if coupling is None:
        return attitude.achieved_lift * attitude.tangent  # Q t
    gap_force = (
        coupling.lift_gap * ranges.gravity * attitude.tilt + coupling.lift * coupling.alpha_gap
    ) / ranges.gravity
    return attitude.achieved_lift * attitude.tilt * (attitude.secant - 1) + gap_force


def vertical_remainders(
    problem: VehicleProblem, ranges: Ranges, attitude: Attitude, drag: DragBounds, lag: RotorLag
) -> Balls:
    """Bounds of the remainders of z: ``force`` [m/s^2] and, with a rotor lag, ``lag`` [m/s^3].

    ``force`` bounds |z'' - (q - c e' + o)|, and ``lag`` bounds |q' - (a_z - q)/tau|, where q is the achieved lift and
    a_z the wanted one.
    """
    force = ranges.thrust_deviation * attitude.achieved_lift + drag.drag_z + drag.tilted_z
    remainders = {"force": force.upper()}
    if problem["rotor_lag"] > 0:
        lift_defect = arb(problem["rotors"]) * lag.defect / arb(problem["believed_mass"])  # n zeta/M_n
        thrust = ranges.gravity + attitude.achieved_lift  # g + Q
        turn_of_thrust = thrust * attitude.tangent * attitude.euler_rate
        remainders["lag"] = (lift_defect + turn_of_thrust).upper()
    return remainders


def coupled_torque(
    problem: VehicleProblem, ranges: Ranges, bounds: SignalBalls, attitude: Attitude, coupling: Coupling | None
) -> arb:
    """Bound of |a_0 g (b_d - a_h/g)| + |a_1 psi' K alpha| [m/s^2], without the known parts of a moving vehicle.

    The first term comes from the nonlinear law of the desired tilt b_d, the second from the turn of the plane by yaw,
    where K is a quarter turn.

    Args:
        problem: The certificate's problem.
        ranges: Extremes over the problem's intervals.
        bounds: Bounds of the vehicle's signals; only those of x are used, and only with a coupling.
        attitude: Bounds of the attitude.
        coupling: Bounds of the couplings; None: the vehicle hovers.
    """
    g = ranges.gravity
    stiffness = arb(problem["stiffness"])
    damping = arb(problem["damping"])
    if coupling is None:
        return stiffness * g * attitude.tilt_defect + g * damping * attitude.yaw_rate * attitude.tilt
    demand = bounds["x"]["wanted"]  # A_h
    desired_tangent = demand / (g - attitude.lift)  # t_d
    tilt_term = g * desired_tangent**3 / 3 + attitude.lift * attitude.lift * desired_tangent / g
    lift_term = (coupling.lift_gap * demand + coupling.lift * coupling.wanted_gap) / g
    yaw_term = coupling.yaw_gap * g * attitude.tilt + coupling.yaw * coupling.alpha_gap
    return stiffness * (tilt_term + lift_term) + damping * yaw_term


def torques_without_lag(
    problem: VehicleProblem,
    ranges: Ranges,
    bounds: SignalBalls,
    attitude: Attitude,
    drag: DragBounds,
    coupling: Coupling | None,
) -> TurningRemainders:
    """Bounds of x.torque and psi.torque without a rotor lag.

    m_h and m_z bound the difference of the body's angular acceleration from the wanted one, across and along body z
    [rad/s^2].

    Args:
        problem: The certificate's problem.
        ranges: Extremes over the problem's intervals.
        bounds: Bounds of the vehicle's signals.
        attitude: Bounds of the attitude.
        drag: Bounds of the drag and of its torques.
        coupling: Bounds of the couplings; None: the vehicle hovers.
    """
    s = attitude.tilt
    t = attitude.tangent
    tilt_demand = attitude.tilt_demand
    yaw_demand = attitude.yaw_demand
    rate_h = attitude.rate_h
    rate_z = attitude.rate_z
    turning_h = tilt_demand + s * yaw_demand + attitude.frame_h + ranges.sum_ratio_h * rate_h * rate_z
    turning_z = yaw_demand + s * tilt_demand + attitude.frame_z + ranges.sum_ratio_z * rate_h * rate_h / 2
    m_h = ranges.turn_deviation * turning_h + drag.torque_h
    m_z = ranges.turn_deviation * turning_z + drag.torque_z
    yaw = (t * m_h + attitude.secant * m_z).upper()  # psi.torque
    turn = turn_of_plane(attitude, yaw_acceleration=yaw_demand + yaw)  # psi_2 = H_psi + psi.torque
    turn = turn + (1 + s * t) * m_h + t * m_z
    plane = ranges.gravity * turn + coupled_torque(problem, ranges, bounds, attitude, coupling)
    return TurningRemainders(plane={"torque": plane.upper()}, yaw={"torque": yaw})


def torques_with_lag(
    problem: VehicleProblem, ranges: Ranges, bounds: SignalBalls, attitude: Attitude, drag: DragBounds, lag: RotorLag
) -> TurningRemainders:
    """Bounds of the remainders ``torque`` and ``lag`` of x and psi with a rotor lag.

    mu is the angular acceleration that the inner loops believe the rotors to achieve; mu_h and mu_z bound it. m_h and
    m_z bound the difference of the body's true angular acceleration from mu. The index h stands for the part across
    body z, the index z for the part along it [rad/s^2].

    Args:
        problem: The certificate's problem.
        ranges: Extremes over the problem's intervals.
        bounds: Bounds of the vehicle's signals.
        attitude: Bounds of the attitude.
        drag: Bounds of the drag and of its torques.
        lag: Bounds of the rotors' lag behind their commands.
    """
    s = attitude.tilt
    t = attitude.tangent
    g = ranges.gravity
    time_constant = arb(problem["rotor_lag"])
    rate_h = attitude.rate_h
    rate_z = attitude.rate_z
    mu_h = (bounds["x"]["gamma"] / g).upper()
    mu_z = bounds["psi"]["gamma"]
    m_h = ranges.turn_deviation * mu_h + drag.torque_h + ranges.ratio_h * rate_h * rate_z + attitude.frame_h
    m_z = ranges.turn_deviation * mu_z + drag.torque_z + ranges.ratio_z * rate_h * rate_h / 2 + attitude.frame_z
    yaw = (t * mu_h + (attitude.secant - 1) * mu_z + t * m_h + attitude.secant * m_z).upper()  # psi.torque
    turn = turn_of_plane(attitude, yaw_acceleration=mu_z + yaw)  # psi_2 = mu_z + psi.torque
    turn = turn + s * t * mu_h + t * mu_z + (1 + s * t) * m_h + t * m_z
    half_defect = arb(problem["rotors"]) * lag.defect / 2  # n zeta/2
    arm_term = g * arb(problem["arm"]) * half_defect / ranges.believed_least  # g L n zeta/(2 J_nl)
    turn_term = attitude.yaw_rate * bounds["x"]["gamma"]  # psi_1 Y[x.gamma]
    spin_term = arb(problem["torque_coefficient"]) * half_defect / ranges.believed_z  # c_tau n zeta/(2 J_nz)
    plane_lag = lag.moment_h / time_constant + turn_term + arm_term
    yaw_lag = lag.moment_z / time_constant + spin_term
    return TurningRemainders(
        plane={"torque": (g * turn).upper(), "lag": plane_lag.upper()},
        yaw={"torque": yaw, "lag": yaw_lag.upper()},
    )


def turn_of_plane(attitude: Attitude, yaw_acceleration: arb) -> arb:
    """Bound of |psi'' K b + 2 psi' K b' + psi'^2 b| [rad/s^2], the part of b'' that the turn of the plane causes.

    Args:
        attitude: Bounds of the attitude.
        yaw_acceleration: psi_2, bound of |psi''| [rad/s^2].
    """
    s = attitude.tilt
    psi_1 = attitude.yaw_rate
    return yaw_acceleration * s + 2 * psi_1 * attitude.tilt_rate + psi_1 * psi_1 * s
