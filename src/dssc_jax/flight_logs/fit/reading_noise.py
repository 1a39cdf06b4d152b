"""The noise that a study's sensors add to a reading: no log is taken to be more precise than that."""

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.signals import Measurement, Params, Scalar, State
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_logs.fit.refusals import noise_between_neighbours
from dssc_jax.flight_logs.hints.references import median_values
from dssc_jax.models.sensors.lag import SENSOR_LAG
from dssc_jax.study import Study


def reading_noise(study: Study, outputs: np.ndarray) -> tuple[float, ...]:
    """Standard deviation of what each channel's sensor adds from one reading to the next, in the output's unit.

    Each sensor sees the logged outputs in place of true ones; its numbers with laws have their medians. The noise is
    how far its readings less the outputs scatter about the straight line between neighbours, so that a bias, a lag or a
    delay adds nothing.

    Args:
        study: The study.
        outputs: Logged outputs at the study's samples, NaN where missing, shape (channels, samples).
    """
    loop = study.loop
    noise = [0.0] * len(outputs)
    with arithmetic(study.config.loop.precision):
        params = study.params(median_values(study))
        for i, logged in enumerate(outputs):
            finite_rows = np.flatnonzero(np.isfinite(logged))
            if len(finite_rows) < 3 or loop.sensor[i] is SENSOR_LAG:  # which adds no noise, and removes that of the log
                continue
            times = loop.sample_time * np.arange(len(logged))
            true = np.interp(times, times[finite_rows], logged[finite_rows])
            key = loop.key(draw_key(study.config.seed, 0), "sensor", loop.channels[i])
            noise_values = sensor_readings(study, i, params.sensor[i], key, true) - true
            noise[i] = noise_between_neighbours(times, noise_values)
    return tuple(noise)


def sensor_readings(study: Study, i: int, params: Params, key: jax.Array, true: np.ndarray) -> np.ndarray:
    """The readings of a channel's sensor for a given true output, shape (samples,).

    Args:
        study: The study.
        i: Position of the channel.
        params: Parameters of the sensor.
        key: Key of the sensor's random numbers.
        true: The true output at the samples, shape (samples,).
    """
    sensor = study.loop.sensor[i]
    dt = study.loop.sample_time
    slopes = np.gradient(true, dt)
    first = Measurement(jnp.asarray(true[0]), jnp.asarray(slopes[0]))

    def sample(state: State, sample_input: tuple[jax.Array, Measurement]) -> tuple[State, Scalar]:
        k, measurement = sample_input
        fresh = jax.random.fold_in(key, k + 1)
        next_state, reading = sensor.step(params, state, measurement, fresh, k * dt, dt)
        return next_state, jnp.asarray(reading.y)

    state = as_arrays(sensor.init(params, first, jax.random.fold_in(key, 0)))
    _, readings = jax.lax.scan(
        sample, state, (jnp.arange(len(true)), Measurement(jnp.asarray(true), jnp.asarray(slopes)))
    )
    return np.asarray(readings, float)
