"""Columns of CSV and Parquet files in a study: they become part of the study when its file is read.

A results folder therefore contains the data that it was computed with, and reading it opens no other file.
"""

import codecs
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.csv_files import NO_NUMBERS, csv_form, csv_header, csv_lines, whole_rows

FIELDS = ("file", "column", "columns", "time_column", "rate_file", "rate_column")
SLOTS = ("reference", "disturbance", "wind", "sensor")
"""The slots that may follow a record."""
SEVERAL = {"wind": ("x", "y", "z"), "sensor": ("position", "velocity")}
"""The slots whose record has several columns, and what these become."""
RATED = "reference"
"""The slot whose record may have the rate of its values."""
TIME = "t"
PARQUET = (".parquet", ".pq")
ULOG = b"ULog\x01\x12\x35"
"""First bytes of a log of PX4."""
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
        return [recorded_slot(item, folder, f"{slot}.{index}") for index, item in enumerate(value)]
    if not isinstance(value, Mapping):
        return value
    with errors_under(slot):
        channels = {}
        for name, item in value.items():
            if isinstance(item, Mapping) and "file" in item:
                with errors_under(name):
                    channels[name] = inlined(item, folder, slot)
        inlined_table = inlined(value, folder, slot) if "file" in value else dict(value)
    return inlined_table | channels


def inlined(part: Mapping[str, Any], folder: Path, slot: str) -> TomlTable:
    """A table with the record's times and values in place of the names of files and columns in :data:`FIELDS`."""
    components = SEVERAL.get(slot.partition(".")[0])
    targets = components or ("value",)
    for name in ("time", *targets):
        if name in part:
            raise ConfigError(name, "is given by the file; give a file, or the values themselves")
    for name in ("file", "column", "time_column", "rate_file", "rate_column"):
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
    other_entries = {name: value for name, value in part.items() if name not in FIELDS}
    return other_entries | dict(zip(("time", *targets), columns, strict=True)) | inlined_rate(part, folder, slot)


def inlined_rate(part: Mapping[str, Any], folder: Path, slot: str) -> TomlTable:
    """The times and values of a record's rate; nothing if the table names no column of it."""
    if not {"rate_column", "rate_file"} & set(part):
        return {}
    if slot != RATED:
        name = "rate_column" if "rate_column" in part else "rate_file"
        raise ConfigError(name, f"is of a recorded reference; a recorded {slot.partition('.')[0]} has no rate")
    for name in ("rate", "rate_time"):
        if name in part:
            raise ConfigError(name, "is given by the file; give rate_column, or the values themselves")
    if "rate_column" not in part:
        raise ConfigError("rate_column", "is required and missing: the column of rate_file with the rate")
    path = folder / part.get("rate_file", part["file"])
    columns = recorded_columns(path, [part.get("time_column", TIME), part["rate_column"]], "rate_column")
    return dict(zip(("rate_time", "rate"), columns, strict=True))


def recorded_columns(path: Path, names: list[str], label: str = "column") -> list[list[float]]:
    """Columns of a CSV or Parquet file, as numbers; rows in which a cell is empty are left out.

    Args:
        path: The file.
        names: Names of the columns; the first one is the time's.
        label: The field of the study that names the others.

    Raises:
        ConfigError: the file cannot be read, a column is absent, a cell is no finite number, the times do not rise, or
            no row is left. The message has the line of a CSV file, or the row of a Parquet file.
    """
    frame = recorded_frame(path)
    for name in names:
        if name not in frame:
            field = "time_column" if name == names[0] else label
            raise ConfigError(field, f"'{path.name}' has no column '{name}'; {nearest(name, map(str, frame.columns))}")
    columns: dict[str, list[float]] = {}
    for index, name in enumerate(names):
        columns[name] = numbers_of(frame[name], path, label if index else "time_column")
    table = np.array(list(columns.values()))
    missing = np.flatnonzero(np.any(np.isnan(table), axis=0))
    require_empty(path, [list(frame.columns).index(name) for name in names], missing, len(frame))
    complete_rows = np.setdiff1d(np.arange(len(frame)), missing)
    if not complete_rows.size:
        raise ConfigError("file", f"'{path.name}' has no row with numbers in {', '.join(map(repr, names))}")
    infinite_rows = complete_rows[np.any(np.isinf(table[:, complete_rows]), axis=0)]
    if infinite_rows.size:
        place = place_of(path, int(infinite_rows[0]))
        raise ConfigError(label, f"'{path.name}' must hold finite numbers; {place} does not")
    times = table[0, complete_rows]
    decreasing = np.flatnonzero(np.diff(times) <= 0.0)
    if decreasing.size:
        before, after = times[decreasing[0] : decreasing[0] + 2]
        place = place_of(path, int(complete_rows[decreasing[0] + 1]))
        rule = f"{after:g} s comes after {before:g} s in {place}"
        raise ConfigError("time_column", f"'{path.name}' must have rising times; {rule}")
    return table[:, complete_rows].tolist()


def numbers_of(column: Any, path: Path, field: str) -> list[float]:
    """The cells of a column as numbers, NaN for those that are missing.

    Raises:
        ConfigError: a cell is no number.
    """
    text = first_text(column, path)
    if text:
        raise ConfigError(field, f"'{path.name}' must hold numbers there; {text}")
    return [float(cell) for cell in column]


def first_text(column: Any, path: Path) -> str:
    """The place and the content of the first cell of a column that is no number, in words; empty if there is none."""
    for row, cell in enumerate(column):
        try:
            float(cell)
        except (TypeError, ValueError):
            return f"{place_of(path, row)} has {cell!r}"
    return ""


def place_of(path: Path, row: int) -> str:
    """Where a row stands in a file, in words."""
    if path.suffix.lower() in PARQUET:
        return f"row {row + 1}"
    lines = list(csv_lines(record_content(path)))[1:]
    return f"line {lines[row].number}" if row < len(lines) else f"row {row + 1}"


def require_empty(path: Path, places: list[int], rows: np.ndarray, count: int) -> None:
    """Require that the missing cells of a CSV file are empty, and not written as no number.

    Args:
        path: The file; one of Parquet has missing cells of its own.
        places: Indices of the columns.
        rows: Rows with a missing cell.
        count: Number of rows.

    Raises:
        ConfigError: one is written, as ``nan``.
    """
    if path.suffix.lower() in PARQUET or not rows.size:
        return
    content = record_content(path)
    form = csv_form(path, content)
    lines = list(csv_lines(content))[1:]
    if len(lines) not in (count, count + 1):  # a quoted cell spans several lines; the last row may be cut off
        return
    for row in rows:
        texts = lines[row].text.decode(errors="replace").split(form.separator)
        cells = [text.strip().strip('"').replace(form.decimal, ".") for text in texts]
        for place in places:
            if place < len(cells) and cells[place] and not is_number(cells[place]):
                text = f"'{path.name}' must hold numbers or empty cells; line {lines[row].number} has {cells[place]!r}"
                raise ConfigError("column", text)


def is_number(text: str) -> bool:
    """Whether a text is a number, NaN excepted."""
    try:
        return not math.isnan(float(text))
    except ValueError:
        return False


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


def parquet_columns(content: bytes) -> int:
    """The number of columns of a Parquet file."""
    from pyarrow import parquet

    return parquet.ParquetFile(io.BytesIO(content)).metadata.num_columns


def require_few_columns(path: Path, count: int) -> None:
    """Require that a file has no more columns than a record can have; raises ConfigError."""
    if count > MOST_COLUMNS:
        raise ConfigError("file", f"'{path}' has {count} columns, more than a record can have ({MOST_COLUMNS})")


def require_header(path: Path, names: list[str]) -> None:
    """Require names in a file's first line, no two of them the same; raises ConfigError."""
    if all(is_number(name) for name in names):
        raise ConfigError(
            "file", f"'{path}' has no header: its first line holds numbers; write the columns' names there"
        )
    for position, name in enumerate(names):
        if name and name in names[:position]:
            raise ConfigError("file", f"'{path}' has two columns '{name}'; rename one of them, or leave it out")


def recorded_frame(path: Path) -> Any:
    """The table of a CSV or Parquet file, as a data frame of pandas.

    Dates and time spans of a Parquet file are in seconds: dates since the beginning of 1970, UTC unless they say else.

    Raises:
        ConfigError: the file cannot be read.
    """
    import pandas as pd  # slow to load, and few studies follow a record

    parquet = path.suffix.lower() in PARQUET
    try:
        if not path.is_file():
            raise ConfigError("file", f"'{path}' cannot be read: it is no file")
        content = record_content(path)
        if not content.strip():
            raise ConfigError("file", f"'{path}' is empty")
        if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise ConfigError("file", f"'{path}' is text in UTF-16; save it as UTF-8")
        if content.startswith(ULOG):
            raise ConfigError("file", f"'{path}' is a ULog: `dssc-jax log FILE --topic TOPIC --csv OUT` writes a table")
        if parquet:
            require_few_columns(path, parquet_columns(content))
            return with_seconds(pd.read_parquet(io.BytesIO(content)))
        form = csv_form(path, content)
        header = csv_header(content).decode(errors="replace").split(form.separator)
        require_few_columns(path, len(header))
        require_header(path, [name.strip().strip('"') for name in header])
        table = io.BytesIO(NO_NUMBERS.sub(b"", whole_rows(path, content, form)))
        return pd.read_csv(table, sep=form.separator, decimal=form.decimal, skipinitialspace=True, comment="#")
    except ImportError as error:
        raise ConfigError("file", "a Parquet file needs pyarrow: pip install 'dssc_jax[export]'") from error
    except ConfigError:
        raise
    except UnicodeDecodeError as error:
        raise ConfigError("file", f"'{path}' is no text, as a CSV file is: byte {error.start} is no UTF-8") from error
    except Exception as error:  # readers of files raise errors of many kinds
        raise ConfigError("file", f"'{path}' cannot be read: {' '.join(str(error).split())}") from error


def with_seconds(frame: Any) -> Any:
    """A data frame whose dates and time spans are numbers of seconds, NaN where one is missing."""
    spans = frame.select_dtypes("timedelta")
    dates = frame.select_dtypes(["datetime", "datetimetz"])
    epoch = np.datetime64(0, "s")
    numbers = {name: column.dt.total_seconds() for name, column in spans.items()}
    for name, column in dates.items():
        plain_dates = column if column.dt.tz is None else column.dt.tz_convert("UTC").dt.tz_localize(None)
        numbers[name] = (plain_dates - epoch).dt.total_seconds()
    return frame.assign(**numbers)
