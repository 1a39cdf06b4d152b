"""Parse the texts of options, such as ``NAME=LO:HI``, and refuse options without a meaning."""

import math
import tomllib
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.study.separators import separator_hint

TomlValue = str | int | float | bool | list["TomlValue"] | dict[str, "TomlValue"]


class Walk(NamedTuple):
    """A walk over the values of a number.

    Args:
        name: Dotted name of the number.
        bounds: The safe end, then the other end.
    """

    name: str
    bounds: tuple[float, float]


def parse_assignment(text: str, option: str) -> tuple[str, str]:
    """Parse ``NAME=VALUE``, the text of an option, to name and value."""
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        raise ConfigError(option, f"must be NAME=VALUE, got '{text}'{separator_hint(text, 1)}")
    return name, value


def parse_within(texts: list[str] | None) -> dict[str, float]:
    """Parse the texts ``NAME=RADIUS`` of ``--within`` to radii by name."""
    radii = {}
    for text in texts or []:
        name, value = parse_assignment(text, "--within")
        try:
            radii[name] = float(value)
        except ValueError:
            raise ConfigError("--within", f"must be NAME=RADIUS, got '{text}'") from None
    return radii


def parse_value(text: str) -> TomlValue:
    """Parse a TOML value; text that is not valid TOML is a string itself."""
    try:
        table = tomllib.loads(f"value = {text}")
    except ValueError:  # TOMLDecodeError is one, so are integers too long
        return text
    return table["value"] if len(table) == 1 else text


def parse_changes(texts: list[str] | None) -> dict[str, TomlValue]:
    """Parse the texts ``NAME=VALUE`` of ``--set`` to values by name."""
    changes = {}
    for text in texts or []:
        name, value = parse_assignment(text, "--set")
        changes[name] = parse_value(value)
    return changes


def parse_point(texts: list[str] | None) -> dict[str, float]:
    """Parse the texts ``NAME=NUMBER`` of ``--at`` to finite numbers by name."""
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
    """Parse ``NAME=LO:HI:COUNT[:log]`` to the name and the table of an axis, as a study's ``[sweep]`` has it."""
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
    """Parse the texts of ``--over`` to the tables of axes by name, see :func:`parse_over`."""
    axes: dict[str, dict[str, list[float]]] = {}
    for text in texts:
        name, axis = parse_over(text)
        if name in axes:
            raise ConfigError("--over", f"'{name}' is given twice")
        axes[name] = axis
    return axes


def parse_walk(text: str) -> Walk:
    """Parse ``NAME=LO:HI`` to the walk over a number."""
    try:
        name, value = text.split("=")
        start, end = map(float, value.split(":"))
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI, got '{text}'{separator_hint(text, 2)}") from None
    return Walk(name, (start, end))


def parse_times(text: str | None) -> tuple[float, ...]:
    """Parse ``T1,T2,..`` to times [s]; none for None."""
    try:
        return tuple(float(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise ConfigError("--at", f"must be times in seconds, T1,T2,.., got '{text}'") from None


def require_unset(circumstance: str, **options: object) -> None:
    """Require that options without a meaning in a circumstance, such as "with a result", are not given.

    Args:
        circumstance: The circumstance, for the message.
        options: Values of the options; None and an empty list mean that an option is not given.

    Raises:
        ConfigError: An option is given.
    """
    for name, value in options.items():
        if value is not None and value != []:
            raise ConfigError(f"--{name.replace('_', '-')}", f"has no meaning {circumstance}")
