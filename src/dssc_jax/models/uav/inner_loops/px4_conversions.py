"""Two conversions of PX4's cascade: from a thrust to the attitude that gives it, and the units of its torques.

References:
    PX4 1.14, modules mc_pos_control (ControlMath) and control_allocator (ControlAllocationPseudoInverse).
"""

import jax.numpy as jnp

from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.models.uav.desaturation import scales_of
from dssc_jax.models.uav.inner_loops.sampled import Craft, half_angle, half_turn


def torque_units(craft: Craft) -> Vec3:
    """The moment of a torque setpoint of 1 in PX4, whose allocation scales the pseudo-inverse [N m].

    A setpoint of 1 changes the thrust of a rotor by its limit if the rotor's entry in the column of the allocation is
    the column's scale. Roll and pitch share one scale, see :func:`dssc_jax.models.uav.desaturation.scales_of`.
    """
    scales = scales_of(craft.allocation)
    tilting = craft.rotor_limit / scales.turning
    return Vec3(tilting, tilting, craft.rotor_limit / scales.yaw)


def attitude_of(thrust: Vec3, present: Quaternion) -> Quaternion:
    """The attitude whose body z points along a thrust, at the heading of the present attitude.

    The attitude is R_z(psi) R_y(theta) R_x(phi). Its quaternion follows from cosines and sines of half the angles:
    ``cr`` and ``sr`` of roll, ``cp`` and ``sp`` of pitch, ``cy`` and ``sy`` of yaw.

    Args:
        thrust: A vector along the wanted thrust, inertial axes, of any length.
        present: The present attitude, body to inertial.
    """
    rotation = present.matrix()
    flat = 1.0 / jnp.sqrt(jnp.maximum(rotation.a.x * rotation.a.x + rotation.b.x * rotation.b.x, 1e-12))
    heading = rotation.a.x * flat, rotation.b.x * flat
    along = thrust / jnp.sqrt(jnp.maximum(thrust.dot(thrust), 1e-12))
    forward = along.x * heading[0] + along.y * heading[1]
    left = along.y * heading[0] - along.x * heading[1]
    lean = jnp.sqrt(forward * forward + along.z * along.z)
    cr, sr = half_angle(lean, -left)
    cp, sp = half_angle(along.z / lean, forward / lean)
    cy, sy = half_turn(*heading)
    return Quaternion(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
