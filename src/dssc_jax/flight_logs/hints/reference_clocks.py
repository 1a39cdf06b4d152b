"""A log whose references are the study's with stretched times, as by a clock that runs too fast or too slow."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.core.flag_runs import flag_runs, longest_run
from dssc_jax.flight_logs.hints.conversions import SAME_REFERENCE, rms
from dssc_jax.flight_logs.reading.reader import FlightLog, first_time
from dssc_jax.flight_logs.reading.ulog import is_ulog

LARGEST_STRETCH = 0.1  # of a log's times that is sought
MOST_READINGS = 4000  # of a reference that are compared; of more, evenly spaced ones are
LEAST_READINGS = 20
EDGES = 0.02  # share of single readings that may differ, each at a jump of the reference
FINER = 4  # times of the study's reference in a sample, between which straight lines go
MOST_DIGITS = 6  # decimals of a stretch


class StretchedReference(NamedTuple):
    """A logged reference, and the study's reference at finer times.

    Args:
        times: Times of the readings, from the study's beginning on [s], shape (n,).
        values: The readings, in the output's unit, shape (n,).
        fine_times: Times of the study's reference [s], shape (m,).
        reference: The study's reference at those times, shape (m,).
    """

    times: np.ndarray
    values: np.ndarray
    fine_times: np.ndarray
    reference: np.ndarray

    def differs(self, stretch: float) -> np.ndarray:
        """Whether each reading differs from the study's reference with times multiplied by ``stretch``, shape (n,)."""
        expected = np.interp(self.times / stretch, self.fine_times, self.reference)
        return np.abs(self.values - expected) > SAME_REFERENCE * rms(self.reference - np.mean(self.reference))


def fine_times(sample_time: float, samples: int) -> np.ndarray:
    """The times at which the study's reference is compared with a stretched one [s], shape (m,).

    Args:
        sample_time: Sample time of the study [s].
        samples: Number of samples of the study that the log covers.
    """
    return sample_time / FINER * np.arange(round((1.0 + 2.0 * LARGEST_STRETCH) * FINER * samples))


def reference_stretch(references: Sequence[StretchedReference]) -> float | None:
    """The factor of the study's times with which all logged references agree, rounded to the fewest digits that agree.

    A reading at which the reference jumps may differ, because it may fall to either side of the jump.

    Returns:
        None if the references agree with no factor, or with 1, or none of them moves.
    """
    moving = []
    for reference in references:
        every = -(-len(reference.times) // MOST_READINGS)
        chosen = reference._replace(times=reference.times[::every], values=reference.values[::every])
        if len(chosen.times) >= LEAST_READINGS and np.ptp(reference.reference) > 0.0 and np.ptp(chosen.values) > 0.0:
            moving.append(chosen)
    if not moving:
        return None
    count = max(len(reference.times) for reference in moving)
    step = 0.25 / count
    stretches = 1.0 + np.arange(-LARGEST_STRETCH, LARGEST_STRETCH, step)
    agrees = np.ones(len(stretches), bool)
    for place, stretch in enumerate(stretches.tolist()):
        for reference in moving:
            is_different = reference.differs(stretch)
            agrees[place] &= longest_run(is_different) <= 1 and np.mean(is_different) <= EDGES
    if not agrees.any():
        return None
    begins, ends = flag_runs(agrees)
    widest = int(np.argmax(ends - begins))
    stretch = shortest_number(float(stretches[begins[widest]]) - step, float(stretches[ends[widest] - 1]) + step)
    return stretch if stretch != 1.0 else None


def shortest_number(low: float, high: float) -> float:
    """The middle of an interval, rounded to the fewest decimals that keep it within the interval.

    Example:
        >>> shortest_number(1.0189, 1.0211)
        1.02
    """
    middle = 0.5 * (low + high)
    for digits in range(MOST_DIGITS):
        if low <= round(middle, digits) <= high:
            return round(middle, digits)
    return middle


def stretch_text(log: FlightLog, stretch: float) -> str:
    """A stretch of a log's references in words, with the scale of the log's times that removes the stretch.

    Args:
        log: The flight.
        stretch: Times of the log over those of the study's reference.
    """
    kind = "fast" if stretch > 1.0 else "slow"
    clock = f"the log's clock is {max(stretch, 1.0 / stretch):.4g} times too {kind}"
    text = f"is the study's with times x {stretch:.4g}: {clock}, or the flight had another reference"
    if log.file is not None and is_ulog(log.file):
        return f"{text}. Compare the log's times with those of another clock"
    scale = f'time = {{ column = "{log.clock.column}", scale = {log.clock.scale / stretch:.4g} }}'
    begin = f" and start = {log.start / stretch:.6g}" if log.start != first_time(log.columns) else ""
    return f"{text}. If it is the clock, scale the times ({scale}{begin})"
