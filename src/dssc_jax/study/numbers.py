"""``Number``, the record of one number of the loop, and the parsing of numbers, laws and expressions."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from dssc_jax.core.quantities import Quantity
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.laws import LAWS, Law, UncertainValue, is_number, parse_law
from dssc_jax.study.parameters import Expression, ParameterTable, require_plain
from dssc_jax.study.tables import PARAMETERS

MOST_COMBINATIONS = 10_000
"""Most combinations of values of discrete laws at which an expression is checked to be whole."""


@dataclass(frozen=True)
class Number:
    """Record of one number of the loop, from which sweeps, laws, units and messages are read.

    Args:
        name: Dotted name in the study, such as ``plant.k_p``.
        paths: Dotted paths in the loop's parameters; several if channels share the number.
        quantity: Unit, meaning and admissible interval.
        value: Plain value, law, or expression of uncertain parameters.
        expression: Expression of the study's parameters that gives the number; None if the study states the number
            itself. A number with an expression cannot be swept, drawn or tuned.
    """

    name: str
    paths: tuple[str, ...]
    quantity: Quantity
    value: float | Law | Expression
    expression: Expression | None = None

    @classmethod
    def of(cls, name: str, quantity: Quantity, content: float | Law | Expression, *paths: str) -> "Number":
        """Make the record of a plain value, a law, or an expression; one without parameters is a plain value."""
        if not isinstance(content, Expression):
            return cls(name, paths, quantity, content)
        expression = content if content.parameters else None
        return cls(name, paths, quantity, content.leaf, expression)

    @property
    def sources(self) -> tuple[str, ...]:
        """Dotted names of the parameters in its expression; empty without one."""
        return self.expression.names if self.expression else ()

    @property
    def follows(self) -> str:
        """Rule that refuses to change a number which follows from parameters, for messages."""
        assert self.expression is not None
        names = self.expression.names
        return f"follows from {', '.join(names)} by {self.expression!r}; take {names[0]} instead"

    def under(self, path: str, name: str) -> "Number":
        """The number with ``path`` in front of its paths and ``name`` in front of its name.

        So a number of a part becomes a number of the whole that contains the part.
        """
        paths = tuple(dotted_name(path, path_in_part) for path_in_part in self.paths)
        return replace(self, name=dotted_name(name, self.name), paths=paths)


def dotted_name(*parts: str) -> str:
    """Join parts with dots to a name; empty parts are omitted."""
    return ".".join(part for part in parts if part)


def parse_number(value: object, quantity: Quantity) -> float | Law | Expression:
    """Parse the value of a number: a plain number, the table of a law, or an expression.

    Raises:
        ValueError: It is none of these, not within the interval of the quantity, or not whole where it must be.
    """
    content = number_content(value, quantity)
    low, high = content.support if isinstance(content, UncertainValue) else (content, content)
    violation = quantity.violated_by(low, high)
    if violation:
        value_text = f"{value!r}" if is_number(value) else f"{content}, whose support is [{low:g}, {high:g}]"
        raise ValueError(f"{quantity.meaning} [{quantity.unit}] {violation}, got {value_text}")
    if quantity.whole and not is_whole(content):
        remedy = "" if isinstance(content, float) else "; its law is a choice of them, such as { choice = [1, 2, 3] }"
        raise ValueError(f"{quantity.meaning} [{quantity.unit}] must be a whole number, got {content}{remedy}")
    return content


def number_content(value: object, quantity: Quantity) -> float | Law | Expression:
    """A plain number, law or expression from a value of a study's table, whatever its interval.

    Raises:
        ValueError: The value is none of these, or the quantity admits no law or no expression.
    """
    if isinstance(value, Expression):
        if quantity.data:
            raise ValueError(f"must be a plain number in a record, got {value!r}")
        if not quantity.law:
            require_plain(value)
        return value
    if isinstance(value, dict):
        if not quantity.law:
            raise ValueError(f"must be a plain number here, got the law {value}")
        return parse_law(value)
    if not is_number(value):
        law = " or a law" if quantity.law else ""
        raise ValueError(f"must be a finite number ({quantity.meaning} [{quantity.unit}]){law}, got {value!r}")
    return float(value)


def is_whole(content: float | Law | Expression) -> bool:
    """Whether all values of a number, a law or an expression are whole numbers.

    The values of a continuous law are not. An expression is checked at every combination of the values of its laws, and
    does not count as whole if there are more than :data:`MOST_COMBINATIONS`.
    """
    if isinstance(content, Law):
        return LAWS[content.kind].discrete and all(value.is_integer() for value in content.arguments)
    if not isinstance(content, Expression):
        return float(content).is_integer()
    laws = content.laws
    if not all(LAWS[law.kind].discrete for law in laws.values()):
        return False
    if math.prod(len(law.arguments) for law in laws.values()) > MOST_COMBINATIONS:
        return False
    for values in product(*(law.arguments for law in laws.values())):
        if not float(content.at(dict(zip(laws, values, strict=True)))).is_integer():
            return False
    return True


def parse_numbers(value: object, quantity: Quantity, depth: int) -> Any:
    """Parse a number (depth 0), a list of numbers (1) or a list of rows (2), of which each may be a law.

    Returns:
        A parsed number, or tuples of them.

    Raises:
        ValueError: The value is no such list, or as in :func:`parse_number`.
    """
    if depth == 0:
        return parse_number(value, quantity)
    if not isinstance(value, list | tuple):
        item_text = "rows of numbers" if depth > 1 else "numbers"
        raise ValueError(f"must be a list of {item_text} ({quantity.meaning} [{quantity.unit}]), got {value!r}")
    return tuple(parse_numbers(item, quantity, depth - 1) for item in value)


def numbers_by_name(name: str, value: object) -> TomlTable:
    """The numbers in nested tuples by dotted name, such as ``a.1.0``; a single number has the name itself."""
    if not isinstance(value, tuple):
        return {name: value}
    numbers: TomlTable = {}
    for index, part in enumerate(value):
        numbers |= numbers_by_name(f"{name}.{index}", part)
    return numbers


def leaves_of(value: Any) -> Any:
    """Leaves of the loop's template for a parsed field: an expression without laws becomes its value."""
    if isinstance(value, tuple):
        return tuple(map(leaves_of, value))
    return value.leaf if isinstance(value, Expression) else value


def merge_numbers(numbers: Iterable[Number]) -> dict[str, Number]:
    """Merge numbers of the same name, which channels share: all their paths, and the unit of the first channel."""
    merged_numbers: dict[str, Number] = {}
    for number in numbers:
        first = merged_numbers.get(number.name)
        merged_numbers[number.name] = replace(first, paths=first.paths + number.paths) if first else number
    return merged_numbers


def parameter_numbers(parameters: ParameterTable, parts: Iterable[Number]) -> list[Number]:
    """Record of each parameter of the study; one that is needed before tracing can be neither drawn nor swept.

    Args:
        parameters: Parameters of the study.
        parts: Numbers of the loop, some of which follow from parameters.
    """
    for number in parts:
        if number.expression and not number.quantity.law:
            parameters.note_plain(number.expression, number.name)
    numbers = []
    for name, content in parameters.contents.items():
        quantity = replace(parameters.quantities[name], law=name not in parameters.plain)
        value = parameters.expression(content) if isinstance(content, str) else content
        numbers.append(Number.of(f"{PARAMETERS}.{name}", quantity, value))
    return numbers
