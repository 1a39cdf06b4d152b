"""Rotors: speeds behind the motors, thrust, moment and gyroscopic torque (1), Appendix A."""

from typing import NamedTuple

from dssc_jax.core.numerics import dot, is_zero, root_abs
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.uav.vehicle import Rotor, Vehicle


class RotorMotion(NamedTuple):
    """Speeds |thetadot_i| [rad/s] and their rates [rad/s^2]; without a motor lag the rates are not modelled: ()."""

    speeds: tuple[Scalar, ...]
    accelerations: tuple[Scalar, ...]


def rotor_motion(
    vehicle: Vehicle, thrusts: tuple[Scalar, ...], thrust_coefficients: tuple[Scalar, ...], speeds: tuple[Scalar, ...]
) -> RotorMotion:
    """The motion of the rotors under commanded thrusts.

    Without a motor lag the rotors turn at the commanded speeds at once. With a lag, their speeds are states, which
    approach the commanded speeds.

    Args:
        vehicle: The vehicle, with the motor lag or without one.
        thrusts: Commanded thrusts f_i [N].
        thrust_coefficients: k_T of each rotor with which the software turns thrusts into speeds [N s^2/rad^2].
        speeds: Present speeds of rotors with a lag [rad/s]; without a lag they are not used.
    """
    commanded = tuple(root_abs(f / k) for f, k in zip(thrusts, thrust_coefficients, strict=True))
    if vehicle.motor_lag is None:
        return RotorMotion(commanded, ())
    accelerations = tuple((c - w) / vehicle.motor_lag for c, w in zip(commanded, speeds, strict=True))
    return RotorMotion(speeds, accelerations)


class Wrench(NamedTuple):
    """Force and moment of all rotors in body axes, which the rotors give or which an inner loop demands.

    Args:
        thrust: Force along body z [N].
        moment: Moment [N m].
        across: Force along body x and y [N]; () where all rotors point along z, and in the demand of an inner loop.
    """

    thrust: Scalar
    moment: Vec3
    across: tuple[Scalar, ...] = ()


def wrench(vehicle: Vehicle, thrusts: tuple[Scalar, ...]) -> Wrench:
    """The net force and moment of all rotors: sum f_i a_i, and sum p_i x (f_i a_i) + s_i c_tau,i f_i a_i.

    Rotor i has the thrust f_i along the axis a_i, the place p_i, the sign s_i of the drag torque and the torque over
    thrust c_tau,i. Rotors on a circle have a_i = e3.

    Args:
        vehicle: The rotors.
        thrusts: f_i of each rotor [N].
    """
    if not vehicle.rotor:
        return circle_wrench(vehicle, thrusts)
    rows = [rotor_wrench(rotor, c) for rotor, c in zip(vehicle.rotor, vehicle.torque_coefficients, strict=True)]
    columns = zip(*rows, strict=True)
    x, y, z, *moments = (dot(column, thrusts) for column in columns)
    are_upright = all(is_zero(row[0]) and is_zero(row[1]) for row in rows)
    return Wrench(z, Vec3(*moments), () if are_upright else (x, y))


def rotor_wrench(rotor: Rotor, torque_coefficient: Scalar) -> tuple[Scalar, ...]:
    """Force and moment of a rotor per thrust, in body axes: F_x, F_y, F_z [1], M_x, M_y, M_z [m].

    Args:
        rotor: Place, axis and turning direction of the rotor.
        torque_coefficient: Its torque over thrust c_tau [m].
    """
    axis = rotor.unit_axis
    lever_moment = Vec3(*rotor.position).cross(axis)
    drag_torque = axis * (rotor.direction * torque_coefficient)
    return (*axis, *(lever_moment + drag_torque))


def circle_wrench(vehicle: Vehicle, thrusts: tuple[Scalar, ...]) -> Wrench:
    """Net thrust f = sum f_i [N] and moment [N m] of rotors on a circle.

    With the places p_bi of the rotors the moment is M = sum p_bi x (f_i e3) + e3 sum s_i c_tau f_i.

    Args:
        vehicle: The rotors.
        thrusts: f_i of each rotor [N].
    """
    x, y = vehicle.directions()
    ones = (1.0,) * vehicle.rotors
    moment = Vec3(dot(y, thrusts), -dot(x, thrusts), 0.0) * vehicle.arm
    net_thrust = dot(ones, thrusts)
    drag_torque = vehicle.torque_coefficient * dot(vehicle.spins, thrusts)
    return Wrench(net_thrust, moment._replace(z=drag_torque))


def gyroscopic_torque(rate: Vec3, rotor_inertia: Scalar, spin: Scalar, spin_up: Scalar) -> Vec3:
    """The torque of spinning rotors with vertical axes on the body, tau_dist = -d/dt(h e3) - Omega x (h e3) [N m].

    h = I_z sum thetadot_i is the rotors' angular momentum about body z. The article prints the opposite sign; with
    s_i = -sgn(thetadot_i) only the sign used here conserves R (J Omega + h e3).

    Args:
        rate: Body rate Omega [rad/s].
        rotor_inertia: Axial inertia I_z of a hub [kg m^2].
        spin: sum thetadot_i, signed [rad/s].
        spin_up: sum thetaddot_i, signed [rad/s^2].
    """
    h = rotor_inertia * spin
    return Vec3(-h * rate.y, h * rate.x, -rotor_inertia * spin_up)


def rotor_torque(vehicle: Vehicle, rate: Vec3, motion: RotorMotion) -> Vec3:
    """The gyroscopic torque of all rotors [N m], for axes of any direction.

    The angular momentum of rotor i is h_i = I_z thetadot_i a_i with thetadot_i = -s_i |thetadot_i|.

    Args:
        vehicle: The rotors and their axial inertia I_z.
        rate: Body rate Omega [rad/s].
        motion: Speeds and their rates.
    """
    if not vehicle.rotor:
        spin_up = -dot(vehicle.spins, motion.accelerations) if motion.accelerations else 0.0
        return gyroscopic_torque(rate, vehicle.rotor_inertia_z, -dot(vehicle.spins, motion.speeds), spin_up)
    momentum = angular_momentum(vehicle, motion.speeds)
    torque = -rate.cross(momentum)
    if not motion.accelerations:  # (): without a motor lag
        return torque
    return torque - angular_momentum(vehicle, motion.accelerations)


def angular_momentum(vehicle: Vehicle, speeds: tuple[Scalar, ...]) -> Vec3:
    """The angular momentum I_z sum thetadot_i a_i of all rotors, body axes [kg m^2/s].

    Args:
        vehicle: The rotors.
        speeds: |thetadot_i| of each rotor [rad/s]. With the rates of the speeds [rad/s^2] in their place, the result is
            the rate of change of the angular momentum.
    """
    axes = [rotor.unit_axis * -rotor.direction for rotor in vehicle.rotor]
    columns = zip(*axes, strict=True)  # the x, y and z of all axes
    return Vec3(*(dot(column, speeds) for column in columns)) * vehicle.rotor_inertia_z
