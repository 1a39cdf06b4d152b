"""Logged flights: columns of CSV or Parquet files, or topics of PX4's ULog, as the signals of a study's channels."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.study.recorded import TIME, record_content, recorded_frame

LOGGED = ("y", "y_dot", "y_ref", "y_ref_dot", "y_ref_ddot", "u_total")
"""Signals of a channel that a log may have, by their names in trajectories."""
MICROSECOND = 1e-6  # s
LARGEST_VALUE = 1e100
"""Times and values of a log; squares and sums of larger ones overflow."""


class Column(NamedTuple):
    """One logged signal.

    Args:
        time: Times of its values [s], not falling, shape (n,).
        value: Its values, finite, in the study's unit, shape (n,).
    """

    time: np.ndarray
    value: np.ndarray


class ColumnMap(NamedTuple):
    """Where a log has the signals of a study.

    Args:
        signals: For each signal its column, a scale and an offset: value = scale * column + offset.
        time: The column with the time [s], of a CSV or Parquet file.
        start: Time of the log at which the study begins [s]; None: the first sample of all signals. Times of a ULog
            count from its beginning.
    """

    signals: dict[str, tuple[str, float, float]]
    time: str = TIME
    start: float | None = None


class FlightLog(NamedTuple):
    """A logged flight.

    Args:
        name: The name of its file.
        columns: The logged signals by name: ``y``, ``u_total`` and others of :data:`LOGGED`; those of a channel x are
            ``x_y``, ``x_u_total`` and so on.
        start: Time of the log at which the study begins [s].
    """

    name: str
    columns: dict[str, Column]
    start: float


def log_signals(channels: tuple[str, ...]) -> list[str]:
    """The names of all signals that a log may have."""
    return [f"{channel}_{name}" if channel else name for channel in channels for name in LOGGED]


def column_map(table: Mapping[str, Any], channels: tuple[str, ...]) -> ColumnMap:
    """Check the table of columns.

    Args:
        table: ``time`` and ``start``, and under ``signals`` for each signal the name of its column, or a table with
            ``column``, ``scale`` and ``offset``.
        channels: The study's channels.

    Raises:
        ConfigError: an entry is unknown or has the wrong type.
    """
    for name in table:
        if name not in (fields := ("signals", *ColumnMap._fields[1:])):
            raise ConfigError(name, f"is no entry of a table of columns; {nearest(name, fields)}")
    time, start, given = table.get("time", TIME), table.get("start"), table.get("signals", {})
    if not isinstance(time, str):
        raise ConfigError("time", f"must be the name of a column, got {time!r}")
    if start is not None and not is_finite_number(start):
        raise ConfigError("start", f"must be a finite number of seconds, got {start!r}")
    if not isinstance(given, Mapping):
        raise ConfigError("signals", f"must be a table, got {given!r}")
    known, signals = log_signals(channels), {}
    with errors_under("signals"):
        for name, value in given.items():
            if name not in known:
                raise ConfigError(name, f"is no signal of the study; {nearest(name, known)}")
            whole = {"column": value} if isinstance(value, str) else value
            if not isinstance(whole, Mapping) or not set(whole) <= {"column", "scale", "offset"}:
                raise ConfigError(name, f"must be a column, or a table of column, scale and offset, got {value!r}")
            scale, offset = whole.get("scale", 1.0), whole.get("offset", 0.0)
            if not isinstance(whole.get("column"), str):
                raise ConfigError(f"{name}.column", f"must be the name of a column, got {whole.get('column')!r}")
            if not is_finite_number(scale) or scale == 0 or not is_finite_number(offset):
                raise ConfigError(
                    name, f"scale and offset must be finite and scale not 0, got {scale!r} and {offset!r}"
                )
            signals[name] = (whole["column"], float(scale), float(offset))
    return ColumnMap(signals, time, None if start is None else float(start))


def is_finite_number(value: Any) -> bool:
    """Whether a value of TOML is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def read_log(path: str | Path, channels: tuple[str, ...] = ("",), table: Mapping[str, Any] | None = None) -> FlightLog:
    """Read a logged flight.

    Args:
        path: A CSV or Parquet file, or a ULog of PX4 (``.ulg``), which needs pyulog.
        channels: The study's channels, ``study.loop.channels``.
        table: The table of columns, see :func:`column_map`; None: those columns that have the signals' own names, as
            ``dssc-jax simulate --csv`` writes them. A column of a ULog is ``topic.field``, or ``topic:1.field`` for
            the topic's second instance.

    Raises:
        ConfigError: the file cannot be read, or a column is absent or holds no numbers.
    """
    file, columns = Path(path), column_map(table or {}, channels)
    with errors_under(str(file)):
        ulog = file.suffix.lower() == ".ulg"
        read = ulog_columns(file, columns) if ulog else table_columns(file, columns, channels)
        if not any(name.endswith(("y", "u_total")) for name in read):
            wanted = [name for name in log_signals(channels) if name.endswith(("y", "u_total"))]
            raise ConfigError("signals", f"map a column to at least one of {', '.join(wanted)}")
        logged = {}
        for name, (time, value) in read.items():
            _, scale, offset = columns.signals.get(name, (name, 1.0, 0.0))
            good = np.isfinite(time) & np.isfinite(value)
            if not good.any():
                raise ConfigError(name, "has no finite value in the log")
            if np.any(np.diff(time[good]) < 0.0):
                raise ConfigError(name, "the log's times must not fall from row to row")
            with np.errstate(over="ignore"):
                scaled = scale * value[good] + offset
            for what, numbers in (("time", time[good]), ("value", scaled)):
                if np.abs(numbers).max() > LARGEST_VALUE:
                    rule = f"its largest {what} in the log is {np.abs(numbers).max():g}; at most {LARGEST_VALUE:g}"
                    raise ConfigError(name, f"{rule} is taken")
            logged[name] = Column(time[good], scaled)
    first = min(column.time[0] for column in logged.values())
    return FlightLog(file.name, logged, float(first) if columns.start is None else columns.start)


def table_columns(path: Path, columns: ColumnMap, channels: tuple[str, ...]) -> dict[str, Column]:
    """The columns of a CSV or Parquet file by the signals' names."""
    frame = recorded_frame(path)
    present = [str(name) for name in frame.columns]
    names = {name: source for name, (source, _, _) in columns.signals.items()} or {
        name: name for name in log_signals(channels) if name in present
    }
    for field, name in (("time", columns.time), *names.items()):
        if name not in present:
            raise ConfigError(
                field, f"has no column '{name}'; {nearest(name, present)}; --columns FILE gives the names"
            )
    try:
        time = frame[columns.time].to_numpy(float)
        return {name: Column(time, frame[source].to_numpy(float)) for name, source in names.items()}
    except (TypeError, ValueError) as error:
        raise ConfigError("signals", f"its columns must hold numbers: {error}") from error


def ulog_columns(path: Path, columns: ColumnMap) -> dict[str, Column]:
    """The fields of a ULog's topics by the signals' names; times count from the beginning of the log.

    PX4 stamps every value with the time since its start, and so the beginning of the log.
    """
    try:
        from pyulog import ULog  # few have it, and few need it
    except ImportError as error:
        raise ConfigError("file", "a log of PX4 needs pyulog: pip install 'dssc_jax[ulog]'") from error
    if not columns.signals:
        raise ConfigError("signals", "a log of PX4 needs a table of columns, such as y = 'topic.field'")
    try:
        whole = ULog(io.BytesIO(record_content(path)))
        topics = {f"{one.name}:{one.multi_id}": one.data for one in whole.data_list}
        begin = float(whole.start_timestamp)
    except ConfigError:
        raise
    except Exception as error:  # pyulog raises errors of many kinds
        raise ConfigError("file", f"cannot be read: {' '.join(str(error).split())}") from error
    read = {}
    for name, (source, _, _) in columns.signals.items():
        topic, _, field = source.partition(".")
        label = topic if ":" in topic else f"{topic}:0"
        if label not in topics:
            raise ConfigError(f"signals.{name}", f"the log has no topic '{topic}'; {nearest(label, topics)}")
        if field not in topics[label]:
            raise ConfigError(
                f"signals.{name}", f"topic '{topic}' has no field '{field}'; {nearest(field, topics[label])}"
            )
        stamps = topics[label]["timestamp"].astype(float) - begin
        read[name] = Column(MICROSECOND * stamps, topics[label][field].astype(float))
    return read


def nearest_rows(column: Column, start: float, sample_time: float, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """The logged value nearest to each sample instant.

    Args:
        column: The logged signal.
        start: Time of the first sample [s].
        sample_time: T_s [s].
        samples: Their number.

    Returns:
        Positions in the column, and the values' times less the instants, in samples; NaN where they exceed half a
        sample. Shape (samples,) each.
    """
    instants = start + sample_time * np.arange(samples)
    middles = 0.5 * (column.time[1:] + column.time[:-1])
    rows = np.searchsorted(middles, instants)
    offsets = (column.time[rows] - instants) / sample_time
    return rows, np.where(np.abs(offsets) <= 0.5 * (1.0 + 1e-6), offsets, np.nan)


def nearest_values(column: Column, start: float, sample_time: float, samples: int) -> np.ndarray:
    """The logged value nearest to each sample instant; NaN where none lies within half a sample time.

    Args:
        column: The logged signal.
        start: Time of the first sample [s].
        sample_time: T_s [s].
        samples: Their number.

    Returns:
        Shape (samples,).

    Example:
        >>> nearest_values(Column(np.array([0.0, 0.11, 0.4]), np.array([1.0, 2.0, 3.0])), 0.0, 0.1, 5)
        array([ 1.,  2., nan, nan,  3.])
    """
    rows, offsets = nearest_rows(column, start, sample_time, samples)
    return np.where(np.isnan(offsets), np.nan, column.value[rows])


def nearest_offsets(column: Column, start: float, sample_time: float, samples: int) -> np.ndarray:
    """Times of the values of :func:`nearest_values` less the sample instants, in samples.

    A value that is nearest to two instants counts at the first. Offsets within the rounding of times are 0.

    Args:
        column: The logged signal.
        start: Time of the first sample [s].
        sample_time: T_s [s].
        samples: Their number.

    Returns:
        Shape (samples,); NaN where there is no value.
    """
    rows, offsets = nearest_rows(column, start, sample_time, samples)
    repeated = np.concatenate([[False], np.diff(rows) == 0]) & np.concatenate([[False], np.isfinite(offsets[:-1])])
    return np.where(repeated, np.nan, np.where(np.abs(offsets) < 1e-6, 0.0, offsets))


def last_time(log: FlightLog) -> float:
    """The time of the log's last value [s]."""
    return float(max(column.time[-1] for column in log.columns.values()))


def samples_within(log: FlightLog, sample_time: float, steps: int) -> int:
    """Number of the study's samples, of ``steps``, up to the log's last value; 0 if the study begins after it."""
    return int(np.clip(np.floor((last_time(log) - log.start) / sample_time + 0.5) + 1.0, 0.0, steps))
