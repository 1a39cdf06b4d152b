"""Sine, cosine and tangent of every number.

An angle is first reduced by its whole quarter turns. For up to :data:`MOST_QUARTERS` quarter turns, the reduction
subtracts pi/2 in three or four parts, after Cody and Waite. Lanes rarely have larger angles. For these, the reduction
multiplies by 2/pi as an integer of 192 bits, after Payne and Hanek.

References:
    W. J. Cody, W. Waite, Software Manual for the Elementary Functions (1980).
    M. H. Payne, R. N. Hanek, "Radian reduction for trigonometric functions", SIGNUM Newsletter 18 (1983).
    Sun Microsystems, FreeBSD's msun (1993): coefficients of sine and cosine.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.lanes.functions.approximations import polynomial

HALF_PI = {
    64: (1.57079632673412561417e0, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    32: (1.5703125, 4.837512969970703e-4, 7.549533620476723e-8, 2.5633440682570896e-12),
}
"""pi/2 as a sum of parts, by the bits of a number.

The product of a whole number below MOST_QUARTERS with each part but the last is exact."""
SINE_SERIES = (1.58969099521155010221e-10, -2.50507602534068634195e-8, 2.75573137070700676789e-6,
        -1.98412698298579493134e-4, 8.33333333332248946124e-3, -1.66666666666666324348e-1)  # fmt: skip
COSINE_SERIES = (-1.13596475577881948265e-11, 2.08757232129817482790e-9, -2.75573143513906633035e-7,
          2.48015872894767294178e-5, -1.38888888888741095749e-3, 4.16666666666666019037e-2)  # fmt: skip
"""(sin x - x)/x^3 and (cos x - 1 + x^2/2)/x^4 for |x| <= pi/4 in powers of x^2, highest first."""
MOST_QUARTERS = {64: 2.0**20, 32: 2.0**12}
"""Quarter turns up to which an angle is reduced by :data:`HALF_PI`, by the bits of a number."""
ROUNDER = {64: 1.5 * 2.0**52, 32: 1.5 * 2.0**23}
"""A number whose sum with x rounds x to a whole number, which is then in the low bits of the sum."""

TWO_BY_PI = (
    0x0000000000000000, 0xA2F9836E4E441529, 0xFC2757D1F534DDC0, 0xDB6295993C439041, 0xFE5163ABDEBBC561,
    0xB7246E3A424DD2E0, 0x06492EEA09D1921C, 0xFE1DEB1CB129A73E, 0xE88235F52EBB4484, 0xE99C7026B45F7E41,
    0x3991D639835339F4, 0x9C845F8BBDF9283B, 0x1FF897FFDE05980F, 0xEF2F118B5A0A6D1F, 0x6D367ECF27CB09B7,
    0x4F463F669E5FEA2D, 0x7527BAC7EBE5F17B, 0x3D0739F78A5292EA, 0x6BFB5FB11F8D5D08, 0x56033046FC7B6BAB,
)  # fmt: skip
"""2/pi in words of 64 bits; the first word is the whole part, 0."""

HALF_PI_SPLIT = 1.5707963109016418, 1.5893254712295857e-8, 6.123233995736766e-17
"""pi/2 as a sum of three numbers: the first 26 bits, the next 27, and the next."""


class ReducedAngle(NamedTuple):
    """An angle without its whole quarter turns.

    Args:
        quarters: Number of removed quarter turns, modulo 4, in the two lowest bits of an integer.
        angle: The remaining angle in [-pi/4, pi/4] [rad].
        angle_error: The rounding error of ``angle`` [rad]: the exact remaining angle is ``angle - angle_error``.
    """

    quarters: jax.Array
    angle: jax.Array
    angle_error: jax.Array


def reduce_near(x: jax.Array) -> ReducedAngle:
    """Reduce an angle x [rad] of at most :data:`MOST_QUARTERS` quarter turns to x - quarters pi/2."""
    bits = 8 * x.dtype.itemsize
    rounded_sum = x * (2.0 / math.pi) + ROUNDER[bits]
    quarters = rounded_sum - ROUNDER[bits]
    angle = x
    angle_error = jnp.zeros_like(x)
    for part in HALF_PI[bits]:
        reduced = angle - quarters * part
        angle_error = angle_error + (quarters * part - (angle - reduced))
        angle = reduced
    return ReducedAngle(jax.lax.bitcast_convert_type(rounded_sum, f"int{bits}"), angle, angle_error)


def is_far(x: jax.Array) -> jax.Array:
    """Whether an angle [rad] has too many quarter turns for :func:`reduce_near`."""
    return jnp.abs(x) >= (0.5 * math.pi) * MOST_QUARTERS[8 * x.dtype.itemsize]


def word(number: int) -> jax.Array:
    """Return a constant as a word of 64 bits."""
    return jnp.uint64(number)


def high_product(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return the upper 64 of the 128 bits of the product of two words, by products of their halves.

    Args:
        x: A word below 2^53.
        y: Any word of 64 bits.
    """
    lower_half = word(0xFFFFFFFF)
    x_high = x >> word(32)
    x_low = x & lower_half
    y_high = y >> word(32)
    y_low = y & lower_half
    low_by_high = x_low * y_high
    high_by_low = x_high * y_low
    middle = (x_low * y_low >> word(32)) + (low_by_high & lower_half) + (high_by_low & lower_half)  # bits 32 to 63
    return x_high * y_high + (low_by_high >> word(32)) + (high_by_low >> word(32)) + (middle >> word(32))


def following_bits(high: jax.Array, low: jax.Array, shift: jax.Array) -> jax.Array:
    """Return 64 of the 128 bits of two consecutive words, from bit ``shift`` on.

    Args:
        high: The first word.
        low: The second word.
        shift: Number of the first bit, from 0 to 63; bit 0 is the highest bit of ``high``.
    """
    return high << shift | (low >> word(1)) >> (word(63) - shift)  # in two shifts, since 64 is too many for a word


def word_as_number(x: jax.Array, scale: float) -> jax.Array:
    """Return a word below 2^32 as a float64 number, multiplied by ``scale``, a power of two."""
    return x.astype(jnp.int64).astype(jnp.float64) * scale


def reduce_far(x: jax.Array) -> ReducedAngle:
    """Reduce any float64 angle x [rad] with |x| >= 2^-9; the remaining angle is NaN for an infinite x.

    |x| = m 2^e with an integer m of 53 bits. The first bits of 2/pi, whose product with |x| is a multiple of 4 quarter
    turns, are left out. The next 192 bits give |x| 2/pi modulo 4 with 126 binary places. For no float64 number do more
    than 62 of these places cancel.
    """
    bits = jax.lax.bitcast_convert_type(jnp.abs(x), jnp.uint64)
    mantissa = bits & word(2**52 - 1) | word(2**52)  # m
    place = (bits >> word(52)).astype(jnp.int32) - (1075 - 62)  # of the first bit of 2/pi, counted from that of 2^63
    shift = (place & 63).astype(jnp.uint64)
    table = jnp.asarray(np.array(TWO_BY_PI, np.uint64))
    words = jnp.unstack(jax.lax.dynamic_slice(table, (place >> 6,), (4,)))
    first = following_bits(words[0], words[1], shift)
    second = following_bits(words[1], words[2], shift)
    third = following_bits(words[2], words[3], shift)
    # the words (high, middle) of m (first, second, third): two bits of quarter turns, then 126 of the fraction
    low = mantissa * second
    middle = low + high_product(mantissa, third)
    carry = (middle < low).astype(jnp.uint64)
    high = mantissa * first + high_product(mantissa, second) + carry
    upper = high << word(2) | middle >> word(62)
    lower = middle << word(2)
    above_half = upper >> word(63)  # 1 if the fraction is nearer to 1, which then counts as a quarter turn
    quarters = (high >> word(62)) + above_half
    inverted_bits = word(0) - above_half  # all bits, or none
    upper = upper ^ inverted_bits
    lower = lower ^ inverted_bits
    return radians(x, quarters, above_half, upper, lower)


def radians(x: jax.Array, quarters: jax.Array, negative: jax.Array, upper: jax.Array, lower: jax.Array) -> ReducedAngle:
    """Convert a reduced angle from a fraction of a quarter turn to radians: fraction * pi/2, with its rounding error.

    Args:
        x: The angle that is reduced [rad]. A negative x negates the result, since the other arguments belong to |x|.
        quarters: Number of quarter turns of |x|.
        negative: 1 if the fraction is negative, else 0.
        upper: First word of the absolute value of the fraction, in units of 2^-128 as an integer of 128 bits.
        lower: Second word of the same integer.
    """
    lower_half = word(0xFFFFFFFF)
    first = word_as_number(upper >> word(32), 2.0**-32)
    second = word_as_number(upper & lower_half, 2.0**-64)
    third = word_as_number(lower >> word(32), 2.0**-96)
    fourth = word_as_number(lower & lower_half, 2.0**-128)
    # the fraction as a sum of two numbers, of which the second is the first one's rounding error
    sum_of_first = first + second
    tail = (second - (sum_of_first - first)) + (third + fourth)
    fraction = sum_of_first + tail
    remainder = tail - (fraction - sum_of_first)
    # the product with pi/2, whose parts of few bits have exact products
    bits = jax.lax.bitcast_convert_type(fraction, jnp.uint64)
    top = jax.lax.bitcast_convert_type(bits & word(2**64 - 2**27), jnp.float64)
    bottom = fraction - top
    p_top, p_bottom, p_rest = HALF_PI_SPLIT
    angle = fraction * (p_top + p_bottom)
    angle_error = (((angle - top * p_top) - top * p_bottom) - bottom * p_top) - bottom * p_bottom
    angle_error = angle_error - (fraction * p_rest + remainder * (p_top + p_bottom))
    is_negated = (negative == word(1)) ^ (x < 0.0)
    quarters = jnp.where(x < 0.0, word(0) - quarters, quarters)
    nan_if_infinite = x - x  # else 0
    return ReducedAngle(
        jax.lax.bitcast_convert_type(quarters, jnp.int64), jnp.where(is_negated, -angle, angle) + nan_if_infinite,
        jnp.where(is_negated, -angle_error, angle_error),
    )  # fmt: skip


def sine_of_remainder(reduced: ReducedAngle) -> jax.Array:
    """Return the sine of the remaining angle, without regard to the removed quarter turns; the sine of -0 is -0."""
    _, angle, angle_error = reduced
    z = angle * angle
    return angle - (angle_error - angle * (z * polynomial(SINE_SERIES, z) + 0.5 * angle * angle_error))


def cosine_of_remainder(reduced: ReducedAngle) -> jax.Array:
    """Return the cosine of the remaining angle, without regard to the removed quarter turns."""
    _, angle, angle_error = reduced
    z = angle * angle
    half = 0.5 * z
    leading = 1.0 - half
    rounding_error = (1.0 - leading) - half
    return leading + (rounding_error + (z * z * polynomial(COSINE_SERIES, z) + angle * angle_error))


def sine(reduced: ReducedAngle) -> jax.Array:
    """Return the sine of the angle that was reduced.

    For 0, 1, 2 or 3 removed quarter turns, the result is the sine, cosine, -sine or -cosine of the remaining angle.
    """
    is_odd = reduced.quarters & 1 == 1
    value = jnp.where(is_odd, cosine_of_remainder(reduced), sine_of_remainder(reduced))
    is_negated = reduced.quarters & 2 == 2
    return jnp.where(is_negated, -value, value)


def cosine(reduced: ReducedAngle) -> jax.Array:
    """Return the cosine of the angle that was reduced.

    For 0, 1, 2 or 3 removed quarter turns, the result is the cosine, -sine, -cosine or sine of the remaining angle.
    """
    is_odd = reduced.quarters & 1 == 1
    value = jnp.where(is_odd, sine_of_remainder(reduced), cosine_of_remainder(reduced))
    is_negated = (reduced.quarters + 1) & 2 == 2
    return jnp.where(is_negated, -value, value)


def tangent(reduced: ReducedAngle) -> jax.Array:
    """Return the tangent of the angle that was reduced.

    The result is sine/cosine of the remaining angle, or -cosine/sine after an odd number of removed quarter turns.
    """
    is_odd = reduced.quarters & 1 == 1
    cosine_value = cosine_of_remainder(reduced)
    sine_value = sine_of_remainder(reduced)
    return jnp.where(is_odd, -cosine_value, sine_value) / jnp.where(is_odd, sine_value, cosine_value)


def sin(x: jax.Array) -> jax.Array:
    """Return the sine of an angle [rad] of at most :data:`MOST_QUARTERS` quarter turns."""
    return sine(reduce_near(x))


def cos(x: jax.Array) -> jax.Array:
    """Return the cosine of an angle [rad] of at most :data:`MOST_QUARTERS` quarter turns."""
    return cosine(reduce_near(x))


def tan(x: jax.Array) -> jax.Array:
    """Return the tangent of an angle [rad] of at most :data:`MOST_QUARTERS` quarter turns."""
    return tangent(reduce_near(x))


def far_sin(x: jax.Array) -> jax.Array:
    """Return the sine of an angle [rad] beyond :data:`MOST_QUARTERS` quarter turns, by float64 arithmetic."""
    return sine(reduce_far(x.astype(jnp.float64))).astype(x.dtype)


def far_cos(x: jax.Array) -> jax.Array:
    """Return the cosine of an angle [rad] beyond :data:`MOST_QUARTERS` quarter turns, by float64 arithmetic."""
    return cosine(reduce_far(x.astype(jnp.float64))).astype(x.dtype)


def far_tan(x: jax.Array) -> jax.Array:
    """Return the tangent of an angle [rad] beyond :data:`MOST_QUARTERS` quarter turns, by float64 arithmetic."""
    return tangent(reduce_far(x.astype(jnp.float64))).astype(x.dtype)
