"""Exponential, logarithm and the hyperbolic functions of every number.

References:
    W. J. Cody, W. Waite, Software Manual for the Elementary Functions (1980): reduction of the argument.
    Sun Microsystems, FreeBSD's msun (1993): coefficients of the logarithm.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.lanes.functions.approximations import LOG_SERIES, polynomial

LN_2 = {64: (6.93147180369123816490e-1, 1.90821492927058770002e-10), 32: (0.693359375, -2.12194440054690582e-4)}
"""ln 2 as a sum of two parts, by the bits of a number; the first part times a moderate whole number is exact."""
EXPONENTIAL = tuple(1.0 / math.factorial(n) for n in range(14, 2, -1))
"""Taylor's coefficients of (e^x - 1 - x - x^2/2)/x^3, from the highest power on."""
EXPONENTS = {64: (-746.0, 711.0), 32: (-104.5, 90.0)}
"""Bounds of x, by the bits of a number, outside of which both e^x and e^x/2 are 0 or infinite."""

BINARY_EXPONENTS = {64: (-1076.0, 1025.0), 32: (-151.0, 129.0)}
"""Bounds of x, by the bits of a number, outside of which 2^x is 0 or infinite."""


def width(x: jax.Array) -> int:
    """Return the number of bits of a floating-point number, 32 or 64."""
    return 8 * jnp.asarray(x).dtype.itemsize


def bits_of(x: jax.Array) -> jax.Array:
    """Return the bits of a floating-point number as a signed integer of the same width."""
    return jax.lax.bitcast_convert_type(x, jnp.int64 if width(x) == 64 else jnp.int32)


def as_integer(x: jax.Array) -> jax.Array:
    """Return a floating-point number whose value is whole as an integer of the same width."""
    return x.astype(jnp.int64 if width(x) == 64 else jnp.int32)


def is_negative(x: jax.Array) -> jax.Array:
    """Whether the sign bit of a number is set; true for -0 as well."""
    return bits_of(x) < 0


def exponential_of_two(exponent: jax.Array, like: jax.Array) -> jax.Array:
    """Return 2^n, built from its bits.

    Args:
        exponent: The whole number n, as a floating-point number. The result must be a normal number.
        like: A number with the dtype of the result.
    """
    mantissa_bits, bias = (52, 1023) if width(like) == 64 else (23, 127)
    n = as_integer(exponent)
    return jax.lax.bitcast_convert_type((n + bias) << mantissa_bits, like.dtype)


def exponential_minus_one(r: jax.Array, correction: jax.Array | float = 0.0) -> jax.Array:
    """Return e^(r + correction) - 1.

    Args:
        r: A number with |r| up to about (ln 2)/2.
        correction: A number as small as the rounding error of r. Its square is neglected.
    """
    return r + (0.5 * r * r + (r * r * r * polynomial(EXPONENTIAL, r) + correction * (1.0 + r)))


def reduce_exponent(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Split x into n ln 2 + r + correction, with a whole number n and |r| up to about (ln 2)/2.

    First, x is limited to :data:`EXPONENTS`. For a NaN, n is 0 and r is NaN.

    Returns:
        n, r and the correction, which is as small as a rounding error of r.
    """
    high, low = LN_2[width(x)]
    x = jnp.clip(x, *EXPONENTS[width(x)])
    n = jnp.round(x * (1.0 / math.log(2.0)))
    first = x - n * high
    r = first - n * low
    return jnp.where(jnp.isnan(n), 0.0, n), r, (first - r) - n * low


def exponential(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return n and e^r - 1, which give e^x = 2^n e^r for x = n ln 2 + r with a whole number n."""
    n, r, correction = reduce_exponent(x)
    return n, exponential_minus_one(r, correction)


def scaled_by_power(x: jax.Array, n: jax.Array) -> jax.Array:
    """Return 2^n x for a whole n; multiply by two factors in turn, so that only the result can over- or underflow."""
    half = jnp.floor(0.5 * n)
    return x * exponential_of_two(half, x) * exponential_of_two(n - half, x)


def exp(x: jax.Array) -> jax.Array:
    """Return e^x.

    For an infinite x, the result is x itself and not a product. Fast arithmetic could contract that product with a
    difference in the caller, and e^inf - inf would be NaN.
    """
    n, remainder = exponential(x)
    return jnp.where(x == jnp.inf, x, scaled_by_power(1.0 + remainder, n))


def exp2(x: jax.Array) -> jax.Array:
    """Return 2^x; for x = inf the result is x itself, for the reason given in :func:`exp`."""
    bounded = jnp.clip(x, *BINARY_EXPONENTS[width(x)])
    n = jnp.round(bounded)
    remainder = exponential_minus_one((bounded - n) * math.log(2.0))
    return jnp.where(x == jnp.inf, x, scaled_by_power(1.0 + remainder, jnp.where(jnp.isnan(n), 0.0, n)))


def expm1(x: jax.Array) -> jax.Array:
    """Return e^x - 1, without cancellation near x = 0."""
    n, remainder = exponential(x)
    is_large = jnp.abs(n) > 60.0  # where 2^n - 1 has lost all digits of 1 or of 2^n
    factor = exponential_of_two(jnp.where(is_large, 0.0, n), x)
    value = factor * remainder + (factor - 1.0)
    value = jnp.where(n == 0.0, remainder, jnp.where(is_large, scaled_by_power(1.0 + remainder, n) - 1.0, value))
    return jnp.where(jnp.isnan(x) | (x == 0.0), x, value)


def mantissa(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Split a positive normal number x = 2^k m into m in [2^(-1/2), 2^(1/2)) and the whole number k."""
    mantissa_bits, bits_of_root = (52, 0x3FE6A09E667F3BCD) if width(x) == 64 else (23, 0x3F3504F3)  # of 2^(-1/2)
    bits = bits_of(x)
    exponent = (bits - bits_of_root) >> mantissa_bits
    return jax.lax.bitcast_convert_type(bits - (exponent << mantissa_bits), x.dtype), exponent.astype(x.dtype)


def logarithm(f: jax.Array, correction: jax.Array, k: jax.Array) -> jax.Array:
    """Return k ln 2 + ln(1 + f) + correction for 1 + f in [2^(-1/2), 2^(1/2)).

    With s = f/(2 + f), the term ln(1 + f) = ln((1 + s)/(1 - s)) is 2 s plus s^3 times a series in s^2.

    Args:
        f: The argument of the logarithm minus 1.
        correction: A small number that is added to the logarithm, at its last digits.
        k: A whole number, as a floating-point number.
    """
    high, low = LN_2[width(f)]
    s = f / (2.0 + f)
    z = s * s
    half = 0.5 * f * f
    remainder = s * (half + z * polynomial(LOG_SERIES, z)) + (k * low + correction)
    return k * high - ((half - remainder) - f)


def normalised_mantissa(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Split a positive number x = 2^k m, which may be subnormal, into m in [2^(-1/2), 2^(1/2)) and the whole number k.

    A subnormal number is first multiplied by a power of two that makes it normal; k makes up for this factor.
    """
    lift = 54 if width(x) == 64 else 25
    is_subnormal = x < np.finfo(x.dtype).tiny
    fraction, k = mantissa(jnp.where(is_subnormal, x * 2.0**lift, x))
    return fraction, jnp.where(is_subnormal, k - lift, k)


def log_at_edges(x: jax.Array, regular_value: jax.Array) -> jax.Array:
    """Return the logarithm of x, given its value for a positive finite x.

    Args:
        x: Any number.
        regular_value: The logarithm if 0 < x < inf. The result is -inf at 0, inf at inf, and NaN for NaN and x < 0.
    """
    value = jnp.where(x < jnp.inf, regular_value, x)
    return jnp.where(x > 0.0, value, jnp.where(x == 0.0, -jnp.inf, jnp.nan))


def log(x: jax.Array) -> jax.Array:
    """Return the natural logarithm ln x; -inf at 0, and NaN below 0."""
    fraction, k = normalised_mantissa(x)
    return log_at_edges(x, logarithm(fraction - 1.0, jnp.zeros_like(x), k))


def log2(x: jax.Array) -> jax.Array:
    """Return the logarithm of x to base 2; -inf at 0, and NaN below 0."""
    fraction, k = normalised_mantissa(x)
    zero = jnp.zeros_like(x)
    return log_at_edges(x, k + logarithm(fraction - 1.0, zero, zero) * (1.0 / math.log(2.0)))


def log1p(x: jax.Array) -> jax.Array:
    """Return ln(1 + x), without cancellation near x = 0.

    The rounding error of u = 1 + x, divided by u, is added to ln u.
    """
    u = 1.0 + x
    rounding_error = jnp.where(x > 1.0, 1.0 - (u - x), x - (u - 1.0))
    fraction, k = mantissa(u)
    is_unscaled = k == 0.0
    f = jnp.where(is_unscaled, x, fraction - 1.0)
    value = logarithm(f, jnp.where(is_unscaled, 0.0, rounding_error / u), k)
    return jnp.where(x == 0.0, x, log_at_edges(u, value))


def tanh(x: jax.Array) -> jax.Array:
    """Return the hyperbolic tangent, whose magnitude is t/(t + 2) with t = e^(2|x|) - 1; it is 1 for |x| > 25."""
    t = expm1(jnp.minimum(2.0 * jnp.abs(x), 50.0))
    value = jnp.where(t < 1.0, t / (t + 2.0), 1.0 - 2.0 / (t + 2.0))
    return jnp.where(is_negative(x), -value, value)


def logistic(x: jax.Array) -> jax.Array:
    """Return the logistic function 1/(1 + e^-x), by e^-|x| alone, which cannot overflow."""
    small = exp(-jnp.abs(x))
    return jnp.where(x < 0.0, small, 1.0) / (1.0 + small)


def half_exponential(x: jax.Array) -> jax.Array:
    """Return e^x/2, which is finite for some x at which e^x overflows."""
    n, remainder = exponential(x)
    return scaled_by_power(1.0 + remainder, n - 1.0)


def sinh(x: jax.Array) -> jax.Array:
    """Return the hyperbolic sine. Its magnitude is (t + t/(t + 1))/2 with t = e^|x| - 1; e^|x|/2 for |x| >= 40."""
    size = jnp.abs(x)
    t = expm1(jnp.minimum(size, 40.0))
    value = jnp.where(size < 40.0, 0.5 * (t + t / (t + 1.0)), half_exponential(size))
    return jnp.where(is_negative(x), -value, value)


def cosh(x: jax.Array) -> jax.Array:
    """Return the hyperbolic cosine as h + 1/(4 h) with h = e^|x|/2."""
    half = half_exponential(jnp.abs(x))
    return half + 0.25 / half
