"""A certificate's text as JSON's types: no entry twice, and no number that float64 does not hold."""

import json
import math
from typing import TypeAlias

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"

MOST_DIGITS = 400
"""Longest integer that is read; the largest number of float64 has 309 digits."""


def certificate_content(text: str) -> Json:
    """The content of a text.

    Raises:
        ValueError: It is no JSON, or holds something that a certificate does not: a repeated entry, NaN, an infinite
            number or one that is too large, or lists within lists beyond any use.
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
    """A table of entries, each of which occurs once.

    Raises:
        ValueError: One occurs twice.
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
        ValueError: always.
    """
    raise ValueError(f"{text} is not a finite number")


def finite_value(text: str) -> float:
    """A number of float64.

    Raises:
        ValueError: It is too large.
    """
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is too large a number")
    return value


def whole_number(text: str) -> int:
    """An integer that float64 can hold.

    Raises:
        ValueError: It is too large.
    """
    if len(text) > MOST_DIGITS or math.isinf(float(text)):
        raise ValueError(f"{text[:12]}... is too large a number")
    return int(text)
