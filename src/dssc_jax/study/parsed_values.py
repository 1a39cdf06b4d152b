"""Parsing of single values in the fixed tables of a study: numbers, units, axes, points of bounds, intervals."""

from itertools import pairwise
from typing import Any

import numpy as np

from dssc_jax.core.errors import nearest
from dssc_jax.core.units import parse_unit
from dssc_jax.study.laws import is_number

LONGEST_UNIT = 40
"""Most characters of a unit."""
MOST_POINTS = 64
"""Most points of a bound over time."""

MOST_VALUES = 10**6
"""Most values of an axis."""
AXES = ("linspace", "logspace", "values")
"""Forms in which a study states the values of an axis."""


def parse_finite(value: object) -> float:
    """Parse a finite number.

    Raises:
        ValueError: The value is no finite number.
    """
    if not is_number(value):
        raise ValueError(f"must be a finite number, got {value!r}")
    return float(value)


def parse_finite_or_text(value: object) -> float | str:
    """Parse a finite number, or leave a text, which may be a number with a unit, to a later check.

    Raises:
        ValueError: The value is neither a finite number nor a text.
    """
    return value if isinstance(value, str) else parse_finite(value)


def parse_unit_text(value: object) -> str:
    """Return the text of a unit, after a check that it is a product of powers such as ``kg m^2/s``.

    Raises:
        ValueError: The value is no such text, or is too long.
    """
    if not isinstance(value, str) or len(value) > LONGEST_UNIT:
        raise ValueError(f"must be a unit of at most {LONGEST_UNIT} characters, such as 'rad/s', got {value!r}")
    parse_unit(value)  # raises if the text is no unit
    return value


def parse_points(value: Any) -> tuple[tuple[float, float], ...]:
    """Parse the points ``[[time, value], ...]`` of a bound over time, times in seconds.

    Raises:
        ValueError: The value is no list of at least two pairs of numbers, has too many of them, or its times fall.
    """
    if not isinstance(value, list | tuple) or len(value) < 2 or not all(map(is_pair, value)):
        raise ValueError(f"must be two or more points [time, value], got {value!r}")
    if len(value) > MOST_POINTS:
        raise ValueError(f"takes at most {MOST_POINTS} points, got {len(value)}")
    points = tuple((float(time), float(bound)) for time, bound in value)
    for (time, _), (next_time, _) in pairwise(points):
        if next_time < time:
            raise ValueError(f"must have rising times, got {next_time:g} s after {time:g} s")
    return points


def is_pair(value: object) -> bool:
    """Whether a value is a list of two numbers."""
    return isinstance(value, list | tuple) and len(value) == 2 and all(map(is_number, value))


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
    """Space values from ``lo`` to ``hi`` at equal distances, or in equal ratios.

    Args:
        spacing: ``linspace`` for equal distances, ``logspace`` for equal ratios.
        arguments: Finite numbers, ``[lo, hi, count]``.

    Raises:
        ValueError: The arguments are not valid.
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
    """Parse the interval ``[low, high]`` of a positive number, with 0 < low < high.

    Raises:
        ValueError: The value is no such interval.
    """
    if not isinstance(value, list | tuple) or not is_pair(value):
        raise ValueError(f"must be [low, high], got {value!r}")
    low, high = value
    if not 0.0 < low < high:
        raise ValueError(f"holds no number: [low, high] needs 0 < low < high, got {value!r}")
    return float(low), float(high)


def parse_free_parameter(value: object) -> tuple[float, float] | float:
    """Parse the interval of a free parameter of Theorem 1, or the positive number at which it is fixed.

    Raises:
        ValueError: The value is neither.
    """
    if isinstance(value, list | tuple):
        return parse_range(value)
    if not is_number(value) or not value > 0:
        raise ValueError(f"must be a number > 0, or [low, high] to vary it, got {value!r}")
    return float(value)


def parse_tuning_limit(value: Any) -> float | str:
    """Parse the limit of a metric in a tuning: a bound > 0, or ``start`` for its value at the start of the tuning.

    Raises:
        ValueError: The value is neither.
    """
    if value == "start":
        return value
    if not is_number(value) or not value > 0:
        raise ValueError(
            f"must be a number > 0, or 'start' for the metric's value at the start of the tuning, got {value!r}"
        )
    return float(value)
