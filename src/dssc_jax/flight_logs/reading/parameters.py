"""The parameters that a log of PX4 holds: those at the start of the log, with changes during the flight applied."""

from pathlib import Path

import numpy as np

from dssc_jax.flight_logs.reading.ulog import parsed_log


def logged_parameters(path: Path) -> dict[str, float]:
    """The parameters of a ULog by name, each with its last value in the flight.

    Parameters whose value is no number, as in a damaged log, are left out.

    Raises:
        ConfigError: pyulog is missing, or the file cannot be read.
    """
    log, _ = parsed_log(path, [])
    parameters = dict(log.initial_parameters)
    for _, name, value in log.changed_parameters:
        parameters[name] = value
    return {name: shortest_decimal(value) for name, value in parameters.items() if isinstance(value, int | float)}


def shortest_decimal(value: float) -> float:
    """A parameter of PX4 as a float. A float32 becomes the decimal with the fewest digits: 0.05, not 0.0500000007."""
    return float(value) if isinstance(value, int) else float(str(np.float32(value)))
