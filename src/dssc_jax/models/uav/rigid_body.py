"""Rigid-body dynamics with spinning rotors and quaternion attitude (1), Appendix A."""

from typing import NamedTuple

from dssc_jax.core.events import Load
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Mat3, Quaternion, Vec3
from dssc_jax.models.uav.vehicle import GRAVITY


class BodyState(NamedTuple):
    """The state of a rigid body, or its derivative.

    Args:
        position: p, inertial, z up [m].
        velocity: v, inertial [m/s].
        attitude: Rotation from body to inertial frame.
        rate: Angular velocity Omega in body axes [rad/s].
    """

    position: Vec3
    velocity: Vec3
    attitude: Quaternion
    rate: Vec3


def body_derivative(
    state: BodyState, mass: Scalar, inertia: Vec3, thrust: Scalar, outer_force: Vec3, torque: Vec3, rotation: Mat3
) -> BodyState:
    """The derivative of a rigid body's state, the right-hand side of (1).

    Args:
        state: The body's state.
        mass: M [kg].
        inertia: Diagonal of J [kg m^2].
        thrust: Net thrust f along body z [N].
        outer_force: Sum of the forces other than thrust and weight, such as F_drag, inertial [N].
        torque: All torques, body frame [N m].
        rotation: R of the state's attitude.
    """
    force = Vec3(rotation.a.z, rotation.b.z, rotation.c.z) * thrust + outer_force
    acceleration = force / mass - Vec3(0.0, 0.0, GRAVITY)
    rate_dot = (torque - turning_moment(inertia, state.rate)).over(inertia)
    return BodyState(state.velocity, acceleration, state.attitude.rate(state.rate), rate_dot)


def turning_moment(inertia: Vec3, rate: Vec3) -> Vec3:
    """Omega x J Omega for a diagonal J [N m]: the moment that keeps the body rate Omega constant.

    Args:
        inertia: Diagonal of J [kg m^2].
        rate: Body rate Omega [rad/s].
    """
    differences = Vec3(inertia.z - inertia.y, inertia.x - inertia.z, inertia.y - inertia.x)
    return Vec3(rate.y * rate.z, rate.z * rate.x, rate.x * rate.y).scale(differences)


def loaded_derivative(
    state: BodyState, mass: Scalar, inertia: Vec3, load: Load, force: Vec3, torque: Vec3, rotation: Mat3
) -> BodyState:
    """The derivative of the body's state with additional masses, which move the centre of mass.

    The state belongs to the point O, the centre of mass without the additional masses. Let M be the total mass,
    c = sum m r/M the centre of mass seen from O, and J_c the inertia about c. Newton and Euler give
    R F/M - g e3 = v' + R (Omega' x c + Omega x (Omega x c)) and J_c Omega' = tau - c x F - Omega x J_c Omega.

    Args:
        state: The state of the point O.
        mass: Mass of the vehicle without the load [kg].
        inertia: Diagonal of the vehicle's inertia about O, without the load [kg m^2].
        load: The additional masses.
        force: All forces but the weight, body frame [N].
        torque: All torques about O but the weight's, body frame [N m].
        rotation: R of the state's attitude.
    """
    total = mass + load.mass
    c = load.first / total
    xx, yy, zz = load.square  # sum m x^2, ..
    yz, zx, xy = load.product  # sum m y z, ..
    # J_c by Steiner's rule: J of body and load about O, less that of the total mass at c
    diagonal = Vec3(
        inertia.x + yy + zz - total * (c.y * c.y + c.z * c.z),
        inertia.y + zz + xx - total * (c.z * c.z + c.x * c.x),
        inertia.z + xx + yy - total * (c.x * c.x + c.y * c.y),
    )
    jxy = total * c.x * c.y - xy
    jyz = total * c.y * c.z - yz
    jzx = total * c.z * c.x - zx
    tensor = Mat3(Vec3(diagonal.x, jxy, jzx), Vec3(jxy, diagonal.y, jyz), Vec3(jzx, jyz, diagonal.z))
    moment = torque - c.cross(force) - state.rate.cross(tensor @ state.rate)
    # J_c^-1 moment: the columns of the inverse are the cross products of the rows over the determinant
    columns = (tensor.b.cross(tensor.c), tensor.c.cross(tensor.a), tensor.a.cross(tensor.b))
    determinant = tensor.a.dot(columns[0])
    rate_dot = (columns[0] * moment.x + columns[1] * moment.y + columns[2] * moment.z) / determinant
    lever = rate_dot.cross(c) + state.rate.cross(state.rate.cross(c))  # acceleration of c relative to O
    acceleration = rotation @ (force / total - lever) - Vec3(0.0, 0.0, GRAVITY)
    return BodyState(state.velocity, acceleration, state.attitude.rate(state.rate), rate_dot)
