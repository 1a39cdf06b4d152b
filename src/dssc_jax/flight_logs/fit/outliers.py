"""Readings that noise does not explain in a fit's residual: single outliers, and jumps that last."""

from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.hints.integrals import usual_size
from dssc_jax.flight_logs.hints.output_steps import step_cause
from dssc_jax.flight_logs.hints.rounded_outputs import AT_MOST, output_rounding, rounded_output_hint
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning, signal_warnings

OUTSTANDING = 8.0  # factor on the usual change from one reading to the next: a larger change is no noise
MOST_SHARE = 0.06  # of the changes that may stand out, two for a spike: more are the study's or the noise's way
MOST_CHANGES = 4  # that may stand out in a short log
CLOSE = 1.5  # factor on the usual time between readings: over a longer one, a change says nothing
ALONE = 0.3  # share of an outlying change: changes beside it are smaller, and a return differs from it by less
NAMED = 3  # readings that a message names


class Outlier(NamedTuple):
    """A change of the residual that stands out.

    Args:
        time: Time of the reading [s].
        size: The change, in the output's unit.
        lasts: Whether the readings after it keep the change (a jump), or the next one returns (a single outlier).
    """

    time: float
    size: float
    lasts: bool

    def text(self, unit: str) -> str:
        """Size and time in words."""
        return f"by {self.size:.3g} {unit} at {self.time:.4g} s"


def outliers(times: np.ndarray, residual: np.ndarray, sensor: float) -> list[Outlier]:
    """Find the changes of a residual that stand out, in order of time; none where there are many.

    Args:
        times: Times of the readings [s], shape (n,).
        residual: Readings less prediction, shape (n,).
        sensor: Standard deviation of the noise that the study's sensor adds to a reading.
    """
    gaps = np.diff(times)
    changes = np.diff(residual)
    if len(changes) < 3:
        return []
    usual_change = max(usual_size(changes - np.median(changes)), np.sqrt(2.0) * sensor)
    is_large = (np.abs(changes) > OUTSTANDING * usual_change) & (gaps <= CLOSE * np.median(gaps))
    rows = np.flatnonzero(is_large)
    if usual_change == 0.0 or len(rows) > max(MOST_CHANGES, MOST_SHARE * len(changes)):
        return []
    padded_changes = np.concatenate([[0.0], changes, [0.0, 0.0]])  # element i is the change before change i
    result = []
    last_counted_row = -1
    for row in rows.tolist():
        if row <= last_counted_row:
            continue
        before, size, following, second = padded_changes[row : row + 4]
        has_returned = abs(size + following) < ALONE * abs(size)
        after = second if has_returned else following
        if max(abs(before), abs(after)) < ALONE * abs(size):
            result.append(Outlier(float(times[row + 1]), float(size), not has_returned))
            last_counted_row = row + 1 if has_returned else row
    return result


def outlier_doubts(problem: FitProblem, x: np.ndarray) -> tuple[SignalWarning, ...]:
    """The doubts about readings that stand out of the residual at coordinates x, by channel, with the remedy.

    Changes that a rounding of the readings can make are reported as rounding, however fine this is beside the output.

    Args:
        problem: The least-squares problem of the log.
        x: Coordinates of the numbers, shape (p,).
    """
    doubts = []
    for readings, columns in zip(problem.readings, problem.columns(x), strict=True):
        name = signal_name(problem.study.loop.channels[readings.channel], "y")
        unit = problem.study.units[readings.channel].output
        changes = []
        least_size = AT_MOST * output_rounding(readings.values, coarse=0.0)
        found = outliers(readings.times, columns[:, 0], float(np.sqrt(readings.sensor)))
        for outlier in found:
            if abs(outlier.size) > least_size:
                changes.append(outlier)
        if len(changes) < len(found):
            rounded = rounded_output_hint(problem.study, readings.channel, readings.values, coarse=0.0)
            doubts += signal_warnings({} if rounded is None else {name: rounded})
        single = [outlier for outlier in changes if not outlier.lasts]
        jumps = [outlier for outlier in changes if outlier.lasts]
        if single:
            text = f"single readings of {name} stand out {list_text(single, unit)} of the study. Leave such cells empty"
            doubts.append(SignalWarning(name, "outliers", text))
        if jumps:
            sizes = [jump.size for jump in jumps]
            cause = step_cause(problem.study, readings.channel, [jump.time for jump in jumps], sizes)
            text = f"{name} jumps {list_text(jumps, unit)} of the study, and what is predicted does not: {cause}"
            doubts.append(SignalWarning(name, "output-jump", text))
    return tuple(doubts)


def list_text(changes: list[Outlier], unit: str) -> str:
    """Sizes and times of the first outliers, and the number of the others, in words."""
    further = f" and at {len(changes) - NAMED} more times" if len(changes) > NAMED else ""
    return ", ".join(outlier.text(unit) for outlier in changes[:NAMED]) + further
