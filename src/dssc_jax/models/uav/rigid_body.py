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
