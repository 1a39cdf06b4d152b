"""First-order lags of sensors: a fit keeps such a lag in its prediction, and seeks one that the study lacks.

The samples agree with those of the package's sensor ``{kind = "lag"}``: the exact solution for outputs that are linear
between samples.
"""

from collections.abc import Mapping

import numpy as np
from scipy import signal

from dssc_jax.core.contracts import Sensor
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.models.sensors import IDEAL
from dssc_jax.models.sensors.lag import SENSOR_LAG
from dssc_jax.study import Study

LOGGED = 0.95  # least share of samples with a logged derivative: with fewer, the derivative tells nothing
EXPLAINED = 0.5  # share of the output's difference from the integral of its derivative that may be left with a lag


def filtered(series: np.ndarray, samples: float) -> np.ndarray:
    """A series behind a first-order lag. Before its first sample, the series counts as constant at the first value.

    Args:
        series: The series at equal gaps, shape (..., n).
        samples: Time constant of the lag, in samples.

    Returns:
        The readings, shape (..., n).
    """
    response = -np.expm1(-1.0 / samples)  # to a step, after one sample
    ramp = samples * response
    first = series[..., :1]
    # reading(k + 1) = (1 - response) reading(k) + numerator[0] series(k + 1) + numerator[1] series(k)
    numerator = [1.0 - ramp, ramp - (1.0 - response)]
    return first + signal.lfilter(numerator, [1.0, response - 1.0], series - first, axis=-1)


def deterministic_sensors(study: Study) -> tuple[Sensor, ...]:
    """Each channel's sensor in a prediction: a lag stays, and an ideal sensor replaces any other one."""
    return tuple(SENSOR_LAG if sensor is SENSOR_LAG else IDEAL for sensor in study.loop.sensor)


def has_sensor_lag(study: Study) -> bool:
    """Whether any channel has a sensor with a lag."""
    return SENSOR_LAG in study.loop.sensor


def lies_behind_rate(signals: Mapping[str, np.ndarray], samples: float) -> bool:
    """Whether an output follows the integral of its logged derivative with a first-order lag.

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
    """Root mean square of what remains of an output after a least-squares fit of an integral and a straight line.

    Args:
        output: The output, NaN where missing, shape (n,).
        integral: The integral, shape (n,).
    """
    is_logged = np.isfinite(output)
    rows = np.arange(len(output), dtype=float)
    regressors = np.column_stack([np.ones(len(output)), rows, integral])[is_logged]
    factors = np.linalg.lstsq(regressors, output[is_logged], rcond=None)[0]
    return rms(output[is_logged] - regressors @ factors)
