"""Logged flights: CSV, Parquet and PX4's ULog as the signals of a study's channels, and their values at its samples."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError, errors_in_file, nearest
from dssc_jax.core.numerics import wrap_angle
from dssc_jax.flight_logs.reading.clocks import sound_rows
from dssc_jax.flight_logs.reading.columns import ColumnMap, SignalSource, TimeSource, column_map, column_place
from dssc_jax.flight_logs.reading.frames import PX4_COLUMNS, derived_fields, field_values
from dssc_jax.flight_logs.reading.placeholders import require_no_placeholder
from dssc_jax.flight_logs.reading.resets import (
    InvalidSpan,
    Reset,
    concerned_resets,
    concerned_spans,
    estimate_topics,
    without_invalid,
    without_jumps,
)
from dssc_jax.flight_logs.reading.ulog import (
    SEGMENT_TOPICS,
    Segment,
    TopicData,
    is_cut,
    is_ulog,
    named_segment,
    read_topics,
    segments_of,
    stamps,
)
from dssc_jax.study import Study
from dssc_jax.study.record_files import recorded_frame
from dssc_jax.study.recorded import numbers_of

LOGGED = ("y", "y_dot", "y_ref", "y_ref_dot", "y_ref_ddot", "u_total")
"""Signals of a channel that a log may have, by their names in trajectories."""
LARGEST_VALUE = 1e100
"""Times and values of a log; squares and sums of larger ones overflow."""
TIME_ROUNDING = 1e-6  # samples


class Column(NamedTuple):
    """One logged signal.

    Args:
        time: Times of the values [s], not falling, shape (n,).
        value: The finite values, in the study's unit, shape (n,).
    """

    time: np.ndarray
    value: np.ndarray


class FlightLog(NamedTuple):
    """A logged flight.

    Args:
        name: Name of the log's file.
        columns: The logged signals by name: ``y``, ``u_total`` and others of :data:`LOGGED`; those of a channel x are
            ``x_y``, ``x_u_total`` and so on.
        start: Time of the log at which the study begins [s].
        damaged: Whether the file has lost messages.
        airborne: When the vehicle was in the air, as far as the file tells.
        file: Path of the log's file; None: the log was made in memory.
        dropped: Number of rows that are left out because their times fall, by signal.
        clock: The column of times of a CSV or Parquet file.
        resets: Resets of the estimator that the signals show after the start; known jumps of positions are taken out.
        invalid: Spans in which the estimator calls the signals invalid; their values are left out.
    """

    name: str
    columns: dict[str, Column]
    start: float
    damaged: bool = False
    airborne: tuple[Segment, ...] = ()
    file: Path | None = None
    dropped: Mapping[str, int] = MappingProxyType({})
    clock: TimeSource = TimeSource()
    resets: tuple[Reset, ...] = ()
    invalid: tuple[InvalidSpan, ...] = ()

    def is_cut(self) -> bool:
        """Whether the log's file ends within a message; the file is read once more."""
        return self.file is not None and is_ulog(self.file) and is_cut(self.file)

    @property
    def end(self) -> float:
        """Time of the last value, on the clock of :attr:`start` [s]."""
        return float(max(column.time[-1] for column in self.columns.values()))


def first_time(columns: Mapping[str, Column]) -> float:
    """The time of the first value of some columns [s]."""
    return float(min(column.time[0] for column in columns.values()))


def signal_name(channel: str, name: str) -> str:
    """The name in a log of a channel's signal: ``x_y`` for y of the channel x, ``y`` for that of a nameless channel."""
    return f"{channel}_{name}" if channel else name


def log_signals(channels: tuple[str, ...]) -> list[str]:
    """The names of all signals that a log may have."""
    return [signal_name(channel, name) for channel in channels for name in LOGGED]


def read_log(
    path: str | Path,
    channels: tuple[str, ...] = ("",),
    table: Mapping[str, object] | None = None,
    *,
    allow_damaged: bool = False,
) -> FlightLog:
    """Read a logged flight.

    Args:
        path: A CSV or Parquet file, or a ULog of PX4 (``.ulg``), which needs pyulog.
        channels: The study's channels, ``study.loop.channels``.
        table: The table of columns: ``time`` (a column, or a table with ``column`` and ``scale``, its unit in seconds)
            and ``start``, ``segment`` (``armed`` or ``airborne``) of a ULog, and under ``signals`` for each signal the
            name of its column, or a table with ``column``, ``scale`` and ``offset``. None: those columns that have the
            signals' own names, as ``dssc-jax simulate --csv`` writes them; of a ULog, those of a vehicle in
            :data:`dssc_jax.flight_logs.reading.frames.PX4_COLUMNS`. A column of a ULog is ``topic.field``, or
            ``topic:1.field`` for the topic's second instance. A field may be one in the model's axes, see
            :data:`dssc_jax.flight_logs.reading.frames.DERIVED`.
        allow_damaged: Whether rows whose times fall are left out, the fewest possible; at most 5 %.

    Raises:
        ConfigError: The file cannot be read; a column is absent, holds no numbers, or holds one that stands for missing
            values; times fall; or the log ends before its start.
    """
    file = Path(path)
    columns = column_map(table or {}, log_signals(channels))
    with errors_in_file(str(file)):
        is_px4 = is_ulog(file)
        if columns.segment is not None and not is_px4:
            raise ConfigError("segment", "is found in a ULog of PX4 only; `start` is a time of any log")
        raw_log = (ulog_columns if is_px4 else table_columns)(file, columns, channels)
        if not any(name.endswith(("y", "u_total")) for name in raw_log.columns):
            names = [name for name in log_signals(channels) if name.endswith(("y", "u_total"))]
            raise ConfigError("signals", f"map a column to at least one of {', '.join(names)}{raw_log.reason}")
        converted = {}
        dropped = {}
        for name, column in raw_log.columns.items():
            source = columns.signals.get(name, SignalSource(name))
            if not (np.isfinite(column.time) & np.isfinite(column.value)).any():
                raise ConfigError(name, f"has no finite value in the log{raw_log.reason}")
            require_no_placeholder(name, column.value)
            converted[name], count = converted_column(name, column, source, allow_damaged)
            if count:
                dropped[name] = count
    first = first_time(converted) if raw_log.begin is None else raw_log.begin
    start = first if columns.start is None else columns.start
    details = raw_log.damaged, raw_log.airborne, file, dropped, columns.time, raw_log.resets, raw_log.invalid
    log = FlightLog(file.name, converted, start, *details)
    if start >= log.end > first:
        raise ConfigError(f"{file}: start", f"is {start:g} s, and the log ends at {log.end:g} s")
    return log


def converted_column(name: str, column: Column, source: SignalSource, allow_damaged: bool) -> tuple[Column, int]:
    """The finite values of a column in the study's unit, and the number of rows left out because their times fall.

    Raises:
        ConfigError: Times fall, and rows may not be left out; or a time or a value is too large.
    """
    rows = np.flatnonzero(np.isfinite(column.time) & np.isfinite(column.value))
    selected_rows = rows[sound_rows(name, column.time[rows], rows, allow_damaged)]
    time = column.time[selected_rows]
    with np.errstate(over="ignore"):
        value = source.scale * column.value[selected_rows] + source.offset
    for label, numbers in (("time", time), ("value", value)):
        largest = np.abs(numbers).max()
        if largest > LARGEST_VALUE:
            rule = f"its largest {label} in the log is {largest:g}; at most {LARGEST_VALUE:g} is taken"
            raise ConfigError(name, rule)
    return Column(time, value), len(rows) - len(selected_rows)


class LogColumns(NamedTuple):
    """Columns of a log by the signals' names, and further facts from a ULog.

    Args:
        columns: The columns.
        begin: Beginning of the chosen segment [s]; None without a segment.
        damaged: Whether messages are lost.
        airborne: When the vehicle was in the air.
        resets: Resets of the estimator after the start.
        invalid: Spans in which the estimator calls values invalid.
    """

    columns: dict[str, Column]
    begin: float | None = None
    damaged: bool = False
    airborne: tuple[Segment, ...] = ()
    resets: tuple[Reset, ...] = ()
    invalid: tuple[InvalidSpan, ...] = ()

    @property
    def reason(self) -> str:
        """Why values may be missing: the invalid spans in words; empty if there are none."""
        return "".join(f"; {span.text()}" for span in self.invalid)


def table_columns(path: Path, columns: ColumnMap, channels: tuple[str, ...]) -> LogColumns:
    """Read the columns of a CSV or Parquet file, by the signals' names."""
    frame = recorded_frame(path)
    present = [str(name) for name in frame.columns]
    names = {signal: source.column for signal, source in columns.signals.items()}
    if not names:
        names = {name: name for name in log_signals(channels) if name in present}
    for field, name in {"time": columns.time.column, **names}.items():
        if name not in present:
            rule = f"has no column '{name}'; {nearest(name, present)}; a table of columns gives the names"
            raise ConfigError(field, rule)
    try:
        time = columns.time.scale * frame[columns.time.column].to_numpy(float)
        signal_columns = {signal: Column(time, frame[name].to_numpy(float)) for signal, name in names.items()}
    except (TypeError, ValueError):
        for signal, name in {"time": columns.time.column, **names}.items():
            numbers_of(frame[name], path, signal)
        raise
    return LogColumns(signal_columns)


def ulog_columns(path: Path, columns: ColumnMap, channels: tuple[str, ...]) -> LogColumns:
    """Read the columns of a ULog, by the signals' names; times count from the beginning of the log.

    Stated jumps of the estimator after the start are taken out, and values that it calls invalid are NaN.
    """
    sources = {name: (source.column,) for name, source in columns.signals.items()} or vehicle_columns(channels)
    if not sources:
        raise ConfigError("signals", "a log of PX4 needs a table of columns, such as y = 'topic.field'")
    names = {column_place(column).topic for choices in sources.values() for column in choices}
    logged, begin, damaged = read_topics(path, {*names, *SEGMENT_TOPICS, *estimate_topics(names)})
    valid = without_invalid(logged)
    segments = segments_of(logged, begin)
    airborne = tuple(segment for segment in segments if segment.name == "airborne")
    segment = None if columns.segment is None else named_segment(columns.segment, segments)
    column_names = {}
    for name, choices in sources.items():
        present = [column for column in choices if has_column(valid, column)]
        if columns.signals or present:
            column_names[name] = present[0] if present else choices[0]
    if not column_names:
        topics = ", ".join(sorted(names))
        raise ConfigError("signals", f"the log has no values of {topics}; `dssc-jax log FILE` lists its topics")
    places = [column_place(column) for column in column_names.values()]
    pairs = [(place.topic, place.field) for place in places if place.label == f"{place.topic}:0"]
    segment_begin = None if segment is None else segment.begin
    start = columns.start if columns.start is not None else segment_begin
    resets = concerned_resets(logged, begin, pairs, -np.inf if start is None else start)
    topics = without_jumps(valid, resets)
    signals = {name: ulog_column(topics, begin, name, column) for name, column in column_names.items()}
    if segment is not None:
        signals = {name: within_segment(name, column, segment) for name, column in signals.items()}
    invalid = concerned_spans(logged, begin, pairs)
    return LogColumns(
        columns=signals, begin=segment_begin, damaged=damaged, airborne=airborne, resets=resets, invalid=invalid
    )


def vehicle_columns(channels: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """The columns of a multirotor's signals in a ULog; none for other channels."""
    choices_by_signal = {}
    for channel in channels:
        for name, choices in PX4_COLUMNS.get(channel, {}).items():
            choices_by_signal[signal_name(channel, name)] = choices
    return choices_by_signal


def column_remedy(channel: str, name: str) -> str:
    """The remedy, in words, for a signal without a column, with the column that a ULog of PX4 usually has."""
    signal = signal_name(channel, name)
    usual_columns = PX4_COLUMNS.get(channel, {}).get(name)
    example = f", which PX4 logs as {' or '.join(usual_columns)}" if usual_columns else ""
    return f"give its column in the table of columns, or by --column {signal}=COLUMN{example}"


def has_column(topics: TopicData, column: str) -> bool:
    """Whether a log has finite values of a column."""
    place = column_place(column)
    values = field_values(place.topic, topics.get(place.label, {}), place.field)
    return values is not None and bool(np.isfinite(values).any())


def ulog_column(topics: TopicData, begin: float, name: str, column: str) -> Column:
    """Get a signal's column of a ULog with its times [s]; raises ConfigError if the log lacks the topic or field."""
    place = column_place(column)
    if place.label not in topics:
        present = [label.removesuffix(":0") for label in topics]
        rule = f"the log has no topic '{place.label.removesuffix(':0')}'; `dssc-jax log FILE` lists its topics"
        raise ConfigError(f"signals.{name}", f"{rule}; {nearest(place.topic, present)}" if present else rule)
    fields = topics[place.label]
    values = field_values(place.topic, fields, place.field)
    if values is None:
        field_names = [*fields, *derived_fields(place.topic, fields)]
        rule = f"topic '{place.topic}' has no field '{place.field}'; {nearest(place.field, field_names)}"
        raise ConfigError(f"signals.{name}", rule)
    return Column(stamps(fields, begin), values)


def within_segment(name: str, column: Column, segment: Segment) -> Column:
    """The values of a column within a segment; raises ConfigError if there are none."""
    is_inside = (column.time >= segment.begin) & (column.time <= segment.end)
    if not is_inside.any():
        span = f"{segment.begin:.4g} s to {segment.end:.4g} s"
        raise ConfigError(name, f"has no value in the segment '{segment.name}', {span}")
    return Column(column.time[is_inside], column.value[is_inside])


def samples_within(log: FlightLog, sample_time: float, steps: int) -> int:
    """Number of the study's samples, of ``steps``, up to the log's last value; 0 if the study begins after it."""
    return int(np.clip(np.floor((log.end - log.start) / sample_time + 0.5) + 1.0, 0.0, steps))


def nearest_rows(column: Column, start: float, sample_time: float, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Find the logged value nearest to each instant ``start`` + k ``sample_time``.

    Args:
        column: The signal.
        start: Time of the log at sample 0 [s].
        sample_time: Time between two samples [s].
        samples: Number of samples.

    Returns:
        Positions of the values in the column, and the values' times less the instants, in samples, NaN where they
        exceed half a sample; both of shape (samples,).
    """
    instants = start + sample_time * np.arange(samples)
    middles = 0.5 * (column.time[1:] + column.time[:-1])
    rows = np.searchsorted(middles, instants)
    offsets = (column.time[rows] - instants) / sample_time
    return rows, np.where(np.abs(offsets) <= 0.5 * (1.0 + TIME_ROUNDING), offsets, np.nan)


def nearest_values(column: Column, start: float, sample_time: float, samples: int) -> np.ndarray:
    """The logged value nearest to each sample instant; NaN where none lies within half a sample time.

    Example:
        >>> nearest_values(Column(np.array([0.0, 0.11, 0.4]), np.array([1.0, 2.0, 3.0])), 0.0, 0.1, 5)
        array([ 1.,  2., nan, nan,  3.])
    """
    rows, offsets = nearest_rows(column, start, sample_time, samples)
    return np.where(np.isnan(offsets), np.nan, column.value[rows])


def nearest_offsets(column: Column, start: float, sample_time: float, samples: int) -> np.ndarray:
    """Times of the values of :func:`nearest_values` less the sample instants, in samples; NaN where there is no value.

    Of values that are nearest to several instants, or have the same time, the first one counts. Offsets within the
    rounding of times are 0.
    """
    rows, offsets = nearest_rows(column, start, sample_time, samples)
    repeated = np.zeros(samples, bool)
    repeated[1:] = (np.diff(column.time[rows]) == 0.0) & np.isfinite(offsets[:-1])
    rounded = np.where(np.abs(offsets) < TIME_ROUNDING, 0.0, offsets)
    return np.where(repeated, np.nan, rounded)


def channel_signals(study: Study, log: FlightLog, index: int, reference: np.ndarray) -> dict[str, np.ndarray]:
    """The logged signals of a channel at the study's samples, NaN where missing, by their names without the channel.

    The output of an angle is shifted by turns to within pi of the study's reference, shape (samples,).
    """
    channel = study.loop.channels[index]
    signals = {}
    for name in LOGGED:
        column = log.columns.get(signal_name(channel, name))
        if column is not None:
            signals[name] = nearest_values(column, log.start, study.loop.sample_time, len(reference))
    if channel in study.loop.plant.angles and "y" in signals:
        signals["y"] = reference + np.asarray(wrap_angle(signals["y"] - reference))
    return signals


def held_samples(signals: Mapping[str, np.ndarray]) -> dict[str, int]:
    """Number of samples at which :func:`forward_filled` gives another sample's value, by signal, where there are any.

    Args:
        signals: Values at the samples by name, NaN where missing, shape (samples,).
    """
    counts = {name: int(np.count_nonzero(~np.isfinite(values))) for name, values in signals.items()}
    return {name: count for name, count in counts.items() if 0 < count < len(signals[name])}


def forward_filled(values: np.ndarray) -> np.ndarray:
    """Fill each missing value with the finite one before it, or else with the first finite one; one has to exist."""
    finite_rows = np.flatnonzero(np.isfinite(values))
    latest = np.searchsorted(finite_rows, np.arange(len(values)), side="right") - 1
    return values[finite_rows[np.maximum(latest, 0)]]
