"""Recorded signals: columns of CSV and Parquet files become part of a study's table when the study is read.

So a results folder contains the data of its run, and reading the folder opens no other file.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.csv_files import csv_form, csv_lines
from dssc_jax.study.record_files import is_numeric, is_parquet, record_content, recorded_frame

FIELDS = ("file", "column", "columns", "time_column", "rate_file", "rate_column")
"""Fields that name files and columns in a table with a record."""
RECORD_SLOTS = ("reference", "disturbance", "wind", "sensor")
"""Slots that may have a record."""
COLUMN_FIELDS = {"wind": ("x", "y", "z"), "sensor": ("position", "velocity")}
"""Fields with the values of a record, for slots whose record has several columns."""
SINGLE_FIELD = ("value",)
"""Field with the values of a record in all other slots."""
RATE_SLOT = "reference"
"""Slot whose record may also contain the derivatives of its values."""
TIME = "t"
"""Default name of the column of times."""
TIME_FIELDS = ("time", "time_column")
"""Fields that name the column of times, in the table of a record and in the columns of a log."""


def with_records(table: Mapping[str, object], folder: Path) -> TomlTable:
    """Copy a study's table, with the times and values of each record in place of the name of its file.

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
    """Copy the content of a slot, with records in place of the names of files.

    Args:
        value: Table of the slot, which may contain tables of channels; or a list of tables.
        folder: Folder to which the names of files are relative.
        slot: Name of the slot; for a table in a list, with the index of the table, such as ``wind.1``.

    Raises:
        ConfigError: As in :func:`with_records`.
    """
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
    """Copy a part's table, with times and values of its record in place of the fields :data:`FIELDS`.

    Args:
        part: Table of the part, which names a file.
        folder: Folder to which the names of files are relative.
        slot: Slot of the part, and its index in a list, such as ``wind.1``.

    Raises:
        ConfigError: The table is not valid, or as in :func:`recorded_columns`.
    """
    kind_of_slot, _, _ = slot.partition(".")
    fields = COLUMN_FIELDS.get(kind_of_slot, SINGLE_FIELD)
    for name in ("time", *fields):
        if name in part:
            raise ConfigError(name, "is given by the file; give a file, or the values themselves")
    for name in ("file", "column", "time_column", "rate_file", "rate_column"):
        if name in part and not isinstance(part[name], str):
            raise ConfigError(name, f"must be a text, got {part[name]!r}")
    time_name = part.get("time_column", TIME)
    columns = recorded_columns(folder / part["file"], [time_name, *value_columns(part, fields)])
    table = {name: value for name, value in part.items() if name not in FIELDS}
    table |= dict(zip(("time", *fields), columns, strict=True))
    return table | rate_fields(part, folder, slot)


def value_columns(part: Mapping[str, Any], fields: tuple[str, ...]) -> list[str]:
    """Names of the columns with the values of a record, one for each field.

    Args:
        part: Table of the part, which names a file.
        fields: Fields that take the values, one or several.

    Raises:
        ConfigError: The table does not name one column for each field.
    """
    if len(fields) == 1:
        if "column" not in part:
            raise ConfigError("column", "is required and missing: the column with the values")
        return [part["column"]]
    names = part.get("columns")
    if not isinstance(names, list) or len(names) != len(fields) or not all(isinstance(name, str) for name in names):
        raise ConfigError("columns", f"must be the file's columns with {', '.join(fields)}, got {names!r}")
    return names


def rate_fields(part: Mapping[str, Any], folder: Path, slot: str) -> TomlTable:
    """The fields ``rate_time`` and ``rate`` with the derivative of a recorded reference.

    The result is empty if the table names no column of derivatives.

    Args:
        part: Table of the part, which names a file.
        folder: Folder to which the names of files are relative.
        slot: Slot of the part, and its index in a list, such as ``wind.1``.

    Raises:
        ConfigError: The table is not valid, or as in :func:`recorded_columns`.
    """
    rate_names = [name for name in ("rate_column", "rate_file") if name in part]
    if not rate_names:
        return {}
    if slot != RATE_SLOT:
        kind_of_slot, _, _ = slot.partition(".")
        raise ConfigError(rate_names[0], f"is of a recorded reference; a recorded {kind_of_slot} has no rate")
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
        names: Names of the columns, the column of times first.
        label: Field of the study that names the other columns, for messages.

    Returns:
        Values of each column, shape (columns, rows).

    Raises:
        ConfigError: The file cannot be read, a column is absent, a cell is no finite number, the times do not rise, or
            no row remains. The message has the line of a CSV file, or the row of a Parquet file.
    """
    frame = recorded_frame(path)
    time_name = names[0]
    for name in names:
        if name not in frame:
            field = "time_column" if name == time_name else label
            raise ConfigError(field, f"'{path.name}' has no column '{name}'; {nearest(name, map(str, frame.columns))}")
    columns = []
    for index, name in enumerate(names):
        columns.append(numbers_of(frame[name], path, field="time_column" if index == 0 else label))
    table = np.array(columns)  # shape (columns, rows)
    incomplete_rows = np.flatnonzero(np.any(np.isnan(table), axis=0))
    require_empty(path, [list(frame.columns).index(name) for name in names], incomplete_rows, len(frame))
    complete_rows = np.setdiff1d(np.arange(len(frame)), incomplete_rows)
    if not complete_rows.size:
        raise ConfigError("file", f"'{path.name}' has no row with numbers in {', '.join(map(repr, names))}")
    infinite_rows = complete_rows[np.any(np.isinf(table[:, complete_rows]), axis=0)]
    if infinite_rows.size:
        place = row_place(path, int(infinite_rows[0]))
        raise ConfigError(label, f"'{path.name}' must hold finite numbers; {place} does not")
    require_rising_times(path, table[0, complete_rows], complete_rows)
    return table[:, complete_rows].tolist()


def require_rising_times(path: Path, times: np.ndarray, rows: np.ndarray) -> None:
    """Require that each time of a record is later than the time before it.

    Args:
        path: The file, for messages.
        times: The times [s], shape (n,).
        rows: Row of the data frame with each time, shape (n,).

    Raises:
        ConfigError: A time is equal to or earlier than the time before it.
    """
    not_rising = np.flatnonzero(np.diff(times) <= 0.0)
    if not not_rising.size:
        return
    first = int(not_rising[0])
    rule = f"{times[first + 1]:g} s comes after {times[first]:g} s in {row_place(path, int(rows[first + 1]))}"
    raise ConfigError("time_column", f"'{path.name}' must have rising times; {rule}")


def numbers_of(column: Any, path: Path, field: str) -> list[float]:
    """Cells of a column as numbers, NaN for empty cells.

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
    """Place and content, in words, of the first cell of a column that is no number; empty if all cells are numbers."""
    for row, cell in enumerate(column):
        try:
            float(cell)
        except (TypeError, ValueError):
            return f"{row_place(path, row)} has {cell!r}"
    return ""


def row_place(path: Path, row: int) -> str:
    """Place of a row in its file, in words: the line of a CSV file, or the row of a Parquet file, from 1.

    Args:
        path: The file.
        row: Index of the row in the data frame, from 0.
    """
    if not is_parquet(path):
        _, *lines = csv_lines(record_content(path))  # without the header
        if row < len(lines):  # a quoted cell may span several lines
            return f"line {lines[row].number}"
    return f"row {row + 1}"


def require_empty(path: Path, places: list[int], rows: np.ndarray, count: int) -> None:
    """Require that the missing cells of a CSV file are empty, rather than texts such as ``nan``.

    Args:
        path: The file; nothing is required of a Parquet file, which marks its missing cells.
        places: Indices of the columns to check.
        rows: Indices of the rows with a missing cell.
        count: Number of all rows in the data frame.

    Raises:
        ConfigError: A missing cell contains a text.
    """
    if is_parquet(path) or not rows.size:
        return
    content = record_content(path)
    form = csv_form(path, content)
    _, *lines = csv_lines(content)  # without the header
    if len(lines) not in (count, count + 1):  # a quoted cell spans several lines; the last row may be cut off
        return
    for row in rows:
        texts = lines[row].text.decode(errors="replace").split(form.separator)
        cells = [text.strip().strip('"').replace(form.decimal, ".") for text in texts]
        for place in places:
            is_empty = place >= len(cells) or not cells[place]
            if not is_empty and not is_numeric(cells[place]):
                text = f"'{path.name}' must hold numbers or empty cells; line {lines[row].number} has {cells[place]!r}"
                raise ConfigError("column", text)
