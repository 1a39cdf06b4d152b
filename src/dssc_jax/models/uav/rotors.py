"""Rotors: speeds behind the motors, thrust, moment and gyroscopic torque (1), Appendix A."""

from typing import NamedTuple

from dssc_jax.core.numerics import dot, root_abs
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.uav.vehicle import Vehicle


class RotorMotion(NamedTuple):
    """Speeds |thetadot_i| [rad/s] and their rates [rad/s^2]; without a motor lag the rates are not modelled: ()."""

    speeds: tuple[Scalar, ...]
    accelerations: tuple[Scalar, ...]


def rotor_motion(
    vehicle: Vehicle, thrusts: tuple[Scalar, ...], thrust_coefficient: Scalar, speeds: tuple[Scalar, ...]
) -> RotorMotion:
    """Speeds of the rotors for commanded thrusts.

    Args:
        vehicle: Motor lag.
        thrusts: Commanded thrusts f_i [N].
        thrust_coefficient: k_T with which the commands are computed [N s^2/rad^2].
        speeds: Speeds of rotors with a lag [rad/s].
    """
    commanded = tuple(root_abs(f / thrust_coefficient) for f in thrusts)
    if vehicle.motor_lag is None:
        return RotorMotion(commanded, ())
    accelerations = tuple((c - w) / vehicle.motor_lag for c, w in zip(commanded, speeds, strict=True))
    return RotorMotion(speeds, accelerations)


def net(vehicle: Vehicle, thrusts: tuple[Scalar, ...]) -> tuple[Scalar, Vec3]:
    """f = sum f_i and M = sum p_bi x (f_i e3) + e3 sum s_i c_tau f_i."""
    x, y = vehicle.directions()
    ones = (1.0,) * vehicle.rotors
    turning = Vec3(dot(y, thrusts), -dot(x, thrusts), 0.0) * vehicle.arm
    return dot(ones, thrusts), turning._replace(z=vehicle.torque_coefficient * dot(vehicle.spins, thrusts))


def gyroscopic_torque(rate: Vec3, rotor_inertia: Scalar, spin: Scalar, spin_up: Scalar) -> Vec3:
    """tau_dist = -d/dt(h e3) - Omega x (h e3) with h = I_z sum thetadot_i [N m].

    The article prints the opposite sign; with s_i = -sgn(thetadot_i) only the sign used here conserves R (J Omega + h
    e3).

    Args:
        rate: Body rate Omega [rad/s].
        rotor_inertia: Axial inertia I_z of a hub [kg m^2].
        spin: sum thetadot_i, signed [rad/s].
        spin_up: sum thetaddot_i, signed [rad/s^2].
    """
    h = rotor_inertia * spin
    return Vec3(-h * rate.y, h * rate.x, -rotor_inertia * spin_up)
