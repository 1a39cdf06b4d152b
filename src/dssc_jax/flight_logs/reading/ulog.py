"""PX4's ULog: its topics and segments listed, and selected topics read, without holding the whole file.

pyulog reads a file message by message and holds the data of the topics that are asked for, with all their fields. The
list of topics comes from a pass of its own, which holds no data at all.

Source: PX4 user guide, "ULog file format".
"""

import struct
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, TypeAlias

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.flight_logs.reading.clocks import LateMessage, log_end_and_strays
from dssc_jax.flight_logs.reading.frames import MICROSECOND
from dssc_jax.flight_logs.reading.ulog_scan import LogTopic, Scan, UndamagedBytes
from dssc_jax.study.record_files import ULOG

if TYPE_CHECKING:
    from pyulog import ULog

HEADER = struct.Struct("<7sBQ")
ARMED = 2  # value of vehicle_status.arming_state
SEGMENTS = ("armed", "airborne")
SEGMENT_TOPICS = ("actuator_armed", "vehicle_status", "vehicle_land_detected")

TopicData: TypeAlias = dict[str, dict[str, np.ndarray]]
"""The fields of each topic, ``name:instance``, each of shape (messages,)."""


class Segment(NamedTuple):
    """A part of a log.

    Args:
        name: ``armed`` or ``airborne``.
        begin: Time of the log [s].
        end: Time of the log [s].
    """

    name: str
    begin: float
    end: float


class LogTopics(NamedTuple):
    """What a log holds.

    Args:
        system: What the log tells of the system that wrote it: hardware, software and so on, by PX4's names.
        duration: Time from the beginning of the log to the last stamp that is not stray [s].
        topics: Topics of the log, sorted by name.
        dropouts: Number of gaps in writing, and their sum [s].
        damaged: Position of the first byte that is no message; None: there is none.
        damages: Number of places with such bytes.
        lost: Number of such bytes.
        cut: Whether the file ends within a message.
        late: Stray last messages of topics, long after the end of the log.
    """

    system: dict[str, str]
    duration: float
    topics: tuple[LogTopic, ...]
    dropouts: tuple[int, float]
    damaged: int | None
    damages: int
    lost: int
    cut: bool
    late: tuple[LateMessage, ...]


class LogWarning(UserWarning):
    """A log is damaged, or what is read from it differs from it because of its estimator."""


def is_ulog(path: Path) -> bool:
    """Whether a file is a ULog, by the end of its name or by its first bytes."""
    return path.suffix.lower() == ".ulg" or (path.is_file() and files.read_bytes(path, len(ULOG)) == ULOG)


def topic_place(name: str) -> tuple[str, str]:
    """The topic of ``topic`` or ``topic:1``, and its key in :data:`TopicData`, which always has the instance."""
    topic, _, instance = name.partition(":")
    return topic, f"{topic}:{instance or 0}"


class OpenedLog(NamedTuple):
    """A ULog's file, and the class of pyulog that parses it."""

    file: BinaryIO
    parse: "type[ULog]"


@contextmanager
def opened_log(path: Path) -> Iterator[OpenedLog]:
    """Open a ULog. Errors of its content, and of pyulog, become a ConfigError."""
    try:
        from pyulog import ULog  # an optional extra
    except ImportError as error:
        raise ConfigError("file", "a log of PX4 needs pyulog: pip install 'dssc_jax[ulog]'") from error
    try:
        with files.open_regular_file(path) as file, redirect_stdout(StringIO()):  # pyulog prints warnings
            yield OpenedLog(file, ULog)
    except ConfigError:
        raise
    except Exception as error:  # pyulog raises errors of many kinds
        raise ConfigError("file", f"cannot be read: {' '.join(str(error).split())}") from error


class ReadTopics(NamedTuple):
    """Topics of a log: their fields, the time at which the log begins [us], and whether messages are lost."""

    topics: TopicData
    begin: float
    damaged: bool


def read_topics(path: Path, names: Iterable[str]) -> ReadTopics:
    """Read the messages of some topics, and skip those of others.

    Args:
        path: The log.
        names: Names of topics, without instance.

    Raises:
        ConfigError: the file cannot be read.

    Warns:
        LogWarning: The log is damaged.
    """
    log, damaged = parsed_log(path, names)
    if damaged:
        text = f"{path.name} is damaged: messages are lost, so that its signals have gaps"
        warnings.warn(text, LogWarning, stacklevel=2)
    topics = {f"{topic.name}:{topic.multi_id}": topic.data for topic in log.data_list}
    return ReadTopics(topics, float(log.start_timestamp), damaged)


def parsed_log(path: Path, names: Iterable[str]) -> "tuple[ULog, bool]":
    """Parse a log with the messages of some topics, and tell whether it is damaged.

    After damage, pyulog skips to the next synchronisation message, or stops. A damaged log is therefore parsed again,
    without the bytes that are no message.

    Raises:
        ConfigError: the file cannot be read.
    """
    topic_names = sorted(set(names))
    with opened_log(path) as opened:
        log_begin(opened.file)
        opened.file.seek(0)
        log = opened.parse(opened.file, topic_names)
    if not log.file_corruption:
        return log, False
    with opened_log(path) as opened:
        scan = scan_log(opened.file)
        if not scan.damages:
            return log, True
        skipped_parts = list(scan.damages)
        if scan.flags is not None:  # the offsets in this message count in the whole file, and would be wrong
            skipped_parts.append(scan.flags)
        skipped_parts.sort()
        size = opened.file.seek(0, 2)
        return opened.parse(UndamagedBytes(opened.file, skipped_parts, size), topic_names), True


def stamps(fields: Mapping[str, np.ndarray], begin: float) -> np.ndarray:
    """Times of a topic's messages from the beginning of the log [s]; NaN where one has no stamp.

    ``timestamp_sample`` is the time of the measurement from which a value follows; ``timestamp`` is that of the
    publication. ``timestamp_sample`` counts if all messages of the topic have it and it does not fall.
    """
    published = fields["timestamp"].astype(float)
    measured = fields.get("timestamp_sample")
    times = published
    if measured is not None and (measured > 0).all() and (np.diff(measured.astype(np.int64)) >= 0).all():
        times = measured.astype(float)
    return np.where(published > 0.0, MICROSECOND * (times - begin), np.nan)


def list_topics(path: Path) -> LogTopics:
    """The topics of a log with their number of messages and spans, in one pass that holds no data.

    Raises:
        ConfigError: the file cannot be read.
    """
    with opened_log(path) as opened:
        scan = scan_log(opened.file)
        opened.file.seek(0)
        log = opened.parse(opened.file, parse_header_only=True)
    system = {name: str(value) for name, value in log.msg_info_dict.items()}
    topics = tuple(sorted(scan.topics(), key=lambda topic: topic.name))
    duration, late_messages = log_end_and_strays(topics)
    damaged = scan.damages[0].begin if scan.damages else None
    lost_bytes = sum(damage.end - damage.begin for damage in scan.damages)
    return LogTopics(
        system=system,
        duration=duration,
        topics=topics,
        dropouts=scan.dropouts,
        damaged=damaged,
        damages=len(scan.damages),
        lost=lost_bytes,
        cut=scan.cut,
        late=tuple(late_messages),
    )


def is_cut(path: Path) -> bool:
    """Whether a log ends within a message, as where the power failed while it was written."""
    with opened_log(path) as opened:
        return scan_log(opened.file).cut


def scan_log(file: BinaryIO) -> Scan:
    """Scan all messages of a log."""
    scan = Scan(log_begin(file))
    scan.run(file)
    return scan


def log_begin(file: BinaryIO) -> int:
    """The time at which a log begins [us]; raises ConfigError if it is no ULog."""
    head = file.read(HEADER.size)
    if not head:
        raise ConfigError("", "is no ULog: the file is empty")
    if len(head) < HEADER.size or head[: len(ULOG)] != ULOG:
        raise ConfigError("", "is no ULog: its first bytes are others")
    return HEADER.unpack(head)[2]


def log_end(topics: TopicData, begin: float) -> float:
    """The last stamp of some topics, from the beginning of the log [s]; 0 if there is none."""
    times = [stamps(fields, begin) for fields in topics.values()]
    return max((float(time[np.isfinite(time)].max(initial=0.0)) for time in times), default=0.0)


def segments_of(topics: TopicData, begin: float, end: float | None = None) -> list[Segment]:
    """The segments in which a vehicle was armed, and in the air.

    Armed: ``actuator_armed.armed``, or ``vehicle_status.arming_state`` is 2. Airborne: armed and not
    ``vehicle_land_detected.landed``. A state holds until the topic's next message, the last one until the end of the
    log: some of these topics are sent at a change only. Before the first message it is unknown, and counts as no.

    Args:
        topics: The topics of the log that are read; those of :data:`SEGMENT_TOPICS`, as far as the log has them.
        begin: The time at which the log begins [us].
        end: End of the log [s]; None: the last stamp of the topics.
    """
    end = log_end(topics, begin) if end is None else end
    armed = spans_of(topics, "actuator_armed:0", "armed", lambda values: values > 0, begin, end)
    if armed is None:
        armed = spans_of(topics, "vehicle_status:0", "arming_state", lambda values: values == ARMED, begin, end)
    if armed is None:
        return []
    segments = [Segment("armed", *span) for span in armed]
    in_air = spans_of(topics, "vehicle_land_detected:0", "landed", lambda values: values == 0, begin, end) or []
    for low, high in in_air:
        for start, stop in armed:
            if max(low, start) < min(high, stop):
                segments.append(Segment("airborne", max(low, start), min(high, stop)))
    return segments


def spans_of(
    topics: TopicData,
    topic: str,
    field: str,
    holds: Callable[[np.ndarray], np.ndarray],
    begin: float,
    end: float,
) -> list[tuple[float, float]] | None:
    """The spans of time in which a field has a property; None if the log lacks the field.

    Args:
        topics: Topics of the log.
        topic: Key of the topic, ``name:instance``.
        field: Name of the field.
        holds: Values of the field -> whether each of them has the property.
        begin: The time at which the log begins [us].
        end: End of the log [s], up to which the last message holds.
    """
    fields = topics.get(topic)
    if fields is None or field not in fields:
        return None
    time = MICROSECOND * (fields["timestamp"].astype(float) - begin)
    bounds = np.append(time, max(end, float(time[-1])))
    begins, ends = flag_runs(holds(fields[field]))
    pairs = zip(bounds[begins].tolist(), bounds[ends].tolist(), strict=True)
    return [(low, high) for low, high in pairs if low < high]


def named_segment(text: str, segments: Sequence[Segment]) -> Segment:
    """The segment that a text names: ``armed`` stands for the longest such segment, ``armed:2`` for the second.

    Args:
        text: The text.
        segments: The segments of the log.

    Raises:
        ConfigError: there is no such segment.
    """
    name, _, number = text.partition(":")
    if name not in SEGMENTS or (number and not number.isdecimal()):
        raise ConfigError("segment", f"must be {' or '.join(SEGMENTS)}, or armed:2 for the second one, got {text!r}")
    matches = [segment for segment in segments if segment.name == name]
    if not matches:
        raise ConfigError("segment", f"the log has no segment '{name}'; `dssc-jax log FILE` lists what it has")
    if not number:
        return max(matches, key=lambda segment: segment.end - segment.begin)
    if not 1 <= int(number) <= len(matches):
        raise ConfigError("segment", f"the log has {len(matches)} segments '{name}', got number {number}")
    return matches[int(number) - 1]
