"""Numerically safe versions of common functions; each docstring gives the reason."""

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from types import ModuleType
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.core.signals import Params, Scalar
from dssc_jax.lanes.functions.approximations import LOG_SERIES, polynomial

Tree = TypeVar("Tree")

LOG_2 = math.log(2.0)


@contextmanager
def arithmetic(precision: int = 64) -> Iterator[None]:
    """Set JAX's precision, 32 or 64 bits, and silence NumPy's floating-point warnings within a ``with`` block.

    The warnings are silenced because an overflow is no fault of the program: the draw that diverges ends early.
    """
    with jax.enable_x64(precision == 64), np.errstate(all="ignore"):
        yield


def namespace(*values: object) -> ModuleType:
    """Return the module to compute with: ``jax.numpy`` if one of the values is an array of JAX, else NumPy.

    NumPy computes in float64 whatever JAX's precision is.
    """
    return jnp if any(isinstance(value, jax.Array) for value in values) else np


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def root_abs(x: Scalar, floor: float = 0.0) -> Scalar:
    """Return the root r = |x|^(1/2), or ``floor`` if ``floor`` is larger, with gradient 0 at x = 0.

    The true slope at 0 is infinite, and would make derivatives NaN.
    """
    magnitude = jnp.abs(x)
    return jnp.sqrt(jnp.maximum(magnitude, floor**2) if floor else magnitude)


@root_abs.defjvp
def root_abs_slope(floor: float, at: tuple[Scalar], tangent: tuple[Scalar]) -> tuple[Scalar, Scalar]:
    """Return the JVP of :func:`root_abs`: value and tangent, with the slope sgn(x)/(2 r) for |x| > floor^2, else 0."""
    (x,) = at
    (x_dot,) = tangent
    is_steep = jnp.abs(x) > floor**2
    r = root_abs(x, floor)
    return r, x_dot * jnp.where(is_steep, jnp.sign(x) / (2.0 * jnp.where(is_steep, r, 1.0)), 0.0)


def binary_exponent(x: Scalar) -> tuple[Scalar, Scalar]:
    """Return the whole number k with 2^-k x in [2^(-1/2), 2^(1/2)), and 2^-k, for x >= 1.

    Both numbers are computed from the bits of x, in arithmetic that vectorises. Their derivative is 0.
    """
    x = jax.lax.stop_gradient(jnp.asarray(x))
    is_double = x.dtype == jnp.float64
    # an integer as long as x, the number of digits of the fraction, and the bias of the exponent
    integer, digits, bias = (jnp.int64, 52, 1023) if is_double else (jnp.int32, 23, 127)
    root = 0x3FE6A09E667F3BCD if is_double else 0x3F3504F3  # 2^(-1/2)
    bits = jax.lax.bitcast_convert_type(x, integer)
    exponent = (bits - integer(root)) >> integer(digits)
    # 2^digits + k, by its bits
    shifted_exponent = jax.lax.bitcast_convert_type(exponent | integer((bias + digits) << digits), x.dtype)
    scale = jax.lax.bitcast_convert_type((integer(bias) - exponent) << integer(digits), x.dtype)
    return shifted_exponent - 2.0**digits, scale


def log_defect(x: Scalar) -> Scalar:
    """Return (x - ln(1 + x))/x^2 for x >= 0, whose singularity at 0 is removable: the limit is 1/2.

    With 1 + x = 2^k (1 + f) and s = f/(2 + f), ln(1 + x) is k ln 2 + 2 s + s^3 q(s^2). If k = 0, then f = x and
    x - 2 s = x s, so the quotient is (2 + x - s q)/(2 + x)^2, in which nothing cancels.

    The polynomial q is that of FreeBSD's e_log.c (Sun Microsystems, 1993).
    """
    k, scale = binary_exponent(1.0 + x)
    is_small = k == 0.0
    f = jnp.where(is_small, x, (1.0 + x) * scale - 1.0)
    s = f / (2.0 + f)
    z = s * s
    remainder = s * polynomial(LOG_SERIES, z)
    log = k * LOG_2 + 2.0 * s + z * remainder
    return jnp.where(is_small, 2.0 + x - remainder, x - log) / jnp.where(is_small, (2.0 + x) * (2.0 + x), x * x)


def root_of(excess: Scalar, slope: Scalar) -> Scalar:
    """Return the positive root s of s^2 + slope s = excess if excess > 0, else 0."""
    is_positive = excess > 0.0
    positive_excess = jnp.where(is_positive, excess, 1.0)
    # 2 c/(b + sqrt(b^2 + 4 c)): the difference of the textbook form cancels for small excess
    return jnp.where(
        is_positive, 2.0 * positive_excess / (slope + jnp.sqrt(slope * slope + 4.0 * positive_excess)), 0.0
    )


def sign(x: Scalar) -> Scalar:
    """Return sgn x: -1, 0 or 1, with sgn 0 = 0."""
    return jnp.sign(x)


def clip(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """Return the value in [low, high] that is nearest to x. A NaN x stays NaN; a NaN bound has no effect.

    With this rule each bound costs one machine instruction. In ``jnp.clip`` a NaN bound gives NaN, which costs three.
    """
    x = jnp.where(low > x, low, x)
    return jnp.where(high < x, high, x)


def as_vector(tree: Tree) -> tuple[jax.Array, Callable[[jax.Array], Tree]]:
    """Return the numbers of a tree as one vector, shape (n,), and the function that makes such a tree from a vector."""
    return ravel_pytree(jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree))


def as_arrays(tree: Tree) -> Tree:
    """Convert the numbers of a tree to arrays of the working precision, so that the carry of a scan keeps its types.

    Words of memory (:func:`is_word`) stay as they are.
    """
    return jax.tree.map(lambda x: x if is_word(x) else jnp.asarray(x, dtype=jnp.result_type(float)), tree)


def is_word(x: Scalar) -> bool:
    """Whether a value is a word of memory, such as a part of the state of a controller in C, and not a real number."""
    return isinstance(x, jax.Array) and jnp.issubdtype(x.dtype, jnp.unsignedinteger)


def is_zero(value: Scalar) -> bool:
    """Whether a value is 0 and known before tracing, so that the program can leave out operations on it."""
    return is_known(value) and float(value) == 0.0


def is_known(value: Scalar) -> bool:
    """Whether a value is a number of Python or NumPy, known before tracing; arrays of JAX are not."""
    return isinstance(value, int | float | np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0)


def times(left: Scalar, right: Scalar) -> Scalar:
    """Return the product of two numbers; a plain 0.0, without an operation, if a factor is 0 before tracing."""
    return 0.0 if is_zero(left) or is_zero(right) else left * right


def difference(minuend: Scalar, subtrahend: Scalar) -> Scalar:
    """Return the difference of two numbers; the minuend itself if the subtrahend is 0 before tracing."""
    return minuend if is_zero(subtrahend) else minuend - subtrahend


def at_least(x: Scalar, low: float) -> Scalar:
    """Return the larger of x and low; for a Python float x, a Python float, so that constants stay constants."""
    return max(x, low) if isinstance(x, float) else jnp.maximum(x, low)


def saturate(x: Scalar, limit: Scalar) -> Scalar:
    """Return the value in [-limit, limit] that is nearest to x; for NaN see :func:`clip`."""
    return clip(x, -limit, limit)


@partial(jax.jit, static_argnums=(0, 4))  # traced once for all channels of a controller
def newton(
    tangent: Callable[[Params, Scalar], tuple[Scalar, Scalar]],
    parameters: Params,
    value: Scalar,
    start: Scalar,
    steps: int,
) -> Scalar:
    """Solve f(x) = value by a fixed number of steps of Newton's method, and return x.

    Args:
        tangent: ``(parameters, x) -> (f(x), f'(x))``. It should be a function of a module and no closure, because each
            new function object is traced anew.
        parameters: Parameters of f.
        value: The value of f at the solution.
        start: First x.
        steps: Number of steps.
    """

    def newton_step(_: int, x: Scalar) -> Scalar:
        """Return the zero of the tangent that f(x) - value has at x."""
        f, slope = tangent(parameters, x)
        return x + (value - f) / slope

    return jax.lax.fori_loop(0, steps, newton_step, jnp.asarray(start))


def turned_near(angle: Scalar, target: Scalar) -> Scalar:
    """Return the angle [rad] plus the whole turns that bring its difference from a target into (-pi, pi].

    An angle that needs no turn is returned with the same bits.
    """
    return angle - 2.0 * math.pi * jnp.ceil((angle - target - math.pi) / (2.0 * math.pi))


def wrap_angle(angle: Scalar) -> Scalar:
    """Return the same angle in (-pi, pi] [rad]."""
    return turned_near(angle, 0.0)


@jax.custom_jvp
def elapsed_share(at: Scalar, t: Scalar, dt: Scalar) -> Scalar:
    """Return the share in [0, 1] of the sample [t, t + dt) that lies after the time ``at`` [s].

    A held signal that begins within the sample acts with its mean, which is its value times this share. If ``at`` is
    the start of a sample, the derivative is one-sided: the one for a later ``at``.

    Args:
        at: The time [s].
        t: Start of the sample [s].
        dt: Length of the sample [s].
    """
    return jnp.clip((t + dt - at) / dt, 0.0, 1.0)


@elapsed_share.defjvp
def elapsed_share_slope(
    point: tuple[Scalar, Scalar, Scalar], tangents: tuple[Scalar, Scalar, Scalar]
) -> tuple[Scalar, Scalar]:
    """Return the JVP of :func:`elapsed_share`: value and tangent, with a slope where the share is in (0, 1].

    The comparisons with 0 and 1 allow for the rounding of the times, so that exactly one of two consecutive samples has
    a slope if ``at`` is the time between them.
    """
    at, t, dt = point
    share, slope = jax.jvp(lambda at, t, dt: (t + dt - at) / dt, point, tangents)
    rounding = 8.0 * jnp.finfo(jnp.result_type(share)).eps * (jnp.abs(t) + jnp.abs(at) + dt) / dt
    is_within = (share > rounding) & (share <= 1.0 + rounding)
    return elapsed_share(at, t, dt), jnp.where(is_within, slope, 0.0)


def delay_weights(samples: Scalar, count: int) -> list[Scalar]:
    """Return the weights of the last held signals in the mean of a delayed signal over a sample.

    With a delay of n + f samples, 0 <= f < 1, the signal n samples ago has the weight 1 - f, the signal before it f,
    and all others 0. If the delay is a whole number of samples, the derivative is one-sided: the one for a longer delay
    or, at the longest delay, for a shorter one.

    Args:
        samples: The delay in samples, from 0 to count - 1.
        count: Number of signals in memory; at least 2.

    Returns:
        ``count`` weights, that of the present signal first.
    """
    whole = jnp.minimum(jnp.floor(samples), count - 2.0)  # n
    weights = []
    for age in range(count):
        weight = jnp.where(whole == age, 1.0 - (samples - age), 0.0)  # 1 - f
        weights.append(jnp.where(whole == age - 1, 1.0 - (age - samples), weight))  # f
    return weights


def stream(name: str) -> int:
    """Return the index of a random stream, computed from the name of the number or part that draws from the stream.

    Because the index depends on the name alone, the draws of a number do not change when other numbers are added.
    """
    return zlib.crc32(name.encode())


def dot(left: Sequence[Scalar], right: Sequence[Scalar]) -> Scalar:
    """Return the scalar product of two tuples, computed term by term, because scalars compile to scalar arithmetic.

    A term whose left factor is the Python float 0.0 is omitted; a left factor 1.0 costs no multiplication.
    """
    total: Scalar = 0.0
    for a, b in zip(left, right, strict=True):
        if isinstance(a, float) and a == 0.0:
            continue
        total = total + (b if isinstance(a, float) and a == 1.0 else a * b)
    return total


def cubic_spline(coefficients: Sequence[Scalar], x: Scalar) -> Scalar:
    """Return the sum of c_i B(x - i), where B is the cubic B-spline with support (-2, 2) and knots at whole numbers.

    The sum lies between the smallest and the largest of (0, c_0, c_1, ..., 0). Its slope lies between the smallest and
    the largest difference of two consecutive numbers of this sequence.

    Reference:
        C. de Boor, A Practical Guide to Splines, revised ed. (2001), chapters IX to XI.
    """
    total: Scalar = 0.0
    for i, coefficient in enumerate(coefficients):
        distance = jnp.abs(x - i)
        outer = jnp.maximum(2.0 - distance, 0.0)
        inner = jnp.maximum(1.0 - distance, 0.0)
        total = total + coefficient * (outer * outer * outer - 4.0 * inner * inner * inner) / 6.0
    return total


def spline_end(at: float, interval: float, knots: int) -> float:
    """Return the time [s] at which a cubic spline is 0 again: two intervals after the last knot.

    Args:
        at: Time of the first knot [s].
        interval: Time between two knots [s].
        knots: Number of knots.
    """
    return at + (knots + 1) * interval


def uniforms(key: jax.Array, count: int) -> tuple[Scalar, ...]:
    """Return independent random numbers, uniform in [0, 1).

    In float32 the numbers have the leading bits of those in float64. So the precision of a study does not change its
    draws, as it would with ``jax.random.uniform``.

    The numbers are scalars, each drawn from the key folded with the number's index. So a batch is vectorised along its
    lanes; an array of all numbers would be vectorised along its short last axis.

    Args:
        key: Random key.
        count: Number of random numbers.
    """
    real = jnp.result_type(float)

    def uniform(i: int) -> Scalar:
        """Return random number i: random bits as the fraction of a number in [1, 2), minus 1."""
        high, low = jax.random.key_data(jax.random.fold_in(key, i))
        if real == jnp.float64:
            fraction = (high.astype(jnp.uint64) << 32 | low) >> 12 | np.uint64(0x3FF << 52)
        else:
            fraction = high >> 9 | np.uint32(0x7F << 23)
        return jax.lax.bitcast_convert_type(fraction, real) - 1.0

    return tuple(uniform(i) for i in range(count))


def standard_normals(key: jax.Array, count: int) -> tuple[Scalar, ...]:
    """Return independent standard normal random numbers, computed from :func:`uniforms`.

    In float64 the result equals ``jax.random.normal(key, (count,))``; in float32 it equals the same up to rounding.

    Args:
        key: Random key.
        count: Number of random numbers.
    """
    real = jnp.result_type(float)
    lowest = np.nextafter(np.array(-1.0, real), np.array(0.0, real))  # the smallest number above -1

    def standard_normal(uniform: Scalar) -> Scalar:
        """Return sqrt 2 erf^-1(v) for v uniform in (-1, 1), given a number uniform in [0, 1)."""
        return np.sqrt(2.0).astype(real) * jax.lax.erf_inv(jnp.maximum(lowest, uniform * (1.0 - lowest) + lowest))

    return tuple(map(standard_normal, uniforms(key, count)))


def standard_normal(key: jax.Array) -> Scalar:
    """Return one standard normal random number, the first of :func:`standard_normals`."""
    return standard_normals(key, 1)[0]
