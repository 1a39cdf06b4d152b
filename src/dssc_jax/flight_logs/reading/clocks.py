"""Where the times of a log fall or jump, and the rows whose times do not fall, if as few as possible are left out."""

import bisect
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.flag_runs import longest_run
from dssc_jax.flight_logs.reading.ulog_scan import LogTopic, Stamps

MOST_DROPPED = 0.05
"""Share of the rows that may be left out: more of them are no stray rows, but another clock."""
LONG_GAP = 10.0
"""Multiple of a topic's usual interval: a longer time without a message is told."""
LEAST_MESSAGES = 20  # of a topic whose interval is usual
STEADY = 0.5  # least share of the time outside of the longest gap that messages at the usual interval fill
LATE = 10.0  # s, see LATE_SHARE
LATE_SHARE = 0.1
"""Share of a log's length. A topic's last message is stray if it is later than the log's end by more than both."""
MOST_TOGETHER = 4  # rows in a row that may be left out
MOST_REPEATED = 0.1  # share of rows that may have the time of the row before
SAME_STEP = 0.1  # share of the length of a fall or gap: closer, those of two topics are the same


class ClockStep(NamedTuple):
    """A fall of time stamps, or a time without a message, in some topics.

    Args:
        stamps: Stamps before and after the step, of the first topic [s].
        topics: Names of the topics.
        falls: The largest number of falls in one of the topics.
        rate: Usual rate of messages of the first topic [1/s].
    """

    stamps: Stamps
    topics: tuple[str, ...]
    falls: int
    rate: float


def falls_of(topics: Iterable[LogTopic]) -> list[ClockStep]:
    """The first fall of each topic whose stamps fall; topics that fall together are one step."""
    return grouped_steps([(topic, topic.fall) for topic in topics if topic.falls])


def gaps_of(topics: Iterable[LogTopic]) -> list[ClockStep]:
    """The longest time without a message of each topic, if unusual; topics with the same gap are one step."""
    unusual = []
    for topic in topics:
        length = topic.gap.late - topic.gap.early
        if is_steady(topic) and length * topic.usual_rate > LONG_GAP:
            unusual.append((topic, topic.gap))
    return grouped_steps(unusual)


def is_steady(topic: LogTopic) -> bool:
    """Whether a topic is sent at a steady rate. A topic sent at changes or in bursts is not, and has no unusual gap."""
    time_outside_gap = topic.last - topic.first - (topic.gap.late - topic.gap.early)
    return topic.messages >= LEAST_MESSAGES and topic.messages >= STEADY * time_outside_gap * topic.usual_rate


class LateMessage(NamedTuple):
    """The last message of a topic long after the end of all others: its time [s]."""

    topic: str
    time: float


def log_end_and_strays(topics: Sequence[LogTopic]) -> tuple[float, list[LateMessage]]:
    """When a log ends, and stray messages long after its end.

    The topics with many messages give a first estimate: the latest of their last messages, without a last message that
    follows a long gap. If there is no such topic, all topics give it. A last message that is later than the estimate by
    more than both ``LATE`` and the share ``LATE_SHARE`` of it is stray. The log ends with the latest message that is
    not stray.

    Returns:
        Time of the end from the beginning of the log [s], 0 if no message has a stamp; and the stray messages.
    """
    stamped_topics = [topic for topic in topics if np.isfinite(topic.last)]
    ends = []
    for topic in stamped_topics:
        if topic.messages >= LEAST_MESSAGES:
            gap_length = topic.gap.late - topic.gap.early
            ends_after_gap = topic.gap.late == topic.last and gap_length * topic.usual_rate > LONG_GAP
            ends.append(topic.gap.early if ends_after_gap else topic.last)
    estimate = max(ends or [topic.last for topic in stamped_topics], default=0.0)
    limit = estimate + max(LATE, LATE_SHARE * estimate)
    late_messages = [LateMessage(topic.name, topic.last) for topic in stamped_topics if topic.last > limit]
    return max((topic.last for topic in stamped_topics if topic.last <= limit), default=estimate), late_messages


def column_clock(name: str, time: np.ndarray) -> LogTopic:
    """Describe the times of a table's column as a topic with one message a row; rows without a time are left out."""
    finite_times = time[np.isfinite(time)]
    steps = np.diff(finite_times)
    if not steps.size:
        single_time = float(finite_times[0]) if finite_times.size else np.nan
        return LogTopic(name, len(finite_times), single_time, single_time)
    falls = np.flatnonzero(steps < 0.0)
    fall = Stamps(float(finite_times[falls[0]]), float(finite_times[falls[0] + 1])) if falls.size else Stamps()
    row_before_gap = int(np.argmax(steps))
    gap = Stamps(float(finite_times[row_before_gap]), float(finite_times[row_before_gap + 1]))
    rising = steps[steps > 0.0]
    usual_rate = float(1.0 / np.median(rising)) if rising.size else np.nan
    return LogTopic(
        name=name,
        messages=len(finite_times),
        first=float(finite_times[0]),
        last=float(finite_times[-1]),
        falls=len(falls),
        fall=fall,
        usual_rate=usual_rate,
        gap=gap,
    )


def repeated_times_text(time: np.ndarray) -> str:
    """A sentence about how many rows of a column share their time with the row before; empty if few do.

    Args:
        time: Finite times that do not fall [s], shape (n,).
    """
    steps = np.diff(time)
    repeated = int(np.count_nonzero(steps == 0.0))
    if repeated <= MOST_REPEATED * len(time) or repeated == len(steps):
        return ""
    usual = float(np.median(steps[steps > 0.0]))
    return (
        f"repeats from one row to the next in {repeated:,} of {len(time):,} rows, and rises by {usual:.3g} s else: "
        "times are rounded, or rows are doubled. Log times with more digits"
    )


def row_numbers_text(time: np.ndarray) -> str:
    """A sentence that asks whether times are the numbers of rows; empty if the times do not rise by one each.

    Args:
        time: Finite times that do not fall [s], shape (n,).
    """
    if len(time) < LEAST_MESSAGES or not (np.diff(time) == 1.0).all() or not float(time[0]).is_integer():
        return ""
    return (
        f"counts {time[0]:.10g}, {time[1]:.10g}, {time[2]:.10g} and so on: are these the numbers of rows? Times must "
        "be in seconds; give the time between two rows as the scale of the column"
    )


def grouped_steps(topic_stamps: Sequence[tuple[LogTopic, Stamps]]) -> list[ClockStep]:
    """Group topics with nearly the same stamps into one step each, in order of time."""
    steps: list[ClockStep] = []
    for topic, stamps in sorted(topic_stamps, key=lambda pair: pair[1]):
        slack = SAME_STEP * abs(stamps.late - stamps.early)
        latest = steps[-1] if steps else None
        if latest and max(abs(a - b) for a, b in zip(latest.stamps, stamps, strict=True)) <= slack:
            steps[-1] = latest._replace(topics=(*latest.topics, topic.name), falls=max(latest.falls, topic.falls))
        else:
            steps.append(ClockStep(stamps, (topic.name,), topic.falls, topic.usual_rate))
    return steps


def rising_rows(time: np.ndarray) -> np.ndarray:
    """The most rows whose times do not fall, in order: a longest non-decreasing subsequence.

    Args:
        time: Finite times, shape (n,).

    Returns:
        Positions of the rows, shape (m,).

    Source: M. L. Fredman, On computing the length of longest increasing subsequences, Discrete Mathematics 11, 1975.

    Example:
        >>> rising_rows(np.array([0.0, 1.0, 9.0, 2.0, 3.0])).tolist()
        [0, 1, 3, 4]
    """
    last_times: list[float] = []  # last time of a subsequence of each length
    last_rows: list[int] = []  # the row of that time
    predecessor = np.full(len(time), -1)
    for row, value in enumerate(time.tolist()):
        length = bisect.bisect_right(last_times, value)
        if length:
            predecessor[row] = last_rows[length - 1]
        if length == len(last_times):
            last_times.append(value)
            last_rows.append(row)
        else:
            last_times[length] = value
            last_rows[length] = row
    selected_rows = []
    row = last_rows[-1] if last_rows else -1
    while row >= 0:
        selected_rows.append(row)
        row = int(predecessor[row])
    return np.array(selected_rows[::-1], int)


def sound_rows(name: str, time: np.ndarray, rows: np.ndarray, may_drop: bool) -> np.ndarray:
    """The positions to keep, so that times do not fall: as many as possible, and all if no time falls.

    Args:
        name: The signal, for messages.
        time: Finite times of the signal [s], shape (n,).
        rows: The row of the log for each of these times, counted from 0, shape (n,).
        may_drop: Whether rows may be left out.

    Raises:
        ConfigError: Times fall, and rows may not be left out. Or too many rows would be left out, in all or in a row,
            so that the log's clock must have been set back.
    """
    falls = np.flatnonzero(np.diff(time) < 0.0)
    if not falls.size:
        return np.arange(len(time))
    first_fall = int(falls[0])
    selected_rows = rising_rows(time)
    dropped = len(time) - len(selected_rows)
    fall_text = (
        f"the log's times must not fall from row to row: {time[first_fall + 1]:.6g} s comes after "
        f"{time[first_fall]:.6g} s in row {rows[first_fall + 1] + 1}"
    )
    share_text = f"{dropped:,} of {len(time):,} rows would have to go"
    is_dropped = ~np.isin(np.arange(len(time)), selected_rows)
    if dropped > MOST_DROPPED * len(time) or longest_run(is_dropped) > MOST_TOGETHER:
        raise ConfigError(
            name,
            f"{fall_text}, and {share_text}: the clock of the log was set back. `dssc-jax log` tells where; take "
            "another log, or a table with the rows before or after that time",
        )
    if not may_drop:
        raise ConfigError(name, f"{fall_text}; {share_text}, which `allow_damaged` leaves out")
    return selected_rows
