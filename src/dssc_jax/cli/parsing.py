"""Parse the texts of options, such as ``NAME=LO:HI``, and refuse options that have no meaning together."""

import math
import tomllib
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.study.separators import separator_hint

SweepAxis = dict[str, list[float]]
"""Axis of a sweep as in a study file: start, end and number of its values, under ``linspace`` or ``logspace``."""
TomlValue = str | int | float | bool | list["TomlValue"] | dict[str, "TomlValue"]


class Walk(NamedTuple):
    """The number that a command walks over, and the ends of the walk.

    Args:
        name: Dotted name of the number.
        bounds: The safe end, then the other end.
    """

    name: str
    bounds: tuple[float, float]


def parse_assignment(text: str, option: str) -> tuple[str, str]:
    """Split the text ``NAME=VALUE`` of an option into name and value.

    Args:
        text: The text.
        option: Name of the option, for messages.

    Raises:
        ConfigError: The text has no ``=``, or nothing on one side of it.
    """
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        raise ConfigError(option, f"must be NAME=VALUE, got '{text}'{separator_hint(text, 1)}")
    return name, value


def parse_within(texts: list[str] | None) -> dict[str, float]:
    """Parse the texts ``NAME=RADIUS`` of ``--within`` to radii by name.

    Raises:
        ConfigError: A text has another form.
    """
    radii = {}
    for text in texts or []:
        name, value = parse_assignment(text, "--within")
        try:
            radii[name] = float(value)
        except ValueError:
            raise ConfigError("--within", f"must be NAME=RADIUS, got '{text}'") from None
    return radii


def parse_value(text: str) -> TomlValue:
    """Parse a text as a TOML value; a text that is not one is returned as it is."""
    try:
        table = tomllib.loads(f"value = {text}")
    except ValueError:  # invalid TOML, or an integer with too many digits
        return text
    has_more_entries = len(table) > 1  # the text has line breaks
    return text if has_more_entries else table["value"]


def parse_changes(texts: list[str] | None) -> dict[str, TomlValue]:
    """Parse the texts ``NAME=VALUE`` of ``--set`` to values by name.

    Raises:
        ConfigError: A text has another form.
    """
    changes = {}
    for text in texts or []:
        name, value = parse_assignment(text, "--set")
        changes[name] = parse_value(value)
    return changes


def parse_point(texts: list[str] | None) -> dict[str, float]:
    """Parse the texts ``NAME=NUMBER`` of ``--at`` to finite numbers by name.

    Raises:
        ConfigError: A text has another form, or its number is not finite.
    """
    point = {}
    for text in texts or []:
        name, value = parse_assignment(text, "--at")
        try:
            number = float(value)
        except ValueError:
            number = math.nan  # no number, which is refused below
        if not math.isfinite(number):
            raise ConfigError("--at", f"must be NAME=NUMBER, got '{text}'")
        point[name] = number
    return point


def parse_sweep_axis(text: str) -> tuple[str, SweepAxis]:
    """Parse ``NAME=LO:HI:COUNT[:log]`` to the name of a number and its axis.

    Raises:
        ConfigError: The text has another form.
    """
    try:
        name, value = text.split("=")
        low, high, count, *scale = value.split(":")
        numbers = [float(low), float(high), int(count)]
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI:COUNT[:log], got '{text}'{separator_hint(text, 3)}") from None
    if scale not in ([], ["log"]):
        raise ConfigError("--over", f"only ':log' may follow COUNT, got '{text}'")
    return name, {"logspace" if scale else "linspace": numbers}


def parse_sweep_axes(texts: list[str]) -> dict[str, SweepAxis]:
    """Parse the texts of ``--over`` to the axes of a sweep by name, see :func:`parse_sweep_axis`.

    Raises:
        ConfigError: A text has another form, or two texts give the same name.
    """
    axes: dict[str, SweepAxis] = {}
    for text in texts:
        name, axis = parse_sweep_axis(text)
        if name in axes:
            raise ConfigError("--over", f"'{name}' is given twice")
        axes[name] = axis
    return axes


def parse_walk(text: str) -> Walk:
    """Parse ``NAME=LO:HI`` to the walk over a number.

    Raises:
        ConfigError: The text has another form.
    """
    try:
        name, value = text.split("=")
        start, end = map(float, value.split(":"))
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI, got '{text}'{separator_hint(text, 2)}") from None
    return Walk(name, (start, end))


def parse_times(text: str | None) -> tuple[float, ...]:
    """Parse ``T1,T2,..`` to times [s]; an empty tuple if the text is None or empty.

    Raises:
        ConfigError: The text has another form.
    """
    try:
        return tuple(float(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise ConfigError("--at", f"must be times in seconds, T1,T2,.., got '{text}'") from None


def require_unset(circumstance: str, **options: object) -> None:
    """Require that none of the options is given, because they have no meaning in a circumstance.

    Args:
        circumstance: The circumstance for the message, such as "with a result".
        options: Values of the options, by name; None and an empty list mean that an option is not given.

    Raises:
        ConfigError: An option is given.
    """
    for name, value in options.items():
        if value is not None and value != []:
            raise ConfigError(f"--{name.replace('_', '-')}", f"has no meaning {circumstance}")
