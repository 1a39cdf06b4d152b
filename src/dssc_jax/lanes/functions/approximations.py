"""Polynomials of elementary functions, and the arctangent in a form that vectorises."""

import math
from collections.abc import Sequence
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

Scalar: TypeAlias = jax.Array | float
"""A number of a lane."""

LOG_SERIES = (1.479819860511658591e-1, 1.531383769920937332e-1, 1.818357216161805012e-1, 2.222219843214978396e-1,
              2.857142874366239149e-1, 3.999999999940941908e-1, 6.666666666666735130e-1)  # fmt: skip
"""(ln((1 + s)/(1 - s)) - 2 s)/s^3 in powers of s^2, highest first: FreeBSD's e_log.c (Sun Microsystems, 1993)."""

ATAN_SERIES = {
    np.dtype(np.float64): (
        (1.62858201153657823623e-02, 4.97687799461593236017e-02, 6.66107313738753120669e-02,
         9.09088713343650656196e-02, 1.42857142725034663711e-01, 3.33333333333329318027e-01),
        (-3.65315727442169155270e-02, -5.83357013379057348645e-02, -7.69187620504482999495e-02,
         -1.11111104054623557880e-01, -1.99999999998764832476e-01),
    ),
    np.dtype(np.float32): (
        (6.1687607318e-02, 1.4253635705e-01, 3.3333328366e-01), (-1.0648017377e-01, -1.9999158382e-01),
    ),
}  # fmt: skip
"""(x - atan x)/x^3 for |x| <= 7/16 in powers of x^2, highest first: the even powers, then the odd powers.

Two polynomials in x^4 make two short chains of operations in place of a long one."""


def polynomial(coefficients: Sequence[float], x: Scalar) -> Scalar:
    """Return the value of a polynomial at x by Horner's rule; the coefficient of the highest power comes first."""
    value: Scalar = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value


def arc(opposite: Scalar, adjacent: Scalar) -> Scalar:
    """Return the arctangent of x = opposite/adjacent [rad] in [0, pi/4], for 0 <= opposite <= adjacent, adjacent > 0.

    For x <= tan(pi/8), the arctangent of r = x is a polynomial. For a larger x it is pi/4 + atan r with the reduced
    ratio r = (x - 1)/(x + 1), which follows from the two sides by one division, without x itself. The polynomials are
    those of FreeBSD's s_atan.c and s_atanf.c (Sun Microsystems, 1993).
    """
    is_beyond = opposite > math.tan(math.pi / 8.0) * adjacent
    r = jnp.where(is_beyond, opposite - adjacent, opposite) / jnp.where(is_beyond, opposite + adjacent, adjacent)
    even, odd = ATAN_SERIES[r.dtype]
    z = r * r
    w = z * z
    # r - atan r = r (z p(z)); the polynomial p(z) = even(w) + z odd(w) is split into its even and odd powers of z
    angle = r - r * (z * polynomial(even, w) + w * polynomial(odd, w))
    return jnp.where(is_beyond, 0.25 * math.pi + angle, angle)


def atan(x: Scalar) -> Scalar:
    """Return the arctangent [rad] in (-pi/2, pi/2), within 3 units in the last place.

    This function consists of arithmetic that a compiler vectorises. On a CPU, XLA's own arctangent is a routine for one
    number at a time.
    """
    magnitude = jnp.abs(x)
    is_steep = magnitude > 1.0
    angle = arc(jnp.where(is_steep, 1.0, magnitude), jnp.where(is_steep, magnitude, 1.0))
    angle = jnp.where(is_steep, 0.5 * math.pi - angle, angle)
    return jnp.where(x < 0.0, -angle, angle)


def atan2(y: Scalar, x: Scalar) -> Scalar:
    """Return the angle of the vector (x, y) [rad] in (-pi, pi], in arithmetic that vectorises; 0 at the origin."""
    height = jnp.abs(y)
    width = jnp.abs(x)
    is_steep = height > width
    longer_side = jnp.where(is_steep, height, width)
    angle = arc(jnp.where(is_steep, width, height), jnp.where(longer_side == 0.0, 1.0, longer_side))
    angle = jnp.where(is_steep, 0.5 * math.pi - angle, angle)
    angle = jnp.where(x < 0.0, math.pi - angle, angle)
    return jnp.where(y < 0.0, -angle, angle)
