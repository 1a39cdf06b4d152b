import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from scipy.interpolate import BSpline

import dssc_jax as dj
from dssc_jax.core.numerics import (
    arithmetic,
    binary_exponent,
    clip,
    cubic_spline,
    delay_weights,
    dot,
    elapsed_share,
    log_defect,
    root_abs,
    standard_normal,
    standard_normals,
)
from dssc_jax.core.signals import Outcome
from dssc_jax.lanes.functions.approximations import atan, atan2
from tests.conftest import UNCERTAIN


def test_root_abs_is_exact_and_has_finite_gradients():
    x = np.array([-4.0, 0.0, 1e-300, 9.0])
    np.testing.assert_allclose(root_abs(x), [2.0, 0.0, 1e-150, 3.0], rtol=1e-15)
    assert np.all(np.isfinite(jax.vmap(jax.grad(root_abs))(jnp.asarray(x))))
    assert jax.grad(root_abs)(0.0) == 0.0
    assert np.isnan(root_abs(np.nan))


def test_root_abs_floor():
    assert root_abs(0.0, 1e-9) == 1e-9
    assert root_abs(1e-20, 1e-9) == 1e-9
    assert root_abs(4.0, 1e-9) == 2.0


@pytest.mark.parametrize(("precision", "largest", "ulps"), [(64, 1e60, 12.0), (32, 1e18, 12.0)])
def test_log_defect_against_high_precision(precision, largest, ulps):
    """(x - ln(1 + x))/x^2 over all magnitudes, and densely where the binary exponent of 1 + x changes."""
    kind = np.dtype(f"float{precision}")
    dense = [np.linspace(0.999, 1.001, 41) * (end - 1.0) for end in (2.0**0.5, 2.0**1.5, 2.0**2.5)]
    x = np.concatenate([[0.0], np.geomspace(1e-30, largest, 400), *dense]).astype(kind)
    with arithmetic(precision):
        values = np.asarray(jax.jit(log_defect)(x))
    assert values.dtype == kind
    with mpmath.workdps(120):
        numbers = [mpmath.mpf(float(value)) for value in x[1:]]
        exact = [mpmath.mpf(1) / 2, *((value - mpmath.log1p(value)) / value**2 for value in numbers)]
        errors = [abs(mpmath.mpf(float(a)) / b - 1) for a, b in zip(values, exact, strict=True)]
    assert max(errors) < ulps * np.finfo(kind).eps


def test_log_defect_has_the_right_slope():
    """The slope, also at 0 and where the binary exponent of 1 + x changes."""
    x = np.array([0.0, 1e-9, 0.1, 2.0**0.5 - 1.0 - 1e-12, 2.0**0.5 - 1.0 + 1e-12, 10.0, 1e6])
    slope = np.asarray(jax.vmap(jax.grad(log_defect))(jnp.asarray(x)))
    assert slope[0] == pytest.approx(-1.0 / 3.0, rel=1e-12)
    with mpmath.workdps(60):
        for value, found in zip(map(mpmath.mpf, map(float, x[1:])), slope[1:], strict=True):
            exact = 1 / (value * (1 + value)) - 2 * (value - mpmath.log1p(value)) / value**3
            assert found == pytest.approx(float(exact), rel=1e-9)


def test_binary_exponent():
    x = np.concatenate([[1.0, 2.0**0.5, 2.0], np.geomspace(1.0, 1e300, 5000)])
    k, scale = map(np.asarray, binary_exponent(jnp.asarray(x)))
    assert np.all(scale * x >= 0.5**0.5)
    assert np.all(scale * x < 2.0**0.5 * (1.0 + 1e-15))
    assert np.array_equal(np.ldexp(1.0, -k.astype(int)), scale)


def test_cubic_spline_is_scipys_and_bounded():
    """Value and slope of the B-spline, whose bounds falsification relies on."""
    coefficients = np.random.default_rng(0).uniform(-1.0, 1.0, 7)
    x = np.linspace(-3.0, 9.0, 601)
    exact = BSpline(np.arange(-2, 9), coefficients, 3, extrapolate=False)
    inside = (x > -2.0 + 3.0) & (x < 8.0 - 3.0)  # where scipy's basis is complete
    found = np.asarray(cubic_spline(list(coefficients), x))
    np.testing.assert_allclose(found[inside], exact(x[inside]), rtol=0, atol=1e-14)
    assert np.all(np.abs(found) <= np.max(np.abs(coefficients)))
    assert np.all(found[(x <= -2.0) | (x >= 8.0)] == 0.0)
    slopes = jax.vmap(jax.grad(lambda at: cubic_spline(list(coefficients), at)))(jnp.asarray(x))
    steps = np.diff([0.0, *coefficients, 0.0])
    assert steps.min() <= float(slopes.min())
    assert float(slopes.max()) <= steps.max()


@pytest.mark.parametrize("bits", [64, 32])
def test_arctangents_are_within_three_ulp(bits):
    """Against extended precision, over the whole range; measured 2.4 (float64) and 2.6 (float32)."""
    rng, real = np.random.default_rng(3), np.dtype(f"float{bits}")
    wide = 10.0 ** rng.uniform(-8.0, 8.0, 100_000) * rng.choice([-1.0, 1.0], 100_000)
    x = np.concatenate([rng.uniform(-3.0, 3.0, 300_000), wide]).astype(real)
    angle = rng.uniform(-np.pi, np.pi, 300_000)
    y, z = np.sin(angle).astype(real), np.cos(angle).astype(real)
    with jax.enable_x64(bits == 64):
        pairs = [(jax.jit(atan)(x), np.arctan(x.astype(np.longdouble)))]
        pairs += [(jax.jit(atan2)(y, z), np.arctan2(y.astype(np.longdouble), z.astype(np.longdouble)))]
        for found, exact in pairs:
            spacing = np.spacing(np.abs(exact).astype(real)).astype(np.longdouble)
            assert np.max(np.abs(np.asarray(found).astype(np.longdouble) - exact) / spacing) < 3.0


def test_arctangents_at_the_corners():
    for y, x in [(0.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0), (1.0, 1.0), (-1.0, -1.0), (2.0, -3.0)]:
        assert float(atan2(y, x)) == pytest.approx(np.arctan2(y, x), abs=1e-7)
    assert np.isnan(atan2(jnp.nan, 1.0))
    assert np.isnan(atan2(1.0, jnp.nan))
    assert np.all(np.isfinite(jax.vmap(jax.grad(lambda y: atan2(y, 0.0)))(jnp.asarray([0.0, 1e-30, 1.0]))))


def test_clip_is_jaxs_for_bounds_that_are_numbers():
    x, low, high = jnp.array([-3.0, -1.0, 0.5, 2.0, jnp.inf, jnp.nan]), -1.0, 2.0
    np.testing.assert_array_equal(clip(x, low, high), jnp.clip(x, low, high))
    np.testing.assert_array_equal(clip(x, jnp.nan, 0.0), jnp.minimum(x, 0.0))
    assert [float(jax.grad(clip)(at, low, high)) for at in (-2.0, 0.0, 3.0)] == [0.0, 1.0, 0.0]


def test_dot_leaves_out_what_is_zero():
    """A plain 0 on the left is no operation, so that an infinite factor does not become NaN; a traced one is."""
    assert float(dot((0.0, 1.0, 2.0), (jnp.inf, 3.0, 4.0))) == 11.0
    assert np.isnan(dot((jnp.zeros(()), 1.0), (jnp.inf, 3.0)))


def normals(precise, function):
    with jax.enable_x64(precise):
        keys = jax.random.split(jax.random.key(4), 20_000)
        return np.asarray(jax.jit(jax.vmap(lambda key: jnp.stack(function(key))))(keys))


def test_weights_of_a_delay_have_the_bits_of_a_hat_function():
    delays = np.concatenate([np.random.default_rng(0).uniform(0.0, 5.0, 2000), np.arange(6.0)])
    ages = np.arange(6)
    expected = np.maximum(0.0, 1.0 - np.abs(delays[:, None] - ages))
    np.testing.assert_array_equal(np.transpose(delay_weights(delays, len(ages))), expected)


@pytest.mark.parametrize(("delay", "expected"), [(0.0, 0), (1.5, 1), (2.0, 2), (3.0, 2)])
def test_weights_of_a_whole_delay_have_the_derivative_of_one_side(delay, expected):
    """Of a longer delay, and at the longest one of a shorter one; in both the slopes cancel."""
    slopes = np.zeros(4)
    slopes[[expected, expected + 1]] = [-1.0, 1.0]
    np.testing.assert_array_equal(jax.jacobian(lambda samples: jnp.stack(delay_weights(samples, 4)))(delay), slopes)


@pytest.mark.parametrize("dt", [0.1, 0.02, 0.005])
def test_a_jump_at_a_sample_has_the_derivative_of_a_later_one(dt):
    """Whatever the roundings of the samples' times: the integral falls by as much as the jump is delayed."""

    def integral(at):
        return jnp.sum(elapsed_share(at, jnp.arange(300) * dt, dt)) * dt

    for sample in (1, 3, 7, 27, 54, 299):
        for at in (sample * dt, float(f"{sample * dt:.6g}"), (sample + 0.5) * dt):
            assert jax.grad(integral)(at) == pytest.approx(-1.0)


def test_standard_normals_are_jaxs_own():
    """Bit by bit, for one draw and for a batch."""
    found = normals(True, lambda key: standard_normals(key, 5))
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, normals(True, lambda key: jax.random.normal(key, (5,))))
    np.testing.assert_array_equal(normals(True, lambda key: (standard_normal(key),))[:, 0], found[:, 0])


def test_both_precisions_draw_the_same_noise():
    """Up to the 23 leading bits of the uniform number, which are few in the tails."""
    double, single = (normals(precise, lambda key: standard_normals(key, 5)) for precise in (True, False))
    assert single.dtype == np.float32
    density = np.exp(-0.5 * double**2) / np.sqrt(2.0 * np.pi)
    np.testing.assert_array_less(np.abs(single - double), 1e-6 + 4.0 * 2.0**-23 / density)


def test_numbers_beyond_the_precision_are_outcomes_and_no_warnings():
    """Gains up to 1e300 in single precision."""
    changes = {"controller.discretisation": "explicit", "controller.rho": {"loguniform": [1.0, 1e300]}}
    study = dj.Study.from_table(UNCERTAIN).override({**changes, "sweep": {}, "loop.precision": 32})
    found = dj.run(study).dataset
    assert 0 < np.sum(found["outcome"] == Outcome.NON_FINITE) < study.config.draws
    worst = int(np.argmax(found["controller.rho"].values))
    assert dj.simulate(study, worst).attrs["outcome"] == Outcome.NON_FINITE
