"""A logged output that is rounded coarsely: its noise is smaller than the step.

The error of such rounding is no white noise, and its steps look like outliers and jumps.
"""

import numpy as np

from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.hints.references import median_values
from dssc_jax.flight_logs.hints.rounded_commands import (
    COARSE,
    LEAST_VALUES,
    NEAR,
    multiple_share,
    rounding_step,
)
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.study import Study

LEAST_LEVELS = 4  # values that occur: fewer are those of a switch
MOSTLY = 0.99  # least share of the readings that are multiples of a step
USUAL = 0.9  # share of the second differences that tell the noise; the largest ones may be the flight's
QUIET = 1.2  # steps, root mean square of these second differences: about 0.5 by rounding alone, 1.7 by noise of a step
AT_MOST = 1.5  # steps: a larger change is more than rounding


def output_rounding(values: np.ndarray, coarse: float = COARSE) -> float:
    """The step to which readings of an output are rounded, if their noise is smaller than the step; else 0.

    Args:
        values: The readings, NaN where missing, in the output's unit, shape (n,).
        coarse: Least step that counts, as a share of the deviation of the readings.
    """
    readings = values[np.isfinite(values)]
    if len(readings) < LEAST_VALUES:
        return 0.0
    levels = np.unique(readings)
    step = rounding_step(levels)
    if len(levels) < LEAST_LEVELS or step <= coarse * rms(readings - np.median(readings)):
        return 0.0
    if multiple_share(readings, step, float(levels[1])) < MOSTLY:
        return 0.0
    sizes = np.sort(np.abs(np.diff(readings, 2)))
    usual_size = rms(sizes[: int(USUAL * len(sizes))])
    return step if usual_size < QUIET * step else 0.0


def declared_resolution(study: Study, index: int) -> float:
    """The step to which the study's sensor of a channel rounds y, at the medians of the laws; 0: it does not round.

    Args:
        study: The study.
        index: Position of the channel.
    """
    sensor = study.loop.sensor[index]
    if sensor.resolution is None:
        return 0.0
    step = sensor.resolution(study.params(median_values(study)).sensor[index])
    return 0.0 if step is None else float(step)


def rounded_output_hint(study: Study, index: int, values: np.ndarray, coarse: float = COARSE) -> Hint | None:
    """The hint that an output is rounded more coarsely than by the study's sensor, with the remedy; None if it is not.

    Args:
        study: The study.
        index: Position of the output's channel.
        values: The readings, NaN where missing, in the output's unit, shape (n,).
        coarse: As of :func:`output_rounding`.
    """
    step = output_rounding(values, coarse)
    if step <= (1.0 + NEAR) * declared_resolution(study, index):
        return None
    text = (
        f"is rounded to {step:.3g} {study.units[index].output}, by more than its noise: a fit takes what is lost for "
        "noise. Log it with more digits; if the sensor rounds it, give the study's sensor that resolution "
        "(position_resolution)"
    )
    return Hint("rounded-output", text)
