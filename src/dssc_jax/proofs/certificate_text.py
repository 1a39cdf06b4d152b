"""Read the text of a certificate's file, more strictly than JSON does: no entry twice, and only finite numbers."""

import json
import math
from typing import TypeAlias

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"

MOST_DIGITS = 400
"""Largest number of characters of an integer that is read; the largest number of float64 has 309 digits."""


def certificate_content(text: str) -> Json:
    """Read the text of a certificate's file as JSON.

    Raises:
        ValueError: The text is no JSON, or has a repeated entry, NaN, infinity, a number beyond float64, or lists that
            are nested too deeply.
    """
    try:
        return json.loads(
            text,
            object_pairs_hook=entries_of,
            parse_constant=refuse_constant,
            parse_float=finite_value,
            parse_int=whole_number,
        )
    except RecursionError:
        raise ValueError("it nests lists or tables too deeply") from None


def entries_of(pairs: list[tuple[str, Json]]) -> dict[str, Json]:
    """Make a table of entries, none of which may occur twice.

    Raises:
        ValueError: An entry occurs twice; the message names it.
    """
    table = dict(pairs)
    if len(table) < len(pairs):
        names = [name for name, _ in pairs]
        repeated_name = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the entry {repeated_name[:40]!r} occurs more than once")
    return table


def refuse_constant(text: str) -> float:
    """Refuse NaN and Infinity, which JSON does not have.

    Raises:
        ValueError: Always.
    """
    raise ValueError(f"{text} is not a finite number")


def finite_value(text: str) -> float:
    """Read a number with a decimal point or an exponent as float64.

    Raises:
        ValueError: The number exceeds the range of float64.
    """
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is too large a number")
    return value


def whole_number(text: str) -> int:
    """Read an integer, which must not exceed the range of float64.

    Raises:
        ValueError: The integer exceeds this range, or has more than ``MOST_DIGITS`` characters.
    """
    if len(text) > MOST_DIGITS or math.isinf(float(text)):
        raise ValueError(f"{text[:12]}... is too large a number")
    return int(text)
