"""``Expression``: an expression of parameters in place of a number, with all that is needed to evaluate it.

An expression that depends on a law stays in the template of the loop, as a law does. For each draw,
:meth:`dssc_jax.study.Study.params` evaluates the expression from the draw's values.
"""

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple, TypeAlias, TypeVar

from dssc_jax.core.intervals import Interval, range_of
from dssc_jax.study.expressions import Numeric, evaluate_intervals, evaluate_numbers, parse_expression
from dssc_jax.study.laws import Law, UncertainValue
from dssc_jax.study.tables import PARAMETERS

Content: TypeAlias = float | Law | str
"""A number, a law, or the text of an expression."""


T = TypeVar("T")
Evaluation: TypeAlias = Callable[[ast.expr, Callable[[str], T]], T]
"""(tree of an expression, (name of a parameter) -> value of the parameter) -> value of the expression."""


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
        """Text of the expression in quotes."""
        return repr(self.text)

    def __str__(self) -> str:
        """Text of the expression."""
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
            values: Numbers, arrays or traced values of parameters by dotted name. Every parameter with a law must be
                among them. A missing parameter without a law has its value in the study.
        """
        return self._evaluated(values, evaluate_numbers, float)

    def between(self, ends: Mapping[str, Interval]) -> Interval:
        """Interval that contains all values of the expression; ``ends`` has intervals of parameters by dotted name."""
        return self._evaluated(ends, evaluate_intervals, lambda number: Interval.of(number, number))

    def _evaluated(self, values: Mapping[str, T], evaluate: Evaluation[T], exact: Callable[[float], T]) -> T:
        """Evaluate the expression in one arithmetic, that of numbers or that of intervals.

        Args:
            values: Values of parameters in this arithmetic, by dotted name.
            evaluate: Evaluates a tree in this arithmetic.
            exact: (plain number) -> the same number in this arithmetic.
        """
        operands: dict[str, T] = {}  # by the name in expressions
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
        """Lower and upper bound of all values of the expression, close to its least and its greatest value.

        Raises:
            ValueError: The expression may have no finite value.
        """
        return support_of(self)

    def undefined_at(self, point: tuple[float, ...]) -> str:
        """End of a message that names parameter values at which the expression has no finite value.

        Args:
            point: Value of each parameter with a law; empty for an expression without laws.
        """
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
    """Lower and upper bound of all values of an expression, close to its least and its greatest value.

    The cache serves all variants of a study with the same expression.

    Raises:
        ValueError: The expression may have no finite value.
    """
    text = repr(expression.text)
    if not expression.laws:
        value = expression.median
        if not math.isfinite(value):
            raise ValueError(f"{text} has no finite value{expression.undefined_at(point=())}")
        return value, value
    names = list(expression.laws)

    def values(*intervals: Interval) -> Interval:
        """Interval of the expression's values while each parameter with a law lies in its interval."""
        return expression.between(dict(zip(names, intervals, strict=True)))

    value_range = range_of(values, [law.support for law in expression.laws.values()])
    has_finite_support = all(math.isfinite(end) for law in expression.laws.values() for end in law.support)
    if value_range.undefined is not None:
        raise ValueError(f"{text} has no finite value{expression.undefined_at(value_range.undefined)}")
    if has_finite_support and not math.isfinite(value_range.low - value_range.high):
        raise ValueError(f"{text} exceeds the largest number within the laws of {', '.join(names)}")
    return value_range.low, value_range.high
