"""Elementary functions as machine code against 40 digits, in units in the last place."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from dssc_jax.lanes.functions.elementary import ELEMENTARY
from dssc_jax.lanes.lanes import CompiledLanes
from tests.lanes.against_plain import arithmetic

POINTS = 1000
RNG = np.random.default_rng(0)


def near_and_far(low, high):
    """Points of both signs whose magnitudes are spread over the decades from low to high."""
    magnitude = np.exp(RNG.uniform(np.log(low), np.log(high), POINTS))
    return magnitude * RNG.choice([-1.0, 1.0], POINTS)


def positive(low, high):
    return np.abs(near_and_far(low, high))


FUNCTIONS = {
    "sin": (jnp.sin, mpmath.sin, near_and_far(1e-8, 5e3)),
    "cos": (jnp.cos, mpmath.cos, near_and_far(1e-8, 5e3)),
    "exp": (jnp.exp, mpmath.exp, near_and_far(1e-6, 80.0)),
    "expm1": (jnp.expm1, mpmath.expm1, near_and_far(1e-6, 60.0)),
    "log": (jnp.log, mpmath.log, positive(1e-30, 1e30)),
    "log1p": (jnp.log1p, mpmath.log1p, np.concatenate([positive(1e-8, 1e6), -RNG.uniform(1e-3, 0.99, POINTS)])),
    "tanh": (jnp.tanh, mpmath.tanh, near_and_far(1e-6, 30.0)),
    "atan": (jnp.arctan, mpmath.atan, near_and_far(1e-6, 1e6)),
    "asin": (jnp.arcsin, mpmath.asin, near_and_far(1e-4, 1.0)),
    "erf_inv": (jax.lax.erf_inv, mpmath.erfinv, np.concatenate([RNG.uniform(-0.99, 0.99, POINTS), [1.0 - 1e-6]])),
}
LIMIT = {"tanh": 4.0, "asin": 3.0, "expm1": 3.0, "erf_inv": 4.0}
"""Units in the last place; 2 for every other function."""


def run(function, *columns, **options):
    """A function of scalars as machine code on columns."""
    types = [jax.ShapeDtypeStruct((), column.dtype) for column in columns]
    compiled = CompiledLanes(lambda *scalars: function(*scalars), *types, **options)
    return compiled.start(columns, len(columns[0]), 1)()


def units(exact, computed):
    """Largest error in units in the last place of the exact value."""
    with mpmath.workdps(40):
        errors = [
            abs(mpmath.mpf(float(y)) - x) / mpmath.mpf(float(np.spacing(computed.dtype.type(abs(float(x))))))
            for x, y in zip(exact, computed, strict=True)
        ]
    return float(max(errors))


@pytest.mark.parametrize("precision", [64, 32])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_elementary_function_is_exact_to_a_few_units(name, precision):
    function, reference, points = FUNCTIONS[name]
    dtype = np.dtype(f"f{precision // 8}")
    points = points.astype(dtype)
    with arithmetic(precision):
        computed = run(function, points, strict=True)
    assert computed.dtype == dtype
    with mpmath.workdps(40):
        exact = [reference(mpmath.mpf(float(x))) for x in points]
    assert units(exact, computed) <= LIMIT.get(name, 2.0)


EDGES = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1e300, -1e300, 800.0, -800.0, 1e-300])


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name not in ("sin", "cos")])
def test_edges_are_those_of_numpy(name):
    """NaN stays, and infinities are those of the exact function."""
    function = FUNCTIONS[name][0]
    with np.errstate(all="ignore"), arithmetic():
        expected = np.asarray(jax.vmap(function)(EDGES))
        np.testing.assert_allclose(run(function, EDGES), expected, rtol=1e-14, atol=1e-309)


def test_sines_of_any_number_are_bounded():
    points = near_and_far(1.0, 1e300)
    for function in (jnp.sin, jnp.cos):
        assert np.all(np.abs(run(function, points)) <= 1.0)
        assert np.all(np.isnan(run(function, np.array([np.inf, -np.inf, np.nan]))))


@pytest.mark.parametrize("width", [1, 4, 8, 16])
def test_strict_functions_have_the_same_bits_for_every_width(width):
    for function, _, points in FUNCTIONS.values():
        np.testing.assert_array_equal(
            run(function, points, strict=True, width=width), run(function, points, strict=True)
        )


def test_an_angle_is_right_in_every_quadrant():
    y, x = near_and_far(1e-3, 1e3), near_and_far(1e-3, 1e3)
    np.testing.assert_allclose(run(jnp.arctan2, y, x), np.arctan2(y, x), rtol=1e-15)
    edges = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf])
    y, x = (grid.ravel() for grid in np.meshgrid(edges, edges))
    np.testing.assert_array_equal(np.signbit(run(jnp.arctan2, y, x)), np.signbit(np.arctan2(y, x)))
    np.testing.assert_allclose(run(jnp.arctan2, y, x), np.arctan2(y, x), rtol=1e-15)


def test_powers():
    x, y = positive(1e-3, 1e3), RNG.uniform(-5.0, 5.0, POINTS)
    np.testing.assert_allclose(run(jnp.power, x, y), x**y, rtol=1e-14)
    negative = run(jnp.power, np.array([-2.0, -2.0, -2.0, 0.0]), np.array([3.0, 2.0, 0.5, 0.0]))
    np.testing.assert_allclose(negative, [-8.0, 4.0, np.nan, 1.0], rtol=1e-15)


ONLY_NEWER = {"log2", "one_minus_square"}  # in jax.lax from 0.11.2 on


def test_every_function_is_one_of_jaxs():
    assert all(hasattr(jax.lax, name) or name in ONLY_NEWER for name in ELEMENTARY)
