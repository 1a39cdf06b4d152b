"""Read logged flights by the options that several commands share."""

from pathlib import Path

from dssc_jax.cli.declarations.types import LogOptions
from dssc_jax.cli.parsing import parse_assignment
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.reading.reader import FlightLog, read_log
from dssc_jax.study import Study, read_toml


def logged_flight(options: LogOptions, path: Path, study: Study) -> FlightLog:
    """Read a log by the table of its columns and the options that change this table.

    Args:
        options: Options on the log.
        path: The log.
        study: The study, for its channels.

    Raises:
        ConfigError: The log or its table cannot be read, or does not fit the study.
    """
    table = read_toml(options.columns) if options.columns is not None else {}
    columns = dict(parse_assignment(text, "--column") for text in options.column or [])
    if columns:
        table = {**table, "signals": {**table.get("signals", {}), **columns}}
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
