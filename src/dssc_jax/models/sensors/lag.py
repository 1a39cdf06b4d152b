"""A sensor with a first-order lag on y and on y'."""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Sensor
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import SMOOTH


class SensorLagParams(NamedTuple):
    """The time constant of a sensor that passes y and y' each through 1/(mu s + 1)."""

    mu: Annotated[Scalar, Quantity("s", "time constant of the sensor's lag", above=0.0)]


class LagState(NamedTuple):
    """What the lag remembers: the previous true measurement (``true``), and the previous reading (``shown``)."""

    true: Measurement
    shown: Measurement


def lag_init(params: SensorLagParams, measurement: Measurement, key: jax.Array) -> LagState:
    """The state at the first measurement, which the sensor shows as if this measurement had been constant before."""
    return LagState(true=measurement, shown=measurement)


def lag_step(
    params: SensorLagParams, state: LagState, measurement: Measurement, key: jax.Array, t: Scalar, dt: Scalar
) -> tuple[LagState, Measurement]:
    """The next state and the reading z, by the exact solution of mu z' = y - z for y linear between the samples.

    With a mu far below T_s, the sensor therefore shows y itself, and not the y of the sample before. ``key`` and ``t``
    are arguments of every sensor; a lag does not use them.
    """
    relative_time = dt / params.mu
    step_response = -jnp.expm1(-relative_time)  # 1 - exp(-dt/mu)

    def filtered_value(value: Scalar, previous: Scalar, shown: Scalar) -> Scalar:
        """The reading at this sample.

        Args:
            value: The true value at this sample.
            previous: The true value at the sample before.
            shown: The reading at the sample before.
        """
        ramp_lag = (value - previous) * step_response / relative_time
        return value - ramp_lag + (shown - previous) * (1.0 - step_response)

    true = state.true
    shown = state.shown
    y = filtered_value(measurement.y, true.y, shown.y)
    reading = Measurement(y, filtered_value(measurement.y_dot, true.y_dot, shown.y_dot))
    return LagState(measurement, reading), reading


SENSOR_LAG = Sensor(SensorLagParams, lag_init, lag_step, smooth=SMOOTH)
