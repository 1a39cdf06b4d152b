"""Elementary functions on hostile numbers: around all powers of two, subnormal ones among them, and at infinity."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from jax import lax

from dssc_jax.lanes.lanes import CompiledLanes
from tests.lanes.against_plain import arithmetic, both

LEAST_FRACTION = 6381956970095103.0 * 2.0**797, 16367173.0 * 2.0**72
"""Closest to a multiple of pi/2 among all numbers of 64 and of 32 bits."""

DIGITS = 40
FUNCTIONS = {
    "sin": (lax.sin, mpmath.sin, 1.0),
    "cos": (lax.cos, mpmath.cos, 1.0),
    "tan": (lax.tan, mpmath.tan, 2.0),
    "exp": (lax.exp, mpmath.exp, 1.0),
    "exp2": (lax.exp2, lambda x: mpmath.power(2, x), 1.0),
    "expm1": (lax.expm1, mpmath.expm1, 1.0),
    "log": (lax.log, mpmath.log, 1.0),
    "log1p": (lax.log1p, mpmath.log1p, 1.0),
    "sinh": (lax.sinh, mpmath.sinh, 2.0),
    "cosh": (lax.cosh, mpmath.cosh, 1.0),
    "tanh": (lax.tanh, mpmath.tanh, 3.0),
    "logistic": (lax.logistic, lambda x: 1 / (1 + mpmath.exp(-x)), 2.0),
    "asin": (lax.asin, mpmath.asin, 2.0),
    "acos": (lax.acos, mpmath.acos, 2.0),
    "atan": (lax.atan, mpmath.atan, 2.0),
    "erf_inv": (lax.erf_inv, mpmath.erfinv, 2.0),
}
"""Function, its exact form and the largest error in units in the last place; docs/lanes.md has the same numbers."""

BOUNDED = {"asin": 1.0, "acos": 1.0, "erf_inv": 0.999999}
GROWING = {"exp", "exp2", "expm1", "sinh", "cosh", "tanh", "logistic"}
BEYOND_ALL = 2000.0
"""Where growing functions have reached their limit in every precision."""


def around_powers_of_two(dtype):
    """Powers of two, their neighbours, and numbers between them, of both signs."""
    limits, rng = np.finfo(dtype), np.random.default_rng(3)
    exponents = np.arange(limits.minexp - limits.nmant, limits.maxexp, 9 if dtype.itemsize == 8 else 2)
    powers = np.ldexp(dtype.type(1), exponents).astype(dtype)
    between = [powers * dtype.type(2.0**0.5), (powers * rng.uniform(1.0, 2.0, len(powers))).astype(dtype)]
    neighbours = [np.nextafter(powers, dtype.type(0)), np.nextafter(powers, dtype.type(np.inf))]
    ends = [limits.max, limits.tiny, 710.4, 709.8, 745.1, 709.7, 88.7, 89.4, 103.9, 2.0**1022.5, 2.0**127.5, 36.0, 8.5]
    turns = 0.5 * np.pi * np.array([1.0, 2.0, 3.0, 2.0**12, 2.0**20, 2.0**20 + 1.0])
    with np.errstate(over="ignore"):
        some = np.array([*ends, *turns, *LEAST_FRACTION], dtype)
    x = np.concatenate([powers, *neighbours, *between, some])
    x = x[np.isfinite(x)]
    return np.concatenate([x, -x])


def points(name, dtype):
    """The numbers of a function's domain."""
    x = around_powers_of_two(dtype)
    if name in BOUNDED:
        near_one = 1.0 - np.ldexp(1.0, -np.arange(1, 20))
        x = np.concatenate([x, near_one, -near_one]).astype(dtype)
        x = x[np.abs(x) <= BOUNDED[name]]
        return x[::5] if name == "erf_inv" else x
    if name == "log":
        return x[x > 0.0]
    return x[x > -1.0] if name == "log1p" else x


def exact_value(name, reference, x):
    """The function of one number; digits enough for its whole quarter turns."""
    turning = name in ("sin", "cos", "tan") and abs(x) > 1e6
    with mpmath.workdps(DIGITS + 320 if turning else DIGITS):
        argument = mpmath.mpf(float(x))
        if name in GROWING and abs(argument) > BEYOND_ALL:
            argument = mpmath.sign(argument) * BEYOND_ALL
        return reference(argument)


def unit(exact, dtype):
    """The distance of a type's numbers at an exact value."""
    limits = np.finfo(dtype)
    exponent = limits.minexp if exact == 0 else max(mpmath.frexp(abs(exact))[1] - 1, limits.minexp)
    return mpmath.ldexp(1, int(exponent - limits.nmant))


def error_of(exact, computed):
    """The error of a number in units in the last place; infinity stands for what rounds to it."""
    dtype = computed.dtype
    largest = mpmath.mpf(float(np.finfo(dtype).max)) + unit(mpmath.mpf(float(np.finfo(dtype).max)), dtype) / 2
    if abs(exact) >= largest:
        return 0.0 if computed == np.inf * int(mpmath.sign(exact)) else np.inf
    if not np.isfinite(computed):
        return np.inf
    return float(abs(mpmath.mpf(float(computed)) - exact) / unit(exact, dtype))


def compiled(function, *columns, strict):
    """A function of scalars as machine code on columns."""
    with arithmetic(8 * columns[0].dtype.itemsize):
        types = [jax.ShapeDtypeStruct((), column.dtype) for column in columns]
        return CompiledLanes(function, *types, strict=strict).start(columns, len(columns[0]), 1)()


@pytest.mark.parametrize("bits", [64, 32])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_is_right_over_its_whole_range(name, bits):
    function, reference, limit = FUNCTIONS[name]
    x = points(name, np.dtype(f"f{bits // 8}"))
    exact = [exact_value(name, reference, number) for number in x]
    for strict in (True, False):
        computed = compiled(function, x, strict=strict)
        assert computed.dtype == x.dtype
        errors = [error_of(*pair) for pair in zip(exact, computed, strict=True)]
        worst = int(np.argmax(errors))
        assert errors[worst] <= limit, (strict, x[worst], computed[worst], errors[worst])


@pytest.mark.parametrize("bits", [64, 32])
def test_a_power_is_right_over_its_whole_range(bits):
    """Exponents up to where the result is 0 or infinite, of bases of every size and of those near 1."""
    dtype, rng, count = np.dtype(f"f{bits // 8}"), np.random.default_rng(4), 1500
    limits, largest = np.finfo(dtype), 745.0 if bits == 64 else 103.0
    sizes = np.ldexp(rng.uniform(1.0, 2.0, count), rng.integers(limits.minexp - limits.nmant, limits.maxexp, count))
    near_one = 1.0 + rng.normal(size=count) * np.exp(-rng.uniform(2.0, 30.0, count))
    x = np.concatenate([sizes, near_one]).astype(dtype)
    x = x[x != 1.0]
    y = (rng.uniform(-1.02, 1.02, len(x)) * largest / np.log(x.astype(np.float64))).astype(dtype)
    for strict in (True, False):
        computed = compiled(lax.pow, x, y, strict=strict)
        with mpmath.workdps(60):
            exact = [mpmath.power(float(a), mpmath.mpf(float(b))) for a, b in zip(x, y, strict=True)]
            assert max(error_of(*pair) for pair in zip(exact, computed, strict=True)) <= 1.5


@pytest.mark.parametrize("bits", [64, 32])
def test_an_angle_is_right_for_sides_of_every_size(bits):
    dtype, rng, count = np.dtype(f"f{bits // 8}"), np.random.default_rng(5), 1000
    limits = np.finfo(dtype)
    sizes = np.ldexp(rng.uniform(1.0, 2.0, count), rng.integers(limits.minexp - limits.nmant, limits.maxexp, count))
    with np.errstate(over="ignore"):
        y, x = sizes.astype(dtype), (sizes * np.exp(rng.normal(size=count))).astype(dtype)
    x *= rng.choice([-1.0, 1.0], count).astype(dtype)
    kept = np.isfinite(x)
    y, x = y[kept], x[kept]
    computed = compiled(lax.atan2, y, x, strict=True)
    with mpmath.workdps(DIGITS):
        exact = [mpmath.atan2(float(a), float(b)) for a, b in zip(y, x, strict=True)]
    assert max(error_of(*pair) for pair in zip(exact, computed, strict=True)) <= 3.0


SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -2.0, 3.0, -3.0, 0.3, np.inf, -np.inf, np.nan, 1e300, -1e300,
                    2.0**52 + 1.0, -(2.0**52) - 1.0, 5e-324, -1e-310])  # fmt: skip


def same_special(found, expected):
    """NaN, infinities and signs of zero alike; numbers within a few units."""
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=0.0)
    known = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(found[known]), np.signbit(expected[known]))


@pytest.mark.parametrize(("function", "reference"), [(lax.pow, np.power), (lax.atan2, np.arctan2)])
def test_two_special_numbers_give_what_c99_says(function, reference):
    """Such as (-inf)^0.3, x^1, 1^NaN and the angles of infinite sides."""
    x, y = (grid.ravel() for grid in np.meshgrid(SPECIAL, SPECIAL))
    with np.errstate(all="ignore"):
        same_special(compiled(function, x, y, strict=True), reference(x, y))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_special_numbers_give_what_plain_xla_gives(name):
    """The signs of zeros, too."""
    x = np.array([0.0, -0.0, np.inf, -np.inf, np.nan])
    lanes, plain = both(FUNCTIONS[name][0], x, strict=True)
    same_special(lanes, plain)


def test_a_whole_exponent_of_an_integer_type():
    x, n = (grid.ravel() for grid in np.meshgrid(np.array([1.5, -2.0, 0.0]), np.arange(-3, 4, dtype=np.int32)))
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(compiled(lax.pow, x, n, strict=True), x ** n.astype(float), rtol=1e-15)


@pytest.mark.parametrize("width", [1, 8, 32])
def test_far_angles_have_the_same_bits_for_every_width_and_time(width):
    """Where only some lanes call the subroutine, and where the time alone does."""
    x = np.where(np.arange(37) % 5 == 0, 1e10, 0.7) * np.linspace(1.0, 2.0, 37)

    def lane(x):
        def turn(carry):
            k, s = carry
            wave = jnp.sin(1e7 * k) + jnp.cos(0.1 * k) * jnp.sin(0.2 * k) + jnp.tan(0.3 * k)
            return k + 1, 0.5 * s + wave * jnp.cos(s * x)

        return lax.while_loop(lambda carry: carry[0] < 29, turn, (0, x))[1]

    typed = jax.ShapeDtypeStruct((), x.dtype)
    found = CompiledLanes(lane, typed, strict=True, width=width).start((x,), len(x), 1)()
    np.testing.assert_array_equal(found, CompiledLanes(lane, typed, strict=True, width=4).start((x,), len(x), 1)())
    s = x.copy()
    for k in range(29):
        s = 0.5 * s + (np.sin(1e7 * k) + np.cos(0.1 * k) * np.sin(0.2 * k) + np.tan(0.3 * k)) * np.cos(s * x)
    near = x < 10.0
    np.testing.assert_allclose(found[near], s[near], rtol=1e-9)


@pytest.mark.parametrize("function", [lax.exp, lax.exp2])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_infinity_less_infinity_is_nan_in_fast_arithmetic(function, dtype):
    """The last product of a power must not be contracted with the difference, which would make it -inf."""
    x = np.array([np.inf, -np.inf, 1.0], dtype)
    found = compiled(lambda x: function(x) - jnp.abs(x), x, strict=False)
    np.testing.assert_array_equal(np.isnan(found), [True, False, False])
    assert found[1] == -np.inf
