"""A sensor that shows its last reading for a while."""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Sensor
from dssc_jax.core.events import AT, SensorEvent, Wrapped
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement, Scalar, State

ROUNDING = 1e-9  # tolerance for the rounding of t = k T_s [samples]


class OutageParams(NamedTuple):
    """Start ``at`` and length ``duration`` of an outage, during which the last reading before the outage is shown."""

    at: Annotated[Scalar, AT]
    duration: Annotated[Scalar, Quantity("s", "time for which the last reading is shown", at_least=0.0)]


class OutageState(NamedTuple):
    """State of a sensor with an outage: the sensor's own state (``inner``), and the last reading shown (``shown``)."""

    inner: State
    shown: Measurement


def wrap(sensor: Sensor) -> Sensor:
    """Make a sensor with an outage from a sensor without one.

    At samples in [at, at + duration) it shows the last reading before the outage. An outage from t = 0 on repeats the
    first reading.
    """

    def init(params: Wrapped, measurement: Measurement, key: jax.Array) -> OutageState:
        """The sensor's own first state, and the first true measurement as the reading that is shown."""
        inner = sensor.init(params.inner, measurement, key)
        # the reading shown is a placeholder: the first sample, at t = 0, replaces it in any case
        return OutageState(inner, Measurement(measurement.y, measurement.y_dot))

    def step(
        params: Wrapped, state: OutageState, measurement: Measurement, key: jax.Array, t: Scalar, dt: Scalar
    ) -> tuple[OutageState, Measurement]:
        """One sample: during the outage the shown y and y' stay, while the sensor's own state goes on."""
        inner, reading = sensor.step(params.inner, state.inner, measurement, key, t, dt)
        elapsed = t - params.event.at + ROUNDING * dt
        frozen = (t > 0.0) & (elapsed >= 0.0) & (elapsed < params.event.duration)
        y = jnp.where(frozen, state.shown.y, reading.y)
        y_dot = jnp.where(frozen, state.shown.y_dot, reading.y_dot)
        return OutageState(inner, Measurement(y, y_dot)), reading._replace(y=y, y_dot=y_dot)

    def resolution(params: Wrapped) -> Scalar | None:
        """The step to which the sensor rounds y."""
        return None if sensor.resolution is None else sensor.resolution(params.inner)

    return Sensor(Wrapped, init, step, resolution=resolution)


SENSOR_OUTAGE = SensorEvent(
    OutageParams, wrap, "the reading of a sensor", last_change=lambda params: params.at + params.duration
)
