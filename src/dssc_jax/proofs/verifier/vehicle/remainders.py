"""The map from bounds of the signals to bounds of the remainders, the vehicle's deviations from its linear channels.

Every number is rounded up. docs/vehicle_proofs.md has the formulas in this order, and the meaning of the symbols.
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


class Remainders(NamedTuple):
    """Bounds of what the vehicle deviates by from its linear channels.

    Args:
        channels: Bounds of the remainders, by channel and name.
        constant: Bound of the constant o of the channel z [m/s^2].
        tilt: Bound of the tilt [rad].
        rotors: Bounds of the rotors' thrusts and speeds.
        shortfall: d, of how far a thrust is behind its command [N]; 0 without a rotor lag.
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
    """(V3) Bounds of the remainders under bounds of the signals; with a moving reference without their known parts.

    Args:
        problem: The certificate's problem.
        ranges: Numbers that follow from its intervals.
        bounds: Bounds of the signals.
        dampings: Damping of drag c in the linear channels of x and z [1/s].
        earlier: Remainders in the time cell before; None in the first one.
        coupling: Bounds of the signals that couple the channels, with a moving reference; then there is no rotor lag.

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
        plane, yaw = torques_without_lag(problem, ranges, bounds, attitude, drag, coupling)
    else:
        plane, yaw = torques_with_lag(problem, ranges, bounds, attitude, drag, lag)
    channels = {
        "x": {"force": plane_force(ranges, attitude, drag, coupling)} | plane,
        "z": vertical_remainders(problem, ranges, attitude, drag, lag),
        "psi": yaw,
    }
    constant = (ranges.thrust_deviation * ranges.gravity).upper()
    return Remainders(channels, constant, attitude.tilt, rotors, lag.shortfall)


def plane_force(ranges: Ranges, attitude: Attitude, drag: DragBounds, coupling: Coupling | None) -> arb:
    """The remainder ``force`` of x and y: lift, a deviating thrust, and drag [m/s^2]."""
    g = ranges.gravity
    k = ranges.thrust_deviation
    s = attitude.tilt
    thrust_force = (1 + k) * g * s * (attitude.secant - 1) + k * g * s + k * attitude.achieved_lift * attitude.tangent
    force = thrust_force + drag.drag_h + drag.tilted_h + lift_force(ranges, attitude, coupling)
    return force.upper()


def lift_force(ranges: Ranges, attitude: Attitude, coupling: Coupling | None) -> arb:
    """Bound of the horizontal force over mass of the lift q on a tilted vehicle, q beta [m/s^2].

    With a moving reference its known part z_m'' alpha_0/g is left out.
    """
    if coupling is None:
        return attitude.achieved_lift * attitude.tangent
    gap_force = (coupling.lift * ranges.gravity * attitude.tilt + coupling.lift_known * coupling.alpha) / ranges.gravity
    return attitude.achieved_lift * attitude.tilt * (attitude.secant - 1) + gap_force


def vertical_remainders(
    problem: VehicleProblem, ranges: Ranges, attitude: Attitude, drag: DragBounds, lag: RotorLag
) -> Balls:
    """The remainders of z: ``force`` [m/s^2] and, with a rotor lag, ``lag`` [m/s^3]."""
    force = ranges.thrust_deviation * attitude.achieved_lift + drag.drag_z + drag.tilted_z
    remainders = {"force": force.upper()}
    if problem["rotor_lag"] > 0:
        lift_defect = arb(problem["rotors"]) * lag.defect / arb(problem["believed_mass"])
        turn_of_thrust = (ranges.gravity + attitude.achieved_lift) * attitude.tangent * attitude.euler_rate
        remainders["lag"] = (lift_defect + turn_of_thrust).upper()
    return remainders


def coupled_torque(
    problem: VehicleProblem, ranges: Ranges, bounds: SignalBalls, attitude: Attitude, coupling: Coupling | None
) -> arb:
    """Bound of a_0 g r_2, by a desired tilt that is not linear, and of a_1 psi' Q alpha, by the turn of the plane.

    With a moving reference their known parts are left out.
    """
    g = ranges.gravity
    stiffness = arb(problem["stiffness"])
    damping = arb(problem["damping"])
    if coupling is None:
        return stiffness * g * attitude.tilt_defect + g * damping * attitude.yaw_rate * attitude.tilt
    demand = bounds["x"]["wanted"]
    desired_tangent = demand / (g - attitude.lift)
    tilt_term = g * desired_tangent**3 / 3 + attitude.lift * attitude.lift * desired_tangent / g
    lift_term = (coupling.lift * demand + coupling.lift_known * coupling.wanted) / g
    yaw_term = coupling.yaw * g * attitude.tilt + coupling.yaw_known * coupling.alpha
    return stiffness * (tilt_term + lift_term) + damping * yaw_term


def torques_without_lag(
    problem: VehicleProblem,
    ranges: Ranges,
    bounds: SignalBalls,
    attitude: Attitude,
    drag: DragBounds,
    coupling: Coupling | None,
) -> tuple[Balls, Balls]:
    """The remainders ``torque`` of x and y and of psi, without a rotor lag.

    m_h and m_z bound what the angular acceleration across and along body z deviates by [rad/s^2].
    """
    s, t, psi_1 = attitude.tilt, attitude.tangent, attitude.yaw_rate
    tilt_demand, yaw_demand = attitude.tilt_demand, attitude.yaw_demand
    rate_h, rate_z = attitude.rate_h, attitude.rate_z
    m_h = tilt_demand + s * yaw_demand + attitude.frame_h + ranges.sum_ratio_h * rate_h * rate_z
    m_z = yaw_demand + s * tilt_demand + attitude.frame_z + ranges.sum_ratio_z * rate_h * rate_h / 2
    m_h = ranges.turn_deviation * m_h + drag.torque_h
    m_z = ranges.turn_deviation * m_z + drag.torque_z
    yaw = (t * m_h + attitude.secant * m_z).upper()
    turn = (yaw_demand + yaw) * s + 2 * psi_1 * attitude.tilt_rate + psi_1 * psi_1 * s
    turn = turn + (1 + s * t) * m_h + t * m_z
    plane = ranges.gravity * turn + coupled_torque(problem, ranges, bounds, attitude, coupling)
    return {"torque": plane.upper()}, {"torque": yaw}


def torques_with_lag(
    problem: VehicleProblem, ranges: Ranges, bounds: SignalBalls, attitude: Attitude, drag: DragBounds, lag: RotorLag
) -> tuple[Balls, Balls]:
    """The remainders ``torque`` and ``lag`` of x and y and of psi, with a rotor lag.

    mu_h and mu_z bound the believed angular acceleration that the rotors achieve, m_h and m_z what the true one
    deviates by, across and along body z [rad/s^2].
    """
    s, t, psi_1 = attitude.tilt, attitude.tangent, attitude.yaw_rate
    g = ranges.gravity
    time_constant = arb(problem["rotor_lag"])
    rate_h, rate_z = attitude.rate_h, attitude.rate_z
    mu_h = (bounds["x"]["gamma"] / g).upper()
    mu_z = bounds["psi"]["gamma"]
    m_h = ranges.turn_deviation * mu_h + drag.torque_h + ranges.ratio_h * rate_h * rate_z + attitude.frame_h
    m_z = ranges.turn_deviation * mu_z + drag.torque_z + ranges.ratio_z * rate_h * rate_h / 2 + attitude.frame_z
    yaw = (t * mu_h + (attitude.secant - 1) * mu_z + t * m_h + attitude.secant * m_z).upper()
    turn = (mu_z + yaw) * s + 2 * psi_1 * attitude.tilt_rate + psi_1 * psi_1 * s
    turn = turn + s * t * mu_h + t * mu_z + (1 + s * t) * m_h + t * m_z
    half_defect = arb(problem["rotors"]) * lag.defect / 2
    arm_term = g * arb(problem["arm"]) * half_defect / ranges.believed_least
    plane = {
        "torque": (g * turn).upper(),
        "lag": (lag.moment_h / time_constant + psi_1 * bounds["x"]["gamma"] + arm_term).upper(),
    }
    spin_term = arb(problem["torque_coefficient"]) * half_defect / ranges.believed_z
    return plane, {"torque": yaw, "lag": (lag.moment_z / time_constant + spin_term).upper()}
