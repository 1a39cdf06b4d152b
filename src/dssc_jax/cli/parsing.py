"""Parse the texts of options, such as ``NAME=LO:HI``."""

import math
import tomllib
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.study.separators import separator_hint

TomlValue = str | int | float | bool | list["TomlValue"] | dict[str, "TomlValue"]


class Walked(NamedTuple):
    """A number and the ends between which it is walked.

    Args:
        name: Its dotted name.
        bounds: The safe end, then the other.
    """

    name: str
    bounds: tuple[float, float]


def parse_assignment(text: str, option: str) -> tuple[str, str]:
    """Parse name and value of ``NAME=VALUE``."""
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        raise ConfigError(option, f"must be NAME=VALUE, got '{text}'{separator_hint(text, 1)}")
    return name, value


def parse_within(texts: list[str] | None) -> dict[str, float]:
    """Parse all ``--within`` options, ``NAME=RADIUS`` each."""
    radii = {}
    for text in texts or []:
        name, value = parse_assignment(text, "--within")
        try:
            radii[name] = float(value)
        except ValueError:
            raise ConfigError("--within", f"must be NAME=RADIUS, got '{text}'") from None
    return radii


def parse_value(text: str) -> TomlValue:
    """Parse a TOML value; text that is not valid TOML is a string."""
    try:
        table = tomllib.loads(f"value = {text}")
    except ValueError:  # TOMLDecodeError is one, so are integers too long
        return text
    return table["value"] if len(table) == 1 else text


def parse_changes(texts: list[str] | None) -> dict[str, TomlValue]:
    """Parse all ``--set`` options."""
    changes = {}
    for text in texts or []:
        name, value = parse_assignment(text, "--set")
        changes[name] = parse_value(value)
    return changes


def parse_point(texts: list[str] | None) -> dict[str, float]:
    """Parse all ``--at`` options, ``NAME=NUMBER`` each."""
    point = {}
    for text in texts or []:
        name, value = parse_assignment(text, "--at")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ConfigError("--at", f"must be NAME=NUMBER, got '{text}'")
        point[name] = number
    return point


def parse_over(text: str) -> tuple[str, dict[str, list[float]]]:
    """Parse name and axis of ``NAME=LO:HI:COUNT[:log]``."""
    try:
        name, value = text.split("=")
        low, high, count, *scale = value.split(":")
        numbers = [float(low), float(high), int(count)]
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI:COUNT[:log], got '{text}'{separator_hint(text, 3)}") from None
    if scale not in ([], ["log"]):
        raise ConfigError("--over", f"only ':log' may follow COUNT, got '{text}'")
    return name, {"logspace" if scale else "linspace": numbers}


def parse_overs(texts: list[str]) -> dict[str, dict[str, list[float]]]:
    """Parse the axes of all ``--over`` options."""
    axes: dict[str, dict[str, list[float]]] = {}
    for text in texts:
        name, axis = parse_over(text)
        if name in axes:
            raise ConfigError("--over", f"'{name}' is given twice")
        axes[name] = axis
    return axes


def parse_walk(text: str) -> Walked:
    """Parse name and ends of ``NAME=LO:HI``."""
    try:
        name, value = text.split("=")
        start, end = map(float, value.split(":"))
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI, got '{text}'{separator_hint(text, 2)}") from None
    return Walked(name, (start, end))


def parse_times(text: str | None) -> tuple[float, ...]:
    """Parse the times of ``T1,T2,..``."""
    try:
        return tuple(float(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise ConfigError("--at", f"must be times in seconds, T1,T2,.., got '{text}'") from None
