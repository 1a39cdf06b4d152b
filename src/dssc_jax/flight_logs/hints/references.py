"""A log's references compared with those of its study: how far they differ, and by which unit, factor or time."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.flight_logs.hints.conversions import (
    SAME_REFERENCE,
    is_same_reference,
    is_shifted,
    multiple_of,
    reference_conversion,
    reference_shift,
    rms,
)
from dssc_jax.flight_logs.hints.log_hints import LogHints
from dssc_jax.flight_logs.hints.reference_clocks import StretchedReference, fine_times, reference_stretch, stretch_text
from dssc_jax.flight_logs.reading.reader import FlightLog, first_time, signal_name
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.study import Study

USUAL = 0.9
"""Share of the values of a rate that tell whether it is a slope; the largest differences may be damage of the log."""
OTHER = 0.1  # share of a reference's range: a larger difference is reported, though nothing explains it
RATE_REMEDY = (
    "its column may be another signal's. If the reference is a record whose time stamps jitter, its slope is rough: "
    "give it the log's rate, by rate_column and rate_file"
)


class ComparedReferences(NamedTuple):
    """How a log's references differ from the study's.

    Args:
        differences: Largest difference of y_ref, by channel.
        rates: Largest difference of y_ref_dot, at the times of the log, by channel.
    """

    differences: dict[str, float]
    rates: dict[str, float]


def median_values(study: Study) -> dict[str, float]:
    """The median of every law of the study, by name of the number."""
    return {name: float(law.median) for name, law in study.laws.items()}


def references_at(study: Study, times: np.ndarray) -> np.ndarray:
    """The study's references with two derivatives, at the medians of the laws, shape (channels, 3, times).

    Args:
        study: The study.
        times: Times of the study [s], shape (times,).
    """
    with arithmetic(study.config.loop.precision):
        params = study.params(median_values(study)).reference
        points = jax.vmap(lambda t: as_arrays(study.loop.mimo_reference.at(params, t)))(jnp.asarray(times))
    return np.array([[np.asarray(part, float) for part in point] for point in points])


def study_references(study: Study, samples: int) -> np.ndarray:
    """The study's references, with two derivatives, at the first samples of the study, shape (channels, 3, samples)."""
    return references_at(study, study.loop.sample_time * np.arange(samples))


def compared_references(
    hints: LogHints,
    study: Study,
    log: FlightLog,
    signals: Sequence[Mapping[str, np.ndarray]],
    references: np.ndarray,
) -> ComparedReferences:
    """Compare the log's references with the study's, and add the hints about them.

    Args:
        hints: The hints so far.
        study: The study, without a sweep.
        log: The flight.
        signals: The logged signals of each channel at the study's samples, NaN where missing.
        references: The study's references with two derivatives, shape (channels, 3, samples).
    """
    loop = study.loop
    comparison = ComparedReferences({}, {})
    rates = logged_rates(study, log)
    unexplained: list[int] = []
    logged = {index: part["y_ref"] for index, part in enumerate(signals) if "y_ref" in part}
    for index, values in logged.items():
        channel = loop.channels[index]
        name = signal_name(channel, "y_ref")
        reference = references[index, 0]
        comparison.differences[channel] = largest_distance(values, reference)
        text = reference_conversion(index, values, references[:, 0], loop.channels, study.units[index].output)
        shift = 0 if text else reference_shift(values, reference)
        if text:
            is_exchanged = text.startswith("is the study's of ")
            hints.conversions[name] = Hint("exchanged-columns" if is_exchanged else "another-unit", text)
        elif shift and all(is_shifted(values, references[other, 0], shift) for other, values in logged.items()):
            hints.shifts[name] = Hint("shifted-reference", shifted_text(log, shift * loop.sample_time))
        elif not is_same_reference(values, reference):
            unexplained.append(index)
        if channel in rates:
            rate, slope = rates[channel]
            comparison.rates[channel] = largest_distance(rate, slope)
            is_moving = np.ptp(reference) > 0.0
            is_same = rms(values - reference) <= SAME_REFERENCE * rms(reference)
            hint = slope_hint(rate, slope, study.units[index].of("y/s")) if is_moving and is_same else None
            if hint is not None:
                hints.slopes[signal_name(channel, "y_ref_dot")] = hint
    stretch = log_stretch(study, log, references.shape[2]) if unexplained else None
    for index in unexplained:
        name = signal_name(loop.channels[index], "y_ref")
        if stretch is not None:
            hints.shifts[name] = Hint("clock-rate", stretch_text(log, stretch))
            continue
        unit = study.units[index].output
        same_unit = [units.output == unit for units in study.units]
        largest_range = float(np.ptp(references[same_unit, 0], axis=1).max())
        text = other_reference_text(logged[index], references[index, 0], largest_range, unit)
        factor = multiple_of(logged[index], references[index, 0])
        if factor != 1.0:
            text = (
                f"is {factor:.4g} times the study's: a scale of {1.0 / factor:.4g} for its column mends it. If the "
                "flight had that reference, give it to the study"
            )
            hints.others[name] = Hint("wrong-scale", text)
        elif text:
            hints.others[name] = Hint("another-reference", text)
    return comparison


def slope_hint(rate: np.ndarray, slope: np.ndarray, unit: str) -> Hint | None:
    """The hint that a logged derivative is not the slope of the study's reference; None if it is at most samples.

    Args:
        rate: The logged derivative, shape (n,).
        slope: The slope of the study's reference at the same times, shape (n,).
        unit: Unit of both.
    """
    factor = multiple_of(rate, slope)
    if factor != 1.0:
        text = (
            f"is {factor:.4g} times the study's: a scale of {1.0 / factor:.4g} for its column mends it, as y_ref is "
            "the same"
        )
        return Hint("wrong-scale", text)
    distance = np.abs(rate - slope)
    is_usual = distance <= np.quantile(distance, USUAL)
    rms_distance = rms(distance[is_usual])
    rms_rate = rms(rate[is_usual])
    if not rms_distance > SAME_REFERENCE * rms_rate > 0.0:
        return None
    text = (
        f"differs from the slope of the study's reference by {rms_distance:.3g} {unit} rms, "
        f"{100 * rms_distance / rms_rate:.2g} % of it, though y_ref is the same: {RATE_REMEDY}"
    )
    return Hint("reference-slope", text)


def shifted_text(log: FlightLog, shift: float) -> str:
    """The words that a logged reference is later than the study's by a time [s], or earlier, with both remedies.

    Args:
        log: The flight.
        shift: How much later the logged reference is [s]; negative: earlier.
    """
    start = log.start + shift
    remedy = f"set start to {start:g} s"
    if start < first_time(log.columns):
        remedy = "shift the study's reference, or let its record begin there, as the log does not begin so early"
    side = "late" if shift > 0.0 else "early"
    return (
        f"is the study's, {abs(shift):g} s {'later' if shift > 0.0 else 'earlier'}: if y and the command are as "
        f"{side}, {remedy}; if not, only its topic is {side}, and a fit of logged commands does not use it"
    )


def log_stretch(study: Study, log: FlightLog, samples: int) -> float | None:
    """The factor of the study's times with which all logged references agree; None if there is none, or it is 1.

    Angles are left out, because a log may have them wrapped to one turn.
    """
    loop = study.loop
    fine = fine_times(loop.sample_time, samples)
    references = references_at(study, fine)[:, 0]
    stretched = []
    for index, channel in enumerate(loop.channels):
        column = log.columns.get(signal_name(channel, "y_ref"))
        if column is None or channel in loop.plant.angles:
            continue
        time = column.time - log.start
        is_inside = (time >= 0.0) & (time <= loop.sample_time * (samples - 1))
        stretched.append(StretchedReference(time[is_inside], column.value[is_inside], fine, references[index]))
    return reference_stretch(stretched)


def other_reference_text(logged: np.ndarray, reference: np.ndarray, largest_range: float, unit: str) -> str:
    """The words that a logged reference is another one, with the size of the difference; empty if this is small.

    Args:
        logged: Values, NaN where missing, in the output's unit, shape (samples,).
        reference: The study's reference at the same times.
        largest_range: Largest range of the study's references in this unit, which sets the tolerance for a reference
            that rests.
        unit: Unit of the output.
    """
    differences = logged - reference
    difference = rms(differences)
    tolerance = max(OTHER * np.ptp(reference), SAME_REFERENCE * rms(reference), SAME_REFERENCE * largest_range)
    if not np.isfinite(difference) or difference <= tolerance:
        return ""
    offset = float(np.median(differences[np.isfinite(differences)]))
    if np.ptp(reference) > 0.0 and rms(differences - offset) <= SAME_REFERENCE * abs(offset):
        return (
            f"is the study's plus {offset:.4g} {unit}: if y is measured from there, too, give both columns an offset "
            f"of {-offset:.4g}; if not, the flight had another reference than the study"
        )
    return (
        f"differs from the study's by {difference:.3g} {unit} rms, whose range is {np.ptp(reference):.3g} {unit}, and "
        "is neither a multiple of it nor the same at other times. The draws follow the study's reference, a replay "
        "follows the logged one, and a fit of logged commands needs neither. If the flight had the logged one, give it "
        "to the study (reference.kind = 'record'); if not, compare times and columns"
    )


def largest_distance(logged: np.ndarray, reference: np.ndarray) -> float:
    """The largest distance of a logged reference from the study's; 0 if no value is logged.

    Args:
        logged: The logged reference, NaN where missing, shape (n,).
        reference: The study's reference at the same times, shape (n,).
    """
    return float(np.nanmax(np.abs(logged - reference), initial=0.0))


def logged_rates(study: Study, log: FlightLog) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The logged rate of each channel's reference, and the study's rate at the same times, by channel.

    Channels whose rate is not logged within the study's duration are left out.
    """
    loop = study.loop
    columns = {}
    for index, channel in enumerate(loop.channels):
        column = log.columns.get(signal_name(channel, "y_ref_dot"))
        if column is not None:
            time = column.time - log.start
            is_inside = (time >= 0.0) & (time <= loop.sample_time * (loop.steps - 1))
            if is_inside.any():
                columns[index] = (time[is_inside], column.value[is_inside])
    if not columns:
        return {}
    times, places = np.unique(np.concatenate([time for time, _ in columns.values()]), return_inverse=True)
    slopes = references_at(study, times)[:, 1]
    rates = {}
    begin = 0
    for index, (time, value) in columns.items():
        rows = places[begin : begin + len(time)]
        begin += len(time)
        rates[loop.channels[index]] = (value, slopes[index, rows])
    return rates
