"""Hints that a logged angle is in degrees in place of radians.

Elsewhere, logged angles count within half a turn of the reference, where degrees look like any other angle. So this
module compares them as they were logged.
"""

import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import wrap_angle
from dssc_jax.flight_logs.hints.conversions import FEWER, rms
from dssc_jax.flight_logs.reading.reader import FlightLog, nearest_values, signal_name
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.study import Study

LARGEST_ERROR = 0.6  # rad, root mean square: an angle in degrees that is farther from its reference is not reported


def angle_hints(study: Study, log: FlightLog, references: np.ndarray) -> dict[str, Hint]:
    """The hints about logged outputs and references that are angles in degrees, by signal.

    Args:
        study: The study.
        log: The flight.
        references: The study's references, shape (channels, 3, samples).
    """
    hints = {}
    for index, channel in enumerate(study.loop.channels):
        if channel not in study.loop.plant.angles:
            continue
        reference = references[index, 0]
        for name in (signal_name(channel, "y"), signal_name(channel, "y_ref")):
            column = log.columns.get(name)
            if column is None:
                continue
            values = nearest_values(column, log.start, study.loop.sample_time, len(reference))
            if is_in_degrees(values, reference):
                hints[name] = Hint("another-unit", "is in degrees in place of radians")
    return hints


def is_in_degrees(values: np.ndarray, reference: np.ndarray) -> bool:
    """Whether an angle is near its reference [rad] if it is in degrees, and far from it if it is in radians.

    Args:
        values: The logged angle, NaN where missing, shape (samples,).
        reference: The reference [rad], shape (samples,).
    """
    finite = values[np.isfinite(values)]
    if not finite.size or float(np.abs(finite).max()) <= 2.0 * np.pi:  # radians of any frame
        return False
    in_radians = rms(np.asarray(wrap_angle(jnp.asarray(values - reference))))
    in_degrees = rms(np.asarray(wrap_angle(jnp.asarray(np.radians(values) - reference))))
    return in_degrees < min(FEWER * in_radians, LARGEST_ERROR)
