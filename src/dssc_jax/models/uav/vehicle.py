"""Vehicle parameters: the article's quadrotor and the hexacopter of its field test (Section V-B, Appendix A)."""

import math
from enum import StrEnum
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import is_known, is_zero
from dssc_jax.core.quantities import Quantity, extent, nominal
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3

GRAVITY = 9.81
"""Standard gravity [m/s^2]."""
ROUNDED_TO_ZERO = 1e-15
"""Smaller sines and cosines count as 0; cos(pi/2) is 6e-17 in double precision."""
UP = (0.0, 0.0, 1.0)
SHORTEST_AXIS = 1e-3
"""Smallest size of an axis' largest component."""


@jax.tree_util.register_static
class RotorCoefficients(StrEnum):
    """Whether a vehicle's thrust and torque coefficients are the true coefficients of its rotors.

    Nominal coefficients give the vehicle's thrusts, but neither the speeds of its rotors nor the power that they take.
    """

    ACTUAL = "actual"
    NOMINAL = "nominal"


class Rotor(NamedTuple):
    """A rotor at any place and in any direction.

    A thrust f acts along the axis a, and the drag torque is s c_tau f a. The sign s is ``direction``: 1 for a rotor
    that turns clockwise when one looks against its thrust. A coefficient that is None is the vehicle's.
    """

    position: Annotated[tuple[Scalar, ...], Quantity("m", "place from the centre of mass, body axes")]
    axis: Annotated[tuple[Scalar, ...], Quantity("1", "direction of the thrust, body axes, of any length")] = UP
    direction: Annotated[Scalar, Quantity("1", "sign of the drag torque", at_least=-1.0, at_most=1.0, law=False)] = 1.0
    thrust_coefficient: Annotated[Scalar | None, Quantity("N s^2/rad^2", "thrust coefficient k_T", above=0.0)] = None
    torque_coefficient: Annotated[Scalar | None, Quantity("m", "torque over thrust c_tau", at_least=0.0)] = None

    @property
    def unit_axis(self) -> Vec3:
        """The direction of the thrust, of length 1; plain numbers where the axis is known before tracing."""
        axis = Vec3(*self.axis)
        if is_zero(axis.x) and is_zero(axis.y) and is_known(axis.z):
            return Vec3(0.0, 0.0, math.copysign(1.0, axis.z))
        square = axis.dot(axis)
        length = math.sqrt(square) if is_known(square) else jnp.sqrt(square)
        return Vec3(axis.x / length, axis.y / length, axis.z / length)


class Vehicle(NamedTuple):
    """A multirotor with equal rotors on a circle around the centre of mass, or with rotors at any place.

    On a circle, rotor i = 1..n_r is at the angle ``rotor_angles[i]`` counter-clockwise from body x, at the distance
    ``arm``. The sign of its drag torque about body z is s_i = -sgn(thetadot_i), in ``spins``.

    If ``rotor`` is not empty, it gives the places and signs, and ``arm``, ``rotor_angles`` and ``spins`` have no
    effect. ``rotor_coefficients`` tells whether thrust and torque coefficients are those of the rotors, or nominal.
    """

    mass: Annotated[Scalar, Quantity("kg", "mass M", above=0.0, leading=True)]
    body_inertia: Annotated[tuple[Scalar, ...], Quantity("kg m^2", "structure's principal inertia I_b", above=0.0)]
    rotor_inertia_xy: Annotated[Scalar, Quantity("kg m^2", "hub's transverse inertia I_xy", at_least=0.0)]
    rotor_inertia_z: Annotated[Scalar, Quantity("kg m^2", "hub's axial inertia I_z", at_least=0.0)]
    thrust_coefficient: Annotated[Scalar, Quantity("N s^2/rad^2", "thrust coefficient k_T", above=0.0)]
    torque_coefficient: Annotated[Scalar, Quantity("m", "torque over thrust c_tau", above=0.0)]
    arm: Annotated[Scalar, Quantity("m", "arm length L", above=0.0)]
    structure_drag: Annotated[tuple[Scalar, ...], Quantity("N s^2/m^2", "structure drag K_Fd, body axes", at_least=0.0)]
    propeller_drag: Annotated[Scalar, Quantity("N s^2/(m rad)", "propeller drag force K_Fdi", at_least=0.0)]
    rotor_angles: Annotated[tuple[Scalar, ...], Quantity("rad", "rotor angle from body x", law=False)]
    spins: Annotated[tuple[Scalar, ...], Quantity("1", "spin sign s_i", at_least=-1.0, at_most=1.0, law=False)]
    max_thrust: Annotated[Scalar | None, Quantity("N", "largest thrust of a rotor f_max", above=0.0)] = None
    motor_lag: Annotated[Scalar | None, Quantity("s", "time constant of the rotor speed", above=0.0, leading=True)] = (
        None
    )
    rotor: tuple[Rotor, ...] = ()
    rotor_coefficients: RotorCoefficients = RotorCoefficients.ACTUAL

    @property
    def rotors(self) -> int:
        """Number of rotors n_r."""
        return len(self.rotor or self.rotor_angles)

    @property
    def thrust_coefficients(self) -> tuple[Scalar, ...]:
        """Thrust coefficient k_T of each rotor [N s^2/rad^2]; a rotor without a value has the vehicle's."""
        common = self.thrust_coefficient
        if not self.rotor:
            return (common,) * self.rotors
        coefficients = (rotor.thrust_coefficient for rotor in self.rotor)
        return tuple(common if value is None else value for value in coefficients)

    @property
    def torque_coefficients(self) -> tuple[Scalar, ...]:
        """Torque over thrust c_tau of each rotor [m]; a rotor without a value has the vehicle's."""
        common = self.torque_coefficient
        if not self.rotor:
            return (common,) * self.rotors
        coefficients = (rotor.torque_coefficient for rotor in self.rotor)
        return tuple(common if value is None else value for value in coefficients)

    @property
    def inertia(self) -> Vec3:
        """Diagonal of the inertia J of structure and rotor hubs [kg m^2].

        J = diag(n_r I_xy + I_bx, n_r I_xy + I_by, n_r I_z + I_bz).
        """
        transverse = self.rotors * self.rotor_inertia_xy
        bx, by, bz = self.body_inertia
        return Vec3(transverse + bx, transverse + by, self.rotors * self.rotor_inertia_z + bz)

    @property
    def thrust_limit(self) -> Scalar:
        """Largest thrust f_max of a rotor [N]; without ``max_thrust``, 2 M g/n_r (assumed)."""
        return 2.0 * self.mass * GRAVITY / self.rotors if self.max_thrust is None else self.max_thrust

    @property
    def has_drag(self) -> bool:
        """Whether the vehicle has a drag: whether a coefficient is positive for at least one value of its law."""
        for coefficient in (*self.structure_drag, self.propeller_drag):
            _, largest = extent(coefficient)
            if largest > 0.0:
                return True
        return False

    @property
    def nominal_thrust_limit(self) -> float:
        """Largest thrust f_max of a rotor that the inner loop assumes [N]; laws count with their medians."""
        if self.max_thrust is None:
            return 2.0 * nominal(self.mass) * GRAVITY / self.rotors
        return nominal(self.max_thrust)

    def directions(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """x and y of every rotor on a circle, for an arm of length 1; values that are 0 up to rounding are 0."""
        x = tuple(without_rounding(math.cos(angle)) for angle in self.rotor_angles)
        y = tuple(without_rounding(math.sin(angle)) for angle in self.rotor_angles)
        return x, y


def without_rounding(value: float) -> float:
    """The value, or 0 if it is below ``ROUNDED_TO_ZERO``, as the cosine of a right angle is."""
    return 0.0 if abs(value) < ROUNDED_TO_ZERO else value


def ring(rotors: int) -> tuple[float, ...]:
    """The angles of equally spaced rotors from body x, counter-clockwise [rad]."""
    return tuple(2.0 * math.pi * i / rotors for i in range(rotors))


def alternating(rotors: int) -> tuple[float, ...]:
    """Spin signs +1, -1, ... of the rotors in turn.

    With another order of these signs, four rotors on a ring cannot control the yaw.
    """
    return tuple(1.0 if i % 2 == 0 else -1.0 for i in range(rotors))


QUADROTOR = Vehicle(
    mass=10.9,
    body_inertia=(0.4, 0.4, 0.74),
    rotor_inertia_xy=0.01,
    rotor_inertia_z=0.5e-5,
    thrust_coefficient=0.0024,
    torque_coefficient=0.57,  # equals the arm and is implausibly large for a propeller; kept as printed
    arm=0.57,
    structure_drag=(0.03, 0.03, 0.015),
    propeller_drag=8e-6,
    rotor_angles=ring(4),
    spins=alternating(4),
)
"""The article's simulated vehicle (Section V-B)."""

HEXACOPTER = QUADROTOR._replace(rotor_angles=ring(6), spins=alternating(6))
"""The body of ``QUADROTOR`` with six of its rotors, like the article's DJI M600 Pro (assumed)."""


def check_circle(vehicle: Vehicle) -> None:
    """Require at least four rotors on a circle, each with the sign 1 or -1 of its drag torque.

    Raises:
        ConfigError: There are too few rotors, or a sign is missing or another number.
    """
    if len(vehicle.spins) != vehicle.rotors or vehicle.rotors < 4:
        raise ConfigError("spins", f"needs one sign a rotor, and four rotors at least; got {vehicle.rotors} rotors")
    if any(abs(s) != 1.0 for s in vehicle.spins):
        raise ConfigError("spins", f"each must be 1 or -1, got {list(vehicle.spins)}")


def check_rotors(vehicle: Vehicle) -> None:
    """Require at least four rotors in the list, each with a place, an axis that is not zero, and a sign.

    Raises:
        ConfigError: A rotor lacks one of these, there are too few, or the arm has a law, which would have no effect.
    """
    if vehicle.rotors < 4:
        raise ConfigError("rotor", f"needs four rotors at least, got {vehicle.rotors}")
    low, high = extent(vehicle.arm)
    if low != high:
        raise ConfigError("arm", "has no effect beside [[rotor]], which gives the places; take the law out")
    for index, rotor in enumerate(vehicle.rotor):
        path = f"rotor.{index}"
        for name in ("position", "axis"):
            if len(getattr(rotor, name)) != 3:
                raise ConfigError(f"{path}.{name}", f"needs three values, got {len(getattr(rotor, name))}")
        if abs(rotor.direction) != 1.0:
            raise ConfigError(f"{path}.direction", f"must be 1 or -1, got {rotor.direction:g}")
        if max(abs(nominal(value)) for value in rotor.axis) < SHORTEST_AXIS:
            raise ConfigError(f"{path}.axis", f"must not be zero, got {[nominal(value) for value in rotor.axis]}")


def check_vehicle(vehicle: Vehicle) -> None:
    """Check the rules between a vehicle's fields, for all values of their laws.

    Raises:
        ConfigError: Rotors do not fit, the moments of inertia break the triangle inequality, or the vehicle cannot lift
            its weight.
    """
    for name in ("body_inertia", "structure_drag"):
        if len(getattr(vehicle, name)) != 3:
            raise ConfigError(name, f"needs three values, got {len(getattr(vehicle, name))}")
    if vehicle.rotor:
        check_rotors(vehicle)
    else:
        check_circle(vehicle)
    lowest, highest = zip(*map(extent, vehicle.body_inertia), strict=True)
    for i, axis in enumerate("xyz"):
        other_two = sum(lowest[j] for j in range(3) if j != i)
        if highest[i] > other_two:
            rule = f"must keep the triangle inequality: I_{axis} <= the sum of the others"
            raise ConfigError("body_inertia", f"{rule}; {highest[i]:g} > {other_two:g}")
    if vehicle.max_thrust is not None:
        least_thrust, _ = extent(vehicle.max_thrust)
        _, largest_mass = extent(vehicle.mass)
        lift = vehicle.rotors * least_thrust
        weight = largest_mass * GRAVITY
        if lift <= weight:
            raise ConfigError("max_thrust", f"hover needs n_r f_max > M g = {weight:g} N, got {lift:g} N")
