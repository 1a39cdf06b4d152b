"""Sensors: the law of the noise, constant errors, delay and hold to the sample, the lag; and the contract."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Measurement
from dssc_jax.models.sensors import IDEAL, SENSORS
from dssc_jax.models.sensors.lag import SENSOR_LAG, SensorLagParams
from dssc_jax.models.sensors.noisy import MOST_DELAY, NOISY, NoisyParams
from dssc_jax.study.components import parse_component
from dssc_jax.study.laws import Law
from tests.contracts import assert_contract

DT = 0.01
TABLES = [
    {"kind": "ideal"},
    {"kind": "lag", "mu": 0.03},
    {"kind": "noisy"},
    {"kind": "noisy", "position_std": 0.1, "velocity_std": 0.2, "position_bias": 0.3, "velocity_bias": -0.4},
    {"kind": "noisy", "position_std": 0.1, "delay_samples": 3, "period_samples": 2},
    {"kind": "record", "time": [0.0, 0.5], "position": [0.1, -0.1], "velocity": [0.2, 0.3]},
    {"kind": "record", "time": [0.0, 0.5], "position": [0.1, -0.1], "velocity": [0.2, 0.3], "start": "first"},
]


def floats(tree):
    return jax.tree.map(lambda x: jnp.asarray(x, dtype=jnp.result_type(float)), tree)


def path(sensor, params, y, y_dot, key, dt=DT):
    """What the sensor delivers for a sequence of measurements, the stream of keys as in the loop."""
    state = floats(sensor.init(params, Measurement(y[0], y_dot[0]), jax.random.fold_in(key, 0)))

    def sample(state, present):
        k, true = present
        state, seen = sensor.step(params, state, true, jax.random.fold_in(key, k + 1), k * dt, dt)
        return floats(state), jnp.stack(seen[:2])

    return jax.lax.scan(sample, state, (jnp.arange(len(y)), Measurement(y, y_dot)))[1].T


def ramp(count):
    k = jnp.arange(count, dtype=float)
    return k + 1.0, -2.0 * k


def delivered(params, count, seed=0):
    """The path of a ramp; only the counts of samples are compiled in."""
    counts = params.delay_samples, params.period_samples
    return np.asarray(ramp_path(tuple(params[:4]), jax.random.key(seed), *counts, count))


@functools.partial(jax.jit, static_argnums=(2, 3, 4))
def ramp_path(numbers, key, delay, period, count):
    return path(NOISY, NoisyParams(*numbers, delay, period), *ramp(count), key)


def test_every_kind_has_a_case():
    assert {table["kind"] for table in TABLES} == set(SENSORS)


@pytest.mark.parametrize("table", TABLES)
def test_contract(table):
    component = parse_component(table, SENSORS, "sensor")
    sensor, params = component.model, component.params

    def two_steps(y, y_dot):
        key = jax.random.key(3)
        state = sensor.init(params, Measurement(y, y_dot), key)
        state, _ = sensor.step(params, state, Measurement(y, y_dot), key, 0.0, DT)
        return sensor.step(params, state, Measurement(0.9 * y, y_dot), key, DT, DT)

    first = sensor.init(params, Measurement(1.0, -0.5), jax.random.key(3))
    assert isinstance(assert_contract(two_steps, first)[1], Measurement)


def test_ideal_is_the_identity():
    true = Measurement(1.25, -0.5)
    assert IDEAL.step(None, (), true, jax.random.key(0), 0.0, DT) == ((), true)


def test_noise_has_the_stated_law():
    """Over 100 000 samples of one draw; five standard deviations of each estimate."""
    n, params = 100_000, NoisyParams(0.3, 0.02)
    zero = jnp.zeros(n)
    y, y_dot = np.asarray(jax.jit(lambda key: path(NOISY, params, zero, zero, key))(jax.random.key(1)))
    for noise, std in ((y / 0.3, 1.0), (y_dot / 0.02, 1.0)):
        assert abs(noise.mean()) < 5 / np.sqrt(n)
        assert noise.std() == pytest.approx(std, abs=5 / np.sqrt(2 * n))
        assert np.mean(noise**4) == pytest.approx(3.0, abs=5 * np.sqrt(96 / n))
        for lag in (1, 2, 7):
            assert abs(np.mean(noise[lag:] * noise[:-lag])) < 5 / np.sqrt(n)
    assert abs(np.mean(y / 0.3 * y_dot / 0.02)) < 5 / np.sqrt(n)


def test_noise_scales_and_adds_to_the_constant_errors():
    """One key, one noise: twice the deviation is twice the noise, and the constant errors do not change it."""
    y, y_dot = ramp(40)
    single = delivered(NoisyParams(0.1, 0.2), 40) - np.stack([y, y_dot])
    two = delivered(NoisyParams(0.2, 0.4, 5.0, -7.0), 40) - np.stack([y + 5.0, y_dot - 7.0])
    np.testing.assert_allclose(two, 2.0 * single, atol=1e-13)
    assert np.abs(delivered(NoisyParams(0.1, 0.2), 40, seed=4) - np.stack([y, y_dot]) - single).max() > 0.1


def test_constant_errors_are_exact():
    y, y_dot = ramp(40)
    found = delivered(NoisyParams(position_bias=0.25, velocity_bias=-0.5), 40)
    np.testing.assert_array_equal(found, [y + 0.25, y_dot - 0.5])


@pytest.mark.parametrize(("delay", "period"), [(0, 1), (7, 1), (0, 5), (3, 2)])
def test_delay_and_hold_to_the_sample(delay, period):
    """Sample k shows the plant of the last multiple of the period not later than k - delay; before, the start."""
    count = 40
    shown = [max(0, (k - delay) // period * period) for k in range(count)]
    expected = np.stack(ramp(count))[:, shown]
    np.testing.assert_array_equal(delivered(NoisyParams(delay_samples=delay, period_samples=period), count), expected)


def test_longest_delay():
    count = MOST_DELAY + 20
    shown = [max(0, k - MOST_DELAY) for k in range(count)]
    found = delivered(NoisyParams(delay_samples=MOST_DELAY), count)
    np.testing.assert_array_equal(found, np.stack(ramp(count))[:, shown])


def test_noise_is_held_with_the_reading():
    found = delivered(NoisyParams(0.1, 0.1, period_samples=4), 40).reshape(2, 10, 4)
    np.testing.assert_array_equal(found, np.repeat(found[:, :, :1], 4, axis=2))
    assert (np.abs(np.diff(found[0, :, 0] - np.arange(1.0, 40.0, 4))) > 0.0).all()


def test_gradients_are_finite():
    def seen(numbers, y, y_dot):
        params = NoisyParams(*numbers, delay_samples=1, period_samples=2)
        return path(NOISY, params, y * jnp.ones(6), y_dot * jnp.ones(6), jax.random.key(0)).sum()

    for leaf in jax.tree.leaves(jax.jit(jax.grad(seen, argnums=(0, 1, 2)))((0.0, 0.1, 0.0, 0.2), 1.0, -0.5)):
        assert jnp.isfinite(leaf)


def shown(mu, y, y_dot, dt=DT):
    """What a lagged sensor delivers."""
    return np.asarray(path(SENSOR_LAG, SensorLagParams(mu), y, y_dot, jax.random.key(0), dt))


@pytest.mark.parametrize("mu", [1e-6, 1e-3, 0.02, 5.0])
def test_lag_is_that_of_scipy_between_samples(mu):
    """``lsim`` is exact for an input that is linear between its points; it starts at rest at the first measurement."""
    values = np.random.default_rng(2).normal(size=(2, 60))
    found = shown(mu, *values)
    for measured, delivered in zip(values, found, strict=True):
        lag = signal.TransferFunction([1.0], [mu, 1.0])
        known = signal.lsim(lag, measured - measured[0], DT * np.arange(60))[1] + measured[0]
        np.testing.assert_allclose(delivered, known, atol=1e-12)


def test_lag_by_hand_and_in_the_limits():
    """A hand-written loop of many short midpoint steps; a small mu shows the plant as it is, a large one its start."""
    t = DT * np.arange(30)
    y, y_dot = np.cos(7 * t), -7 * np.sin(7 * t)
    z, parts = y[0], 200
    short = DT / parts / 0.05
    for k in range(1, 30):
        for i in range(parts):
            z += short / (1 + short / 2) * (y[k - 1] + (i + 0.5) / parts * (y[k] - y[k - 1]) - z)
    assert shown(0.05, y, y_dot)[0, -1] == pytest.approx(z, abs=1e-8)
    np.testing.assert_allclose(shown(1e-9, y, y_dot), [y, y_dot], atol=1e-5)
    np.testing.assert_allclose(shown(1e9, y, y_dot), np.outer([1.0, 0.0], np.ones(30)), atol=1e-8)


def test_lag_does_not_depend_on_the_sampling_of_a_line():
    """Of y = t it shows t - mu (1 - exp(-t/mu)) at every T_s."""
    for dt in (0.005, 0.1, 1.0):
        t = dt * np.arange(1 + round(2.0 / dt))
        found = shown(0.3, t, np.ones_like(t), dt)
        np.testing.assert_allclose(found[0], t - 0.3 * (1.0 - np.exp(-t / 0.3)), atol=1e-13)
        np.testing.assert_allclose(found[1], 1.0, atol=1e-13)


def test_gradients_of_the_lag_are_finite():
    def seen(mu, y):
        return path(SENSOR_LAG, SensorLagParams(mu), y * jnp.arange(6.0), jnp.ones(6), jax.random.key(0)).sum()

    for mu in (1e-3, 0.02, 10.0):
        slope, by_y = jax.jit(jax.grad(seen, argnums=(0, 1)))(mu, 1.0)
        difference = (seen(mu * (1 + 1e-5), 1.0) - seen(mu * (1 - 1e-5), 1.0)) / (2e-5 * mu)
        assert float(slope) == pytest.approx(float(difference), rel=1e-6)
        assert jnp.isfinite(by_y)


def test_laws_stand_in_the_numbers():
    table = {"kind": "noisy", "position_std": {"uniform": [0.0, 0.1]}, "velocity_bias": {"normal": [0.0, 0.2]}}
    component = parse_component(table, SENSORS, "sensor")
    assert isinstance(component.params.position_std, Law)
    assert {n.name: n for n in component.numbers}["velocity_bias"].quantity.unit == "y/s"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "nois"}, "sensor.kind: unknown kind 'nois'; did you mean 'noisy'?"),
        ({"position_std": -0.1}, "sensor.position_std: standard deviation .* must be >= 0, got -0.1"),
        ({"velocity_std": {"normal": [0.1, 0.1]}}, "sensor.velocity_std: .* must be >= 0, got .*support"),
        ({"position_bias": float("nan")}, "sensor.position_bias: must be a finite number"),
        ({"velocity_bias": "large"}, "sensor.velocity_bias: must be a finite number .* got 'large'"),
        ({"delay_samples": -1}, "sensor.delay_samples: .* must be >= 0, got -1"),
        ({"delay_samples": 201}, "sensor.delay_samples: .* must be <= 200, got 201"),
        ({"delay_samples": 2.5}, "sensor.delay_samples: must be a whole number of samples, got 2.5"),
        ({"delay_samples": {"uniform": [0, 3]}}, "sensor.delay_samples: must be a plain number here"),
        ({"period_samples": 0}, "sensor.period_samples: .* must be >= 1, got 0"),
        ({"period_samples": 1.5}, "sensor.period_samples: must be a whole number of samples, got 1.5"),
        ({"delay_sample": 1}, "sensor.delay_sample: unknown name; did you mean 'delay_samples'?"),
    ],
)
def test_bad_input_is_told_in_one_line(changes, message):
    with pytest.raises(ConfigError, match=message.replace("?", r"\?")) as caught:
        parse_component({"kind": "noisy", **changes}, SENSORS, "sensor")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mu": 0.0}, "sensor.mu: time constant of the sensor's lag .* must be > 0, got 0"),
        ({}, "sensor.mu: is required and missing"),
        ({"mu": 0.1, "position_std": 0.1}, "sensor.position_std: unknown name"),
    ],
)
def test_bad_input_of_the_lag(changes, message):
    with pytest.raises(ConfigError, match=message):
        parse_component({"kind": "lag", **changes}, SENSORS, "sensor")


def test_a_traced_count_is_told():
    """The counts decide shapes; JAX's own error would name neither field nor rule."""
    with pytest.raises(ConfigError, match="delay_samples: decides the shape of the state"):
        jax.jit(lambda n: NOISY.init(NoisyParams(delay_samples=n), Measurement(0.0, 0.0), jax.random.key(0)))(2.0)
