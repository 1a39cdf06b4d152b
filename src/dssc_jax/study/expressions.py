"""The language of expressions such as ``=1/(L*C)``: parsing, and evaluation in numbers, arrays or intervals.

Python's parser reads the text. The language admits only certain kinds of nodes, and the text is never executed.
"""

import ast
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
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
LARGEST_PRODUCT = 1024  # largest whole exponent that is computed by products

Value = TypeVar("Value")

Numeric: TypeAlias = Scalar | np.ndarray
"""A number, an array of NumPy, or a traced value."""


class UnknownParameter(ValueError):
    """An expression names something that is no parameter of the study."""


@dataclass(frozen=True)
class Operation:
    """An operation of the language, for numbers and for intervals.

    Args:
        ufunc: Name of the operation's function in NumPy and JAX.
        interval: The operation for intervals.
        is_variadic: Whether the operation takes two or more arguments, which are combined two at a time.
    """

    ufunc: str
    interval: Callable[..., Interval]
    is_variadic: bool = False


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
    "min": Operation("minimum", intervals.minimum, is_variadic=True),
    "max": Operation("maximum", intervals.maximum, is_variadic=True),
}
RESERVED = (PI, *FUNCTIONS)
"""Words of the language, which no parameter may have as its name."""
GRAMMAR = f"numbers, parameters, + - * / **, parentheses, pi and {', '.join(FUNCTIONS)}"


def is_expression(value: object) -> TypeGuard[str]:
    """Whether a value of a study's table is an expression: a text that begins with :data:`MARK`."""
    return isinstance(value, str) and value.lstrip().startswith(MARK)


@lru_cache(maxsize=4096)
def parse_expression(text: str) -> ast.expr:
    """Parse an expression into the tree of Python's parser.

    Args:
        text: Text of the expression, with or without its leading ``=``.

    Raises:
        ValueError: The text is no expression; the message gives the reason.
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
    require_language(tree, body, depth=0)
    return tree


def require_language(node: ast.expr, body: str, depth: int) -> None:
    """Require that a tree, or a part of it, contains only nodes of the language.

    Args:
        node: Root of the tree or of the part.
        body: Text of the whole expression, for messages.
        depth: Depth of the node in the whole tree; 0 for the root of the tree.

    Raises:
        ValueError: A node is not admissible, or lies too deep.
    """
    if depth > DEEPEST_TREE:
        raise ValueError(f"{excerpt(body)!r} is nested too deeply, at most {DEEPEST_TREE} levels are taken")
    for operand in operands(node, body):
        require_language(operand, body, depth + 1)


def operands(node: ast.expr, body: str) -> list[ast.expr]:
    """Operands of a node that the language admits; empty for a number or a name.

    Args:
        node: The node.
        body: Text of the whole expression, for messages.

    Raises:
        ValueError: The node is not admissible.
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
            require_call(name, len(arguments))
            return arguments
    part = ast.get_source_segment(body, node) or body
    raise ValueError(f"{excerpt(part)!r} is not admissible in an expression, which may hold {GRAMMAR}")


def require_call(name: str, count: int) -> None:
    """Require that the language has a function, and that the function takes this number of arguments.

    Args:
        name: Name of the function.
        count: Number of arguments in the call.

    Raises:
        ValueError: The language has no such function, or the function takes another number of arguments.
    """
    if name not in FUNCTIONS:
        raise ValueError(f"'{name}' is no function of expressions; {nearest(name, FUNCTIONS)}")
    if FUNCTIONS[name].is_variadic and count < 2:
        raise ValueError(f"{name} takes two or more arguments, got {count}")
    if not FUNCTIONS[name].is_variadic and count != 1:
        raise ValueError(f"{name} takes one argument, got {count}")


def excerpt(text: str) -> str:
    """The first :data:`EXCERPT` characters of a text, for messages, followed by dots if the text is longer."""
    return text if len(text) <= EXCERPT else f"{text[:EXCERPT]}..."


def names_of(tree: ast.expr) -> tuple[str, ...]:
    """Names of the parameters in an expression, each once, in the order of the text."""
    return tuple(dict.fromkeys(names_in(tree)))


def names_in(node: ast.expr) -> Iterator[str]:
    """Yield the names of the parameters in a tree, as often as they occur, in the order of the text."""
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
    """Evaluate an expression in an arithmetic that three functions define, such as interval arithmetic.

    Args:
        node: Tree from :func:`parse_expression`.
        value_of: (name of a parameter) -> value in this arithmetic.
        number: (constant) -> value in this arithmetic.
        apply: (operation, value of each operand) -> result.
    """

    def value_at(part: ast.expr) -> Value:
        """Value of a part of the expression."""
        return evaluate(part, value_of, number, apply)

    match node:
        case ast.Constant(value=constant) if is_number(constant):
            return number(float(constant))
        case ast.Name(id=name):
            return number(np.pi) if name == PI else value_of(name)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return value_at(operand)
        case ast.UnaryOp(op=operator, operand=operand):
            return apply(OPERATORS[type(operator)], value_at(operand))
        case ast.BinOp(left=left, op=operator, right=right):
            return apply(OPERATORS[type(operator)], value_at(left), value_at(right))
        case ast.Call(func=ast.Name(id=name), args=[first, *remaining]):
            operation = FUNCTIONS[name]
            if not operation.is_variadic:
                return apply(operation, value_at(first))
            value = value_at(first)
            for operand in remaining:
                value = apply(operation, value, value_at(operand))
            return value
    raise AssertionError(node)  # parse_expression admits no other node


Apply = Callable[..., Value]
"""(Operation, value of each operand) -> value."""


def apply_to_numbers(operation: Operation, *values: Numeric) -> Numeric:
    """Apply an operation to numbers, arrays or traced values; the result of plain numbers is a plain float.

    An undefined result, such as that of 1/0, is infinite or NaN, and raises no error.
    """
    xp = namespace(*values)
    if operation.ufunc == "power" and xp is not np and is_whole_exponent(values[1]):
        return values[0] ** int(values[1])  # products, which have a derivative at and below 0
    result = getattr(xp, operation.ufunc)(*values)
    return float(result) if isinstance(result, np.generic) else result


def is_whole_exponent(exponent: Numeric) -> bool:
    """Whether an exponent is a plain whole number that is small enough for a power computed by products."""
    return is_number(exponent) and abs(exponent) <= LARGEST_PRODUCT and float(exponent).is_integer()


def evaluate_numbers(tree: ast.expr, value_of: Callable[[str], Numeric]) -> Numeric:
    """Evaluate an expression for numbers, arrays or traced values; the value is infinite or NaN where undefined.

    Args:
        tree: Tree from :func:`parse_expression`.
        value_of: (name of a parameter) -> value of the parameter.
    """
    with np.errstate(all="ignore"):
        return evaluate(tree, value_of, float, apply_to_numbers)


def evaluate_intervals(tree: ast.expr, value_of: Callable[[str], Interval]) -> Interval:
    """Interval that contains all values of an expression while each parameter lies in its interval.

    Args:
        tree: Tree from :func:`parse_expression`.
        value_of: (name of a parameter) -> interval of the parameter.
    """

    def exact_interval(value: float) -> Interval:
        """Interval that contains a single number."""
        return Interval.of(value, value)

    def apply_to_intervals(operation: Operation, *values: Interval) -> Interval:
        """Interval that contains all results of an operation whose operands lie in these intervals."""
        return operation.interval(*values)

    with np.errstate(all="ignore"):
        return evaluate(tree, value_of, exact_interval, apply_to_intervals)
