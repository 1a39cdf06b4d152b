"""Recorded signals: columns of CSV and Parquet files become part of a study when its file is read.

So a results folder contains the data with which it was computed, and reading the folder opens no other file.
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
"""Fields that name files and columns in a table with a record."""
RECORD_SLOTS = ("reference", "disturbance", "wind", "sensor")
"""Slots that may have a record."""
COLUMN_FIELDS = {"wind": ("x", "y", "z"), "sensor": ("position", "velocity")}
"""Fields of the slots whose record has several columns; the field of all other slots is ``value``."""
RATE_SLOT = "reference"
"""Slot whose record may also have the rate of its values."""
TIME = "t"
"""Default name of the column of times."""
TIME_FIELDS = ("time", "time_column")
"""Fields that name the column of times."""
PARQUET = (".parquet", ".pq")
ULOG = b"ULog\x01\x12\x35"
"""First bytes of a log of PX4."""
LARGEST_RECORD = 2**27  # most bytes of a file
MOST_COLUMNS = 10_000
"""Most columns of a file; a table with more takes minutes to read."""


def with_records(table: Mapping[str, object], folder: Path) -> TomlTable:
    """A study's table with the times and values of each record in place of its file.

    Args:
        table: Table of the study.
        folder: Folder to which the names of files are relative.

    Raises:
        ConfigError: A file cannot be read, or lacks a column.
    """
    content = dict(table)
    for slot in RECORD_SLOTS:
        if slot in table:
            content[slot] = slot_with_records(table[slot], folder, slot)
    return content


def slot_with_records(value: object, folder: Path, slot: str) -> Any:
    """Content of a slot with records in place of files: of its table, its channels' tables, or a list of tables."""
    if isinstance(value, list):
        return [slot_with_records(item, folder, f"{slot}.{index}") for index, item in enumerate(value)]
    if not isinstance(value, Mapping):
        return value
    with errors_under(slot):
        channels = {}
        for name, item in value.items():
            if isinstance(item, Mapping) and "file" in item:
                with errors_under(name):
                    channels[name] = table_with_record(item, folder, slot)
        table = table_with_record(value, folder, slot) if "file" in value else dict(value)
    return table | channels


def table_with_record(part: Mapping[str, Any], folder: Path, slot: str) -> TomlTable:
    """A part's table with the times and values of its record in place of the names in :data:`FIELDS`.

    Args:
        part: Table with a file.
        folder: Folder to which the names of files are relative.
        slot: Slot of the part, and its index in a list.

    Raises:
        ConfigError: The table is not valid, or as in :func:`recorded_columns`.
    """
    fields = COLUMN_FIELDS.get(slot.partition(".")[0], ("value",))
    for name in ("time", *fields):
        if name in part:
            raise ConfigError(name, "is given by the file; give a file, or the values themselves")
    for name in ("file", "column", "time_column", "rate_file", "rate_column"):
        if not isinstance(part.get(name, TIME), str):
            raise ConfigError(name, f"must be a text, got {part[name]!r}")
    if len(fields) > 1:
        names = part.get("columns")
        if not isinstance(names, list) or len(names) != len(fields) or not all(isinstance(n, str) for n in names):
            raise ConfigError("columns", f"must be the file's columns with {', '.join(fields)}, got {names!r}")
    elif "column" in part:
        names = [part["column"]]
    else:
        raise ConfigError("column", "is required and missing: the column with the values")
    columns = recorded_columns(folder / part["file"], [part.get("time_column", TIME), *names])
    table = {name: value for name, value in part.items() if name not in FIELDS}
    table |= dict(zip(("time", *fields), columns, strict=True))
    return table | rate_fields(part, folder, slot)


def rate_fields(part: Mapping[str, Any], folder: Path, slot: str) -> TomlTable:
    """The fields ``rate_time`` and ``rate`` of a record; empty if its table names no column of rates.

    Raises:
        ConfigError: The table is not valid, or as in :func:`recorded_columns`.
    """
    if not {"rate_column", "rate_file"} & set(part):
        return {}
    if slot != RATE_SLOT:
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
    """Read columns of a CSV or Parquet file as numbers; rows with an empty cell are left out.

    Args:
        path: The file.
        names: Names of the columns, that of the times first.
        label: Field of the study that names the other columns, for messages.

    Returns:
        Values of each column, shape (columns, rows).

    Raises:
        ConfigError: The file cannot be read, a column is absent, a cell is no finite number, the times do not rise, or
            no row remains. The message has the line of a CSV file, or the row of a Parquet file.
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
        place = row_place(path, int(infinite_rows[0]))
        raise ConfigError(label, f"'{path.name}' must hold finite numbers; {place} does not")
    times = table[0, complete_rows]
    decreasing = np.flatnonzero(np.diff(times) <= 0.0)
    if decreasing.size:
        before, after = times[decreasing[0] : decreasing[0] + 2]
        place = row_place(path, int(complete_rows[decreasing[0] + 1]))
        rule = f"{after:g} s comes after {before:g} s in {place}"
        raise ConfigError("time_column", f"'{path.name}' must have rising times; {rule}")
    return table[:, complete_rows].tolist()


def numbers_of(column: Any, path: Path, field: str) -> list[float]:
    """Cells of a column as numbers, NaN for empty ones.

    Args:
        column: Column of a data frame.
        path: The file, for messages.
        field: Field of the study that names the column, for messages.

    Raises:
        ConfigError: A cell is no number.
    """
    text = first_text(column, path)
    if text:
        remedy = "; write times in seconds" if field in TIME_FIELDS else ""
        raise ConfigError(field, f"'{path.name}' must hold numbers there; {text}{remedy}")
    return [float(cell) for cell in column]


def first_text(column: Any, path: Path) -> str:
    """Place and content of the first cell of a column that is no number, in words; empty if there is none."""
    for row, cell in enumerate(column):
        try:
            float(cell)
        except (TypeError, ValueError):
            return f"{row_place(path, row)} has {cell!r}"
    return ""


def row_place(path: Path, row: int) -> str:
    """Place of a row of the data frame in its file, in words: the line of a CSV file, or the row."""
    if is_parquet(path):
        return f"row {row + 1}"
    lines = list(csv_lines(record_content(path)))[1:]
    return f"line {lines[row].number}" if row < len(lines) else f"row {row + 1}"


def require_empty(path: Path, places: list[int], rows: np.ndarray, count: int) -> None:
    """Require that the missing cells of a CSV file are empty, rather than texts such as ``nan``.

    Args:
        path: The file; a Parquet file marks its missing cells.
        places: Indices of the columns.
        rows: Indices of the rows with a missing cell.
        count: Number of all rows.

    Raises:
        ConfigError: A missing cell has a text.
    """
    if is_parquet(path) or not rows.size:
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
            if place < len(cells) and cells[place] and not is_numeric(cells[place]):
                text = f"'{path.name}' must hold numbers or empty cells; line {lines[row].number} has {cells[place]!r}"
                raise ConfigError("column", text)


def is_parquet(path: Path) -> bool:
    """Whether a file is a Parquet file, by its name."""
    return path.suffix.lower() in PARQUET


def is_numeric(text: str) -> bool:
    """Whether a text is a number other than NaN."""
    try:
        return not math.isnan(float(text))
    except ValueError:
        return False


def record_content(path: Path) -> bytes:
    """Read the file of a record.

    Raises:
        ConfigError: The file is too large.
        OSError: The file cannot be read, or is no regular file.
    """
    content = files.read_bytes(path, LARGEST_RECORD + 1)
    if len(content) > LARGEST_RECORD:
        raise ConfigError("file", f"'{path}' is larger than a record can be ({LARGEST_RECORD} bytes)")
    return content


def parquet_column_count(content: bytes) -> int:
    """Number of columns of a Parquet file, without reading them."""
    from pyarrow import parquet

    return parquet.ParquetFile(io.BytesIO(content)).metadata.num_columns


def require_few_columns(path: Path, count: int) -> None:
    """Require that a file has at most :data:`MOST_COLUMNS` columns.

    Raises:
        ConfigError: It has more.
    """
    if count > MOST_COLUMNS:
        raise ConfigError("file", f"'{path}' has {count} columns, more than a record can have ({MOST_COLUMNS})")


def require_header(path: Path, names: list[str]) -> None:
    """Require that a file's first line has names, and no name twice.

    Raises:
        ConfigError: It has numbers, or a name twice.
    """
    if all(is_numeric(name) for name in names):
        raise ConfigError(
            "file", f"'{path}' has no header: its first line holds numbers; write the columns' names there"
        )
    for position, name in enumerate(names):
        if name and name in names[:position]:
            raise ConfigError("file", f"'{path}' has two columns '{name}'; rename one of them, or leave it out")


def recorded_frame(path: Path) -> Any:
    """Read a CSV or Parquet file as a data frame of pandas.

    Dates and time spans of a Parquet file become seconds. Dates count from the beginning of 1970, and are in UTC unless
    they have a time zone.

    Raises:
        ConfigError: The file cannot be read.
    """
    import pandas as pd  # slow to load, and few studies have a record

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
        if is_parquet(path):
            require_few_columns(path, parquet_column_count(content))
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
    """A data frame in which dates and time spans have become numbers of seconds, NaN for missing ones."""
    spans = frame.select_dtypes("timedelta")
    dates = frame.select_dtypes(["datetime", "datetimetz"])
    epoch = np.datetime64(0, "s")
    numbers = {name: column.dt.total_seconds() for name, column in spans.items()}
    for name, column in dates.items():
        plain_dates = column if column.dt.tz is None else column.dt.tz_convert("UTC").dt.tz_localize(None)
        numbers[name] = (plain_dates - epoch).dt.total_seconds()
    return frame.assign(**numbers)
