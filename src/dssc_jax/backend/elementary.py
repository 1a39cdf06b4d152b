"""Elementary functions as arithmetic, so that every machine and every width of vectors computes the same bits.

They are ordinary functions of JAX arrays, without branches: a lane's program traces them where it meets the primitive
of the same name. Within the ranges that the tests state, float64 and float32 results are within two units in the last
place of the exact value.

References:
    W. J. Cody, W. Waite, Software Manual for the Elementary Functions (1980): reduction of the argument.
    Sun Microsystems, FreeBSD's msun (1993): coefficients of sine, cosine and logarithm.
"""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core import numerics
from dssc_jax.core.numerics import polynomial
from dssc_jax.core.signals import Scalar

# pi/2 and ln 2 in parts; a product of all but the last with a whole number of moderate size is exact.
HALF_PI = {
    64: (1.57079632673412561417e0, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    32: (1.5703125, 4.837512969970703e-4, 7.549533620476723e-8, 2.5633440682570896e-12),
}
LN_2 = {64: (6.93147180369123816490e-1, 1.90821492927058770002e-10), 32: (0.693359375, -2.12194440054690582e-4)}
SINE_SERIES = (1.58969099521155010221e-10, -2.50507602534068634195e-8, 2.75573137070700676789e-6,
        -1.98412698298579493134e-4, 8.33333333332248946124e-3, -1.66666666666666324348e-1)  # fmt: skip
COSINE_SERIES = (-1.13596475577881948265e-11, 2.08757232129817482790e-9, -2.75573143513906633035e-7,
          2.48015872894767294178e-5, -1.38888888888741095749e-3, 4.16666666666666019037e-2)  # fmt: skip
EXPONENTIAL = tuple(1.0 / math.factorial(n) for n in range(14, 2, -1))  # of (e^x - 1 - x - x^2/2)/x^3, by Taylor
INVERSE_ERROR = {
    64: (
        (
            3.240704459379902e-21, -1.113483769832702e-21, -3.4996044354754177e-19, 1.150022252066253e-18,
            1.5574320246233251e-17, -1.3016928016796445e-16, -4.0282154327661744e-17, 6.5964077124208341e-15,
            -4.0012377350918961e-14, -8.1183994430743526e-14, 2.6304834740560442e-12, -1.2976885526532075e-11,
            -5.414287198084716e-11, 1.0512181539804126e-09, -4.1126608200232397e-09, -2.9070382262927266e-08,
            4.2347881737823391e-07, -1.3654691850603575e-06, -1.3882523394405316e-05, 0.00018673420802464837,
            -0.00074070253415447704, -0.0060336708714278497, 0.24015818242558831, 1.6536545626831027,
        ),
        (
            -1.5102695423335065e-08, 6.9692419776296945e-10, 1.3104351499972014e-07, -2.7134511054394561e-07,
            -2.7004219280868947e-08, 1.4987130784186127e-06, -3.986084395214756e-06, 2.9257291901789823e-06,
            1.2465167157087251e-05, -4.7318984120112452e-05, 6.8287086547533766e-05, 2.4031257015092525e-05,
            -0.00035503780975963814, 0.00095328936374356377, -0.0016882755357337071, 0.0024914420969817607,
            -0.003751208508215561, 0.0053709145535716799, 1.0052589676941652, 3.0838856104922208,
        ),
        (
            2.7520836691204922e-11, -2.2467591693364952e-11, -3.7171553416167463e-10, 1.4895546197648137e-09,
            -3.5875995609819953e-09, 7.6443359835573965e-09, -1.5146221782627176e-08, 2.9124399186491765e-08,
            -6.761414811460412e-08, 2.2901554497563463e-07, -9.9301191834829539e-07, 4.5260599477720725e-06,
            -1.9681773483763821e-05, 7.5995277351601924e-05, -0.00021503011962944126, -0.00013871931835112341,
            1.0103004648645413, 4.8499064014085844,
        ),
    ),
    32: (
        (
            -8.931925970244222e-09, 2.3335967195708108e-08, 4.6813134805534123e-07, -3.4639852676333717e-06,
            -4.9724196894547514e-06, 0.00021834938623976644, -0.0012527263917732291, -0.0041773928752031489,
            0.24664027905463662, 1.5014093604503289,
        ),
        (
            9.4318286945379432e-05, -0.00028383382080894755, -2.9263578703979435e-05, 0.0014519277163066668,
            -0.0036101715202431378, 0.0057004171379147631, -0.0076347339589097592, 0.0094435543259884531,
            1.0016747999742759, 2.8329768349758204,
        ),
    ),
}  # fmt: skip
"""Of erfinv(x)/x in powers of w - c, w = -ln(1 - x^2), near 0, and of w^(1/2) - c in the tails; highest power first.

They interpolate values of 50 digits at Chebyshev's nodes."""

INVERSE_ERROR_RANGES = {64: ((6.25, 3.125), (16.0, 3.25), (math.inf, 5.0)), 32: ((5.0, 2.5), (math.inf, 3.0))}
"""End of each range of w, and c."""

MOST_QUARTERS = {64: 2.0**20, 32: 2.0**12}  # quarter turns up to which the reduction is exact


def width(x: jax.Array) -> int:
    """Bits of a floating-point type."""
    return 8 * jnp.asarray(x).dtype.itemsize


def as_integer(x: jax.Array) -> jax.Array:
    """A whole number in the integer type of the same width."""
    return x.astype(jnp.int64 if width(x) == 64 else jnp.int32)


def exponential_of_two(exponent: jax.Array, like: jax.Array) -> jax.Array:
    """2^n of a whole number within the range of normal numbers."""
    digits, bias = (52, 1023) if width(like) == 64 else (23, 127)
    integer = as_integer(exponent)
    return jax.lax.bitcast_convert_type((integer + bias) << digits, like.dtype)


def quarter_turns(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The nearest whole number of quarter turns, and the remaining angle in two parts."""
    turns = jnp.round(x * (2.0 / math.pi))
    angle, rest = x, jnp.zeros_like(x)
    for part in HALF_PI[width(x)]:
        after = angle - turns * part
        rest = rest + ((angle - after) - turns * part)
        angle = after
    small = jnp.abs(turns) < MOST_QUARTERS[width(x)]
    beyond = jnp.clip(angle, -0.25 * math.pi, 0.25 * math.pi)
    return jnp.where(small, turns, 0.0), jnp.where(small, angle, beyond), jnp.where(small, rest, 0.0)


def sine_and_cosine(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Quarter turns as an integer, and sine and cosine of the rest of the angle."""
    turns, angle, rest = quarter_turns(x)
    z = angle * angle
    sine = angle + (rest + angle * (z * polynomial(SINE_SERIES, z) - 0.5 * angle * rest))
    half = 0.5 * z
    near = 1.0 - half
    cosine = near + (((1.0 - near) - half) + (z * z * polynomial(COSINE_SERIES, z) - angle * rest))
    return as_integer(turns), sine, cosine


def sin(x: jax.Array) -> jax.Array:
    """The sine; bounded by 1, but without meaning, beyond :data:`MOST_QUARTERS`."""
    turns, sine, cosine = sine_and_cosine(x)
    value = jnp.where(turns & 1 == 1, cosine, sine)
    return jnp.where(turns & 2 == 2, -value, value)


def cos(x: jax.Array) -> jax.Array:
    """The cosine, with the range of :func:`sin`."""
    turns, sine, cosine = sine_and_cosine(x)
    value = jnp.where(turns & 1 == 1, sine, cosine)
    return jnp.where((turns + 1) & 2 == 2, -value, value)


def tan(x: jax.Array) -> jax.Array:
    """The tangent, with the range of :func:`sin`."""
    turns, sine, cosine = sine_and_cosine(x)
    odd = turns & 1 == 1
    return jnp.where(odd, -cosine, sine) / jnp.where(odd, sine, cosine)


def exponential(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """A whole number n and e^r - 1 with x = n ln 2 + r; x is limited to the range of results that are not 0 or inf."""
    high, low = LN_2[width(x)]
    least, most = (-745.2, 709.8) if width(x) == 64 else (-104.0, 88.8)
    x = jnp.clip(x, least, most)
    n = jnp.round(x * (1.0 / math.log(2.0)))
    first = x - n * high
    r = first - n * low
    rest = (first - r) - n * low
    return n, r + (0.5 * r * r + (r * r * r * polynomial(EXPONENTIAL, r) + rest * (1.0 + r)))


def scaled(x: jax.Array, n: jax.Array) -> jax.Array:
    """2^n x, through two factors, so that the first result out of range is the last."""
    half = jnp.floor(0.5 * n)
    return x * exponential_of_two(half, x) * exponential_of_two(n - half, x)


def exp(x: jax.Array) -> jax.Array:
    """e^x."""
    n, rest = exponential(x)
    value = scaled(1.0 + rest, jnp.where(jnp.isnan(n), 0.0, n))
    return jnp.where(jnp.isnan(x), x, value)


def expm1(x: jax.Array) -> jax.Array:
    """e^x - 1, also near 0."""
    n, rest = exponential(x)
    n = jnp.where(jnp.isnan(n), 0.0, n)
    far = jnp.abs(n) > 60.0
    factor = exponential_of_two(jnp.where(far, 0.0, n), x)
    value = factor * rest + (factor - 1.0)
    value = jnp.where(n == 0.0, rest, jnp.where(far, scaled(1.0 + rest, n) - 1.0, value))
    return jnp.where(jnp.isnan(x) | (x == 0.0), x, value)


def logarithm(mantissa: jax.Array, correction: jax.Array, k: jax.Array) -> jax.Array:
    """k ln 2 + ln(1 + f + correction) for 1 + f = ``mantissa`` - 1 in [2^(-1/2), 2^(1/2)) and a small correction."""
    high, low = LN_2[width(mantissa)]
    f = mantissa
    s = f / (2.0 + f)
    z = s * s
    half = 0.5 * f * f
    rest = s * (half + z * polynomial(numerics.LOG_SERIES, z)) + (k * low + correction)
    return k * high - ((half - rest) - f)


def split_exponent(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """k and 2^-k with 2^-k x in [2^(-1/2), 2^(1/2)), for a positive normal number."""
    digits, bias, root = (52, 1023, 0x3FE6A09E667F3BCD) if width(x) == 64 else (23, 127, 0x3F3504F3)
    bits = jax.lax.bitcast_convert_type(x, jnp.int64 if width(x) == 64 else jnp.int32)
    exponent = (bits - root) >> digits
    return exponent.astype(x.dtype), jax.lax.bitcast_convert_type((bias - exponent) << digits, x.dtype)


def log_at_edges(x: jax.Array, inside: jax.Array) -> jax.Array:
    """The logarithm with its values at 0, infinity, NaN and below 0."""
    value = jnp.where(x < jnp.inf, inside, x)
    return jnp.where(x > 0.0, value, jnp.where(x == 0.0, -jnp.inf, jnp.nan))


def log(x: jax.Array) -> jax.Array:
    """ln x."""
    least = np.finfo(x.dtype).tiny
    lift = 2.0 ** (54 if width(x) == 64 else 25)
    small = x < least
    normal = jnp.where(small, x * lift, x)
    k, scale = split_exponent(normal)
    f = normal * scale - 1.0
    k = jnp.where(small, k - math.log2(lift), k)
    return log_at_edges(x, logarithm(f, jnp.zeros_like(x), k))


def log1p(x: jax.Array) -> jax.Array:
    """ln(1 + x), also near 0."""
    u = 1.0 + x
    lost = jnp.where(x > 1.0, 1.0 - (u - x), x - (u - 1.0))
    k, scale = split_exponent(u)
    near = k == 0.0
    f = jnp.where(near, x, u * scale - 1.0)
    value = logarithm(f, jnp.where(near, 0.0, lost * scale / (1.0 + f)), k)
    return jnp.where(x == 0.0, x, log_at_edges(u, value))


def tanh(x: jax.Array) -> jax.Array:
    """The hyperbolic tangent."""
    t = expm1(jnp.minimum(2.0 * jnp.abs(x), 50.0))
    value = jnp.where(t < 1.0, t / (t + 2.0), 1.0 - 2.0 / (t + 2.0))
    return jnp.where(x < 0.0, -value, value)


def logistic(x: jax.Array) -> jax.Array:
    """1/(1 + e^-x)."""
    return 1.0 / (1.0 + exp(-x))


def erf_inv(x: jax.Array) -> jax.Array:
    """The inverse of the error function; its tails are computed only if a lane is in them.

    The form in w is that of M. Giles, "Approximating the erfinv function", GPU Computing Gems, Jade Edition (2012).
    """
    y = (1.0 - x) * (1.0 + x)
    k, scale = split_exponent(y)
    w = -logarithm(y * scale - 1.0, jnp.zeros_like(x), k)
    near, *tails = zip(INVERSE_ERROR[width(x)], INVERSE_ERROR_RANGES[width(x)], strict=True)

    def tail() -> jax.Array:
        root = jnp.sqrt(w)
        *others, (coefficients, (_, centre)) = tails
        value = jnp.asarray(polynomial(coefficients, root - centre))
        for coefficients, (end, centre) in reversed(others):
            value = jnp.where(w < end, polynomial(coefficients, root - centre), value)
        return jnp.where(y > 0.0, value, jnp.where(y == 0.0, jnp.inf, jnp.nan))

    coefficients, (end, centre) = near
    central = polynomial(coefficients, w - centre)
    return x * jax.lax.cond(y > math.exp(-end), lambda: jnp.asarray(central), tail)


def sinh(x: jax.Array) -> jax.Array:
    """The hyperbolic sine."""
    t = expm1(jnp.abs(x))
    value = 0.5 * (t + t / (t + 1.0))
    return jnp.where(x < 0.0, -value, jnp.where(jnp.isinf(t), jnp.abs(x), value))


def cosh(x: jax.Array) -> jax.Array:
    """The hyperbolic cosine."""
    t = exp(jnp.abs(x))
    return 0.5 * (t + 1.0 / t)


def asin(x: jax.Array) -> jax.Array:
    """The arc sine."""
    return jnp.asarray(numerics.atan2(x, jnp.sqrt((1.0 - x) * (1.0 + x))))


def acos(x: jax.Array) -> jax.Array:
    """The arc cosine."""
    return jnp.asarray(numerics.atan2(jnp.sqrt((1.0 - x) * (1.0 + x)), x))


def is_negative(x: jax.Array) -> jax.Array:
    """Whether the sign is negative, also of zero."""
    return jax.lax.bitcast_convert_type(x, jnp.int64 if width(x) == 64 else jnp.int32) < 0


def angle(y: jax.Array, x: jax.Array) -> jax.Array:
    """The angle of (x, y) in [-pi, pi]."""
    both = jnp.isinf(x) & jnp.isinf(y)  # a diagonal
    magnitude = numerics.atan2(jnp.where(both, 1.0, jnp.abs(y)), jnp.where(both, jnp.sign(x), x))
    magnitude = jnp.where((x == 0.0) & (y == 0.0) & is_negative(x), math.pi, magnitude)
    return jnp.where(is_negative(y), -magnitude, magnitude)


def general_power(x: jax.Array, y: jax.Array) -> jax.Array:
    """x^y for x >= 0, and for whole y also of negative x; relative error about |y ln x| units in the last place."""
    whole = jnp.floor(y) == y
    odd = whole & (jnp.abs(y - 2.0 * jnp.floor(0.5 * y)) == 1.0)
    value = exp(y * log(jnp.abs(x)))
    value = jnp.where((y == 0.0) | (x == 1.0), 1.0, value)
    value = jnp.where((x < 0.0) & odd, -value, value)
    return jnp.where((x < 0.0) & ~whole, jnp.nan, value)


ELEMENTARY: dict[str, Callable[..., Scalar]] = {
    "sin": sin, "cos": cos, "tan": tan, "exp": exp, "expm1": expm1, "log": log, "log1p": log1p, "tanh": tanh,
    "erf_inv": erf_inv, "logistic": logistic, "sinh": sinh, "cosh": cosh, "asin": asin, "acos": acos,
    "atan": numerics.atan, "atan2": angle, "pow": general_power,
    "exp2": lambda x: exp(x * math.log(2.0)), "log2": lambda x: log(x) * (1.0 / math.log(2.0)),
    "one_minus_square": lambda x: (1.0 + x) * (1.0 - x),
}  # fmt: skip
"""Function of each primitive by its name. A new one takes its definition above and its name here."""
