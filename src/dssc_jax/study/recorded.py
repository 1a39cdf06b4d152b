"""Columns of CSV and Parquet files in a study: they become part of the study when its file is read.

A results folder therefore contains the data that it was computed with, and reading it opens no other file.
"""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.toml import TomlTable

FIELDS = ("file", "column", "columns", "time_column")
SLOTS = ("reference", "disturbance", "wind", "sensor")
"""The slots that may follow a record."""
SEVERAL = {"wind": ("x", "y", "z"), "sensor": ("position", "velocity")}
"""The slots whose record has several columns, and what these become."""
TIME = "t"
LARGEST_RECORD = 2**27  # bytes of a file
MOST_COLUMNS = 10_000
"""Columns of a file; a table of more takes minutes to read."""


def with_records(table: Mapping[str, object], folder: Path) -> TomlTable:
    """A study's table with the times and values of each record in place of its file.

    Args:
        table: The study's table.
        folder: The folder that names of files are relative to.

    Raises:
        ConfigError: a file cannot be read, or does not have the column.
    """
    return {**table, **{slot: recorded_slot(table[slot], folder, slot) for slot in SLOTS if slot in table}}


def recorded_slot(value: object, folder: Path, slot: str) -> Any:
    """A slot's table, each of its channels' tables, or each table of a list, with records in place of files."""
    if isinstance(value, list):
        return [recorded_slot(part, folder, f"{slot}.{index}") for index, part in enumerate(value)]
    if not isinstance(value, Mapping):
        return value
    with errors_under(slot):
        channels = {}
        for name, part in value.items():
            if isinstance(part, Mapping) and "file" in part:
                with errors_under(name):
                    channels[name] = inlined(part, folder, slot)
        inlined_table = inlined(value, folder, slot) if "file" in value else dict(value)
    return inlined_table | channels


def inlined(part: Mapping[str, Any], folder: Path, slot: str) -> TomlTable:
    """A table with the record's times and values in place of ``file``, ``column``, ``columns`` and ``time_column``."""
    components = SEVERAL.get(slot.partition(".")[0])
    targets = components or ("value",)
    for name in ("time", *targets):
        if name in part:
            raise ConfigError(name, "is given by the file; give a file, or the values themselves")
    for name in ("file", "column", "time_column"):
        if not isinstance(part.get(name, TIME), str):
            raise ConfigError(name, f"must be a text, got {part[name]!r}")
    if components:
        names = part.get("columns")
        if not isinstance(names, list) or len(names) != len(components) or not all(isinstance(n, str) for n in names):
            raise ConfigError("columns", f"must be the file's columns with {', '.join(components)}, got {names!r}")
    elif "column" in part:
        names = [part["column"]]
    else:
        raise ConfigError("column", "is required and missing: the column with the values")
    columns = recorded_columns(folder / part["file"], [part.get("time_column", TIME), *names])
    kept = {name: value for name, value in part.items() if name not in FIELDS}
    return kept | dict(zip(("time", *targets), columns, strict=True))


def recorded_columns(path: Path, names: list[str]) -> list[list[float]]:
    """Columns of a CSV or Parquet file, as numbers; rows in which one of them is missing are left out.

    Raises:
        ConfigError: the file cannot be read, a column is absent, or its values are not numbers.
    """
    frame = recorded_frame(path)
    for name in names:
        if name not in frame:
            field = "time_column" if name == names[0] else "column"
            raise ConfigError(field, f"'{path.name}' has no column '{name}'; {nearest(name, map(str, frame.columns))}")
    frame = frame[names].dropna()
    try:
        return [[float(value) for value in frame[name]] for name in names]
    except (TypeError, ValueError) as error:
        raise ConfigError("column", f"'{path.name}' must hold numbers there: {error}") from error


def record_content(path: Path) -> bytes:
    """The content of a record's file.

    Raises:
        ConfigError: it is too large.
        OSError: it cannot be read, or is no regular file.
    """
    content = files.read_bytes(path, LARGEST_RECORD + 1)
    if len(content) > LARGEST_RECORD:
        raise ConfigError("file", f"'{path}' is larger than a record can be ({LARGEST_RECORD} bytes)")
    return content


def csv_columns(content: bytes) -> int:
    """The number of columns of a CSV file: the separators of its first line that is no comment, and one more."""
    start = 0
    while start < len(content):
        end = content.find(b"\n", start)
        end = len(content) if end < 0 else end
        line = content[start:end].strip()
        if line and not line.startswith(b"#"):
            return line.count(b",") + 1
        start = end + 1
    return 0


def parquet_columns(content: bytes) -> int:
    """The number of columns of a Parquet file."""
    from pyarrow import parquet

    return parquet.ParquetFile(io.BytesIO(content)).metadata.num_columns


def recorded_frame(path: Path) -> Any:
    """The table of a CSV or Parquet file, as a data frame of pandas.

    Raises:
        ConfigError: the file cannot be read.
    """
    import pandas as pd  # slow to load, and few studies follow a record

    parquet = path.suffix.lower() in (".parquet", ".pq")
    try:
        if not path.is_file():
            raise ConfigError("file", f"'{path}' cannot be read: it is no file")
        content = record_content(path)
        count = parquet_columns(content) if parquet else csv_columns(content)
        if count > MOST_COLUMNS:
            raise ConfigError("file", f"'{path}' has {count} columns, more than a record can have ({MOST_COLUMNS})")
        table = io.BytesIO(content)
        return pd.read_parquet(table) if parquet else pd.read_csv(table, skipinitialspace=True, comment="#")
    except ImportError as error:
        raise ConfigError("file", "a Parquet file needs pyarrow: pip install 'dssc_jax[export]'") from error
    except ConfigError:
        raise
    except Exception as error:  # readers of files raise errors of many kinds
        raise ConfigError("file", f"'{path}' cannot be read: {' '.join(str(error).split())}") from error
