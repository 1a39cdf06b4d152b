"""Linear systems of SciPy and python-control as plants of a study."""

from typing import Any

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.plants.linear import DELAYED_BY_A_SAMPLE


def plant_table(system: Any) -> TomlTable:
    """Convert a linear system into a table ``[plant]`` of kind ``state_space`` or ``transfer_function``.

    The table contains the numbers of the system, and does not refer to code. A law may replace any of the numbers.

    Args:
        system: A continuous-time system with one input and one output: ``scipy.signal.StateSpace``,
            ``TransferFunction`` or ``ZerosPolesGain``, or ``control.StateSpace`` or ``TransferFunction``.

    Returns:
        A table for ``study.override({"plant": ...})`` or ``dj.Study.from_table``.

    Raises:
        ConfigError: The system is sampled, has several inputs or outputs, passes its input directly to its output, or
            is no linear system.

    Example:
        >>> from scipy import signal
        >>> plant_table(signal.TransferFunction([2.0], [1.0, 3.0, 0.0]))
        {'kind': 'transfer_function', 'numerator': [2.0], 'denominator': [1.0, 3.0, 0.0]}
    """
    name = type(system).__name__
    if getattr(system, "dt", None) not in (None, 0):  # of SciPy and of python-control in continuous time
        raise ConfigError("plant", f"must be a system in continuous time, got {name} with dt = {system.dt}")
    if all(hasattr(system, matrix_name) for matrix_name in "ABCD"):
        return state_space_table(system)
    if hasattr(system, "zeros") and hasattr(system, "gain") and hasattr(system, "to_tf"):
        system = system.to_tf()  # from zeros, poles and gain
    if not hasattr(system, "num") or not hasattr(system, "den"):
        raise ConfigError("plant", f"must be a linear system of scipy.signal or control, got {name}")
    numerator = coefficients(system.num, name)
    denominator = coefficients(system.den, name)
    if len(numerator) >= len(denominator):
        raise ConfigError("plant", f"must have more poles than zeros: {DELAYED_BY_A_SAMPLE}")
    return {"kind": "transfer_function", "numerator": numerator, "denominator": denominator}


def state_space_table(system: Any) -> TomlTable:
    """Table of kind ``state_space`` of a system x' = A x + B u, y = C x + D u with one input and one output.

    Raises:
        ConfigError: The system has several inputs or outputs, or D is not 0.
    """
    a, b, c, d = (np.atleast_2d(np.asarray(matrix, float)) for matrix in (system.A, system.B, system.C, system.D))
    if b.shape[1] != 1 or c.shape[0] != 1:
        raise ConfigError("plant", f"must have one input and one output, got {b.shape[1]} and {c.shape[0]}")
    if np.any(d):
        rule = f"must not pass its input directly to its output, got D = {d.item():g}"
        raise ConfigError("plant", f"{rule}: {DELAYED_BY_A_SAMPLE}")
    return {"kind": "state_space", "a": a.tolist(), "b": b[:, 0].tolist(), "c": c[0].tolist()}


def coefficients(polynomial: Any, name: str) -> list[float]:
    """Coefficients of a polynomial, the highest power first, without leading zeros.

    Args:
        polynomial: Array of coefficients, or python-control's nested lists with an array for each output and input.
        name: Type of the system, for messages.

    Raises:
        ConfigError: The system has several inputs or outputs.
    """
    while isinstance(polynomial, list | np.ndarray) and len(polynomial) and np.ndim(polynomial[0]) > 0:
        if len(polynomial) != 1:
            raise ConfigError("plant", f"must have one input and one output, got a {name} of several")
        polynomial = polynomial[0]
    return np.trim_zeros(np.asarray(polynomial, float), trim="f").tolist()  # from the front
