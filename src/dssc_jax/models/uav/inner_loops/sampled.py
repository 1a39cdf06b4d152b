"""Common parts of the sampled inner loops: inputs, results, limits, and the filters of autopilots."""

import math
from collections.abc import Iterable
from typing import NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import clip, dot, root_abs
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Mat3, Quaternion, Vec3, quaternion_from_euler
from dssc_jax.lanes.functions.approximations import atan2
from dssc_jax.models.uav.desaturation import rotors_of_full_thrust
from dssc_jax.models.uav.inner_loops.start import Start
from dssc_jax.models.uav.rotors import Wrench


class Readings(NamedTuple):
    """Measurements of an inner loop.

    Args:
        velocity: Velocity in the inertial frame [m/s].
        attitude: Rotation from the body frame to the inertial frame.
        rate: Angular rate in the body frame [rad/s].
    """

    velocity: Vec3
    attitude: Quaternion
    rate: Vec3


class Craft(NamedTuple):
    """The vehicle's parameters that an inner loop uses.

    Args:
        mass: Mass M [kg].
        inertia: Diagonal of the inertia J [kg m^2].
        allocation: The matrix from (f, M_x, M_y, M_z) to the rotors' thrusts f_i, shape (n_r, 4).
        moments: The matrix from the rotors' thrusts f_i to (M_x, M_y, M_z), shape (3, n_r).
        rotor_limit: Largest thrust of a rotor [N].
    """

    mass: Scalar
    inertia: Vec3
    allocation: tuple[tuple[float, ...], ...]
    moments: tuple[tuple[float, ...], ...]
    rotor_limit: Scalar

    @property
    def full_thrust(self) -> Scalar:
        """Net thrust of the thrust command 1, at which the rotors are at their limit in the mean [N]."""
        return rotors_of_full_thrust(self.allocation) * self.rotor_limit


class Angles(NamedTuple):
    """Roll phi, pitch theta and yaw psi [rad] of R_z(psi) R_y(theta) R_x(phi)."""

    phi: Scalar
    theta: Scalar
    psi: Scalar


class Trim(NamedTuple):
    """An equilibrium of the vehicle: its attitude, and the commands that hold it there.

    Args:
        angles: Angles of the attitude.
        thrust: Wanted net thrust [N].
        moment: Wanted moment in the body frame [N m].
        rotor: Commanded thrusts of the rotors [N].
    """

    angles: Angles
    thrust: Scalar
    moment: Vec3
    rotor: tuple[Scalar, ...]

    @property
    def upward(self) -> Vec3:
        """The direction of body z in the inertial frame, of length 1."""
        rotation = attitude_from_angles(self.angles).matrix()
        return Vec3(rotation.a.z, rotation.b.z, rotation.c.z)


def attitude_from_angles(angles: Angles) -> Quaternion:
    """The attitude, body to inertial, that has these Euler angles [rad]."""
    return quaternion_from_euler(*angles)


def body_angles(upward: Vec3, psi: Scalar) -> Angles:
    """The angles at which body z points along ``upward``, a vector of length 1, at the yaw ``psi`` [rad].

    The roll is in [-pi/2, pi/2].
    """
    cosine = jnp.cos(psi)
    sine = jnp.sin(psi)
    forward = upward.x * cosine + upward.y * sine
    left = upward.y * cosine - upward.x * sine
    return Angles(atan2(-left, root_abs(forward * forward + upward.z * upward.z)), atan2(forward, upward.z), psi)


def angles_of(rotation: Mat3) -> Vec3:
    """Roll, pitch and yaw [rad].

    Args:
        rotation: R = R_z(psi) R_y(theta) R_x(phi), body to inertial.
    """
    flat = jnp.sqrt(rotation.c.y * rotation.c.y + rotation.c.z * rotation.c.z)
    return Vec3(atan2(rotation.c.y, rotation.c.z), atan2(-rotation.c.x, flat), atan2(rotation.b.x, rotation.a.x))


class StartsSettled(Protocol):
    """The fields that :func:`require_integral` reads of an inner loop's gains."""

    @property
    def start(self) -> Start:
        """Whether the integrals start at the study's numbers alone, or at these plus their values in equilibrium."""
        ...

    @property
    def velocity_integral(self) -> tuple[Scalar, ...]:
        """The integrals of velocity at the start that the study states."""
        ...


def require_integral(gains: StartsSettled, gain: str) -> None:
    """Require that the integrals at the start are three and, with a settled start, that they can hold the weight.

    Args:
        gains: Gains of an inner loop.
        gain: Name of the field with the integral gain of the vertical velocity.

    Raises:
        ConfigError: The integrals of velocity are not three, or the start is settled and the gain is 0.
    """
    count = len(gains.velocity_integral)
    if count != 3:
        raise ConfigError("velocity_integral", f"needs three values, got {count}")
    if gains.start is Start.SETTLED and nominal(getattr(gains, gain)) == 0.0:
        rule = "'settled' is the equilibrium of the integrals"
        raise ConfigError("start", f"{rule}, and with {gain} = 0 the vertical velocity has none: set 'zero'")


def require_triples(gains: object, names: Iterable[str]) -> None:
    """Require three values, of roll, pitch and yaw, in each of some fields of an inner loop's gains.

    Args:
        gains: The gains.
        names: Names of the fields.

    Raises:
        ConfigError: A field has another number of values.
    """
    for name in names:
        count = len(getattr(gains, name))
        if count != 3:
            raise ConfigError(name, f"needs three values, roll, pitch and yaw; got {count}")


def allocated_moment(craft: Craft, thrusts: tuple[Scalar, ...]) -> Vec3:
    """The moment of rotor thrusts in the geometry that the inner loop knows [N m]."""
    return Vec3(*(dot(row, thrusts) for row in craft.moments))


def net_wrench(craft: Craft, thrusts: tuple[Scalar, ...]) -> Wrench:
    """The thrust and moment for which the allocation gives rotor thrusts that are nearest to those.

    The thrust is the first row of the allocation's pseudo-inverse times the rotor thrusts.

    Args:
        craft: The vehicle as the inner loop knows it.
        thrusts: Thrusts of the rotors [N].
    """
    rows = np.linalg.pinv(np.array(craft.allocation)).tolist()
    return Wrench(dot(rows[0], thrusts), allocated_moment(craft, thrusts))


def limited(vector: Vec3, limit: Vec3) -> Vec3:
    """The vector with each component within [-limit, limit].

    Args:
        vector: The vector.
        limit: Largest magnitude of each component.
    """
    return Vec3(*(clip(value, -bound, bound) for value, bound in zip(vector, limit, strict=True)))


def smoothing(cutoff: float | None, dt: float) -> float:
    """Weight of a new value in a first-order low-pass filter with a cutoff frequency [Hz]; None, no filter: 1.

    Args:
        cutoff: Cutoff frequency [Hz]; None: there is no filter.
        dt: Time between two values [s].
    """
    return 1.0 if cutoff is None else dt / (dt + 1.0 / (2.0 * math.pi * cutoff))


def blend(old: Vec3, new: Vec3, weight: float) -> Vec3:
    """One step of a first-order low-pass filter.

    Args:
        old: The filtered value so far.
        new: The new value.
        weight: Weight of the new value in (0, 1], from :func:`smoothing`; with 1 there is no filter.
    """
    return new if weight == 1.0 else old + (new - old) * weight


class LowPass(NamedTuple):
    """State of a second-order filter in direct form II: the last internal value, and the one before (``earlier``)."""

    last: Vec3
    earlier: Vec3


def butterworth(cutoff: float, dt: float) -> tuple[float, float, float]:
    """Coefficients (b_0, a_1, a_2) of the second-order Butterworth low-pass with a cutoff frequency [Hz].

    The filter is sampled every dt [s] by the bilinear transform with prewarping. The numerator of its transfer function
    is b_0 (1 + 2/z + 1/z^2), and the denominator 1 + a_1/z + a_2/z^2.
    """
    c = math.tan(math.pi * cutoff * dt)
    root = 2.0 * math.cos(0.25 * math.pi)
    scale = 1.0 / (1.0 + root * c + c * c)
    return c * c * scale, 2.0 * (c * c - 1.0) * scale, (1.0 - root * c + c * c) * scale


def settled_low_pass(value: Vec3, cutoff: float, dt: float) -> LowPass:
    """The filter's state after a constant input.

    Both internal values are then value/(4 b_0), because the numerator's coefficients sum to 4 b_0.

    Args:
        value: The input.
        cutoff: Cutoff frequency [Hz].
        dt: Time between two values [s].
    """
    b0, _, _ = butterworth(cutoff, dt)
    return LowPass(value * (0.25 / b0), value * (0.25 / b0))


def low_pass(state: LowPass, value: Vec3, cutoff: float, dt: float) -> tuple[LowPass, Vec3]:
    """One step of the second-order Butterworth low-pass.

    Args:
        state: The filter's state.
        value: The new value.
        cutoff: Cutoff frequency [Hz], below 1/(2 dt).
        dt: Time between two values [s].

    Returns:
        The next state, and the filtered value.
    """
    b0, a1, a2 = butterworth(cutoff, dt)
    inner = value - state.last * a1 - state.earlier * a2
    return LowPass(inner, state.last), (inner + state.last * 2.0 + state.earlier) * b0


def half_angle(cosine: Scalar, sine: Scalar) -> tuple[Scalar, Scalar]:
    """(cos, sin) of half an angle in (-pi, pi) from those of the angle.

    At an angle near pi the cosine of the half counts as 1e-6, so that the quotient stays finite.
    """
    half_cosine = jnp.sqrt(jnp.maximum(0.5 * (1.0 + cosine), 1e-12))
    return half_cosine, 0.5 * sine / half_cosine


def half_turn(cosine: Scalar, sine: Scalar) -> tuple[Scalar, Scalar]:
    """(cos, sin) of half an angle of any size, up to the sign of both, which turns nothing.

    A root gives the larger of the two, and a quotient the smaller one, so that no difference of near numbers loses
    digits.
    """
    back = cosine < 0.0
    large = jnp.sqrt(0.5 * (1.0 + jnp.abs(cosine)))
    small = 0.5 * sine / large
    return jnp.where(back, small, large), jnp.where(back, large, small)


def product(left: Quaternion, right: Quaternion) -> Quaternion:
    """The rotation ``left`` after ``right``, Hamilton's product."""
    a, b, c, d = left
    w, x, y, z = right
    return Quaternion(
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """The inverse of a rotation."""
    return Quaternion(q.w, -q.x, -q.y, -q.z)


def canonical(q: Quaternion) -> Quaternion:
    """The same rotation with a scalar part that is not negative."""
    sign = jnp.where(q.w < 0.0, -1.0, 1.0)
    return Quaternion(q.w * sign, q.x * sign, q.y * sign, q.z * sign)
