"""The parameters that a log of PX4 holds: those at its start, as changed during the flight."""

from pathlib import Path

import numpy as np

from dssc_jax.flight_logs.reading.ulog import parsed_log


def logged_parameters(path: Path) -> dict[str, float]:
    """The parameters of a ULog by name; of one that changed in flight, its last value.

    What a damaged log holds in place of a number is left out.

    Raises:
        ConfigError: pyulog is missing, or the file cannot be read.
    """
    log, _ = parsed_log(path, [])
    parameters = dict(log.initial_parameters)
    for _, name, value in log.changed_parameters:
        parameters[name] = value
    return {name: shortest_decimal(value) for name, value in parameters.items() if isinstance(value, int | float)}


def shortest_decimal(value: float) -> float:
    """A parameter of PX4; of a float32 the number with the fewest digits: 0.05, not 0.05000000074505806."""
    return float(value) if isinstance(value, int) else float(str(np.float32(value)))
