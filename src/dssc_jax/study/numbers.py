"""``Number``, the record of a number of the loop, and the parsing of numbers, laws and expressions."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from dssc_jax.core.quantities import Quantity
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.laws import LAWS, Law, is_number, parse_law
from dssc_jax.study.parameters import Expression, ParameterTable, require_plain
from dssc_jax.study.tables import PARAMETERS

MOST_COMBINATIONS = 10_000
"""Largest number of combinations of the laws' values for which an expression is checked."""


@dataclass(frozen=True)
class Number:
    """A number of the loop, the source for sweeps, laws, units and messages.

    Args:
        name: Its dotted name in the study; if a slot was given as a bare number, the name of the slot.
        paths: Its dotted paths in the parameters; several if channels share it.
        quantity: Unit, meaning and admissible interval.
        value: The number, the law that replaces it, or an expression of uncertain parameters.
        expression: What the number follows from, if it is computed from parameters; it then has no value of its own
            that could be swept, drawn or tuned.
    """

    name: str
    paths: tuple[str, ...]
    quantity: Quantity
    value: float | Law | Expression
    expression: Expression | None = None

    @classmethod
    def of(cls, name: str, quantity: Quantity, content: float | Law | Expression, *paths: str) -> "Number":
        """The record of a number, a law, or an expression."""
        if isinstance(content, Expression):
            return cls(name, paths, quantity, content.leaf, content if content.parameters else None)
        return cls(name, paths, quantity, content)

    @property
    def sources(self) -> tuple[str, ...]:
        """Dotted names of the parameters that it follows from."""
        return self.expression.names if self.expression else ()

    @property
    def follows(self) -> str:
        """The end of a message that refuses to move a number which is computed from parameters."""
        assert self.expression is not None
        names = self.expression.names
        return f"follows from {', '.join(names)} by {self.expression!r}; take {names[0]} instead"

    def under(self, path: str, name: str) -> "Number":
        """The number of a part as a number of the whole, which contains the part at ``path`` under ``name``."""
        paths = tuple(dotted_name(path, path_in_part) for path_in_part in self.paths)
        return replace(self, name=dotted_name(name, self.name), paths=paths)


def dotted_name(*parts: str) -> str:
    """Join the parts of a dotted name; empty parts are omitted."""
    return ".".join(part for part in parts if part)


def parse_number(value: object, quantity: Quantity) -> float | Law | Expression:
    """Parse a number, a law or an expression within the quantity's interval.

    Raises:
        ValueError: the rule that is broken, and the value found.
    """
    content: float | Law | Expression
    if isinstance(value, Expression):
        if quantity.data:
            raise ValueError(f"must be a plain number in a record, got {value!r}")
        if not quantity.law:
            require_plain(value)
        content = value
        low, high = value.support
    elif isinstance(value, Law):
        content = value
        low, high = value.support
    elif isinstance(value, dict):
        if not quantity.law:
            raise ValueError(f"must be a plain number here, got the law {value}")
        content = parse_law(value)
        low, high = content.support
    elif is_number(value):
        content = float(value)
        low = high = content
    else:
        law = " or a law" if quantity.law else ""
        raise ValueError(f"must be a finite number ({quantity.meaning} [{quantity.unit}]){law}, got {value!r}")
    violation = quantity.violated_by(low, high)
    if violation:
        value_text = f"{value!r}" if is_number(value) else f"{content}, whose support is [{low:g}, {high:g}]"
        raise ValueError(f"{quantity.meaning} [{quantity.unit}] {violation}, got {value_text}")
    if quantity.whole and not is_whole(content):
        remedy = "" if isinstance(content, float) else "; its law is a choice of them, such as { choice = [1, 2, 3] }"
        raise ValueError(f"{quantity.meaning} [{quantity.unit}] must be a whole number, got {content}{remedy}")
    return content


def is_whole(content: float | Law | Expression) -> bool:
    """Whether all values of a number, a law or an expression are whole numbers.

    Those of a continuous law are not, and those of an expression with too many combinations do not count as whole.
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
    combinations = product(*(law.arguments for law in laws.values()))
    return all(float(content.at(dict(zip(laws, values, strict=True)))).is_integer() for values in combinations)


def parse_numbers(value: object, quantity: Quantity, depth: int = 1) -> Any:
    """Parse a list of numbers or laws; with depth 2, a list of rows of them."""
    if depth == 0:
        return parse_number(value, quantity)
    if not isinstance(value, list | tuple):
        item_text = "rows of numbers" if depth > 1 else "numbers"
        raise ValueError(f"must be a list of {item_text} ({quantity.meaning} [{quantity.unit}]), got {value!r}")
    return tuple(parse_numbers(item, quantity, depth - 1) for item in value)


def numbers_by_name(name: str, value: object) -> TomlTable:
    """The numbers of a list, or of rows, by dotted name; a number alone has the name itself."""
    if not isinstance(value, tuple):
        return {name: value}
    return {key: item for i, part in enumerate(value) for key, item in numbers_by_name(f"{name}.{i}", part).items()}


def leaves_of(value: Any) -> Any:
    """What the loop's template holds of a field: numbers, laws, and expressions of uncertain parameters."""
    if isinstance(value, tuple):
        return tuple(map(leaves_of, value))
    return value.leaf if isinstance(value, Expression) else value


def parameter_numbers(parameters: ParameterTable, parts: Iterable[Number]) -> list[Number]:
    """The record of each parameter; one that a part needs before tracing can be neither drawn nor swept.

    Args:
        parameters: The parameters.
        parts: The numbers of the loop.
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
