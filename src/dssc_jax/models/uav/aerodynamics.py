"""Drag of structure and propellers (Appendix A).

The drag of propeller i is F_di = -K_Fdi |thetadot_i| (v_i - v_w) with v_i = v + R (Omega x p_bi). For equal rotors the
sum over the rotors depends on three moments of the speeds w_i = |thetadot_i| alone: sum w_i, sum w_i p_i and
sum w_i p_i p_i^T.
"""

from collections.abc import Sequence
from typing import NamedTuple

from dssc_jax.core.numerics import dot
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Mat3, Vec3, minor
from dssc_jax.models.uav.vehicle import Vehicle


class Drag(NamedTuple):
    """Force F_drag in the inertial frame [N], and torque tau_drag in the body frame [N m]."""

    force: Vec3
    torque: Vec3


def drag(vehicle: Vehicle, rotation: Mat3, rate: Vec3, air_velocity: Vec3, speeds: tuple[Scalar, ...]) -> Drag:
    """Force and torque of the drag of structure and propellers on the whole vehicle.

    Args:
        vehicle: K_Fd, K_Fdi and the geometry.
        rotation: R, body to inertial.
        rate: Body rate Omega [rad/s].
        air_velocity: v_r = v - v_w, inertial [m/s].
        speeds: |thetadot_i| of each rotor [rad/s].
    """
    in_body = rotation.transpose @ air_velocity
    structure = Vec3(*vehicle.structure_drag) * (-air_velocity.norm())  # force on the structure per velocity, by axis
    if vehicle.rotor:
        propellers, torque = drag_of_rotors(vehicle, rate, in_body, speeds)
        return Drag(rotation @ (in_body.scale(structure) + propellers), torque)
    moments = speed_moments(vehicle, speeds)
    sxx, sxy, syy = moments.second
    propeller = Vec3(moments.total, moments.total, moments.total)
    force = in_body.scale(structure + propeller) + rate.cross(moments.first)
    # sum w_i p_i x (Omega x p_i) = sum w_i (|p_i|^2 Omega - (p_i . Omega) p_i)
    spin = Vec3(minor(syy, rate.x, sxy, rate.y), minor(sxx, rate.y, sxy, rate.x), (sxx + syy) * rate.z)
    return Drag(rotation @ force, moments.first.cross(in_body) + spin)


class SpeedMoments(NamedTuple):
    """The moments of the rotor speeds w_i at the places p_i, each times -K_Fdi.

    Args:
        total: sum w_i [N s/m].
        first: sum w_i p_i [N s].
        second: Entries xx, xy and yy of sum w_i p_i p_i^T [N m s].
    """

    total: Scalar
    first: Vec3
    second: tuple[Scalar, Scalar, Scalar]


def speed_moments(vehicle: Vehicle, speeds: tuple[Scalar, ...]) -> SpeedMoments:
    """The moments of the rotor speeds of a vehicle whose rotors are on a circle.

    Args:
        vehicle: K_Fdi, the arm and the directions of the rotors.
        speeds: |thetadot_i| of each rotor [rad/s].
    """
    x, y = vehicle.directions()
    ones = (1.0,) * vehicle.rotors
    k = -vehicle.propeller_drag
    total = k * dot(ones, speeds)
    lever = k * vehicle.arm
    first = Vec3(lever * dot(x, speeds), lever * dot(y, speeds), 0.0)

    def second_moment(a: Sequence[float], b: Sequence[float]) -> Scalar:
        """An entry of the second moment.

        Args:
            a: One coordinate of each rotor's place, for an arm of length 1.
            b: The same or the other coordinate.
        """
        return lever * vehicle.arm * dot([i * j for i, j in zip(a, b, strict=True)], speeds)

    return SpeedMoments(total, first, (second_moment(x, x), second_moment(x, y), second_moment(y, y)))


def drag_of_rotors(vehicle: Vehicle, rate: Vec3, in_body: Vec3, speeds: tuple[Scalar, ...]) -> tuple[Vec3, Vec3]:
    """Drag of the propellers of a vehicle that lists its rotors, in body axes.

    Args:
        vehicle: K_Fdi and the places of the rotors.
        rate: Body rate Omega [rad/s].
        in_body: v_r = v - v_w in body axes [m/s].
        speeds: |thetadot_i| of each rotor [rad/s].

    Returns:
        Force [N] and torque [N m].
    """
    force = Vec3(0.0, 0.0, 0.0)
    torque = Vec3(0.0, 0.0, 0.0)
    for rotor, speed in zip(vehicle.rotor, speeds, strict=True):
        place = Vec3(*rotor.position)
        rotor_drag = (in_body + rate.cross(place)) * (-vehicle.propeller_drag * speed)
        force = force + rotor_drag
        torque = torque + place.cross(rotor_drag)
    return force, torque
