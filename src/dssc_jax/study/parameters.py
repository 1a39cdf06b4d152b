"""Parameters of a study, the named numbers of ``[parameters]``, and expressions of them in place of a number.

A parameter is a number, a law, or an expression of other parameters. If a parameter has a law, an expression of it
stays in the template of the loop, as a law does, and :meth:`dssc_jax.study.Study.params` evaluates it from each draw's
values.
"""

import ast
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, TypeAlias, TypeVar

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.intervals import Interval, range_of
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.expressions import (
    RESERVED,
    Numeric,
    UnknownParameter,
    evaluate_intervals,
    evaluate_numbers,
    is_expression,
    names_of,
    parse_expression,
)
from dssc_jax.study.laws import LAWS, Law, UncertainValue, is_law, is_number, parse_law
from dssc_jax.study.schema import LONGEST_PHRASE, unit_text
from dssc_jax.study.table_errors import value_errors_at
from dssc_jax.study.tables import DESCRIPTION, PARAMETERS

TEXTS = ("name", "description", "units")
"""Entries of a study without numbers and expressions."""
MOST_PARAMETERS = 200
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
FORMS = "a number, a law, an expression, or a table such as { value = 1e-5, unit = 'H', meaning = 'inductance' }"

Content: TypeAlias = float | Law | str
"""A number, a law, or the text of an expression."""


T = TypeVar("T")
Evaluation: TypeAlias = Callable[[ast.expr, Callable[[str], T]], T]
"""(tree of an expression, value of a parameter by name) -> value of the expression."""


class Parameter(NamedTuple):
    """A parameter: its name in expressions, and its content."""

    name: str
    content: Content

    @property
    def dotted_name(self) -> str:
        """Dotted name of the parameter in the study."""
        return f"{PARAMETERS}.{self.name}"


@dataclass(frozen=True, repr=False)
class Expression(UncertainValue):
    """An expression of parameters, with all that is needed to evaluate it.

    Args:
        text: Text in the study file.
        parameters: Parameters that the expression depends on, directly or through others, in an order in which each
            depends on earlier ones only.
    """

    text: str
    parameters: tuple[Parameter, ...]

    def __repr__(self) -> str:
        return repr(self.text)

    def __str__(self) -> str:
        return self.text

    @property
    def names(self) -> tuple[str, ...]:
        """Dotted names of the parameters that the expression depends on."""
        return tuple(parameter.dotted_name for parameter in self.parameters)

    @cached_property
    def laws(self) -> dict[str, Law]:
        """Laws of the parameters that the expression depends on, by dotted name."""
        return {p.dotted_name: p.content for p in self.parameters if isinstance(p.content, Law)}

    def at(self, values: Mapping[str, Numeric]) -> Numeric:
        """Value of the expression for values of its parameters.

        Args:
            values: Numbers, arrays or traced values by dotted name. Every parameter with a law must be among them; one
                without keeps the study's value if it is missing.
        """
        return self._evaluated(values, evaluate_numbers, float)

    def between(self, ends: Mapping[str, Interval]) -> Interval:
        """Interval that contains all values of the expression, for intervals of its parameters by dotted name."""
        return self._evaluated(ends, evaluate_intervals, lambda number: Interval.of(number, number))

    def _evaluated(self, values: Mapping[str, T], evaluate: Evaluation[T], exact: Callable[[float], T]) -> T:
        """Value of the expression in numbers or intervals; ``exact`` makes one of a plain number."""
        operands: dict[str, T] = {}
        for parameter in self.parameters:
            if parameter.dotted_name in values:
                operands[parameter.name] = values[parameter.dotted_name]
            elif isinstance(parameter.content, str):
                operands[parameter.name] = evaluate(parse_expression(parameter.content), operands.__getitem__)
            elif isinstance(parameter.content, float):
                operands[parameter.name] = exact(parameter.content)
        return evaluate(parse_expression(self.text), operands.__getitem__)

    @property
    def median(self) -> float:
        """Value of the expression with every law at its median."""
        return float(self.at({name: law.median for name, law in self.laws.items()}))

    @property
    def nominal(self) -> float:
        """Value of the expression with every law at its nominal value."""
        return float(self.at({name: law.nominal for name, law in self.laws.items()}))

    @property
    def support(self) -> tuple[float, float]:
        """Bounds of all values of the expression, near the least and the greatest value.

        Raises:
            ValueError: The expression may have no finite value.
        """
        return support_of(self)

    def undefined_at(self, point: tuple[float, ...]) -> str:
        """End of a message: the parameters at which the expression has no value; ``point`` has those with laws."""
        values = dict(zip(self.laws, point, strict=True)) if point else {}
        values |= {p.dotted_name: p.content for p in self.parameters if isinstance(p.content, float)}
        if not values:
            return ""
        value_text = ", ".join(f"{name} = {value:.4g}" for name, value in values.items())
        return f" near {value_text}; the laws must exclude that" if point else f" at {value_text}"

    @property
    def leaf(self) -> "float | Expression":
        """Leaf in the template of the loop: the value if no parameter has a law, otherwise the expression."""
        return self if self.laws else self.support[0]


@lru_cache(maxsize=4096)
def support_of(expression: Expression) -> tuple[float, float]:
    """Compute :attr:`Expression.support`; the cache serves all variants of a study."""
    text = repr(expression.text)
    if not expression.laws:
        value = expression.median
        if not math.isfinite(value):
            raise ValueError(f"{text} has no finite value{expression.undefined_at(())}")
        return value, value
    names = list(expression.laws)

    def values(*intervals: Interval) -> Interval:
        return expression.between(dict(zip(names, intervals, strict=True)))

    value_range = range_of(values, [law.support for law in expression.laws.values()])
    has_finite_support = all(math.isfinite(end) for law in expression.laws.values() for end in law.support)
    if value_range.undefined is not None:
        raise ValueError(f"{text} has no finite value{expression.undefined_at(value_range.undefined)}")
    if has_finite_support and not math.isfinite(value_range.low - value_range.high):
        raise ValueError(f"{text} exceeds the largest number within the laws of {', '.join(names)}")
    return value_range.low, value_range.high


@dataclass
class ParameterTable:
    """The parameters of a study, and the parser of its expressions.

    Args:
        contents: Content of each parameter by name, in an order in which each depends on earlier ones only.
        quantities: Unit and meaning of each parameter by name.
        plain: Parameters whose plain value some place of the study needs before tracing, and the first such place.
    """

    contents: dict[str, Content]
    quantities: dict[str, Quantity]
    plain: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, table: TomlTable) -> "ParameterTable":
        """Parse the table ``[parameters]``.

        Raises:
            ConfigError: A name, a number, a law or an expression is not valid, or parameters depend on one another.
        """
        if len(table) > MOST_PARAMETERS:
            raise ConfigError(PARAMETERS, f"holds at most {MOST_PARAMETERS} parameters, got {len(table)}")
        entries = {}
        parameters = cls({}, {})
        for name, value in table.items():
            require_name(name)
            entries[name], parameters.quantities[name] = described_content(name, value)
        for name in dependency_order(entries):
            parameters.contents[name] = parameters.content(name, entries[name])
        return parameters

    def content(self, name: str, value: Any) -> Content:
        """Parse the content of a parameter; the parameters that it depends on must have been parsed.

        Raises:
            ConfigError: The content is not valid.
        """
        place = f"{PARAMETERS}.{name}"
        with value_errors_at(place):
            if is_expression(value):
                return self.expression(value).text
            if isinstance(value, dict):
                return parse_law(self.resolved(value, place))
        if not is_number(value):
            raise ConfigError(place, f"must be {FORMS}; got {value!r}")
        return float(value)

    def expression(self, text: str) -> Expression:
        """Parse an expression, which must have a finite value for all values of its parameters.

        Raises:
            UnknownParameter: The text names something that is no parameter.
            ValueError: The text is no expression, or may have no finite value.
        """
        needed_names: set[str] = set()
        pending_names = list(names_of(parse_expression(text)))
        for name in pending_names:
            if name not in self.contents:
                hint = nearest(name, self.contents) if self.contents else "name numbers in [parameters]"
                raise UnknownParameter(f"{text!r} names '{name}', which is no parameter; {hint}")
        while pending_names:
            name = pending_names.pop()
            content = self.contents[name]
            if name not in needed_names and isinstance(content, str):
                pending_names += names_of(parse_expression(content))
            needed_names.add(name)
        parameters = tuple(Parameter(name, content) for name, content in self.contents.items() if name in needed_names)
        expression = Expression(text, parameters)
        _ = expression.support  # raises where it has no finite value
        return expression

    def constant(self, text: str, place: str) -> float:
        """Value of an expression that is needed before tracing.

        Args:
            text: Text of the expression.
            place: Place of the study that needs the value.

        Raises:
            ValueError: The expression is not valid, or depends on a law.
        """
        expression = self.expression(text)
        require_plain(expression)
        self.note_plain(expression, place)
        value = expression.support[0]
        return int(value) if value.is_integer() and abs(value) < 2.0**53 else value

    def note_plain(self, expression: Expression, place: str) -> None:
        """Record in :attr:`plain` that a place needs the value of an expression before tracing."""
        for parameter in expression.parameters:
            self.plain.setdefault(parameter.name, place)

    def resolved(self, value: object, place: str) -> Any:
        """Part of a study's table in which the text of each expression has become an :class:`Expression`.

        Raises:
            ConfigError: An expression is not valid.
        """
        return self.substitute(value, place, self.expression)

    def constants(self, value: object, place: str) -> Any:
        """Part of a study's table in which each expression has become a plain number.

        Raises:
            ConfigError: An expression is not valid, or depends on a law.
        """
        return self.substitute(value, place, lambda text: self.constant(text, place))

    def substitute(self, value: object, place: str, value_of: Callable[[str], object]) -> Any:
        """Replace each expression in a part of a study's table; arguments of laws always become plain numbers.

        Args:
            value: Part of the table.
            place: Dotted name of the part, for messages.
            value_of: Replacement for the text of an expression.

        Raises:
            ConfigError: An expression is not valid.
        """
        if is_law(value):
            return {kind: self.constants(arguments, place) for kind, arguments in value.items()}
        if isinstance(value, dict):
            return {key: self.substitute(item, f"{place}.{key}", value_of) for key, item in value.items()}
        if isinstance(value, list | tuple):
            if not any(isinstance(item, str | dict | list | tuple) for item in value):
                return value
            return [self.substitute(item, f"{place}.{index}", value_of) for index, item in enumerate(value)]
        if not is_expression(value):
            return value
        with value_errors_at(place):
            return value_of(value)


def require_plain(expression: Expression) -> None:
    """Require that no parameter of an expression has a law.

    Raises:
        ValueError: A parameter has one.
    """
    if expression.laws:
        name = next(iter(expression.laws))
        raise ValueError(f"must be known before tracing, and {expression.text!r} depends on the law of {name}")


def require_name(name: str) -> None:
    """Require that the name of a parameter can be used in expressions.

    Raises:
        ConfigError: It cannot.
    """
    place = f"{PARAMETERS}.{name}"
    if not NAME.fullmatch(name):
        raise ConfigError(place, "a parameter's name consists of letters, digits and _, and begins with no digit")
    if name in RESERVED:
        raise ConfigError(place, f"'{name}' has a meaning in expressions; take another name, such as '{name}_0'")
    try:
        parse_expression(name)
    except ValueError:
        raise ConfigError(place, f"'{name}' is a word of Python; take another name, such as '{name}_0'") from None


def described_content(name: str, value: object) -> tuple[object, Quantity]:
    """Split a parameter in a study file into its content, which is not yet parsed, and its unit and meaning.

    Raises:
        ConfigError: The value is a table with invalid entries.
    """
    place = f"{PARAMETERS}.{name}"
    if not isinstance(value, dict):
        return value, Quantity("SI", f"parameter {name}")
    content = {key: item for key, item in value.items() if key not in DESCRIPTION}
    if "value" in content or not is_law(content):
        unknown = [key for key in content if key != "value" and key not in LAWS]
        if unknown:
            valid = nearest(unknown[0], ["value", *DESCRIPTION, *LAWS])
            raise ConfigError(f"{place}.{unknown[0]}", f"is no entry of a parameter; {valid}")
        if list(content) != ["value"]:
            raise ConfigError(place, f"must be {FORMS}; got {value!r}")
    with value_errors_at(f"{place}.unit"):
        unit = unit_text(value.get("unit", "SI"))
    meaning = value.get("meaning", f"parameter {name}")
    if not isinstance(meaning, str) or not meaning.isprintable() or not 0 < len(meaning) <= LONGEST_PHRASE:
        raise ConfigError(f"{place}.meaning", f"must be a text of 1 to {LONGEST_PHRASE} characters, got {meaning!r}")
    return content.get("value", content), Quantity(unit, meaning)


def dependency_order(entries: Mapping[str, object]) -> list[str]:
    """Names of the parameters in an order in which each depends on earlier ones only.

    Raises:
        ConfigError: An expression is not valid, or parameters depend on one another.
    """
    order: list[str] = []
    for root in entries:
        path: list[str] = [root]
        while path:
            name = path[-1]
            with value_errors_at(f"{PARAMETERS}.{name}"):
                names = [parent for parent in names_within(entries[name]) if parent in entries]
            missing = [parent for parent in names if parent not in order]
            if name in order or not missing:
                path.pop()
                if name not in order:
                    order.append(name)
                continue
            parent = missing[0]
            if parent in path:
                cycle = [*path[path.index(parent) :], parent]
                raise ConfigError(f"{PARAMETERS}.{parent}", f"depends on itself: {' -> '.join(cycle)}")
            path.append(parent)
    return order


def names_within(value: object) -> Iterator[str]:
    """Names of parameters in the expressions of a part of a study's table.

    Raises:
        ValueError: An expression is not valid.
    """
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for item in value:
            yield from names_within(item)
    elif is_expression(value):
        yield from names_of(parse_expression(value))
