"""Registry of sensors: one per channel, evaluated once per controller sample; a new one is one file and one row."""

from dssc_jax.core.contracts import NoParams, Sensor
from dssc_jax.core.default_functions import always
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.models.sensors.lag import SENSOR_LAG
from dssc_jax.models.sensors.noisy import NOISY
from dssc_jax.models.sensors.record import RECORDED_NOISE

IDEAL = Sensor(
    NoParams,
    init=lambda params, measurement, key: (),
    step=lambda params, state, measurement, key, t, dt: (state, measurement),
    smooth=SMOOTH,
    transparent=always,
)

SENSORS: Registry = {
    "ideal": single(IDEAL, "the plant's own y and y'"),
    "lag": single(SENSOR_LAG, "y and y' each through 1/(mu s + 1)", mu=0.02),
    "noisy": single(
        NOISY,
        "white noise, constant errors, delay, own period, resolution, lost readings, jitter",
        position_std=0.01,
        velocity_std=0.02,
        delay_samples=1,
        period_samples=2,
    ),
    "record": RECORDED_NOISE,
}
