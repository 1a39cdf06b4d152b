"""CSV and Parquet files of recorded signals, read as data frames of pandas."""

import codecs
import io
import math
from pathlib import Path
from typing import Any

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.study.csv_files import NO_NUMBERS, csv_form, csv_header, whole_rows

PARQUET = (".parquet", ".pq")
"""Endings of the names of Parquet files."""
ULOG = b"ULog\x01\x12\x35"
"""First bytes of a log of PX4."""
LARGEST_RECORD = 2**27  # most bytes of a file
MOST_COLUMNS = 10_000
"""Most columns of a file; a table with more takes minutes to read."""


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
    """Number of columns of a Parquet file, from its metadata alone."""
    from pyarrow import parquet

    return parquet.ParquetFile(io.BytesIO(content)).metadata.num_columns


def require_few_columns(path: Path, count: int) -> None:
    """Require that a file has at most :data:`MOST_COLUMNS` columns.

    Raises:
        ConfigError: The file has more columns.
    """
    if count > MOST_COLUMNS:
        raise ConfigError("file", f"'{path}' has {count} columns, more than a record can have ({MOST_COLUMNS})")


def require_header(path: Path, names: list[str]) -> None:
    """Require that the first line of a CSV file names the columns, each with a name of its own.

    Args:
        path: The file, for messages.
        names: Cells of the first line.

    Raises:
        ConfigError: The line consists of numbers, or contains a name twice.
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

    Dates and time spans of a Parquet file become seconds.

    Raises:
        ConfigError: The file cannot be read.
    """
    try:
        if not path.is_file():
            raise ConfigError("file", f"'{path}' cannot be read: it is no file")
        content = record_content(path)
        require_table(path, content)
        return parquet_frame(path, content) if is_parquet(path) else csv_frame(path, content)
    except ImportError as error:
        raise ConfigError("file", "a Parquet file needs pyarrow: pip install 'dssc_jax[export]'") from error
    except ConfigError:
        raise
    except UnicodeDecodeError as error:
        raise ConfigError("file", f"'{path}' is no text, as a CSV file is: byte {error.start} is no UTF-8") from error
    except Exception as error:  # readers of files raise errors of many kinds
        raise ConfigError("file", f"'{path}' cannot be read: {' '.join(str(error).split())}") from error


def require_table(path: Path, content: bytes) -> None:
    """Require that a file is not empty, and is neither text in UTF-16 nor a ULog, which users often take for a table.

    Raises:
        ConfigError: The file is one of these; the message has a remedy.
    """
    if not content.strip():
        raise ConfigError("file", f"'{path}' is empty")
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ConfigError("file", f"'{path}' is text in UTF-16; save it as UTF-8")
    if content.startswith(ULOG):
        raise ConfigError("file", f"'{path}' is a ULog: `dssc-jax log FILE --topic TOPIC --csv OUT` writes a table")


def parquet_frame(path: Path, content: bytes) -> Any:
    """Read the content of a Parquet file as a data frame, with seconds in place of dates and time spans.

    Raises:
        ConfigError: The file has too many columns.
    """
    import pandas as pd  # slow to load, and few studies have a record

    require_few_columns(path, parquet_column_count(content))
    return with_seconds(pd.read_parquet(io.BytesIO(content)))


def csv_frame(path: Path, content: bytes) -> Any:
    """Read the whole rows of a CSV file as a data frame; error values of spreadsheets become empty cells.

    Raises:
        ConfigError: The form of the file is not clear, its header is not valid, or a row has too many or too few cells.
    """
    import pandas as pd  # slow to load, and few studies have a record

    form = csv_form(path, content)
    header = csv_header(content).decode(errors="replace").split(form.separator)
    require_few_columns(path, len(header))
    require_header(path, [name.strip().strip('"') for name in header])
    table = io.BytesIO(NO_NUMBERS.sub(b"", whole_rows(path, content, form)))
    return pd.read_csv(table, sep=form.separator, decimal=form.decimal, skipinitialspace=True, comment="#")


def with_seconds(frame: Any) -> Any:
    """Replace dates and time spans in a data frame by numbers of seconds; missing ones become NaN.

    A date becomes the time since the beginning of 1970 UTC. A date without a time zone counts as UTC.
    """
    spans = frame.select_dtypes("timedelta")
    dates = frame.select_dtypes(["datetime", "datetimetz"])
    epoch = np.datetime64(0, "s")
    numbers = {name: column.dt.total_seconds() for name, column in spans.items()}
    for name, column in dates.items():
        plain_dates = column if column.dt.tz is None else column.dt.tz_convert("UTC").dt.tz_localize(None)
        numbers[name] = (plain_dates - epoch).dt.total_seconds()
    return frame.assign(**numbers)
