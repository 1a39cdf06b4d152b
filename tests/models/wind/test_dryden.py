"""Dryden turbulence against MIL-F-8785C: its law, and its statistics at any step."""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import linalg, optimize, special

from dssc_jax.core.vectors import Vec3
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.models.wind import dryden as wind
from tests.models.wind.test_wind import TABLES, arrays, held_at, parsed
from tests.tolerances import ROUNDING

SIGMAS = 4.0
"""Sampling errors by which a measured statistic may miss (one of 16 000 would by chance; the seeds are fixed)."""


def dryden(**change):
    return parsed({"kind": "dryden", **TABLES["dryden"], **change})


def test_dryden_law():
    """At 1000 ft the model's axes are alike; at 20 ft the mean is W20; in between, the formulas in feet."""
    top = wind.dryden_law(dryden(altitude=304.8)[1])
    np.testing.assert_allclose([top.length_uv, top.length_w], 304.8, rtol=ROUNDING)
    np.testing.assert_allclose([top.sigma_uv, top.sigma_w], 0.8, rtol=ROUNDING)
    low = wind.dryden_law(dryden(altitude=6.096, turbulence=2.0)[1])
    assert float(low.mean) == pytest.approx(8.0, rel=ROUNDING)
    assert low.sigma_w == pytest.approx(1.6, rel=ROUNDING)
    assert low.sigma_uv == pytest.approx(1.6 / (0.177 + 0.01646) ** 0.4, rel=ROUNDING)
    assert low.length_uv == pytest.approx(0.3048 * 20.0 / (0.177 + 0.01646) ** 1.2, rel=ROUNDING)
    high = wind.dryden_law(dryden(altitude=150.0)[1])
    assert float(high.mean) == pytest.approx(8.0 * math.log(150 / 0.3048 / 0.15) / math.log(20 / 0.15), rel=ROUNDING)


STEPS = [1e-7, 1e-5, 1e-3, 0.03, 0.3, 0.999, 1.0, 1.001, 3.0, 20.0]


@pytest.mark.parametrize("h", STEPS)
def test_noise_factor_is_exact(h):
    """L L' = int_0^h (1, s)(1, s)' exp(-2 s) ds, by incomplete gamma functions, in both precisions."""
    a_a, b_a, b_b = (float(entry) for entry in jax.jit(wind.noise_factor)(h))
    moments = [special.gammainc(n + 1, 2 * h) * math.factorial(n) / 2 ** (n + 1) for n in range(3)]
    np.testing.assert_allclose([a_a**2, a_a * b_a, b_a**2 + b_b**2], moments, rtol=ROUNDING)
    with jax.enable_x64(False):
        single = jax.jit(wind.noise_factor)(jnp.float32(h))
        assert all(entry.dtype == jnp.float32 for entry in single)
        np.testing.assert_allclose(np.array(single, dtype=float), [a_a, b_a, b_b], rtol=2e-6)


def test_transverse_filter_is_the_specified_one():
    """Transition, stationary law and output of :class:`Transverse` belong to (1 + sqrt(3) s)/(1 + s)^2."""
    matrix, h = np.array([[-1.0, 0.0], [1.0, -1.0]]), 0.37
    step = partial(wind.transverse_step, h=h, n1=0.0, n2=0.0)
    moved = np.array([step(wind.Transverse(*unit)) for unit in np.eye(2)]).T
    np.testing.assert_allclose(moved, linalg.expm(matrix * h), rtol=ROUNDING, atol=ROUNDING)
    factor = np.array([wind.transverse_init(*unit) for unit in np.eye(2)]).T
    stationary = linalg.solve_continuous_lyapunov(matrix, -np.diag([1.0, 0.0]))
    np.testing.assert_allclose(factor @ factor.T, stationary, rtol=ROUNDING)
    out = np.array([wind.Transverse(*unit).output for unit in np.eye(2)])
    assert out @ stationary @ out == pytest.approx(1.0, rel=ROUNDING)
    for s in (0.3j, 1.0j, 5.0j):
        transfer = out @ np.linalg.solve(s * np.eye(2) - matrix, [1.0, 0.0])
        assert transfer == pytest.approx((1 + np.sqrt(3) * s) / (1 + s) ** 2, rel=ROUNDING)


PATHS, BLOCK, BLOCKS = 1024, 0.06, 200
"""Independent paths; seconds between records; records a path."""
DIRECTION = TABLES["dryden"]["direction"]


def in_wind_axes(velocity, direction):
    """u, v, w of an inertial velocity."""
    c, s = jnp.cos(direction), jnp.sin(direction)
    return Vec3(c * velocity.x + s * velocity.y, c * velocity.y - s * velocity.x, velocity.z)


def simulated(dt, paths=PATHS, block=BLOCK, blocks=BLOCKS, seed=1):
    """Turbulence u, v, w over sigma at the start of each block, and its mean over each block: (paths, blocks, 3)."""
    model, params = dryden()
    law = wind.dryden_law(params)
    inner = round(block / dt)

    def path(index):
        key = jax.random.fold_in(jax.random.key(seed), index)

        def sample(state, k):
            state = model.step(params, state, jax.random.fold_in(key, k + 1), k * dt, dt)
            return state, in_wind_axes(model.value(params, state, k * dt), DIRECTION)

        def record(carry, j):
            state, first = sample(carry, j * inner)

            def sampled(i, at):
                state, x = sample(at[0], j * inner + i)
                return state, at[1] + x

            state, total = jax.lax.fori_loop(1, inner, sampled, (state, first))
            return state, (first, total / inner)

        return jax.lax.scan(record, arrays(model.init(params, jax.random.fold_in(key, 0))), jnp.arange(blocks))[1]

    lanes = CompiledLanes(path, jax.ShapeDtypeStruct((), np.uint32)).start((np.arange(paths),), paths, 2)()
    sigma, mean = np.array([law.sigma_uv, law.sigma_uv, law.sigma_w]), np.array([law.mean, 0.0, 0.0])
    return tuple((np.stack(velocity, axis=-1) - mean) / sigma for velocity in lanes)


def correlation(lags, transverse):
    """Autocorrelation of the Dryden form at lags in units of L/V."""
    return np.exp(-lags) * (1 - 0.5 * transverse * lags)


def dispersion(count, h, transverse):
    """Variance of the mean of ``count`` samples h apart, in units of L/V, of a process of variance 1."""
    k = np.arange(1, count)
    return (1.0 + 2.0 * np.sum((1.0 - k / count) * correlation(k * h, transverse))) / count


def with_error(samples):
    """Mean over independent paths and its standard error."""
    return samples.mean(), samples.std(ddof=1) / math.sqrt(len(samples))


def measured_length(means, squares, count, dt, airspeed, transverse):
    """L from the variance of means over ``count`` blocks, relative to the measured variance; with standard error."""
    spans = means[:, : len(means[0]) // count * count].reshape(len(means), -1, count).mean(axis=2)
    power, level = np.square(spans).mean(axis=1), squares.mean()
    ratio = power.mean() / level
    error = with_error(power - ratio * squares)[1] / level

    def excess(length, target):
        return dispersion(count * round(BLOCK / dt), dt * airspeed / length, transverse) - target

    length, distant = (optimize.brentq(excess, 0.1, 1e4, args=(target,)) for target in (ratio, ratio + error))
    return length, distant - length


@pytest.mark.parametrize("dt", [0.001, 0.005, 0.02])
def test_dryden_has_the_specified_statistics_at_any_step(dt):
    """Standard deviation, autocorrelation and scale length of u, v, w, of independent paths with every error known."""
    airspeed = TABLES["dryden"]["airspeed"]
    law = wind.dryden_law(dryden()[1])
    x, means = simulated(dt)
    for i, (name, length) in enumerate(zip("uvw", (law.length_uv, law.length_uv, law.length_w), strict=True)):
        transverse, time = name != "u", length / airspeed
        squares = np.square(x[:, :, i]).mean(axis=1)
        variance, error = with_error(squares)
        print(f"\nT_s = {dt:g} s, {name}: sigma/spec {math.sqrt(variance):.4f} +- {0.5 * error:.4f}", end="")
        assert error < 0.04
        assert abs(variance - 1.0) < SIGMAS * error

        found, error = measured_length(means[:, :, i], squares, round(3 * time / BLOCK), dt, airspeed, transverse)
        print(f", L/spec {found / length:.4f} +- {error / length:.4f}, rho at", end="")
        assert 0 < error < 0.08 * length
        assert abs(found - length) < SIGMAS * error

        for lag in (0.3, 1.0, 2.0, 4.0):
            count = max(1, round(lag * time / BLOCK))
            rho, error = with_error((x[:, count:, i] * x[:, :-count, i]).mean(axis=1))
            exact = correlation(count * BLOCK / time, transverse)
            print(f" {count * BLOCK / time:.2f}: {rho:.3f} ({exact:.3f}) +- {error:.3f}", end="")
            assert error < 0.02
            assert abs(rho - exact) < SIGMAS * error

        ends = np.square(x[:, [0, 1, -1], i]).mean(axis=0)  # stationary from the first sample
        assert np.all(np.abs(ends - 1.0) < SIGMAS * math.sqrt(2 / PATHS))
    pairs = [(0, 1), (0, 2), (1, 2)]
    for i, j in pairs:
        cross, error = with_error((x[:, :, i] * x[:, :, j]).mean(axis=1))
        assert abs(cross) < SIGMAS * error


def test_dryden_spectrum():
    """Hann periodograms against the specification's one-sided spectra in omega, folded at the Nyquist frequency."""
    dt, count, airspeed = 0.02, 2048, TABLES["dryden"]["airspeed"]
    law = wind.dryden_law(dryden()[1])
    x, _ = simulated(dt, paths=384, block=dt, blocks=count, seed=2)
    window = np.hanning(count)
    power = np.square(np.abs(np.fft.rfft(x * window[:, None], axis=1))) * dt / (np.pi * np.sum(window**2))
    omega = 2 * np.pi * np.fft.rfftfreq(count, dt)
    fold = 2 * np.pi / dt * np.arange(1, 50)[:, None]

    def spectrum(omega, time, transverse):
        square = np.square(omega * time)
        return time / np.pi * ((1 + 3 * square) / (1 + square) ** 2 if transverse else 2 / (1 + square))

    for i, length in enumerate((law.length_uv, law.length_uv, law.length_w)):
        form = partial(spectrum, time=length / airspeed, transverse=i > 0)
        exact = form(omega) + form(fold - omega).sum(axis=0) + form(fold + omega).sum(axis=0)
        for low, high in zip(*(np.geomspace(0.7, 150.0, 9)[cut] for cut in (slice(-1), slice(1, None))), strict=True):
            band = (omega >= low) & (omega < high)
            ratio, error = with_error((power[:, band, i] / exact[band]).mean(axis=1))
            assert error < 0.04
            assert abs(ratio - 1.0) < SIGMAS * error + 0.02  # the window's leakage


def test_dryden_axes():
    """The mean wind blows to ``direction``; u, v, w stand along, across and up; nothing before ``at``."""
    model, params = dryden(direction=2.0, at=1.0)
    law = wind.dryden_law(params)
    resting = wind.DrydenState(0.0, wind.Transverse(0.0, 0.0), wind.Transverse(0.0, 0.0), 1.0)
    mean = float(law.mean) * np.array([math.cos(2.0), math.sin(2.0), 0.0])
    np.testing.assert_allclose(np.array(model.value(params, resting, 0.0)), mean, rtol=0, atol=1e-14)
    gusty = resting._replace(u=1.0, v=wind.Transverse(1.0, 0.0), w=wind.Transverse(0.0, 1.0))
    found = in_wind_axes(model.value(params, gusty, 0.0) - Vec3(*mean), 2.0)
    root3 = math.sqrt(3.0)
    expected = [law.sigma_uv, root3 * law.sigma_uv, (1 - root3) * law.sigma_w]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    assert not held_at({"kind": "dryden", **TABLES["dryden"], "at": 1.0}, 0.5).any()
    assert held_at({"kind": "dryden", **TABLES["dryden"], "at": 1.0}, 1.0).all()


def test_direction_may_be_random():
    """A uniform law over the circle, its draws traced: mean and turbulence turn with it."""
    model, params = dryden(direction={"uniform": [-math.pi, math.pi]})
    directions = params.direction.quantile((np.arange(64) + 0.5) / 64)
    key = jax.random.key(3)

    def velocity(direction):
        drawn = params._replace(direction=direction)
        return in_wind_axes(model.value(drawn, model.step(drawn, model.init(drawn, key), key, 0.0, 0.005), 0.0), 0.0)

    found = np.stack(jax.jit(jax.vmap(velocity))(directions), axis=-1)
    angle = np.unwrap(np.arctan2(found[:, 1], found[:, 0]))
    np.testing.assert_allclose(angle - angle[0], directions - directions[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.hypot(found[:, 0], found[:, 1]), np.hypot(*found[0, :2]), rtol=ROUNDING)
    np.testing.assert_allclose(found[:, 2], found[0, 2], rtol=ROUNDING)


def test_dryden_in_single_precision_at_a_fine_step():
    """High above ground at 1 ms, where h = V dt/L is 3e-5: finite, in float32, and of the right spread."""
    with jax.enable_x64(False):
        model, params = dryden(altitude=300.0, airspeed=10.0)

        def path(key):
            def sample(state, k):
                return model.step(params, state, jax.random.fold_in(key, k), 0.0, 0.001), None

            state, _ = jax.lax.scan(sample, arrays(model.init(params, key)), jnp.arange(100))
            return model.value(params, state, 0.1).z

        z = jax.jit(jax.vmap(path))(jax.random.split(jax.random.key(5), 4096))
        assert z.dtype == jnp.float32
    assert float(jnp.std(z)) == pytest.approx(0.8, rel=SIGMAS / math.sqrt(2 * 4096))
