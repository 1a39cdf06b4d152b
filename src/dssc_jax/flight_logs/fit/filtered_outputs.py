"""Outputs behind a first-order lag of the sensor, which a fit keeps in its prediction and seeks where a study lacks it.

The samples are those of the package's sensor ``{kind = "lag"}``: the exact solution for outputs that are linear between
samples.
"""

from collections.abc import Mapping

import numpy as np
from scipy import signal

from dssc_jax.core.contracts import Sensor
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.models.sensors import IDEAL
from dssc_jax.models.sensors.lag import SENSOR_LAG
from dssc_jax.study import Study

LOGGED = 0.95  # share of the samples with a derivative that tells anything
EXPLAINED = 0.5  # share of what an output differs by from the integral of its derivative that a lag may leave


def filtered(series: np.ndarray, samples: float) -> np.ndarray:
    """A series behind a first-order lag, which shows the first value as if it had been constant before.

    Args:
        series: The series at equal gaps, shape (..., n).
        samples: Time constant of the lag, in samples.

    Returns:
        The readings, shape (..., n).
    """
    response = -np.expm1(-1.0 / samples)  # to a step, after one sample
    ramp = samples * response
    first = series[..., :1]
    numerator = [1.0 - ramp, ramp - (1.0 - response)]
    return first + signal.lfilter(numerator, [1.0, response - 1.0], series - first, axis=-1)


def deterministic_sensors(study: Study) -> tuple[Sensor, ...]:
    """The sensors of the channels as a prediction has them: a lag stays, and any other sensor is ideal."""
    return tuple(SENSOR_LAG if sensor is SENSOR_LAG else IDEAL for sensor in study.loop.sensor)


def has_sensor_lag(study: Study) -> bool:
    """Whether any channel has a sensor with a lag."""
    return SENSOR_LAG in study.loop.sensor


def lies_behind_rate(signals: Mapping[str, np.ndarray], samples: float) -> bool:
    """Whether an output lies behind the integral of its logged derivative as behind a lag.

    Args:
        signals: The logged signals of a channel at the samples, NaN where missing, shape (n,) each.
        samples: Time constant of the lag, in samples.
    """
    if "y" not in signals or "y_dot" not in signals:
        return False
    rate = signals["y_dot"]
    is_logged = np.isfinite(rate)
    if np.mean(is_logged) < LOGGED:
        return False
    rows = np.arange(len(rate), dtype=float)
    filled = np.interp(rows, rows[is_logged], rate[is_logged])
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (filled[1:] + filled[:-1]))])
    left = [beside_integral(signals["y"], course) for course in (integral, filtered(integral, samples))]
    return left[1] < EXPLAINED * left[0]


def beside_integral(output: np.ndarray, integral: np.ndarray) -> float:
    """The root mean square of an output beside a multiple of an integral and a straight line; both of shape (n,)."""
    is_logged = np.isfinite(output)
    rows = np.arange(len(output), dtype=float)
    regressors = np.column_stack([np.ones(len(output)), rows, integral])[is_logged]
    factors = np.linalg.lstsq(regressors, output[is_logged], rcond=None)[0]
    return rms(output[is_logged] - regressors @ factors)
