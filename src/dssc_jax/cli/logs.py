"""Read a logged flight as the options of a command request; shared by compare-log and explore."""

from collections.abc import Mapping
from pathlib import Path

from dssc_jax.cli.declarations.types import LogOptions
from dssc_jax.cli.parsing import parse_assignment
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.reading.reader import FlightLog, read_log
from dssc_jax.study import Study, read_toml


def logged_flight(options: LogOptions, path: Path, study: Study) -> FlightLog:
    """Read a log of a study's flight.

    Args:
        options: Options on the log: the file with the table of its columns, and changes of this table.
        path: The log.
        study: The study, whose channels name the signals.

    Raises:
        ConfigError: The log or its table cannot be read, or does not fit the study.
    """
    table = read_toml(options.columns) if options.columns is not None else {}
    columns = dict(parse_assignment(text, "--column") for text in options.column or [])
    columns_of_file = table.get("signals", {})
    if columns and isinstance(columns_of_file, Mapping):  # other types are refused by read_log
        table = {**table, "signals": {**columns_of_file, **columns}}
    if options.start is not None:
        table = {**table, "start": options.start}
    if options.segment is not None:
        table = {**table, "segment": options.segment}
    try:
        return read_log(path, study.loop.channels, table, allow_damaged=options.allow_damaged)
    except ConfigError as error:
        if options.columns is not None and path.is_file():
            raise error.within(str(options.columns)) from None
        raise
