"""``Number``, the record of one number of the loop, and the parsing of numbers, laws and expressions."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from dssc_jax.core.quantities import Quantity
from dssc_jax.study.laws import LAWS, Law, UncertainValue, is_number, parse_law
from dssc_jax.study.parameters import Expression, ParameterTable, require_plain
from dssc_jax.study.tables import PARAMETERS

MOST_COMBINATIONS = 10_000
"""Largest number of combinations of discrete laws' values at which an expression is checked to be whole."""


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
        """Make the record of a plain value, a law, or an expression.

        An expression without parameters, such as ``=2*pi``, is a plain value.
        """
        if not isinstance(content, Expression):
            return cls(name, paths, quantity, content)
        expression = content if content.parameters else None
        return cls(name, paths, quantity, content.leaf, expression)

    @property
    def sources(self) -> tuple[str, ...]:
        """Dotted names of the parameters from which the number follows; empty if it has no expression."""
        return self.expression.names if self.expression else ()

    @property
    def follows(self) -> str:
        """Text of a message that refuses to change this number, because it follows from parameters."""
        assert self.expression is not None
        names = self.expression.names
        return f"follows from {', '.join(names)} by {self.expression!r}; take {names[0]} instead"

    def under(self, path: str, name: str) -> "Number":
        """Make the number of a part a number of the whole that contains the part.

        Args:
            path: Path of the part in the whole, which precedes each of the number's paths.
            name: Dotted name of the part in the study, which precedes the number's name.
        """
        paths = tuple(dotted_name(path, path_in_part) for path_in_part in self.paths)
        return replace(self, name=dotted_name(name, self.name), paths=paths)


def dotted_name(*parts: str) -> str:
    """Join parts with dots to a name; empty parts are omitted."""
    return ".".join(part for part in parts if part)


def parse_number(value: object, quantity: Quantity) -> float | Law | Expression:
    """Parse the value of a number in a study: a plain number, the table of a law, or an expression.

    All values that the number may take must be admissible.

    Args:
        value: Value in the study's table.
        quantity: Unit, meaning and admissible interval of the number.

    Raises:
        ValueError: The value is none of these, may lie outside of the quantity's interval, or may not be whole although
            it must be.
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
    """Parse a plain number, a law or an expression, without a check of the admissible interval.

    Args:
        value: Value in the study's table; the text of an expression has already become an :class:`Expression`.
        quantity: Unit and meaning of the number, and which of the three forms it admits.

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

    The result is False for a continuous law. An expression is evaluated at every combination of the values of its
    discrete laws. With more than :data:`MOST_COMBINATIONS` combinations, it does not count as whole.
    """
    if isinstance(content, Law):
        return LAWS[content.kind].discrete and all(value.is_integer() for value in content.arguments)
    if not isinstance(content, Expression):
        return float(content).is_integer()
    laws = content.laws
    if not all(LAWS[law.kind].discrete for law in laws.values()):
        return False
    values_of_laws = [law.arguments for law in laws.values()]  # all values of a discrete law are among its arguments
    if math.prod(map(len, values_of_laws)) > MOST_COMBINATIONS:
        return False
    for combination in product(*values_of_laws):
        value = content.at(dict(zip(laws, combination, strict=True)))
        if not float(value).is_integer():
            return False
    return True


def parse_numbers(value: object, quantity: Quantity, depth: int) -> Any:
    """Parse a number or nested lists of numbers, each of which may be a law or an expression.

    Args:
        value: Value in the study's table.
        quantity: Unit, meaning and admissible interval of each number.
        depth: Number of lists around a number: 0 for a number alone, 1 for a list of numbers, 2 for a list of rows.

    Returns:
        A parsed number, or nested tuples of parsed numbers.

    Raises:
        ValueError: The value is not a list of this depth, or as in :func:`parse_number`.
    """
    if depth == 0:
        return parse_number(value, quantity)
    if not isinstance(value, list | tuple):
        item_text = "rows of numbers" if depth > 1 else "numbers"
        raise ValueError(f"must be a list of {item_text} ({quantity.meaning} [{quantity.unit}]), got {value!r}")
    return tuple(parse_numbers(item, quantity.element(index), depth - 1) for index, item in enumerate(value))


def numbers_of_field(name: str, quantity: Quantity, value: Any) -> tuple[Number, ...]:
    """Records of the numbers in a field, with names such as ``a.1.0``; a single number has the name of the field.

    Args:
        name: Name of the field.
        quantity: Unit, meaning and admissible interval of each number.
        value: A parsed number, or nested tuples of parsed numbers.
    """
    if not isinstance(value, tuple):
        return (Number.of(name, quantity, value, name),)
    numbers: list[Number] = []
    for index, part in enumerate(value):
        numbers += numbers_of_field(f"{name}.{index}", quantity.element(index), part)
    return tuple(numbers)


def leaves_of(value: Any) -> Any:
    """Content of a parsed field as it stands in the loop's template.

    An expression without laws becomes its value, also within nested tuples. Everything else stays.
    """
    if isinstance(value, tuple):
        return tuple(map(leaves_of, value))
    return value.leaf if isinstance(value, Expression) else value


def merge_numbers(numbers: Iterable[Number]) -> dict[str, Number]:
    """Collect the records of numbers by name, and merge the records of a number that channels share.

    The merged record has the paths in all these channels, and the unit in the first one.
    """
    merged_numbers: dict[str, Number] = {}
    for number in numbers:
        first = merged_numbers.get(number.name)
        if first is None:
            merged_numbers[number.name] = number
        else:
            merged_numbers[number.name] = replace(first, paths=first.paths + number.paths)
    return merged_numbers


def parameter_numbers(parameters: ParameterTable, parts: Iterable[Number]) -> list[Number]:
    """Make a record of each parameter, so that parameters can be drawn and swept as numbers of the loop can.

    A parameter whose value is needed before tracing can be neither drawn nor swept.

    Args:
        parameters: Parameters of the study.
        parts: Numbers of the loop, some of which follow from parameters.
    """
    for number in parts:
        needs_plain_value = not number.quantity.law
        if number.expression and needs_plain_value:
            parameters.note_plain(number.expression, number.name)
    numbers = []
    for name, content in parameters.contents.items():
        quantity = replace(parameters.quantities[name], law=name not in parameters.plain)
        value = parameters.expression(content) if isinstance(content, str) else content
        numbers.append(Number.of(f"{PARAMETERS}.{name}", quantity, value))
    return numbers
