"""The form of a CSV file: its separator, its decimal sign, and whether every row has the header's cells."""

import io
import itertools
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError

SEPARATORS = (b",", b";", b"\t")
QUOTED = re.compile(rb'"[^"]*"')
DECIMAL_COMMA = re.compile(rb"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
DECIMAL_POINT = re.compile(rb"\s*[+-]?\d*\.\d*([eE][+-]?\d+)?\s*")
DECIMAL = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
NO_NUMBERS = re.compile(rb"#(N/A|NUM!|DIV/0!|VALUE!|REF!|NAME\?|NULL!)")
"""What spreadsheets write in place of a number; the rest of such a line is no comment."""
FIRST_LINES = 100
"""Lines that tell the form."""
LAST_LINES = 100
"""Lines that tell the usual length of a number."""
SHORT = 0.7
"""Share of the usual length of a column's numbers: a shorter one at the end of a file may be cut off."""


class RecordWarning(UserWarning):
    """A row of a table is left out, or doubtful."""


class CsvForm(NamedTuple):
    """How a CSV file is written: what separates its cells, and the sign before its decimals."""

    separator: str = ","
    decimal: str = "."


class CsvLine(NamedTuple):
    """A line of a CSV file that is neither empty nor a comment.

    Args:
        number: Counted from 1.
        begin: Position of its first byte.
        text: Without a comment behind it.
    """

    number: int
    begin: int
    text: bytes


def csv_lines(content: bytes) -> Iterator[CsvLine]:
    """The header and the rows of a CSV file."""
    begin = 0
    for number, line in enumerate(io.BytesIO(content), start=1):
        text = NO_NUMBERS.sub(b"", line).partition(b"#")[0].rstrip(b"\r\n")
        if text.strip():
            yield CsvLine(number, begin, text)
        begin += len(line)


def csv_header(content: bytes) -> bytes:
    """The first line that is neither empty nor a comment; empty if there is none."""
    return next((line.text for line in csv_lines(content)), b"")


def cells(text: bytes, separator: bytes) -> list[bytes]:
    """The cells of a line; a quoted one is empty."""
    return QUOTED.sub(b"", text).split(separator)


def csv_form(path: Path, content: bytes) -> CsvForm:
    """The separator and the decimal sign of a file, by its first lines.

    Commas separate where the header has them and no other separator, or where nothing else separates header and rows
    alike. Cells such as 0,5 tell a decimal comma, if others separate.

    Raises:
        ConfigError: numbers have decimal commas and points, or blanks separate them.
    """
    header, *rows = [line.text for line in itertools.islice(csv_lines(content), FIRST_LINES)] or [b""]
    separators = [separator for separator in SEPARATORS if separator in QUOTED.sub(b"", header)]
    if len(separators) > 1:
        even_separators = [separator for separator in separators if is_even(header, rows, separator)]
        separators = even_separators if len(even_separators) == 1 else [b","]
    if not separators and any(are_numbers(row.split()) for row in rows):
        raise ConfigError(
            "file", f"'{path}' has cells that are separated by blanks: separate them by commas, semicolons or tabs"
        )
    separator = separators[0] if separators else b","
    if separator == b",":
        return CsvForm()
    commas = points = None
    for row in rows:
        for cell in cells(row, separator):
            commas = commas or (cell if DECIMAL_COMMA.fullmatch(cell) else None)
            points = points or (cell if DECIMAL_POINT.fullmatch(cell) else None)
    if commas and points:
        raise ConfigError(
            "file",
            f"'{path}' has numbers with decimal commas and with points, as {commas.decode().strip()} and "
            f"{points.decode().strip()}: write all with points",
        )
    return CsvForm(separator.decode(), "," if commas else ".")


def are_numbers(texts: list[bytes]) -> bool:
    """Whether there are several texts, and all are numbers."""
    return len(texts) > 1 and all(DECIMAL.fullmatch(text) for text in texts)


def is_even(header: bytes, rows: list[bytes], separator: bytes) -> bool:
    """Whether every row has as many cells as the header."""
    count = len(cells(header, separator))
    return all(len(cells(row, separator)) == count for row in rows)


def whole_rows(path: Path, content: bytes, form: CsvForm) -> bytes:
    """The content, without a last row that is cut off.

    Args:
        path: The file.
        content: Its content.
        form: Its form.

    Raises:
        ConfigError: another row has more or fewer cells than the header; the message has its line.

    Warns:
        RecordWarning: The last row is left out, or its last number may be cut off.
    """
    separator = form.separator.encode()
    has_quotes = b'"' in content
    has_open_quotes = has_quotes and any(line.text.count(b'"') % 2 for line in csv_lines(content))
    if has_open_quotes:  # a quoted cell spans several lines
        return content
    header_count = 0
    short_line: CsvLine | None = None
    for line in csv_lines(content):
        count = len(cells(line.text, separator)) if has_quotes else line.text.count(separator) + 1
        header_count = header_count or count
        if short_line is not None:
            raise uneven_row_error(path, short_line, form, header_count)
        if count > header_count:
            raise uneven_row_error(path, line, form, header_count)
        short_line = line if count < header_count else None
    if short_line is None:
        warn_of_cut_number(path, content, separator)
        return content
    warnings.warn(f"'{path.name}' ends within line {short_line.number}, which is left out", RecordWarning, stacklevel=2)
    return content[: short_line.begin]


def warn_of_cut_number(path: Path, content: bytes, separator: bytes) -> None:
    """Warn of a file without a last line break whose last number is shorter than those before it."""
    lines = content.rsplit(b"\n", LAST_LINES)[1:]  # without the header
    numbers = [cells(line, separator)[-1].strip() for line in lines] or [b""]
    last_number = numbers[-1]
    lengths = sorted(map(len, numbers))
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
    """The error of a row that has more or fewer cells than the header."""
    count = len(cells(line.text, form.separator.encode()))
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
