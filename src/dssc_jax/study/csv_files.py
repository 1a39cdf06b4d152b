"""The form of a CSV file: separator, decimal sign, and the check that all rows have as many cells as the header."""

import io
import itertools
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError

SEPARATORS = (b",", b";", b"\t")
"""Characters that may separate the cells of a line."""
QUOTED = re.compile(rb'"[^"]*"')
"""A cell in quotes, such as ``"speed, m/s"``."""
DECIMAL_COMMA = re.compile(rb"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
"""A cell with a decimal comma, such as ``0,5``."""
DECIMAL_POINT = re.compile(rb"\s*[+-]?\d*\.\d*([eE][+-]?\d+)?\s*")
"""A cell with a decimal point, such as ``0.5``."""
DECIMAL = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
"""A number with or without a decimal point."""
NO_NUMBERS = re.compile(rb"#(N/A|NUM!|DIV/0!|VALUE!|REF!|NAME\?|NULL!)")
"""Error values that spreadsheets write in place of a number; the ``#`` of an error value begins no comment."""
FIRST_LINES = 100
"""Number of lines at the start of a file from which the form of the file is found."""
LAST_LINES = 100
"""Number of lines at the end of a file from which the median length of a number is taken."""
SHORT = 0.7
"""Share of the median length of a number below which the last number of a file may be cut off."""


class RecordWarning(UserWarning):
    """Warning that a row in the file of a record is left out, or may be damaged."""


class CsvForm(NamedTuple):
    """Form of a CSV file: the separator of its cells, and the decimal sign of its numbers."""

    separator: str = ","
    decimal: str = "."


class CsvLine(NamedTuple):
    """A line of a CSV file that is neither empty nor a comment.

    Args:
        number: Number of the line in the file, from 1.
        begin: Offset of the first byte of the line in the file.
        text: Content of the line without its comment, its line break and error values of spreadsheets.
    """

    number: int
    begin: int
    text: bytes


def csv_lines(content: bytes) -> Iterator[CsvLine]:
    """Yield the lines of a CSV file that are neither empty nor comments: the header, then the rows."""
    begin = 0
    for number, line in enumerate(io.BytesIO(content), start=1):
        text = NO_NUMBERS.sub(b"", line).partition(b"#")[0].rstrip(b"\r\n")
        if text.strip():
            yield CsvLine(number, begin, text)
        begin += len(line)


def csv_header(content: bytes) -> bytes:
    """Text of the header of a CSV file; empty if the file has only empty lines and comments."""
    return next((line.text for line in csv_lines(content)), b"")


def split_cells(text: bytes, separator: bytes) -> list[bytes]:
    """Split a line into its cells; quoted cells become empty, since they may contain separators."""
    return QUOTED.sub(b"", text).split(separator)


def csv_form(path: Path, content: bytes) -> CsvForm:
    """Find the separator and the decimal sign of a CSV file from its first lines.

    Args:
        path: File, for messages.
        content: Content of the file.

    Raises:
        ConfigError: Some numbers have decimal commas and others points, or blanks separate the cells.
    """
    lines = [line.text for line in itertools.islice(csv_lines(content), FIRST_LINES)]
    if not lines:
        return CsvForm()
    header, *rows = lines
    separator = separator_of(header, rows)
    if separator is None and any(are_numbers(row.split()) for row in rows):
        raise ConfigError(
            "file", f"'{path}' has cells that are separated by blanks: separate them by commas, semicolons or tabs"
        )
    if separator is None or separator == b",":  # None: the file has a single column
        return CsvForm()
    return CsvForm(separator.decode(), decimal_sign(path, rows, separator))


def separator_of(header: bytes, rows: list[bytes]) -> bytes | None:
    """The separator of the cells of a CSV file; None if its header has none.

    If the header contains several separators, the result is the one that splits all lines into equally many cells. If
    none or several of them do so, the result is the comma.
    """
    unquoted_header = QUOTED.sub(b"", header)
    separators = [separator for separator in SEPARATORS if separator in unquoted_header]
    if not separators:
        return None
    if len(separators) == 1:
        return separators[0]
    even_separators = [separator for separator in separators if has_equal_rows(header, rows, separator)]
    return even_separators[0] if len(even_separators) == 1 else b","


def decimal_sign(path: Path, rows: list[bytes], separator: bytes) -> str:
    """The decimal sign, ``,`` or ``.``, of the numbers in rows whose cells are separated by semicolons or tabs.

    Args:
        path: File, for messages.
        rows: The rows.
        separator: Separator of the cells.

    Raises:
        ConfigError: Some numbers have decimal commas and others points.
    """
    number_with_comma: bytes | None = None  # the first one, for the message
    number_with_point: bytes | None = None
    for row in rows:
        for cell in split_cells(row, separator):
            if number_with_comma is None and DECIMAL_COMMA.fullmatch(cell):
                number_with_comma = cell
            if number_with_point is None and DECIMAL_POINT.fullmatch(cell):
                number_with_point = cell
    if number_with_comma is None:
        return "."
    if number_with_point is not None:
        raise ConfigError(
            "file",
            f"'{path}' has numbers with decimal commas and with points, as {number_with_comma.decode().strip()} and "
            f"{number_with_point.decode().strip()}: write all with points",
        )
    return ","


def are_numbers(texts: list[bytes]) -> bool:
    """Whether there are at least two texts, and each of them is a number."""
    return len(texts) > 1 and all(DECIMAL.fullmatch(text) for text in texts)


def has_equal_rows(header: bytes, rows: list[bytes], separator: bytes) -> bool:
    """Whether every row has as many cells as the header, if ``separator`` separates the cells."""
    count = len(split_cells(header, separator))
    return all(len(split_cells(row, separator)) == count for row in rows)


def whole_rows(path: Path, content: bytes, form: CsvForm) -> bytes:
    """Content of a CSV file without a last row that is cut off, as by a full disk.

    A file in which a quoted cell spans several lines is returned unchecked.

    Args:
        path: File, for messages.
        content: Content of the file.
        form: Separator and decimal sign of the file.

    Raises:
        ConfigError: A row has more cells than the header, or a row before the last one has fewer.

    Warns:
        RecordWarning: The last row is left out, or its last number may be cut off.
    """
    separator = form.separator.encode()
    has_quotes = b'"' in content
    has_open_quotes = has_quotes and any(line.text.count(b'"') % 2 for line in csv_lines(content))
    if has_open_quotes:  # a quoted cell spans several lines
        return content
    header_count = 0  # number of cells of the header; 0 before the header has been read
    short_line: CsvLine | None = None  # a row with too few cells, which must be the last one
    for line in csv_lines(content):
        count = len(split_cells(line.text, separator)) if has_quotes else line.text.count(separator) + 1
        header_count = header_count or count
        if short_line is not None:
            raise uneven_row_error(path, short_line, form, header_count)
        if count > header_count:
            raise uneven_row_error(path, line, form, header_count)
        if count < header_count:
            short_line = line
    if short_line is None:
        warn_of_cut_number(path, content, separator)
        return content
    warnings.warn(f"'{path.name}' ends within line {short_line.number}, which is left out", RecordWarning, stacklevel=2)
    return content[: short_line.begin]


def warn_of_cut_number(path: Path, content: bytes, separator: bytes) -> None:
    """Warn if a file ends without a line break and its last number is much shorter than the numbers above it.

    Args:
        path: File, for messages.
        content: Content of the file.
        separator: Separator of its cells.

    Warns:
        RecordWarning: The last number may be cut off.
    """
    lines = content.rsplit(b"\n", LAST_LINES)[1:]  # without the first part: the header, or all earlier lines
    if not lines:
        return
    last_cells = [split_cells(line, separator)[-1].strip() for line in lines]
    last_number = last_cells[-1]  # empty after a line break
    lengths = sorted(map(len, last_cells))
    median_length = lengths[len(lengths) // 2]
    if 0 < len(last_number) < SHORT * median_length:
        text = last_number.decode()
        warnings.warn(
            f"'{path.name}' ends without a line break, so that its last number, {text}, may be cut off; it is "
            "taken as it is",
            RecordWarning,
            stacklevel=3,
        )


def uneven_row_error(path: Path, line: CsvLine, form: CsvForm, header_count: int) -> ConfigError:
    """The error that a row has more or fewer cells than the header, with the likely reason.

    Args:
        path: File, for the message.
        line: The row.
        form: Separator and decimal sign of the file.
        header_count: Number of cells of the header.
    """
    count = len(split_cells(line.text, form.separator.encode()))
    if header_count == 1:
        reason = "its first line is no header"
    elif count < header_count:
        reason = "the row is cut off, or goes on behind a #, where comments begin"
    elif form.separator == ",":
        reason = "it ends with a separator, or commas are its decimal signs"
    else:
        reason = "it ends with a separator"
    place = f"'{path}' has {count} cells in line {line.number}, and {header_count} in its header"
    return ConfigError("file", f"{place}: {reason}")
