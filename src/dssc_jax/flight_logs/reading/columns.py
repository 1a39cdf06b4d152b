"""The table that tells where a log has a study's signals."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeGuard

import numpy as np

from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.flight_logs.reading.ulog import topic_place
from dssc_jax.study.recorded import TIME

ENTRIES = ("signals", "time", "start", "segment")


class SignalSource(NamedTuple):
    """The column of a signal, and the conversion to the study's unit: value = scale * column + offset."""

    column: str
    scale: float = 1.0
    offset: float = 0.0


class TimeSource(NamedTuple):
    """The column of the times of a CSV or Parquet file, and its conversion to seconds: time = scale * column."""

    column: str = TIME
    scale: float = 1.0


class ColumnMap(NamedTuple):
    """The places of a study's signals in a log."""

    signals: dict[str, SignalSource]
    time: TimeSource
    start: float | None  # time of the log at which the study begins [s]; None: that of the segment, or the first sample
    segment: str | None = None  # part of a ULog to read: armed or airborne


def column_map(table: Mapping[str, object], signal_names: Sequence[str]) -> ColumnMap:
    """Check a table of columns and parse it; :func:`dssc_jax.read_log` describes its entries.

    Args:
        table: The table.
        signal_names: The signals that the table may map.

    Raises:
        ConfigError: An entry is unknown or of another type.
    """
    for name in table:
        if name not in ENTRIES:
            raise ConfigError(name, f"is no entry of a table of columns; {nearest(name, ENTRIES)}")
    time = time_source(table.get("time", TIME))
    start = table.get("start")
    if start is not None and not is_finite_number(start):
        raise ConfigError("start", f"must be a finite number of seconds, got {start!r}")
    segment = table.get("segment")
    if segment is not None and not isinstance(segment, str):
        raise ConfigError("segment", f"must be a text, got {segment!r}")
    entries = table.get("signals", {})
    if not isinstance(entries, Mapping):
        raise ConfigError("signals", f"must be a table, got {entries!r}")
    signals = {}
    with errors_under("signals"):
        for name, entry in entries.items():
            if name not in signal_names:
                raise ConfigError(name, f"is no signal of the study; {nearest(name, signal_names)}")
            signals[name] = signal_source(name, entry)
    return ColumnMap(signals, time, None if start is None else float(start), segment)


def time_source(entry: object) -> TimeSource:
    """Parse the entry ``time``: the name of a column, or a table of ``column`` and ``scale``, the column's unit in s.

    Raises:
        ConfigError: The entry is neither, or the scale is not finite and above 0.
    """
    table = {"column": entry} if isinstance(entry, str) else entry
    if not isinstance(table, Mapping) or not set(table) <= set(TimeSource._fields):
        raise ConfigError("time", f"must be the name of a column, or a table of column and scale, got {entry!r}")
    column = table.get("column", TIME)
    if not isinstance(column, str):
        raise ConfigError("time.column", f"must be the name of a column, got {column!r}")
    scale = table.get("scale", 1.0)
    if not is_finite_number(scale) or scale <= 0:
        raise ConfigError("time.scale", f"must be the column's unit in seconds, finite and above 0, got {scale!r}")
    return TimeSource(column, float(scale))


def signal_source(name: str, entry: object) -> SignalSource:
    """Parse the entry of a signal: the name of a column, or a table of ``column``, ``scale`` and ``offset``.

    Args:
        name: Name of the signal.
        entry: The entry.

    Raises:
        ConfigError: The entry is neither, or a number is not finite, or the scale is 0.
    """
    table = {"column": entry} if isinstance(entry, str) else entry
    if not isinstance(table, Mapping) or not set(table) <= set(SignalSource._fields):
        raise ConfigError(name, f"must be a column, or a table of column, scale and offset, got {entry!r}")
    column = table.get("column")
    if not isinstance(column, str):
        raise ConfigError(f"{name}.column", f"must be the name of a column, got {column!r}")
    scale = table.get("scale", 1.0)
    offset = table.get("offset", 0.0)
    if not is_finite_number(scale) or scale == 0 or not is_finite_number(offset):
        raise ConfigError(name, f"scale and offset must be finite and scale not 0, got {scale!r} and {offset!r}")
    return SignalSource(column, float(scale), float(offset))


def is_finite_number(value: object) -> TypeGuard[float]:
    """Whether a value of TOML is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


class ColumnPlace(NamedTuple):
    """A column of a ULog, ``topic.field`` or ``topic:1.field``."""

    topic: str
    label: str  # with the instance
    field: str


def column_place(column: str) -> ColumnPlace:
    """Parse the name of a column of a ULog into topic, topic with instance, and field."""
    label, _, field = column.partition(".")
    topic, key = topic_place(label)
    return ColumnPlace(topic, key, field)
