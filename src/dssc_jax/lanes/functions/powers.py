"""x^y, with the logarithm as the sum of two numbers.

An absolute error of y ln x becomes a relative error of x^y, and y ln x may be 700. So float64 computes y ln x with
twice its digits, by sums and products with their exact rounding errors. Float32 is computed in float64.

References:
    T. J. Dekker, "A floating-point technique for extending the available precision", Numerische Mathematik 18 (1971).
    ISO/IEC 9899:1999 (C99), annex F.9.4.4: the values at 0, 1, infinity and NaN.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.lanes.functions.approximations import polynomial
from dssc_jax.lanes.functions.exponentials import (
    EXPONENTS,
    LN_2,
    exponential_minus_one,
    is_negative,
    normalised_mantissa,
    reduce_exponent,
    scaled_by_power,
)

SPLITTER = 2.0**27 + 1.0
"""Dekker's factor, whose product with a float64 number splits its 53 bits into halves."""
LARGEST_EXPONENT = 2.0**70
"""Size of y beyond which x^y is 0, 1 or infinite for every x."""

THIRD = 1.0 / 3.0, 1.850371707708594e-17
"""1/3 as a sum of two numbers."""

SERIES = tuple(1.0 / n for n in range(27, 4, -2))
"""Taylor's coefficients of (atanh(s)/s - 1 - s^2/3)/s^4 in powers of s^2 < 0.0295, from the highest power on."""


class TwoPartNumber(NamedTuple):
    """A number with about twice the digits of float64, as the sum of two float64 numbers.

    Args:
        high: The number, rounded to float64.
        low: The remainder, at most as large as the rounding error of ``high``.
    """

    high: jax.Array
    low: jax.Array


def exact_sum(larger: jax.Array, smaller: jax.Array) -> TwoPartNumber:
    """Return the exact sum of two numbers as the rounded sum and its rounding error.

    Args:
        larger: A number that is 0 or has at least the magnitude of the other one.
        smaller: The other number.
    """
    total = larger + smaller
    return TwoPartNumber(total, smaller - (total - larger))


def split_digits(x: jax.Array) -> TwoPartNumber:
    """Split a float64 number into the exact sum of two numbers of at most 26 bits each."""
    scaled_number = x * SPLITTER
    high = scaled_number - (scaled_number - x)
    return TwoPartNumber(high, x - high)


def exact_product(x: jax.Array, y: jax.Array) -> TwoPartNumber:
    """Return the exact product of two numbers as the rounded product and its rounding error.

    The numbers must be neither so large that Dekker's splitting overflows nor so small that the error underflows.
    """
    product = x * y
    a = split_digits(x)
    b = split_digits(y)
    error = ((a.high * b.high - product) + a.high * b.low + a.low * b.high) + a.low * b.low
    return TwoPartNumber(product, error)


def pair_product(x: TwoPartNumber, y: TwoPartNumber) -> TwoPartNumber:
    """Return the product of two numbers in two parts each, to about twice the digits of float64."""
    high, low = exact_product(x.high, y.high)
    return TwoPartNumber(high, low + (x.high * y.low + x.low * y.high))


def logarithm_pair(x: jax.Array) -> TwoPartNumber:
    """Return ln x of a positive float64 number, to about 64 bits.

    With x = 2^k (1 + f) and s = f/(2 + f), the logarithm is k ln 2 + 2 atanh s. With z = s^2, the series of atanh s is
    s + s z (1/3 + z/5 + ...).
    """
    fraction, k = normalised_mantissa(x)
    f = fraction - 1.0
    denominator = exact_sum(jnp.full_like(f, 2.0), f)  # 2 + f
    s_high = f / denominator.high
    product = exact_product(s_high, denominator.high)
    s = TwoPartNumber(s_high, (((f - product.high) - product.low) - s_high * denominator.low) / denominator.high)
    z = pair_product(s, s)
    correction = z.high * polynomial(SERIES, z.high)
    third, third_error = THIRD
    start = exact_sum(jnp.full_like(f, third), correction)  # 1/3 + z/5 + ...
    term = pair_product(s, pair_product(z, TwoPartNumber(start.high, start.low + third_error)))  # atanh s - s
    ln_2_high, ln_2_low = LN_2[64]
    first = exact_sum(k * ln_2_high, 2.0 * s.high)
    second = exact_sum(first.high, 2.0 * term.high)
    remainder = (first.low + second.low) + (k * ln_2_low + 2.0 * (s.low + term.low))
    return exact_sum(second.high, remainder)


def magnitude(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return x^y = e^(y ln x) for a positive, finite x in float64, to the precision of float64."""
    limited = jnp.clip(y, -LARGEST_EXPONENT, LARGEST_EXPONENT)
    log = logarithm_pair(x)
    exponent = exact_product(limited, log.high)
    n, r, correction = reduce_exponent(exponent.high)
    smallest_exponent, _ = EXPONENTS[64]
    is_out_of_range = jnp.abs(exponent.high) > -smallest_exponent  # where the result is 0 or infinite
    correction = jnp.where(is_out_of_range, 0.0, correction + (exponent.low + limited * log.low))
    remainder = exponential_minus_one(r)
    return scaled_by_power(1.0 + (remainder + correction * (1.0 + remainder)), n)


def power(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return x^y, with C99's values for zeros, infinities and NaN.

    The result is NaN for a negative finite x and a y that is not whole. It has the dtype of x.
    """
    y = y.astype(x.dtype)
    size = jnp.abs(x)
    is_ordinary = (size > 0.0) & (size < jnp.inf)
    base = jnp.where(is_ordinary, size, 1.0).astype(jnp.float64)
    exponent = y.astype(jnp.float64)
    value = magnitude(base, jnp.where(jnp.isnan(y), 0.0, exponent)).astype(x.dtype)
    is_infinite = (size == 0.0) == (y < 0.0)  # 0 to a negative power, or infinity to a positive one
    value = jnp.where(is_ordinary, value, jnp.where(is_infinite, jnp.inf, 0.0))
    is_whole = jnp.floor(y) == y
    is_odd = is_whole & (jnp.abs(y - 2.0 * jnp.floor(0.5 * y)) == 1.0)
    value = jnp.where(is_odd & is_negative(x), -value, value)
    value = jnp.where((x < 0.0) & is_ordinary & ~is_whole, jnp.nan, value)
    value = jnp.where(jnp.isnan(x) | jnp.isnan(y), jnp.nan, value)
    value = jnp.where(y == 1.0, x, value)
    return jnp.where((y == 0.0) | (x == 1.0), 1.0, value)
