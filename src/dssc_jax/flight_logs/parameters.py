"""The parameters that a log of PX4 holds: those at its start, as changed during the flight."""

import io
from pathlib import Path

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError


def logged_parameters(path: Path) -> dict[str, float]:
    """The parameters of a ULog by name; of one that changed in flight, its last value.

    Raises:
        ConfigError: pyulog is missing, or the file is no ULog.
    """
    try:
        from pyulog import ULog  # an optional extra
    except ImportError as error:
        raise ConfigError("file", "a log of PX4 needs pyulog: pip install 'dssc_jax[ulog]'") from error
    content = io.BytesIO(files.read_bytes(path))
    try:
        log = ULog(content, [])
    except Exception as error:  # pyulog raises errors of many kinds
        raise ConfigError("", f"is no ULog: {' '.join(str(error).split())}") from error
    parameters = {name: shortest(value) for name, value in log.initial_parameters.items()}
    for _, name, value in log.changed_parameters:
        parameters[name] = shortest(value)
    return parameters


def shortest(value: float) -> float:
    """A parameter of PX4; of a float32 the number with the fewest digits: 0.05, not 0.05000000074505806."""
    return float(value) if isinstance(value, int) else float(str(np.float32(value)))
