"""Vectors, matrices and quaternions of scalars, with operators.

Arrays of length three inside a step cost up to half of the speed. Tuples of scalars compile to scalar arithmetic, and
with operators ``R @ force / mass - gravity`` still reads like the equation.
"""

from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.core.numerics import difference, root_abs, times
from dssc_jax.core.signals import Scalar


class Vec3(NamedTuple):
    """A vector with ``+ - * /`` (by scalars), ``dot`` and ``cross``."""

    x: Scalar
    y: Scalar
    z: Scalar

    def __add__(self, vector: "Vec3") -> "Vec3":  # type: ignore[override]
        """Add a vector; a NamedTuple by itself would append it."""
        return Vec3(self.x + vector.x, self.y + vector.y, self.z + vector.z)

    def __sub__(self, vector: "Vec3") -> "Vec3":
        """Subtract a vector."""
        return Vec3(self.x - vector.x, self.y - vector.y, self.z - vector.z)

    def __mul__(self, factor: Scalar) -> "Vec3":  # type: ignore[override]
        """Multiply by a scalar; products with a component that is known to be 0 before tracing stay 0."""
        return Vec3(times(self.x, factor), times(self.y, factor), times(self.z, factor))

    __rmul__ = __mul__  # type: ignore[assignment]

    def __truediv__(self, divisor: Scalar) -> "Vec3":
        """Divide by a scalar, by one division and three products."""
        return self * (1.0 / divisor)

    def __neg__(self) -> "Vec3":
        """Turn the vector to the opposite direction."""
        return Vec3(-self.x, -self.y, -self.z)

    def dot(self, vector: "Vec3") -> Scalar:
        """Scalar product."""
        return self.x * vector.x + self.y * vector.y + self.z * vector.z

    def cross(self, vector: "Vec3") -> "Vec3":
        """Vector product; products with a component that is known to be 0 before tracing are left out."""
        return Vec3(
            minor(self.y, vector.z, self.z, vector.y),
            minor(self.z, vector.x, self.x, vector.z),
            minor(self.x, vector.y, self.y, vector.x),
        )

    def scale(self, by: "Vec3") -> "Vec3":
        """Componentwise product: a diagonal matrix applied."""
        return Vec3(times(self.x, by.x), times(self.y, by.y), times(self.z, by.z))

    def over(self, by: "Vec3") -> "Vec3":
        """Componentwise quotient: the inverse of a diagonal matrix applied."""
        return self.scale(Vec3(1.0 / by.x, 1.0 / by.y, 1.0 / by.z))

    def norm(self) -> Scalar:
        """Length, with gradient 0 at the zero vector."""
        return root_abs(self.dot(self))


def minor(a: Scalar, b: Scalar, c: Scalar, d: Scalar) -> Scalar:
    """The determinant a b - c d of two rows and columns, without products that are known to be 0."""
    return difference(times(a, b), times(c, d))


class Mat3(NamedTuple):
    """A 3 x 3 matrix with rows a, b and c; ``@`` multiplies it by a vector."""

    a: Vec3
    b: Vec3
    c: Vec3

    @property
    def transpose(self) -> "Mat3":
        """The transposed matrix."""
        return Mat3(
            Vec3(self.a.x, self.b.x, self.c.x), Vec3(self.a.y, self.b.y, self.c.y), Vec3(self.a.z, self.b.z, self.c.z)
        )

    def __matmul__(self, v: Vec3) -> Vec3:
        """Multiply the matrix by a vector."""
        return Vec3(self.a.dot(v), self.b.dot(v), self.c.dot(v))


class Quaternion(NamedTuple):
    """A rotation from body to inertial frame as a quaternion, scalar part first; of unit length up to drift."""

    w: Scalar
    x: Scalar
    y: Scalar
    z: Scalar

    def normalised(self) -> "Quaternion":
        """The same rotation at unit length."""
        inverse = 1.0 / jnp.sqrt(self.w * self.w + self.x * self.x + self.y * self.y + self.z * self.z)
        return Quaternion(self.w * inverse, self.x * inverse, self.y * inverse, self.z * inverse)

    def matrix(self) -> Mat3:
        """The rotation matrix R, body to inertial; orthogonal for a unit quaternion."""
        w, x, y, z = self
        return Mat3(
            Vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            Vec3(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            Vec3(2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )

    def rate(self, body_rate: Vec3) -> "Quaternion":
        """q' = q (0, Omega)/2, the kinematics R' = R [Omega]_x.

        Args:
            body_rate: Omega, the angular velocity in body axes [rad/s].
        """
        w, x, y, z = self
        p, q, r = body_rate
        return Quaternion(
            0.5 * (-x * p - y * q - z * r),
            0.5 * (w * p + y * r - z * q),
            0.5 * (w * q + z * p - x * r),
            0.5 * (w * r + x * q - y * p),
        )


def quaternion_from_euler(phi: Scalar, theta: Scalar, psi: Scalar) -> Quaternion:
    """The rotation R_z(psi) R_y(theta) R_x(phi); angles in rad.

    Args:
        phi: Roll angle [rad].
        theta: Pitch angle [rad].
        psi: Yaw angle [rad].
    """
    cr = jnp.cos(0.5 * phi)
    sr = jnp.sin(0.5 * phi)
    cp = jnp.cos(0.5 * theta)
    sp = jnp.sin(0.5 * theta)
    cy = jnp.cos(0.5 * psi)
    sy = jnp.sin(0.5 * psi)
    return Quaternion(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
