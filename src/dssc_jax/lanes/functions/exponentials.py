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
"""ln 2 as a sum of two parts, by the bits of a number; products of the first with moderate whole numbers are exact."""
EXPONENTIAL = tuple(1.0 / math.factorial(n) for n in range(14, 2, -1))
"""Taylor's coefficients of (e^x - 1 - x - x^2/2)/x^3, from the highest power on."""
EXPONENTS = {64: (-746.0, 711.0), 32: (-104.5, 90.0)}
"""Bounds of x, by the bits of a number, outside of which both e^x and e^x/2 are 0 or infinite."""

BINARY_EXPONENTS = {64: (-1076.0, 1025.0), 32: (-151.0, 129.0)}
"""Bounds of x, by the bits of a number, outside of which 2^x is 0 or infinite."""


def width(x: jax.Array) -> int:
    """Number of bits of a floating-point number, 32 or 64."""
    return 8 * jnp.asarray(x).dtype.itemsize


def bits_of(x: jax.Array) -> jax.Array:
    """The bits of a floating-point number as an integer of the same width."""
    return jax.lax.bitcast_convert_type(x, jnp.int64 if width(x) == 64 else jnp.int32)


def as_integer(x: jax.Array) -> jax.Array:
    """A whole floating-point number as an integer of the same width."""
    return x.astype(jnp.int64 if width(x) == 64 else jnp.int32)


def is_negative(x: jax.Array) -> jax.Array:
    """Whether the sign bit of a number is set, also that of -0."""
    return bits_of(x) < 0


def exponential_of_two(exponent: jax.Array, like: jax.Array) -> jax.Array:
    """2^n for a whole number n, in the dtype of ``like``; the result must be a normal number."""
    mantissa_bits, bias = (52, 1023) if width(like) == 64 else (23, 127)
    n = as_integer(exponent)
    return jax.lax.bitcast_convert_type((n + bias) << mantissa_bits, like.dtype)


def exponential_minus_one(r: jax.Array, correction: jax.Array | float = 0.0) -> jax.Array:
    """e^(r + correction) - 1 for |r| up to about ln 2 / 2, with a correction as small as a rounding error of r."""
    return r + (0.5 * r * r + (r * r * r * polynomial(EXPONENTIAL, r) + correction * (1.0 + r)))


def reduce_exponent(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Write x as n ln 2 + r + correction, with a whole number n and |r| up to about ln 2 / 2.

    x is first limited to :data:`EXPONENTS`; n is 0 for a NaN.

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
    """The whole number n and the number e^r - 1 that give e^x = 2^n e^r, where x = n ln 2 + r."""
    n, r, correction = reduce_exponent(x)
    return n, exponential_minus_one(r, correction)


def scaled_by_power(x: jax.Array, n: jax.Array) -> jax.Array:
    """2^n x, by two factors, so that only the final result can overflow or underflow."""
    half = jnp.floor(0.5 * n)
    return x * exponential_of_two(half, x) * exponential_of_two(n - half, x)


def exp(x: jax.Array) -> jax.Array:
    """e^x.

    An infinite result is selected and not computed: fast arithmetic could contract the last product with a following
    difference, and e^inf - inf would be NaN.
    """
    n, remainder = exponential(x)
    return jnp.where(x == jnp.inf, x, scaled_by_power(1.0 + remainder, n))


def exp2(x: jax.Array) -> jax.Array:
    """2^x; an infinite result is selected as in :func:`exp`."""
    bounded = jnp.clip(x, *BINARY_EXPONENTS[width(x)])
    n = jnp.round(bounded)
    remainder = exponential_minus_one((bounded - n) * math.log(2.0))
    return jnp.where(x == jnp.inf, x, scaled_by_power(1.0 + remainder, jnp.where(jnp.isnan(n), 0.0, n)))


def expm1(x: jax.Array) -> jax.Array:
    """e^x - 1, without cancellation near 0."""
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
    """k ln 2 + ln(1 + f + correction) for 1 + f in [2^(-1/2), 2^(1/2)) and a small correction.

    With s = f/(2 + f), ln(1 + f) = ln((1 + s)/(1 - s)) is 2 s and a series in s^2.
    """
    high, low = LN_2[width(f)]
    s = f / (2.0 + f)
    z = s * s
    half = 0.5 * f * f
    remainder = s * (half + z * polynomial(LOG_SERIES, z)) + (k * low + correction)
    return k * high - ((half - remainder) - f)


def normalised_mantissa(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """As :func:`mantissa`, for a positive number that may be subnormal; such a number is multiplied by 2^lift first."""
    lift = 54 if width(x) == 64 else 25
    is_subnormal = x < np.finfo(x.dtype).tiny
    fraction, k = mantissa(jnp.where(is_subnormal, x * 2.0**lift, x))
    return fraction, jnp.where(is_subnormal, k - lift, k)


def log_at_edges(x: jax.Array, regular_value: jax.Array) -> jax.Array:
    """The logarithm of x: ``regular_value``, but -inf at 0, infinity at infinity, and NaN for NaN and below 0."""
    value = jnp.where(x < jnp.inf, regular_value, x)
    return jnp.where(x > 0.0, value, jnp.where(x == 0.0, -jnp.inf, jnp.nan))


def log(x: jax.Array) -> jax.Array:
    """ln x."""
    fraction, k = normalised_mantissa(x)
    return log_at_edges(x, logarithm(fraction - 1.0, jnp.zeros_like(x), k))


def log2(x: jax.Array) -> jax.Array:
    """The logarithm to base 2."""
    fraction, k = normalised_mantissa(x)
    zero = jnp.zeros_like(x)
    return log_at_edges(x, k + logarithm(fraction - 1.0, zero, zero) * (1.0 / math.log(2.0)))


def log1p(x: jax.Array) -> jax.Array:
    """ln(1 + x), without cancellation near 0: the rounding error of u = 1 + x is added to its logarithm."""
    u = 1.0 + x
    rounding_error = jnp.where(x > 1.0, 1.0 - (u - x), x - (u - 1.0))
    fraction, k = mantissa(u)
    is_unscaled = k == 0.0
    f = jnp.where(is_unscaled, x, fraction - 1.0)
    value = logarithm(f, jnp.where(is_unscaled, 0.0, rounding_error / u), k)
    return jnp.where(x == 0.0, x, log_at_edges(u, value))


def tanh(x: jax.Array) -> jax.Array:
    """The hyperbolic tangent, t/(t + 2) with t = e^(2|x|) - 1; |x| beyond 25 gives 1."""
    t = expm1(jnp.minimum(2.0 * jnp.abs(x), 50.0))
    value = jnp.where(t < 1.0, t / (t + 2.0), 1.0 - 2.0 / (t + 2.0))
    return jnp.where(is_negative(x), -value, value)


def logistic(x: jax.Array) -> jax.Array:
    """The logistic function 1/(1 + e^-x); it computes e^-|x| alone, which does not overflow."""
    small = exp(-jnp.abs(x))
    return jnp.where(x < 0.0, small, 1.0) / (1.0 + small)


def half_exponential(x: jax.Array) -> jax.Array:
    """e^x/2, which overflows later than e^x."""
    n, remainder = exponential(x)
    return scaled_by_power(1.0 + remainder, n - 1.0)


def sinh(x: jax.Array) -> jax.Array:
    """The hyperbolic sine, (t + t/(t + 1))/2 with t = e^|x| - 1; from |x| = 40 on it is e^|x|/2."""
    size = jnp.abs(x)
    t = expm1(jnp.minimum(size, 40.0))
    value = jnp.where(size < 40.0, 0.5 * (t + t / (t + 1.0)), half_exponential(size))
    return jnp.where(is_negative(x), -value, value)


def cosh(x: jax.Array) -> jax.Array:
    """The hyperbolic cosine, h + 1/(4 h) with h = e^|x|/2."""
    half = half_exponential(jnp.abs(x))
    return half + 0.25 / half
