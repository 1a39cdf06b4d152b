"""The ground: a plane on which the vehicle stands by four feet, and its effect on the rotors above it.

A foot at r_j that has sunk in by d > 0 at the velocity v_j is pushed up by N = max(0, k d - c v_jz), and held by the
friction -mu N v_jt/(|v_jt|^2 + v_s^2)^(1/2), in which v_s smooths the change of direction.

Reference:
    I. C. Cheeseman, W. E. Bennett, The Effect of the Ground on a Helicopter Rotor in Forward Flight, ARC R&M 3021
    (1955): at the same power and speed, thrust near the ground is 1/(1 - (R/(4 h))^2) times that far from it.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.quantities import Quantity, nominal
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Mat3, Vec3
from dssc_jax.models.uav.vehicle import GRAVITY, Vehicle

SINK = 0.01
"""Depth by which the feet of a standing vehicle sink in if no stiffness is given [m]; assumed."""
SLOW = 0.05
"""Speed v_s below which friction fades [m/s]; assumed."""
LOWEST_HEIGHT = 0.5
"""Height over rotor radius below which the ground effect stays constant, because its formula is not valid there."""
# x and y of the feet, as multiples of ``gear_width``
FEET = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))


class Ground(NamedTuple):
    """The ground, a plane z = ``height``, with the feet of the vehicle and the radius of its rotors."""

    height: Annotated[Scalar, Quantity("m", "height z of the ground")] = 0.0
    gear_height: Annotated[Scalar, Quantity("m", "feet below the centre of mass", above=0.0)] = 0.2
    gear_width: Annotated[Scalar, Quantity("m", "feet beside it, along x and y", above=0.0)] = 0.2
    stiffness: Annotated[Scalar | None, Quantity("N/m", "stiffness of a foot", above=0.0)] = None
    damping: Annotated[Scalar | None, Quantity("N s/m", "damping of a foot", at_least=0.0)] = None
    friction: Annotated[Scalar, Quantity("1", "coefficient of friction", at_least=0.0)] = 0.6
    fastest_landing: Annotated[Scalar, Quantity("m/s", "rate of descent at which a touch is a crash", above=0.0)] = 3.0
    rotor_radius: Annotated[Scalar | None, Quantity("m", "rotor radius R of the ground effect", above=0.0)] = None


class Contact(NamedTuple):
    """Force of the ground in the inertial frame [N], and its torque about the centre of mass in body axes [N m]."""

    force: Vec3
    torque: Vec3


def prepared_ground(ground: Ground, mass: Scalar) -> Ground:
    """The ground with the stiffness and the damping of a foot, which are set if the study states none.

    The default stiffness lets a standing vehicle sink in by :data:`SINK`; the default damping is critical.

    Args:
        ground: The ground.
        mass: Mass of the vehicle [kg]; a law counts with its median.
    """
    mass_on_foot = nominal(mass) / len(FEET)
    stiffness = ground.stiffness if ground.stiffness is not None else mass_on_foot * GRAVITY / SINK
    damping = ground.damping if ground.damping is not None else 2.0 * (nominal(stiffness) * mass_on_foot) ** 0.5
    return ground._replace(stiffness=stiffness, damping=damping)


def contact(ground: Ground, position: Vec3, velocity: Vec3, rotation: Mat3, rate: Vec3) -> Contact:
    """Force and torque of the ground on the vehicle, the sum over its four feet; 0 where no foot touches.

    Args:
        ground: The plane and the feet, from :func:`prepared_ground`.
        position: Place of the centre of mass [m].
        velocity: Velocity of the centre of mass, inertial [m/s].
        rotation: R, body to inertial.
        rate: Body rate [rad/s].
    """
    assert ground.stiffness is not None
    assert ground.damping is not None
    force = Vec3(0.0, 0.0, 0.0)
    torque = Vec3(0.0, 0.0, 0.0)
    for x, y in FEET:
        foot = Vec3(x * ground.gear_width, y * ground.gear_width, -ground.gear_height)  # r_j, body axes
        depth = ground.height - position.z - (rotation @ foot).z
        speed = velocity + rotation @ rate.cross(foot)  # v_j, inertial
        normal_force = jnp.maximum(ground.stiffness * depth - ground.damping * speed.z, 0.0)
        push = jnp.where(depth > 0.0, normal_force, 0.0)  # N
        sliding = jnp.sqrt(speed.x * speed.x + speed.y * speed.y + SLOW * SLOW)
        friction_factor = -ground.friction * push / sliding
        foot_force = Vec3(friction_factor * speed.x, friction_factor * speed.y, push)
        force = force + foot_force
        torque = torque + foot.cross(rotation.transpose @ foot_force)
    return Contact(force, torque)


def lift_factor(ground: Ground, height: Scalar) -> Scalar:
    """Thrust near the ground over the thrust far from it, for a height z of the centre of mass [m].

    The quotient is 1/(1 - (R/(4 h))^2) (Cheeseman and Bennett). All rotors count as being at the height of the centre
    of mass.
    """
    radius = ground.rotor_radius
    assert radius is not None
    ratio = radius / (4.0 * jnp.maximum(height - ground.height, LOWEST_HEIGHT * radius))  # R/(4 h)
    return 1.0 / (1.0 - ratio * ratio)


def rotor_thrusts(
    vehicle: Vehicle, ground: Ground | None, height: Scalar, speeds: tuple[Scalar, ...]
) -> tuple[Scalar, ...]:
    """Thrusts of the rotors at their speeds [N], with the effect of the ground.

    Args:
        vehicle: The thrust coefficients of the rotors.
        ground: The ground; None: there is none. Without a radius of the rotors it has no effect.
        height: Height z of the centre of mass [m].
        speeds: Speed of each rotor [rad/s].
    """
    thrusts = tuple(k * w * w for k, w in zip(vehicle.thrust_coefficients, speeds, strict=True))
    if ground is None or ground.rotor_radius is None:
        return thrusts
    factor = lift_factor(ground, height)
    return tuple(factor * f for f in thrusts)


def lowest_foot(ground: Ground, rotation: Mat3) -> Scalar:
    """Height of the lowest foot over the centre of mass [m], which is negative for an upright vehicle.

    Args:
        ground: The feet.
        rotation: R, body to inertial; its last row has the vertical components of the body axes.
    """
    lowered_by_tilt = ground.gear_width * (jnp.abs(rotation.c.x) + jnp.abs(rotation.c.y))
    return -ground.gear_height * rotation.c.z - lowered_by_tilt


def has_crashed(
    ground: Ground, height: Scalar, foot: Scalar, climb: Scalar, acceleration: Scalar, dt: Scalar
) -> Scalar:
    """Whether the vehicle hits the ground in a sample: a foot touches too fast, or the centre of mass is below it.

    The acceleration hardly changes within a sample. A foot that is above the ground therefore touches it with the
    vertical speed (climb^2 - 2 acceleration gap)^(1/2). A foot that is already below the ground counts only if it still
    sinks too fast, because the ground may have braked it since it touched.

    Args:
        ground: The plane and the feet.
        height: Height z of the centre of mass at the sample [m].
        foot: Height of the lowest foot over the centre of mass, from :func:`lowest_foot` [m].
        climb: Vertical velocity of the centre of mass [m/s].
        acceleration: Vertical acceleration of the centre of mass [m/s^2].
        dt: Duration of the sample [s].
    """
    gap = height + foot - ground.height  # of the lowest foot, at the sample
    limit = ground.fastest_landing
    touches = (gap > 0.0) & (gap + climb * dt + 0.5 * acceleration * dt * dt <= 0.0)
    falls = touches & (climb * climb - 2.0 * acceleration * gap > limit * limit)
    sinks = (gap <= 0.0) & (climb < -limit)
    return falls | sinks | (height < ground.height)
