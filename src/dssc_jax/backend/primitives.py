"""JAX's elementwise primitives in terms of the operations of a lane's program, one row each.

A row is a function of the builder, the operands, the equation's parameters and the type of the result. Functions such
as the sine are not here: :mod:`dssc_jax.backend.elementary` writes them as arithmetic, and JAX traces that.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from dssc_jax.backend.program import BOOL, Builder, Value

ElementRule = Callable[[Builder, Sequence[Value], Mapping[str, Any], np.dtype], Value]


def same_operation(operation: str) -> ElementRule:
    """An operation of the same meaning."""
    return lambda build, operands, params, dtype: build.add(operation, *operands)


def integer_division(operation: str) -> ElementRule:
    """Division, or its remainder; the machine must not divide an integer by zero."""

    def rule(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
        x, y = operands
        if dtype.kind == "f":
            return build.add(operation, x, y)
        zero, one = build.constant(0, dtype), build.constant(1, dtype)
        by_zero = build.add("eq", y, zero)
        quotient = build.add(operation, x, build.add("select", by_zero, one, y))
        return build.add("select", by_zero, build.constant(-1, dtype) if operation == "div" else x, quotient)

    return rule


def shift(operation: str, unsigned: bool = False) -> ElementRule:
    """A shift; by the width of the type or more it leaves nothing, or the sign."""

    def rule(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
        x, count = operands
        width = 8 * dtype.itemsize
        kind = np.dtype(f"u{dtype.itemsize}") if unsigned else dtype
        x, count = (build.add("bitcast", value, dtype=kind) for value in (x, count))
        known = count.operation == "constant" and 0 <= count.detail < width
        if known:
            return build.add("bitcast", build.add(operation, x, count), dtype=dtype)
        inside = build.add("lt", build.add("bitcast", count, dtype=np.dtype(f"u{dtype.itemsize}")),
                           build.constant(width, np.dtype(f"u{dtype.itemsize}")))  # fmt: skip
        some = build.add(operation, x, build.add("select", inside, count, build.constant(width - 1, kind)))
        signed = operation == "shr" and kind.kind == "i"
        all_out = some if signed else build.constant(0, kind)
        return build.add("bitcast", build.add("select", inside, some, all_out), dtype=dtype)

    return rule


def sign_of(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
    """The sign; NaN and zeros are their own."""
    (x,) = operands
    zero = build.constant(0, dtype)
    below = x if dtype.kind == "u" else build.add(
        "select", build.add("lt", x, zero), build.constant(-1, dtype), x)  # fmt: skip
    return build.add("select", build.add("gt", x, zero), build.constant(1, dtype), below)


def clamp(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
    """The middle operand, at least the first and at most the last."""
    least, x, most = operands
    return build.add("min", build.add("max", x, least), most)


def select_n(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
    """The case that the first operand counts."""
    which, *cases = operands
    if which.dtype == BOOL:
        return build.add("select", which, cases[-1], cases[0])
    chosen = cases[-1]
    for number, case in reversed(list(enumerate(cases[:-1]))):
        below = build.add("le", which, build.constant(number, which.dtype))
        chosen = build.add("select", below, case, chosen)
    return chosen


def convert(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
    """The same number in another type."""
    (x,) = operands
    if dtype == BOOL and x.dtype != BOOL:
        return build.add("ne", x, build.constant(0, x.dtype))
    return build.add("convert", x, dtype=dtype)


def whole_power(build: Builder, x: Value, exponent: int) -> Value:
    """x to a whole power, by squaring."""
    if exponent < 0:
        return build.add("div", build.constant(1, x.dtype), whole_power(build, x, -exponent))
    result, square = None, x
    while exponent:
        if exponent & 1:
            result = square if result is None else build.add("mul", result, square)
        exponent >>= 1
        square = build.add("mul", square, square) if exponent else square
    return build.constant(1, x.dtype) if result is None else result


def finite(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
    """Whether a number is neither infinite nor NaN."""
    (x,) = operands
    return build.add("lt", build.add("abs", x), build.constant(np.inf, x.dtype))


def in_total_order(operation: str) -> ElementRule:
    """A comparison with NaN above all numbers; JAX itself makes the signs of 0 and of NaN alike before."""

    def rule(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
        a, b = operands
        last = build.add("ne", b, b)
        if operation == "lt":
            last = build.add("and", last, build.add("eq", a, a))
        return build.add("or", build.add(operation, a, b), last)

    return rule


def complement(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
    """Every bit inverted."""
    ones = build.constant(True if dtype == BOOL else -1, dtype)
    return build.add("xor", operands[0], ones)


def same_value(build: Builder, operands: Sequence[Value], params: Mapping[str, Any], dtype: np.dtype) -> Value:
    """The operand itself."""
    return operands[0]


ELEMENT_RULES: dict[str, ElementRule] = {
    **{name: same_operation(name) for name in (
        "add", "sub", "mul", "neg", "abs", "max", "min", "floor", "ceil", "sqrt", "and", "or", "xor", "eq", "ne", "lt",
        "le", "gt", "ge")},
    "add_any": same_operation("add"),
    "div": integer_division("div"),
    "rem": integer_division("rem"),
    "shift_left": shift("shl"),
    "shift_right_arithmetic": shift("shr"),
    "shift_right_logical": shift("shr", unsigned=True),
    "not": complement,
    "lt_to": in_total_order("lt"),
    "le_to": in_total_order("le"),
    "sign": sign_of,
    "clamp": clamp,
    "select_n": select_n,
    "convert_element_type": convert,
    "bitcast_convert_type": lambda build, operands, params, dtype: build.add("bitcast", *operands, dtype=dtype),
    "integer_pow": lambda build, operands, params, dtype: whole_power(build, operands[0], params["y"]),
    "square": lambda build, operands, params, dtype: build.add("mul", operands[0], operands[0]),
    "rsqrt": lambda build, operands, params, dtype: build.add(
        "div", build.constant(1, dtype), build.add("sqrt", operands[0])),
    "round": lambda build, operands, params, dtype: rounded_by(build, operands[0], params["rounding_method"].name),
    "is_finite": finite,
    "stop_gradient": same_value,
    "copy": same_value,
    "copy_p": same_value,
    "reduce_precision": same_value,
    "pvary": same_value,
}  # fmt: skip
"""ElementRule of each primitive by its name."""


def rounded_by(build: Builder, x: Value, method: str) -> Value:
    """The nearest whole number; halves to even, or away from zero."""
    if method == "TO_NEAREST_EVEN":
        return build.add("round", x)
    half = build.add("trunc", x)
    rest = build.add("abs", build.add("sub", x, half))
    one = sign_of(build, [x], {}, x.dtype)
    return build.add("select", build.add("ge", rest, build.constant(0.5, x.dtype)), build.add("add", half, one), half)
