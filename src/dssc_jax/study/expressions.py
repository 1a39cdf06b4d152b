"""The language of expressions: parsing of ``=1/(L*C)``, and its value for numbers, arrays, traced values, intervals.

Python's parser reads the text, and an allow-list of its nodes decides what an expression may hold. Nothing is executed.
"""

import ast
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import TypeAlias, TypeGuard, TypeVar

import numpy as np

from dssc_jax.core import intervals
from dssc_jax.core.errors import nearest
from dssc_jax.core.intervals import Interval
from dssc_jax.core.numerics import namespace
from dssc_jax.core.signals import Scalar
from dssc_jax.study.laws import is_number

MARK = "="
"""The first character of a text that is an expression."""
LONGEST_TEXT = 500
DEEPEST_TREE = 60
PI = "pi"
EXCERPT = 40  # characters of a text in a message
LARGEST_PRODUCT = 1024  # whole exponent that is computed by products

Value = TypeVar("Value")

Numeric: TypeAlias = Scalar | np.ndarray
"""A number, an array of NumPy, or a traced value."""


@dataclass(frozen=True)
class Operation:
    """An operation of the language.

    Args:
        ufunc: Its name in NumPy and in JAX.
        interval: Its form for intervals.
        several: Whether it takes two or more arguments, two at a time.
    """

    ufunc: str
    interval: Callable[..., Interval]
    several: bool = False


OPERATORS: dict[type[ast.operator] | type[ast.unaryop], Operation] = {
    ast.Add: Operation("add", intervals.add),
    ast.Sub: Operation("subtract", intervals.subtract),
    ast.Mult: Operation("multiply", intervals.multiply),
    ast.Div: Operation("true_divide", intervals.divide),
    ast.Pow: Operation("power", intervals.power),
    ast.USub: Operation("negative", intervals.negative),
}
FUNCTIONS = {
    "sqrt": Operation("sqrt", intervals.square_root),
    "exp": Operation("exp", intervals.exponential),
    "log": Operation("log", intervals.logarithm),
    "sin": Operation("sin", intervals.sine),
    "cos": Operation("cos", intervals.cosine),
    "abs": Operation("abs", intervals.absolute),
    "min": Operation("minimum", intervals.minimum, several=True),
    "max": Operation("maximum", intervals.maximum, several=True),
}
RESERVED = (PI, *FUNCTIONS)
"""Names that no parameter may have."""
GRAMMAR = f"numbers, parameters, + - * / **, parentheses, pi and {', '.join(FUNCTIONS)}"


def is_expression(value: object) -> TypeGuard[str]:
    """Whether a value of a study's table is an expression."""
    return isinstance(value, str) and value.lstrip().startswith(MARK)


@lru_cache(maxsize=4096)
def parse_expression(text: str) -> ast.expr:
    """The tree of an expression.

    Args:
        text: With its sign of equality.

    Raises:
        ValueError: it is none; the message gives the reason.
    """
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"an expression has at most {LONGEST_TEXT} characters, got {len(text)}")
    body = text.strip().removeprefix(MARK).strip()
    if not body.isascii() or not body.isprintable():
        raise ValueError(f"{text!r} is no expression: it may hold {GRAMMAR}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as 1if 2else 3, which will be a syntax error
            tree = ast.parse(body, mode="eval").body
    except (SyntaxError, SyntaxWarning, DeprecationWarning, MemoryError, RecursionError, ValueError) as error:
        reason = getattr(error, "msg", None) or str(error) or "it is too deeply nested"
        raise ValueError(f"{text!r} is no expression: {reason}") from None
    check(tree, body, 0)
    return tree


def check(node: ast.expr, body: str, depth: int) -> None:
    """Require that a tree holds nothing but the language.

    Raises:
        ValueError: it holds something else.
    """
    if depth > DEEPEST_TREE:
        raise ValueError(f"{excerpt(body)!r} is nested too deeply, at most {DEEPEST_TREE} levels are taken")
    for inner in operands(node, body):
        check(inner, body, depth + 1)


def operands(node: ast.expr, body: str) -> list[ast.expr]:
    """The parts of an admissible node.

    Raises:
        ValueError: the node is not admissible.
    """
    match node:
        case ast.Constant(value=value) if is_number(value):
            return []
        case ast.Name():
            return []
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
            return [operand]
        case ast.BinOp(left=left, op=operator, right=right) if type(operator) in OPERATORS:
            return [left, right]
        case ast.BinOp(op=ast.BitXor()):
            raise ValueError(f"{excerpt(body)!r} holds '^'; a power is written **")
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            check_call(name, len(arguments))
            return arguments
    part = ast.get_source_segment(body, node) or body
    raise ValueError(f"{excerpt(part)!r} is not admissible in an expression, which may hold {GRAMMAR}")


def check_call(name: str, count: int) -> None:
    """Require that a function is known and has as many arguments as it takes.

    Raises:
        ValueError: otherwise.
    """
    if name not in FUNCTIONS:
        raise ValueError(f"'{name}' is no function of expressions; {nearest(name, FUNCTIONS)}")
    variadic = FUNCTIONS[name].several
    if (count < 2) if variadic else (count != 1):
        raise ValueError(f"{name} takes {'two or more arguments' if variadic else 'one argument'}, got {count}")


def excerpt(text: str) -> str:
    """The beginning of a text."""
    return text if len(text) <= EXCERPT else f"{text[:EXCERPT]}..."


def names_of(tree: ast.expr) -> tuple[str, ...]:
    """The parameters in an expression, each once, in its order."""
    return tuple(dict.fromkeys(names_in(tree)))


def names_in(node: ast.expr) -> Iterator[str]:
    """The parameters in a node, as often as they occur."""
    match node:
        case ast.Name(id=name) if name != PI:
            yield name
        case ast.UnaryOp(operand=operand):
            yield from names_in(operand)
        case ast.BinOp(left=left, right=right):
            yield from names_in(left)
            yield from names_in(right)
        case ast.Call(args=arguments):
            for argument in arguments:
                yield from names_in(argument)


def evaluate(
    node: ast.expr, value_of: Callable[[str], Value], number: Callable[[float], Value], apply: "Apply[Value]"
) -> Value:
    """The value of a tree.

    Args:
        node: A tree of :func:`parse_expression`.
        value_of: Value of each parameter.
        number: Value of a constant.
        apply: Value of an operation on values.
    """

    def inner(part: ast.expr) -> Value:
        return evaluate(part, value_of, number, apply)

    match node:
        case ast.Constant(value=constant) if is_number(constant):
            return number(float(constant))
        case ast.Name(id=name):
            return number(np.pi) if name == PI else value_of(name)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return inner(operand)
        case ast.UnaryOp(op=operator, operand=operand):
            return apply(OPERATORS[type(operator)], inner(operand))
        case ast.BinOp(left=left, op=operator, right=right):
            return apply(OPERATORS[type(operator)], inner(left), inner(right))
        case ast.Call(func=ast.Name(id=name), args=[first, *others]):
            operation = FUNCTIONS[name]
            if not operation.several:
                return apply(operation, inner(first))
            return reduce(lambda value, other: apply(operation, value, inner(other)), others, inner(first))
    raise AssertionError(node)  # parse_expression admits no other


Apply = Callable[..., Value]
"""(Operation, value of each operand) -> value."""


def apply_to_numbers(operation: Operation, *values: Numeric) -> Numeric:
    """An operation on numbers, arrays or traced values; plain numbers stay plain, and no value is an error."""
    xp = namespace(*values)
    if operation.ufunc == "power" and xp is not np and is_whole(values[1]):
        return values[0] ** int(values[1])  # products, whose derivative exists at and below 0
    result = getattr(xp, operation.ufunc)(*values)
    return float(result) if isinstance(result, np.generic) else result


def is_whole(exponent: Numeric) -> bool:
    """Whether an exponent is known before tracing, and whole."""
    return is_number(exponent) and abs(exponent) <= LARGEST_PRODUCT and float(exponent).is_integer()


def apply_to_intervals(operation: Operation, *values: Interval) -> Interval:
    """An operation on intervals."""
    return operation.interval(*values)


def evaluate_numbers(tree: ast.expr, value_of: Callable[[str], Numeric]) -> Numeric:
    """The value of an expression for numbers, arrays or traced values; not finite where it has none."""
    with np.errstate(all="ignore"):
        return evaluate(tree, value_of, float, apply_to_numbers)


def evaluate_intervals(tree: ast.expr, value_of: Callable[[str], Interval]) -> Interval:
    """An interval that holds the values of an expression."""
    with np.errstate(all="ignore"):
        return evaluate(tree, value_of, lambda value: Interval.of(value, value), apply_to_intervals)
