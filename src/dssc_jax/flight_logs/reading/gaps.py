"""Spans of a log in which messages are missing, by the log's own rate.

A command that is held over such a span is not the one that flew, and the simulated output is wrong from there on.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.reading.reader import Column, FlightLog

MISSING = 4  # least number of missing messages in succession that are a gap
REGULAR = 2.5  # factor on the median gap: a signal has a rate if nine in ten gaps are shorter
UNCHANGED = 1e-3  # share of a signal's range: one that rests before and after, at one value, may not have been sent
BESIDE = 5  # messages on either side that tell whether it rests
LINE = 10  # messages on either side through which a line goes
MOVED = 10.0  # standard deviations of the noise by which a signal has to move within a gap to tell a jump of the clock
FEWER = 1.0 / 3.0  # share of the distance from a change by the time of the gap: closer to none, a signal goes on
NAMED = 3  # gaps that a message names


class Gap(NamedTuple):
    """A span without messages.

    Args:
        begin: Time of the last message before the gap, or of the study's beginning [s].
        end: Time of the first message after the gap, or of the study's end [s].
        signals: Names of the signals that lack messages.
    """

    begin: float
    end: float
    signals: tuple[str, ...]


def gaps_of(column: Column, begin: float, end: float) -> list[tuple[float, float]]:
    """Find spans between two times [s] in which a signal with a regular rate lacks messages while its value changes.

    Args:
        column: The signal.
        begin: Time of the log from which on gaps count [s].
        end: Time of the log up to which gaps count [s].
    """
    is_selected = (column.time >= begin) & (column.time <= end)
    time, value = column.time[is_selected], column.value[is_selected]
    steps = np.diff(time)
    steps = steps[steps > 0.0]
    if not steps.size:
        return []
    usual_step = float(np.median(steps))
    if np.quantile(steps, 0.9, method="lower") > REGULAR * usual_step:
        return []
    bounds = np.concatenate([[begin], time, [end]])
    rows = np.flatnonzero(np.diff(bounds) > (MISSING + 0.5) * usual_step)
    least_change = UNCHANGED * np.ptp(value)
    spans: list[tuple[float, float]] = []
    for row in rows.tolist():
        nearby_values = value[max(row - BESIDE, 0) : row + BESIDE]
        is_inside = 0 < row < len(time)  # beyond the messages the change is not known
        if not is_inside or not np.ptp(nearby_values) <= least_change:
            spans.append((float(bounds[row]), float(bounds[row + 1])))
    return spans


def log_gaps(log: FlightLog, signals: Iterable[str], end: float) -> tuple[Gap, ...]:
    """Find the gaps of signals from the study's beginning to a time of the log [s]; overlapping gaps are merged.

    Args:
        log: The flight.
        signals: Names of the signals.
        end: The time of the log up to which gaps count [s].
    """
    gaps: list[Gap] = []
    spans = ((span, name) for name in signals for span in gaps_of(log.columns[name], log.start, end))
    for (begin, stop), name in sorted(spans):
        latest = gaps[-1] if gaps else None
        if latest is not None and begin < latest.end:
            names = latest.signals if name in latest.signals else (*latest.signals, name)
            gaps[-1] = Gap(latest.begin, max(latest.end, stop), names)
        else:
            gaps.append(Gap(begin, stop, (name,)))
    return tuple(gaps)


def runs_on(column: Column, begin: float, end: float) -> bool | None:
    """Whether a signal goes on after a gap as if no time had passed, as it does if the clock jumps.

    Args:
        column: The signal.
        begin: Time of the last message before the gap [s].
        end: Time of the first message after the gap [s].

    Returns:
        None if nothing can be told, because the signal rests, or its noise hides the change, or messages are too few.
    """
    before = np.flatnonzero(column.time <= begin)[-LINE:]
    after = np.flatnonzero(column.time >= end)[:LINE]
    if min(len(before), len(after)) < LINE:
        return None
    lines = [
        np.polyfit(column.time[rows] - time, column.value[rows], 1) for rows, time in ((before, begin), (after, end))
    ]
    noise = 0.0
    for line, rows, time in zip(lines, (before, after), (begin, end), strict=True):
        noise = max(noise, float(np.std(column.value[rows] - np.polyval(line, column.time[rows] - time))))
    slope = 0.5 * (lines[0][0] + lines[1][0])
    change = lines[1][1] - lines[0][1]
    usual_step = float(np.median(np.diff(column.time)))
    if abs(slope) * (end - begin - usual_step) < MOVED * noise or slope == 0.0:
        return None
    return abs(change - slope * usual_step) < FEWER * abs(change - slope * (end - begin))


def clock_jumped(log: FlightLog, gap: Gap) -> bool:
    """Whether all signals lack messages in a gap, and those that move go on after it as if no time had passed."""
    answers = []
    for column in log.columns.values():
        if np.any((column.time > gap.begin) & (column.time < gap.end)):
            return False
        answers.append(runs_on(column, gap.begin, gap.end))
    return True in answers and False not in answers


def gap_text(log: FlightLog, gaps: tuple[Gap, ...], sample_time: float) -> str:
    """The gaps in words, with the parts of the log before and after the longest gap as the remedy.

    Args:
        log: The flight.
        gaps: The gaps, in order of time; at least one.
        sample_time: Sample time of the study [s].
    """
    spans = []
    for gap in gaps[:NAMED]:
        spans.append(f"{gap.end - gap.begin:.3g} s from {gap.begin:.4g} s on ({', '.join(gap.signals)})")
    further = f" and {len(gaps) - NAMED} more times" if len(gaps) > NAMED else ""
    longest = max(gaps, key=lambda gap: gap.end - gap.begin)
    duration = sample_time * np.floor((longest.begin - log.start) / sample_time)
    parts = [f"the part before with loop.duration = {duration:g}"] if duration > 0.0 else []
    if longest.end < log.end - sample_time:
        part = f"the part after with a start of {longest.end:.4g} s and a law of the initial state (plant.initial)"
        parts.append(part)
    clock = ""
    if any(clock_jumped(log, gap) for gap in gaps):
        clock = ", or the clock jumped, as the signals go on as if no time had passed"
    return (
        f"messages are missing for {', '.join(spans)}{further}{clock}, and commands are held where the flight had "
        f"others. Fit {', or '.join(parts) or 'another log'}"
    )
