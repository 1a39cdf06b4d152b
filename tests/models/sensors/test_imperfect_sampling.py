"""Readings that are rounded, lost, or taken early; a command of limited resolution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Measurement
from dssc_jax.models.sensors.noisy import NOISY, NoisyParams, aged_reading
from dssc_jax.statistics import clopper_pearson
from tests.conftest import UNCERTAIN

SAMPLES, DT = 4000, 0.01
LOOP = {**UNCERTAIN, "sweep": {}, "draws": 4, "disturbance": {"kind": "none"}}


def readings(params, y, y_dot=None):
    """What a controller sees of a signal, sample by sample."""
    y = jnp.asarray(y)
    y_dot = jnp.zeros_like(y) if y_dot is None else jnp.asarray(y_dot)
    keys = jax.random.split(jax.random.key(3), len(y))
    state = NOISY.init(params, Measurement(y[0], y_dot[0]), jax.random.key(5))
    state = jax.tree.map(lambda x: jnp.asarray(x, float), state)

    def single(state, at):
        key, *signals = at
        state, seen = NOISY.step(params, state, Measurement(*signals), key, 0.0, DT)
        return jax.tree.map(lambda x: jnp.asarray(x, float), state), seen

    return jax.tree.map(np.asarray, jax.lax.scan(single, state, (keys, y, y_dot))[1])


def test_lost_readings_are_held_at_the_given_rate():
    seen = readings(NoisyParams(loss=0.05), np.arange(1.0, SAMPLES + 1)).y
    fresh = seen == np.arange(1.0, SAMPLES + 1)
    low, high = clopper_pearson(int((~fresh).sum()), SAMPLES, 0.9999)
    assert low < 0.05 < high
    assert np.array_equal(seen[1:][~fresh[1:]], seen[:-1][~fresh[1:]])


def test_losses_do_not_change_the_noise():
    """The noise of a study is the same with and without losses."""
    signal = np.zeros(SAMPLES)
    plain, lossy = (readings(NoisyParams(position_std=0.1, loss=loss), signal).y for loss in (None, 0.2))
    kept = plain == lossy
    assert 0.75 < kept.mean() < 0.85
    assert np.std(plain) == pytest.approx(0.1, rel=0.05)


def test_readings_are_multiples_of_the_resolution():
    signal = np.sin(0.01 * np.arange(SAMPLES))
    seen = readings(NoisyParams(position_resolution=0.03, velocity_resolution=0.5), signal, 7.0 * signal)
    assert np.allclose(seen.y / 0.03, np.round(seen.y / 0.03), atol=1e-9)
    assert np.abs(seen.y - signal).max() <= 0.015 + 1e-12
    assert set(np.round(seen.y_dot / 0.5)) == set(range(-14, 15))


@pytest.mark.parametrize("age", [0.0, 0.003, 0.01])
def test_an_earlier_measurement_is_exact_on_cubics(age):
    signal = np.polynomial.Polynomial([0.3, -2.0, 5.0, 7.0])
    slope = signal.deriv()
    present, previous = (Measurement(signal(t), slope(t)) for t in (0.02, 0.01))
    seen = aged_reading(present, previous, age, 0.01)
    assert seen.y == pytest.approx(signal(0.02 - age), abs=1e-13)
    assert seen.y_dot == pytest.approx(slope(0.02 - age), abs=1e-11)


def test_jitter_is_uniform_over_its_range():
    """Of the signal y = t a reading's error is its age."""
    t = DT * np.arange(SAMPLES)
    age = t - readings(NoisyParams(jitter=0.004), t, np.ones(SAMPLES)).y
    age = age[1:]
    assert 0.0 <= age.min() < 1e-4
    assert 0.0039 < age.max() <= 0.004 + 1e-12
    assert np.mean(age) == pytest.approx(0.002, rel=0.05)
    assert np.std(age) == pytest.approx(0.004 / np.sqrt(12.0), rel=0.05)


def test_an_axis_and_a_margin_of_jitter_end_at_one_sample():
    study = dj.Study.from_table({**LOOP, "sensor": {"kind": "noisy", "jitter": 0.0}})
    with pytest.raises(ConfigError, match=r"sweep\.sensor\.jitter: .* must be <= 0\.01, got 0\.02"):
        study.override({"sweep": {"sensor.jitter": [0.0, 0.02]}})
    with pytest.raises(ConfigError, match=r"must be <= 0\.01, got 0\.02"):
        dj.margin(study, over="sensor.jitter", bounds=(0.0, 0.02))


def test_jitter_of_more_than_a_sample_is_refused():
    with pytest.raises(ConfigError, match=r"sensor\.jitter: must be <= loop\.sample_time = 0\.01 s, got up to 0\.02 s"):
        dj.Study.from_table({**LOOP, "sensor": {"kind": "noisy", "jitter": {"uniform": [0.0, 0.02]}}})


def test_a_loop_with_all_of_them():
    """Losses may be uncertain and swept; the ideal loop is their limit."""
    ideal = dj.run(dj.Study.from_table(LOOP)).dataset["error_rms"].values
    tiny = {"kind": "noisy", "loss": 0.0, "jitter": 0.0, "position_resolution": 1e-9, "velocity_resolution": 1e-9}
    study = dj.Study.from_table({**LOOP, "sensor": tiny})
    assert dj.run(study).dataset["error_rms"].values == pytest.approx(ideal, rel=1e-5)
    swept = dj.run(study.override({"sweep": {"sensor.loss": [0.0, 0.5, 0.9]}, "sensor.jitter": {"uniform": [0, 0.01]}}))
    assert np.ptp(swept.dataset["error_rms"].values, axis=0).min() > 1e-3
    assert np.isfinite(swept.dataset["error_rms"].values).all()


def test_a_command_of_limited_resolution():
    study = dj.Study.from_table({**LOOP, "unmodelled": {"kind": "quantisation", "resolution": 1e-9}})
    ideal = dj.run(dj.Study.from_table({**LOOP, "unmodelled": {"kind": "none"}})).dataset["error_rms"].values
    assert dj.run(study).dataset["error_rms"].values == pytest.approx(ideal, rel=1e-5)
    coarse = dj.run(study.override({"unmodelled.resolution": 1.0})).dataset["error_rms"].values
    assert (np.abs(coarse / ideal - 1.0) > 1e-3).all()
