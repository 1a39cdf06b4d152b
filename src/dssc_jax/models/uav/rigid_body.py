"""Rigid-body dynamics with spinning rotors and quaternion attitude (1), Appendix A."""

from typing import NamedTuple

from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Mat3, Quaternion, Vec3
from dssc_jax.models.uav.vehicle import GRAVITY


class BodyState(NamedTuple):
    """Position p [m] and velocity v [m/s], inertial, z up; attitude, body to inertial; body rate Omega [rad/s]."""

    position: Vec3
    velocity: Vec3
    attitude: Quaternion
    rate: Vec3


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


def body_derivative(
    state: BodyState, mass: Scalar, inertia: Vec3, thrust: Scalar, drag: Vec3, torque: Vec3, rotation: Mat3
) -> BodyState:
    """Right-hand side of (1).

    Args:
        state: The body's state.
        mass: M [kg].
        inertia: Diagonal of J [kg m^2].
        thrust: Net thrust f along body z [N].
        drag: F_drag, inertial [N].
        torque: All torques, body frame [N m].
        rotation: R of the state's attitude.
    """
    force = Vec3(rotation.a.z, rotation.b.z, rotation.c.z) * thrust + drag
    acceleration = force / mass - Vec3(0.0, 0.0, GRAVITY)
    rate_dot = (torque - state.rate.cross(state.rate.scale(inertia))).over(inertia)
    return BodyState(state.velocity, acceleration, state.attitude.rate(state.rate), rate_dot)
