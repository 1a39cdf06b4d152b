"""Parameters of a study: the named numbers of ``[parameters]``, and the parser of expressions of them.

A parameter is a number, a law, or an expression of other parameters.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.expressions import RESERVED, UnknownParameter, is_expression, names_of, parse_expression
from dssc_jax.study.laws import LAWS, is_law, is_number, parse_law
from dssc_jax.study.parameter_expressions import Content, Expression, Parameter
from dssc_jax.study.parsed_values import parse_unit_text
from dssc_jax.study.schema import LONGEST_PHRASE
from dssc_jax.study.table_errors import value_errors_at
from dssc_jax.study.tables import DESCRIPTION, PARAMETERS

TEXTS = ("name", "description", "units")
"""Entries of a study that contain only texts, and so neither numbers nor expressions."""
MOST_PARAMETERS = 200
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
LARGEST_EXACT = 2.0**53
"""Below this magnitude, float64 represents every whole number exactly."""
FORMS = "a number, a law, an expression, or a table such as { value = 1e-5, unit = 'H', meaning = 'inductance' }"


@dataclass
class ParameterTable:
    """The parameters of a study, and the parser of its expressions.

    Args:
        contents: Content of each parameter by name, in an order in which each depends on earlier ones only.
        quantities: Unit and meaning of each parameter by name.
        plain: Parameters whose plain value is needed before tracing, each with the first place that needs it.
    """

    contents: dict[str, Content]
    quantities: dict[str, Quantity]
    plain: dict[str, str] = field(default_factory=dict)

    @classmethod
    def from_toml(cls, table: TomlTable) -> "ParameterTable":
        """Parse the table ``[parameters]``, each parameter after those on which its expression depends.

        Raises:
            ConfigError: A name, a number, a law or an expression is not valid, or parameters depend on one another.
        """
        if len(table) > MOST_PARAMETERS:
            raise ConfigError(PARAMETERS, f"holds at most {MOST_PARAMETERS} parameters, got {len(table)}")
        unparsed_contents = {}
        parameters = cls(contents={}, quantities={})
        for name, value in table.items():
            require_name(name)
            content, quantity = described_content(name, value)
            unparsed_contents[name] = content
            parameters.quantities[name] = quantity
        for name in dependency_order(unparsed_contents):
            parameters.contents[name] = parameters.parsed_content(name, unparsed_contents[name])
        return parameters

    def parsed_content(self, name: str, value: Any) -> Content:
        """Parse the content of a parameter; the parameters on which it depends must have been parsed before.

        Args:
            name: Name of the parameter.
            value: Value of the parameter in the study's table.

        Returns:
            A number, a law, or the text of an expression.

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
        """Parse an expression, and require that it is finite for all values of its parameters.

        Raises:
            UnknownParameter: The text names something that is no parameter.
            ValueError: The text is no expression, or may have no finite value.
        """
        for name in names_of(parse_expression(text)):
            if name not in self.contents:
                hint = nearest(name, self.contents) if self.contents else "name numbers in [parameters]"
                raise UnknownParameter(f"{text!r} names '{name}', which is no parameter; {hint}")
        needed_names = self.needed_names(text)
        parameters = tuple(Parameter(name, content) for name, content in self.contents.items() if name in needed_names)
        expression = Expression(text, parameters)
        _ = expression.support  # raises where it has no finite value
        return expression

    def needed_names(self, text: str) -> set[str]:
        """Collect the parameters that an expression needs, directly or through expressions of other parameters."""
        needed: set[str] = set()
        pending_names = list(names_of(parse_expression(text)))
        while pending_names:
            name = pending_names.pop()
            if name in needed:
                continue
            needed.add(name)
            content = self.contents[name]
            if isinstance(content, str):
                pending_names += names_of(parse_expression(content))
        return needed

    def constant(self, text: str, place: str) -> float:
        """Compute an expression whose value is needed before tracing; a whole number, such as a count, becomes an int.

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
        return int(value) if value.is_integer() and abs(value) < LARGEST_EXACT else value

    def note_plain(self, expression: Expression, place: str) -> None:
        """Record in :attr:`plain` that a place needs the parameters of an expression before tracing.

        The first place that needs a parameter stays recorded.
        """
        for parameter in expression.parameters:
            self.plain.setdefault(parameter.name, place)

    def resolved(self, value: object, place: str) -> Any:
        """Replace the text of each expression in a part of a study's table by an :class:`Expression`.

        Raises:
            ConfigError: An expression is not valid.
        """
        return self.substitute(value, place, self.expression)

    def constants(self, value: object, place: str) -> Any:
        """Replace each expression in a part of a study's table by a plain number.

        Raises:
            ConfigError: An expression is not valid, or depends on a law.
        """
        return self.substitute(value, place, lambda text: self.constant(text, place))

    def substitute(self, value: object, place: str, value_of: Callable[[str], object]) -> Any:
        """Replace each expression in a part of a study's table; in arguments of laws, always by plain numbers.

        Args:
            value: Part of the table.
            place: Dotted name of the part, for messages.
            value_of: (text of an expression) -> value that replaces it outside of laws.

        Raises:
            ConfigError: An expression is not valid.
        """
        if is_law(value):
            return {kind: self.constants(arguments, place) for kind, arguments in value.items()}
        if isinstance(value, dict):
            return {key: self.substitute(item, f"{place}.{key}", value_of) for key, item in value.items()}
        if isinstance(value, list | tuple):
            if not any(isinstance(item, str | dict | list | tuple) for item in value):
                return value  # numbers alone, such as a long record
            return [self.substitute(item, f"{place}.{index}", value_of) for index, item in enumerate(value)]
        if not is_expression(value):
            return value
        with value_errors_at(place):
            return value_of(value)


def require_plain(expression: Expression) -> None:
    """Require that no parameter of an expression has a law, so that the expression's value is known before tracing.

    Raises:
        ValueError: A parameter has a law.
    """
    if expression.laws:
        name = next(iter(expression.laws))
        raise ValueError(f"must be known before tracing, and {expression.text!r} depends on the law of {name}")


def require_name(name: str) -> None:
    """Require that the name of a parameter can stand in an expression.

    Raises:
        ConfigError: The name is malformed, or is a word of the expression language or of Python.
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

    Args:
        name: Name of the parameter.
        value: Value of the parameter in the study's table: a content alone, a law with unit and meaning, or
            ``{ value = ..., unit = ..., meaning = ... }``.

    Raises:
        ConfigError: The value is a table with invalid entries.
    """
    place = f"{PARAMETERS}.{name}"
    if not isinstance(value, dict):
        return value, Quantity("SI", f"parameter {name}")
    content = {key: item for key, item in value.items() if key not in DESCRIPTION}
    has_law = is_law(content)
    if not has_law:
        for key in content:
            if key != "value" and key not in LAWS:
                valid = nearest(key, ["value", *DESCRIPTION, *LAWS])
                raise ConfigError(f"{place}.{key}", f"is no entry of a parameter; {valid}")
        if list(content) != ["value"]:
            raise ConfigError(place, f"must be {FORMS}; got {value!r}")
    with value_errors_at(f"{place}.unit"):
        unit = parse_unit_text(value.get("unit", "SI"))
    meaning = value.get("meaning", f"parameter {name}")
    if not isinstance(meaning, str) or not meaning.isprintable() or not 0 < len(meaning) <= LONGEST_PHRASE:
        raise ConfigError(f"{place}.meaning", f"must be a text of 1 to {LONGEST_PHRASE} characters, got {meaning!r}")
    return content if has_law else content["value"], Quantity(unit, meaning)


def dependency_order(unparsed_contents: Mapping[str, object]) -> list[str]:
    """Sort the names of the parameters so that each depends on earlier ones only.

    Args:
        unparsed_contents: Content of each parameter by name.

    Raises:
        ConfigError: An expression is not valid, or parameters depend on one another.
    """
    order: list[str] = []
    for root in unparsed_contents:
        path = [root]  # from the root to one of the parameters on which it depends
        while path:
            name = path[-1]
            if name in order:
                path.pop()
                continue
            with value_errors_at(f"{PARAMETERS}.{name}"):
                parents = [parent for parent in names_within(unparsed_contents[name]) if parent in unparsed_contents]
            missing_parents = [parent for parent in parents if parent not in order]
            if not missing_parents:
                order.append(path.pop())
                continue
            parent = missing_parents[0]
            if parent in path:
                cycle = [*path[path.index(parent) :], parent]
                raise ConfigError(f"{PARAMETERS}.{parent}", f"depends on itself: {' -> '.join(cycle)}")
            path.append(parent)
    return order


def names_within(value: object) -> Iterator[str]:
    """Yield the name of a parameter for each occurrence in the expressions of a part of a study's table.

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
