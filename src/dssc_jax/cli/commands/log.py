"""dssc-jax log: the topics, segments and fields of logged flights."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dssc_jax.cli.analysing import save_text
from dssc_jax.cli.declarations.flight import Log
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.console.logs import show_log
from dssc_jax.console.terminal import show_line
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.reading.contents import log_contents, topic_table
from dssc_jax.results.summary import jsonable
from dssc_jax.study.recorded import TIME


def run(options: Log) -> int:
    """Read the logs, and print what they hold, or write a topic as a table."""
    if options.csv is not None:
        return write_topic(options, options.csv)
    if options.segment is not None or options.start is not None:
        raise ConfigError("--segment, --start", "choose a part of a topic to write, and need --csv")
    logs = [log_contents(path, options.topic or []) for path in options.file]
    if options.as_json:
        print(json.dumps({"logs": [jsonable(log.summary()) for log in logs]}, allow_nan=False))
        return DONE
    for log in logs:
        show_log(log)
    return DONE


def write_topic(options: Log, out: Path) -> int:
    """Write a topic of a log as CSV, and return the exit code.

    Raises:
        ConfigError: There is not exactly one file with one topic, or the table cannot be written.
    """
    topics = options.topic or []
    if len(options.file) != 1 or len(topics) != 1:
        raise ConfigError("--csv", "writes one topic of one file; give one FILE and one --topic")
    table = topic_table(options.file[0], topics[0], options.segment, options.start)
    save_text(out, csv_lines(table))
    count = len(table[TIME])
    if options.as_json:
        print(json.dumps({"file": str(out), "rows": count, "columns": list(table)}))
    else:
        show_line(f"wrote {out}: {count:,} rows of {', '.join(table)}")
    return DONE


def csv_lines(table: dict[str, np.ndarray]) -> Iterator[str]:
    """Yield the lines of a table as CSV; numbers have all their digits, and NaN is an empty cell.

    Args:
        table: Columns of equal length, by name.
    """
    yield ",".join(table) + "\n"
    for row in zip(*table.values(), strict=True):
        cells = ["" if math.isnan(value) else repr(float(value)) for value in row]
        yield ",".join(cells) + "\n"
