"""Parsing of the values of a sweep, and of the intervals and limits of a tuning."""

from typing import Any

import numpy as np

from dssc_jax.core.errors import nearest
from dssc_jax.study.laws import is_number

MOST_VALUES = 10**6
"""Most values of an axis."""
AXES = ("linspace", "logspace", "values")
"""Forms in which a study states the values of an axis."""


def parse_axis(value: object) -> tuple[float, ...]:
    """Parse the values of a sweep axis: a list, ``{ values = [...] }``, or ``{ linspace | logspace = [lo, hi, n] }``.

    Raises:
        ValueError: The value is none of these, or has invalid ends or too many values.
    """
    if isinstance(value, list | tuple):
        value = {"values": list(value)}
    if not isinstance(value, dict) or len(value) != 1:
        raise ValueError(f"must be a list or one of {{ linspace | logspace = [lo, hi, count] }}, got {value!r}")
    spacing, arguments = next(iter(value.items()))
    if spacing not in AXES:
        raise ValueError(f"'{spacing}' is not a spacing; {nearest(spacing, AXES)}")
    if not isinstance(arguments, list) or not arguments or not all(is_number(item) for item in arguments):
        raise ValueError(f"{spacing} takes a list of finite numbers, got {arguments!r}")
    if spacing == "values":
        return tuple(float(item) for item in arguments)
    return spaced_values(spacing, arguments)


def spaced_values(spacing: str, arguments: list[Any]) -> tuple[float, ...]:
    """Values from ``lo`` to ``hi`` at equal distances, or in equal ratios.

    Args:
        spacing: ``linspace`` for equal distances, ``logspace`` for equal ratios.
        arguments: Finite numbers, ``[lo, hi, count]``.

    Raises:
        ValueError: There are no such values.
    """
    if len(arguments) != 3 or not isinstance(arguments[2], int) or arguments[2] < 1:
        raise ValueError(f"{spacing} takes [lo, hi, count] with a whole count >= 1, got {arguments}")
    low, high, count = arguments
    if count > MOST_VALUES:
        raise ValueError(f"{spacing} takes at most {MOST_VALUES} values, got {count}")
    if count > 1 and not low < high:
        raise ValueError(f"{spacing} needs lo < hi, got {arguments}")
    if count == 1 and low != high:
        rule = f"{spacing} with count = 1 needs lo = hi, or a count of 2 or more for both ends"
        raise ValueError(f"{rule}, got {arguments}")
    if spacing == "linspace":
        return tuple(np.linspace(low, high, count).tolist())
    if low <= 0:
        raise ValueError(f"logspace needs 0 < lo, got {arguments}")
    return tuple(np.geomspace(low, high, count).tolist())


def parse_range(value: object) -> tuple[float, float]:
    """Parse the interval ``[low, high]`` of a positive number.

    Raises:
        ValueError: The value is no such interval.
    """
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(is_number(end) for end in value):
        raise ValueError(f"must be [low, high], got {value!r}")
    if not 0.0 < value[0] < value[1]:
        raise ValueError(f"holds no number: [low, high] needs 0 < low < high, got {value!r}")
    return float(value[0]), float(value[1])


def parse_free(value: object) -> tuple[float, float] | float:
    """Parse the interval of a free parameter of Theorem 1, or the positive number at which it is fixed.

    Raises:
        ValueError: The value is neither.
    """
    if isinstance(value, list | tuple):
        return parse_range(value)
    if not is_number(value) or not value > 0:
        raise ValueError(f"must be a number > 0, or [low, high] to vary it, got {value!r}")
    return float(value)


def parse_limit(value: Any) -> float | str:
    """Parse the limit of a metric in a tuning: a bound > 0, or the word ``start`` for the metric's first value.

    Raises:
        ValueError: The value is neither.
    """
    if value == "start":
        return value
    if not is_number(value) or not value > 0:
        raise ValueError(f"must be a number > 0, or 'start' for what the start has, got {value!r}")
    return float(value)
