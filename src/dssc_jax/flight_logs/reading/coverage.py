"""Whether a log has enough of a study's samples to say anything, and whether its times are in seconds."""

from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.reading.clocks import repeated_times_text, row_numbers_text
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.study import Study

LEAST_COMPARED = 5
"""Samples of a study at which a log needs a value to be compared."""
UNUSUAL_GAP = (1.0 / 30.0, 100.0)  # sample times between two values, beyond which the unit of time is doubted
USUAL_GAP = (0.1, 10.0)
SINCE_1970 = (1e9, 4e9)  # s, from 2001 to 2096: a time of these many seconds is one since 1970
COARSE = 0.1  # sample times between two floating-point numbers at the log's start: more blur its times


class TimeUnit(NamedTuple):
    """A unit of time, with its size [s]."""

    name: str
    seconds: float


TIME_UNITS = (
    TimeUnit("milliseconds", 1e-3),
    TimeUnit("microseconds", 1e-6),
    TimeUnit("nanoseconds", 1e-9),
    TimeUnit("minutes", 60.0),
    TimeUnit("hours", 3600.0),
)


def times_text(log: FlightLog, least_length: float = 0.0) -> str:
    """What is wrong with a log's times if they repeat or count rows, in words; empty if nothing is wrong.

    Args:
        log: The flight.
        least_length: Length of the log [s] up to which times that count by one are not taken for numbers of rows.
    """
    columns = log.columns.values()
    repeated = next(filter(None, (repeated_times_text(column.time) for column in columns)), "")
    counted = next(filter(None, (row_numbers_text(column.time) for column in columns)), "")
    return repeated or (counted if log.end - log.start > least_length else "")


def time_unit_text(log: FlightLog, sample_time: float) -> str:
    """What is wrong with a log's times if they repeat, count rows, or do not look like seconds; else empty.

    Args:
        log: The flight.
        sample_time: Sample time of the study [s].
    """
    doubt_of_times = times_text(log)
    if doubt_of_times:
        return f"; its column of times {doubt_of_times}"
    for unit in TIME_UNITS:
        if SINCE_1970[0] <= log.start * unit.seconds <= SINCE_1970[1]:
            return f"; its times are {unit.name} since 1970. They must be in seconds: {scale_text(log, unit)}"
    gaps = [np.median(np.diff(column.time)) for column in log.columns.values() if len(column.time) > 1]
    gap = min((float(gap) for gap in gaps if gap > 0.0), default=0.0)
    if gap == 0.0 or UNUSUAL_GAP[0] <= gap / sample_time <= UNUSUAL_GAP[1]:
        return ""
    text = f"; its values are {gap:.4g} s apart, the study's samples {sample_time:g} s"
    for unit in TIME_UNITS:
        if USUAL_GAP[0] <= gap * unit.seconds / sample_time <= USUAL_GAP[1]:
            return f"{text}: are its times in {unit.name}? They must be in seconds: {scale_text(log, unit)}"
    return f"{text}: its times must be in seconds"


def scale_text(log: FlightLog, unit: TimeUnit) -> str:
    """The remedy, in words: the entry of the table of columns that turns times of a unit into seconds.

    Args:
        log: The flight.
        unit: The unit of the log's times.
    """
    scale = unit.seconds * log.clock.scale
    return f'give time = {{ column = "{log.clock.column}", scale = {scale:.4g} }} in the table of columns'


def few_samples_remedy(has_signal: np.ndarray, sample_time: float) -> str:
    """Why a log lacks a signal at many samples, because it is logged too rarely or has gaps, and the remedy.

    Args:
        has_signal: Whether the log has the signal, at each sample, shape (samples,).
        sample_time: Sample time of the study [s].
    """
    logged_samples = np.flatnonzero(has_signal)
    steps = np.diff(logged_samples)
    if not steps.size or np.median(steps) > 1:
        return "log it as often as the controller runs, or set loop.sample_time to the log's"
    if steps.max() == 1:
        begin, end = sample_time * logged_samples[0], sample_time * logged_samples[-1]
        return f"it has values from {begin:.4g} s to {end:.4g} s of the study only. Compare `start` and loop.duration"
    longest = int(np.argmax(steps))
    begin, end = sample_time * logged_samples[longest], sample_time * logged_samples[longest + 1]
    return (
        f"it is logged as often, but values are missing, at most {steps[longest] - 1} in a row (between {begin:.4g} s "
        f"and {end:.4g} s of the study). Take a part without gaps (`start`, loop.duration), or another log"
    )


def require_samples(study: Study, log: FlightLog, has_value: np.ndarray) -> None:
    """Require that a log has values at some samples of the study.

    Args:
        study: The study, without a sweep.
        log: The flight.
        has_value: Whether the log has any compared value, at each sample up to its end, shape (samples,).

    Raises:
        ConfigError: The log has hardly any value, or its times are so large that rounding blurs the samples.
    """
    loop = study.loop
    resolution = float(np.spacing(abs(log.start)))
    if resolution > COARSE * loop.sample_time:
        text = (
            f"its times, {log.start:.6g} s at the start, are so large that they are rounded to {resolution:g} s, "
            f"and the study's samples are {loop.sample_time:g} s apart"
        )
        raise ConfigError(log.name, f"{text}{time_unit_text(log, loop.sample_time) or '; they must be in seconds'}")
    count = int(np.count_nonzero(has_value))
    span = f"{loop.steps * loop.sample_time:g} s from {log.start:g} s on"
    hint = time_unit_text(log, loop.sample_time)
    if not count:
        raise ConfigError(log.name, f"has no output and no command in the study's {span}{hint}")
    needed = min(LEAST_COMPARED, loop.steps)
    if count < needed:
        text = f"has values at {count} of the study's {loop.steps} samples ({span}), and a comparison needs {needed}"
        raise ConfigError(log.name, f"{text}{hint}")
