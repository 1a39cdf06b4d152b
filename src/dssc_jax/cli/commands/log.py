"""dssc-jax log: the topics, segments and fields of logged flights."""

import json

from dssc_jax.cli.declarations.flight import Log
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.console.logs import show_log
from dssc_jax.flight_logs.contents import log_contents
from dssc_jax.results.summary import jsonable


def run(options: Log) -> int:
    """Read the logs, and print what they hold."""
    logs = [log_contents(path, options.topic or []) for path in options.file]
    if options.as_json:
        print(json.dumps({"logs": [jsonable(log.summary()) for log in logs]}, allow_nan=False))
        return DONE
    for log in logs:
        show_log(log)
    return DONE
