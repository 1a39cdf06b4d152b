"""What a log holds: its topics or columns, its segments, and the values of chosen topics."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError, errors_in_file, nearest
from dssc_jax.flight_logs.reading.clocks import ClockStep, LateMessage, column_clock, falls_of, gaps_of
from dssc_jax.flight_logs.reading.frames import derived_fields, field_values
from dssc_jax.flight_logs.reading.resets import (
    ATTITUDE,
    POSITION,
    InvalidSpan,
    Reset,
    estimate_topics,
    invalid_spans,
    reset_list,
    resets_of,
    without_invalid,
    without_jumps,
)
from dssc_jax.flight_logs.reading.ulog import (
    SEGMENT_TOPICS,
    LogWarning,
    Segment,
    TopicData,
    is_ulog,
    list_topics,
    named_segment,
    read_topics,
    segments_of,
    stamps,
    topic_place,
)
from dssc_jax.flight_logs.reading.ulog_scan import LogTopic
from dssc_jax.study.record_files import recorded_frame
from dssc_jax.study.recorded import TIME, first_text

TIME_NAMES = ("time", "stamp", "seconds")
"""Beginnings of the names that columns of times usually have."""
ESTIMATES = (POSITION, ATTITUDE)


class FieldValues(NamedTuple):
    """The values of a field or column.

    Args:
        name: The column's name, as a table of columns takes it.
        derived: Whether the field is computed in the model's axes, and not a field of the log itself.
        finite: Number of finite values.
        lowest: Minimum of the finite values; NaN if there are none.
        median: Median of the finite values.
        highest: Maximum of the finite values.
    """

    name: str
    derived: bool
    finite: int
    lowest: float
    median: float
    highest: float


@dataclass(frozen=True)
class LogContents:
    """What a log holds.

    Attributes:
        name: Name of the log's file.
        system: What a ULog tells of the system that wrote it, by PX4's names.
        duration: Time from the beginning to the end of the log [s].
        topics: Topics of a ULog; none of a table.
        segments: When the vehicle was armed and airborne.
        dropouts: Number of gaps in writing, and their sum [s].
        damaged: Position of the first byte that is no message; None: there is none.
        damages: Number of places with bytes that are no message.
        lost: Number of bytes that are no message.
        cut: Whether the file ends within a message, as where the power failed while it was written.
        fields: Fields of the chosen topics, or the columns of a table.
        resets: Resets of the estimator, of position, velocity and attitude.
        invalid: When the estimator called position or velocity invalid.
        late: Last messages of topics long after the end of the log.
        clock: The times of a table; None: it has none, or the log is a ULog.
        text_columns: Columns of a table that hold text, in some cells at least.
        text_cells: The first cell with text of each such column, in words; without columns whose texts are all numbers.
    """

    name: str
    system: dict[str, str]
    duration: float
    topics: tuple[LogTopic, ...]
    segments: tuple[Segment, ...]
    dropouts: tuple[int, float]
    damaged: int | None
    damages: int
    lost: int
    cut: bool
    fields: tuple[FieldValues, ...]
    resets: tuple[Reset, ...] = ()
    invalid: tuple[InvalidSpan, ...] = ()
    late: tuple[LateMessage, ...] = ()
    clock: LogTopic | None = None
    text_columns: tuple[str, ...] = ()
    text_cells: tuple[str, ...] = ()

    @property
    def lacks_times(self) -> bool:
        """Whether the log is a table that has columns, but none with times in numbers."""
        return self.clock is None and not self.topics and bool(self.fields or self.text_columns)

    @property
    def clocks(self) -> tuple[LogTopic, ...]:
        """The times that may fall or jump: those of the topics, or of a table's column."""
        return self.topics if self.clock is None else (self.clock,)

    @property
    def falls(self) -> list[ClockStep]:
        """Where time stamps fall from one message or row to the next."""
        return falls_of(self.clocks)

    @property
    def gaps(self) -> list[ClockStep]:
        """Where messages are missing, or the clock jumps."""
        return gaps_of(self.clocks)

    def summary(self) -> dict[str, object]:
        """The contents as plain data for JSON."""
        topics = [topic._asdict() | {"rate": topic.rate} for topic in self.topics]
        segments = [segment._asdict() for segment in self.segments]
        fields = [field._asdict() for field in self.fields]
        falls = [step._asdict() for step in self.falls]
        gaps = [step._asdict() for step in self.gaps]
        resets = []
        for reset in self.resets:
            names = reset.counter.fields
            resets.append({"counter": reset.label, "time": reset.time, "fields": names, "jump": reset.jump})
            resets[-1] |= {"size": reset.size, "unit": reset.counter.unit, "stated": reset.is_stated}
        invalid = [span._asdict() for span in self.invalid]
        lists = {"topics": topics, "segments": segments, "fields": fields, "falls": falls, "gaps": gaps}
        late_messages = [message._asdict() for message in self.late]
        facts = {**vars(self), **lists, "resets": resets, "invalid": invalid, "late": late_messages}
        del facts["clock"]
        return facts


def log_contents(path: Path, topics: Sequence[str] = ()) -> LogContents:
    """Read what a log holds, with the values of the fields of some topics.

    Args:
        path: A ULog of PX4, a CSV or a Parquet file.
        topics: Topics of a ULog, ``topic`` or ``topic:1``.

    Raises:
        ConfigError: the file cannot be read, or there is no such topic.
    """
    with errors_in_file(str(path)):
        if not is_ulog(path):
            if topics:
                raise ConfigError("topic", "is for a ULog of PX4; a table has columns, which are shown")
            return table_contents(path)
        listing = list_topics(path)
        topic_names = [topic.name for topic in listing.topics]
        for name in topics:
            if name.removesuffix(":0") not in topic_names:
                raise ConfigError("topic", f"the log has no topic '{name}'; {nearest(name, topic_names)}")
        names = [topic_place(name)[0] for name in topics]
        data, begin, _ = read_topics(path, [*names, *SEGMENT_TOPICS, *ESTIMATES])
        fields = [field for name in topics for field in topic_fields(name, data, begin)]
        return LogContents(
            name=path.name,
            system=listing.system,
            duration=listing.duration,
            topics=listing.topics,
            segments=tuple(segments_of(data, begin, listing.duration)),
            dropouts=listing.dropouts,
            damaged=listing.damaged,
            damages=listing.damages,
            lost=listing.lost,
            cut=listing.cut,
            fields=tuple(fields),
            resets=tuple(resets_of(data, begin)),
            invalid=tuple(invalid_spans(data, begin, listing.duration)),
            late=listing.late,
        )


def topic_fields(name: str, data: TopicData, begin: float) -> Iterable[FieldValues]:
    """The fields of a topic, those in the model's axes first; none if the log lacks the topic.

    Args:
        name: ``topic`` or ``topic:1``.
        data: Topics of the log.
        begin: The time at which the log begins [us].
    """
    topic, key = topic_place(name)
    signals = data.get(key, {})
    if not signals:
        return
    label = name.removesuffix(":0")
    time = stamps(signals, begin)
    for field in derived_fields(topic, signals):
        yield field_summary(f"{label}.{field}", field_values(topic, signals, field), True)
    yield field_summary(f"{label}: time [s]", time, False)
    for field in signals:
        if not field.startswith("timestamp"):
            yield field_summary(f"{label}.{field}", field_values(topic, signals, field), False)


def field_summary(name: str, values: np.ndarray | None, derived: bool) -> FieldValues:
    """The number, range and median of a field's finite values.

    Args:
        name: Name of the field.
        values: Values of the field; None: the log lacks it.
        derived: Whether the field is in the model's axes.
    """
    finite = np.empty(0) if values is None else values[np.isfinite(values)]
    if not finite.size:
        return FieldValues(name=name, derived=derived, finite=0, lowest=np.nan, median=np.nan, highest=np.nan)
    numbers = (finite.min(), np.median(finite), finite.max())
    return FieldValues(name, derived, finite.size, *map(float, numbers))


def table_contents(path: Path) -> LogContents:
    """The columns of a CSV or Parquet file that hold numbers, and the span, falls and gaps of the file's times.

    The times are in the column t, or else in the first one whose name begins with one of :data:`TIME_NAMES`.
    """
    whole_frame = recorded_frame(path)
    frame = whole_frame.select_dtypes("number")
    texts = whole_frame.select_dtypes(exclude=["number", "bool"])
    text_columns = tuple(map(str, texts.columns))
    text_cells = tuple(f"{name}: {cell}" for name, column in texts.items() if (cell := first_text(column, path)))
    columns: Mapping[str, np.ndarray] = {str(name): frame[name].to_numpy(float) for name in frame.columns}
    fields = tuple(field_summary(name, values, False) for name, values in columns.items())
    names = [name for name in columns if name.strip().lower().startswith(TIME_NAMES)]
    name = TIME if TIME in columns else next(iter(names), None)
    clock = None
    span = 0.0
    if name is not None:
        clock = column_clock(name, columns[name])
        finite_times = columns[name][np.isfinite(columns[name])]
        span = float(np.ptp(finite_times)) if finite_times.size else 0.0
    return LogContents(
        name=path.name,
        system={},
        duration=span,
        topics=(),
        segments=(),
        dropouts=(0, 0.0),
        damaged=None,
        damages=0,
        lost=0,
        cut=False,
        fields=fields,
        clock=clock,
        text_columns=text_columns,
        text_cells=text_cells,
    )


def topic_table(
    path: Path, topic: str, segment: str | None = None, start: float | None = None
) -> dict[str, np.ndarray]:
    """A topic as columns of equal length: its times ``t`` [s], and its fields, those in the model's axes first.

    Messages without a stamp, or from before the start, are left out, except for the last message before the start. It
    is kept at a negative time, so that the record has a value at 0. As in a comparison, jumps of the estimator after
    the start are taken out, and values that the estimator calls invalid are NaN.

    Args:
        path: A ULog of PX4.
        topic: ``topic`` or ``topic:1``.
        segment: The part to take.
        start: Time of the log at which t is 0 [s]; None: the beginning of the segment, or of the log.

    Raises:
        ConfigError: the file cannot be read, it lacks the topic or the segment, or the part has no message.

    Warns:
        LogWarning: The log is damaged, or the table differs from the log because of its estimator.
    """
    with errors_in_file(str(path)):
        name, key = topic_place(topic)
        data, begin, _ = read_topics(path, [name, *SEGMENT_TOPICS, *estimate_topics([name])])
        signals = data.get(key)
        if signals is None:
            topic_names = [logged_topic.name for logged_topic in list_topics(path).topics]
            raise ConfigError("topic", f"the log has no topic '{topic}'; {nearest(topic, topic_names)}")
        time = stamps(signals, begin)
        log_span = Segment("whole", 0.0, np.inf)
        span = log_span if segment is None else named_segment(segment, segments_of(data, begin))
        origin = span.begin if start is None else start
        signals = valid_signals(path, topic, data, begin, Segment("part", origin, span.end))
        first = max(span.begin, origin)
        is_inside = (time >= first) & (time <= span.end)
        if not is_inside.any():
            span_text = "none has a stamp"
            finite_times = time[np.isfinite(time)]
            if finite_times.size:
                span_text = f"its messages are from {finite_times.min():.4g} s to {finite_times.max():.4g} s"
            raise ConfigError(topic, f"has no message from {first:.4g} s on in the part asked for; {span_text}")
        earlier = np.flatnonzero(time < first)
        if earlier.size:
            is_inside[earlier[-1]] = True
        table = {TIME: time[is_inside] - origin}
        for field in [*derived_fields(name, signals), *signals]:
            values = field_values(name, signals, field)
            if values is not None and not field.startswith("timestamp"):
                table[field] = values[is_inside]
        return table


def valid_signals(path: Path, topic: str, data: TopicData, begin: float, part: Segment) -> dict[str, np.ndarray]:
    """The fields of a topic, without the estimator's invalid values, and without its jumps in a part of the log.

    Args:
        path: The log, for the warning.
        topic: ``topic`` or ``topic:1``.
        data: Topics of the log.
        begin: The time at which the log begins [us].
        part: The part of the log in which jumps are taken out.

    Warns:
        LogWarning: The result differs from the log.
    """
    _, key = topic_place(topic)
    resets = [reset for reset in resets_of(data, begin) if part.begin < reset.time <= part.end]
    signals = without_jumps(without_invalid(data), resets)[key]
    changed_names = []
    for name, values in signals.items():
        if not np.array_equal(values, data[key][name], equal_nan=True):
            changed_names.append(name)
    if changed_names:
        removed_resets = [reset for reset in resets if reset.is_removed]
        reasons = [f"jumps {reset_list(removed_resets)} are taken out"] if removed_resets else []
        if any(np.isnan(signals[name]).sum() > np.isnan(data[key][name]).sum() for name in changed_names):
            reasons.append("invalid values are left out")
        text = f"{path.name}: {topic} is not as logged in {', '.join(changed_names)}: {' and '.join(reasons)}"
        warnings.warn(text, LogWarning, stacklevel=3)
    return signals
