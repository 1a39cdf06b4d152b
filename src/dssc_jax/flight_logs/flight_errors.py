"""Errors of flights and of draws, and their columns in the dataset of the next flight."""

from typing import TypeAlias

import numpy as np

from dssc_jax.study import Study

Column: TypeAlias = tuple[tuple[str, ...], np.ndarray, dict[str, str]]
"""Dimensions, values and attributes of a variable."""


def error_columns(study: Study, channel: int, flight_errors: np.ndarray, draw_errors: np.ndarray) -> dict[str, Column]:
    """The dataset's columns of the largest and the RMS error of a channel, of the flights and of the draws.

    Args:
        study: The study.
        channel: Index of the channel.
        flight_errors: Measured errors of the flights, shape (flights, samples).
        draw_errors: Measured errors of the draws, shape (draws, samples).
    """
    unit = study.units[channel].output
    suffix = f"_{study.loop.channels[channel]}".rstrip("_")
    largest = largest_error(flight_errors), largest_error(draw_errors)
    rms = rms_error(flight_errors), rms_error(draw_errors)
    return {
        **number_columns(f"error_max{suffix}", unit, "largest measured error", *largest),
        **number_columns(f"error_rms{suffix}", unit, "root mean square of the measured error", *rms),
    }


def number_columns(name: str, unit: str, meaning: str, flights: np.ndarray, draws: np.ndarray) -> dict[str, Column]:
    """The dataset's two columns of a number: its values of the flights, and those of the compared draws.

    Args:
        name: Name of the column of the flights; that of the draws has ``_of_draw`` at its end.
        unit: Unit of the number.
        meaning: What the number is, in words.
        flights: Values of the flights, shape (flights,).
        draws: Values of the compared draws, shape (draws,).
    """
    return {
        name: (("flight",), flights, {"long_name": f"{meaning} of each flight", "units": unit}),
        f"{name}_of_draw": (("draw",), draws, {"long_name": f"{meaning} of each draw", "units": unit}),
    }


def measured_samples(study: Study, times: np.ndarray) -> np.ndarray:
    """Whether each sample lies in the window of the study's metrics, shape (samples,); all do if the logs end before.

    Args:
        study: The study.
        times: Times of the samples from the study's beginning on [s], shape (samples,).
    """
    is_inside = times >= study.config.metrics.window.after - 1e-9
    return is_inside if is_inside.any() else np.ones_like(is_inside)


def largest_error(errors: np.ndarray) -> np.ndarray:
    """The largest absolute error along the last axis; infinite where errors are NaN, because a draw has ended."""
    return np.nan_to_num(np.abs(errors), nan=np.inf).max(axis=-1)


def rms_error(errors: np.ndarray) -> np.ndarray:
    """The root mean square of errors along the last axis; infinite if a draw has ended."""
    return np.sqrt(np.mean(np.nan_to_num(np.abs(errors), nan=np.inf) ** 2, axis=-1))
