"""Rules of JAX's elementwise primitives, which translate them into the operations of a lane's program.

Functions such as the sine are not here: :mod:`dssc_jax.lanes.functions.elementary` writes them as arithmetic, and JAX
traces that.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jax.extend.core import JaxprEqn

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.program import BOOL, Value
from dssc_jax.lanes.tracing.specification import (
    NUMBER_TYPES,
    REAL,
    SCALARS,
    SIGNED_INTEGERS,
    TRUTH,
    WHOLE,
    Parameters,
    Specification,
    TranslationRule,
    any_value,
    array_type,
    no_value,
    one_of,
    rule,
)

ElementRule = Callable[[Builder, Sequence[Value], Mapping[str, Any], np.dtype], Value]
"""``(build, operands, params, dtype) -> result``: the builder, the operands, the parameters of JAX's equation by name,
and the dtype of the result. All rules have these arguments, of which each uses what it needs."""


def same_operation(operation: str) -> ElementRule:
    """Return the translation of a primitive of which the program has the same operation."""
    return lambda build, operands, params, dtype: build.add(operation, *operands)


def larger_or_smaller(operation: str) -> ElementRule:
    """Return the translation of ``max`` or ``min``; for truth values these are "or" and "and"."""

    def translate(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
        """Return the larger or smaller operand."""
        logic = {"max": "or", "min": "and"}
        return build.add(logic[operation] if dtype == BOOL else operation, *operands)

    return translate


def division(operation: str) -> ElementRule:
    """Return the translation of ``div`` or ``rem``, with JAX's results where integers have no quotient.

    The machine must not divide an integer by zero, nor the least integer by -1. In JAX, x divided by zero has a
    quotient with all bits set and the remainder x. Divided by -1, x has the quotient -x, which wraps for the least x.
    """

    def translate(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
        """Return the quotient or remainder; the machine divides by 1 where the divisor is 0 or -1."""
        x, y = operands
        if dtype.kind == "f":
            return build.add(operation, x, y)
        zero = build.constant(0, dtype)
        unit = build.constant(1, dtype)
        by_zero = build.add("eq", y, zero)
        signed = dtype.kind == "i"
        unusual = build.add("or", by_zero, build.add("eq", y, build.constant(-1, dtype))) if signed else by_zero
        result = build.add(operation, x, build.add("select", unusual, unit, y))
        if operation == "rem":  # the remainder by 1 is 0, as the one by -1 is
            return build.add("select", by_zero, x, result)
        if signed:
            result = build.add("select", unusual, build.add("neg", x), result)
        all_bits = build.constant(np.array(-1).astype(dtype), dtype)
        return build.add("select", by_zero, all_bits, result)

    return translate


def shift(operation: str, treated_as: str = "") -> ElementRule:
    """Return the translation of a shift.

    A shift by the width of the type or more leaves zeros or, if the sign bit is copied, copies of the sign bit.

    Args:
        operation: ``shl`` or ``shr``.
        treated_as: Kind of integer as which the operand is shifted: "i" copies the sign bit, "u" moves zeros in; empty:
            the operand's own kind.
    """

    def translate(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
        """Return the shifted operand; the machine must not shift by the width or more, so the count is limited."""
        width = 8 * dtype.itemsize
        unsigned = np.dtype(f"u{dtype.itemsize}")
        kind = np.dtype(f"{treated_as or dtype.kind}{dtype.itemsize}")
        x, count = (build.add("bitcast", value, dtype=kind) for value in operands)
        limit = build.constant(width - 1, kind)
        is_within_width = build.add("lt", build.add("bitcast", count, dtype=unsigned), build.constant(width, unsigned))
        shifted = build.add(operation, x, build.add("select", is_within_width, count, limit))
        past_end = shifted if treated_as == "i" else build.constant(0, kind)
        return build.add("bitcast", build.add("select", is_within_width, shifted, past_end), dtype=dtype)

    return translate


def sign_of(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.sign``: -1 or 1, or the operand itself if it is a zero or NaN; the arguments are an ElementRule's."""
    x = operands[0]
    zero = build.constant(0, dtype)
    sign_unless_positive = x
    if dtype.kind != "u":
        is_negative = build.add("lt", x, zero)
        sign_unless_positive = build.add("select", is_negative, build.constant(-1, dtype), x)
    return build.add("select", build.add("gt", x, zero), build.constant(1, dtype), sign_unless_positive)


def clamp(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.clamp``: the middle operand, at least the first and at most the last; the last counts if they conflict."""
    lower, x, upper = operands
    return build.add("min", build.add("max", x, lower), upper)


def select_n(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.select_n``: one of several cases, which the first operand selects.

    That operand is the index of the case or, for two cases, a truth value that selects the second case. An index below
    0 selects the first case, and an index beyond the end the last.
    """
    index, *cases = operands
    if index.dtype == BOOL:
        if_false = cases[0]
        if_true = cases[-1]
        return build.add("select", index, if_true, if_false)
    selected = cases[-1]
    for number in reversed(range(len(cases) - 1)):
        is_at_most = build.add("le", index, build.constant(number, index.dtype))
        selected = build.add("select", is_at_most, cases[number], selected)
    return selected


def convert(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """Return the operand converted to the dtype of the result; as a truth value, it tells whether it differs from 0."""
    x = operands[0]
    if dtype == BOOL and x.dtype != BOOL:
        return build.add("ne", x, build.constant(0, x.dtype))
    return build.add("convert", x, dtype=dtype)


def whole_power(build: Builder, x: Value, exponent: int) -> Value:
    """Return x to a whole power, by repeated squaring.

    The result is the product of those of the powers x, x^2, x^4, ... whose bits are set in the exponent. For a negative
    exponent, it is the reciprocal of the positive power.
    """
    if exponent < 0:
        return build.add("div", build.constant(1, x.dtype), whole_power(build, x, -exponent))
    product = None  # of no factor yet
    power = x  # x^(2^i) for bit i of the exponent
    while exponent:
        if exponent & 1:
            product = power if product is None else build.add("mul", product, power)
        exponent >>= 1
        if exponent:
            power = build.add("mul", power, power)
    return build.constant(1, x.dtype) if product is None else product


def is_finite(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.is_finite``: the truth value whether the operand is neither infinite nor NaN."""
    x = operands[0]
    return build.add("lt", build.add("abs", x), build.constant(np.inf, x.dtype))


def in_total_order(operation: str) -> ElementRule:
    """Return the translation of a comparison ``lt`` or ``le`` in which NaN is above all numbers.

    JAX removes the signs of zeros and NaN before this comparison, so signs of these need no care.
    """

    def translate(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
        """Return the truth value whether the first operand is below the second or, for ``le``, equal to it."""
        a, b = operands
        holds_by_nan = build.add("ne", b, b)  # b is NaN, and a is at most NaN
        if operation == "lt":
            a_is_number = build.add("eq", a, a)
            holds_by_nan = build.add("and", holds_by_nan, a_is_number)
        return build.add("or", build.add(operation, a, b), holds_by_nan)

    return translate


def complement(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.bitwise_not``: the operand with every bit inverted; a truth value is negated."""
    all_bits = build.constant(True if dtype == BOOL else -1, dtype)
    return build.add("xor", operands[0], all_bits)


def same_value(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """Return the operand itself, for primitives that change nothing in a lane, such as ``lax.stop_gradient``."""
    return operands[0]


def nearest_whole(build: Builder, x: Value, method: str) -> Value:
    """Return the whole number nearest to x.

    Args:
        build: The builder.
        x: The number.
        method: JAX's name of the rule for halves: ``TO_NEAREST_EVEN``, or any other for away from zero.
    """
    if method == "TO_NEAREST_EVEN":
        return build.add("round", x)
    truncated = build.add("trunc", x)
    distance = build.add("abs", build.add("sub", x, truncated))
    outward_unit = sign_of(build, [x], {}, x.dtype)
    is_half_or_more = build.add("ge", distance, build.constant(0.5, x.dtype))
    return build.add("select", is_half_or_more, build.add("add", truncated, outward_unit), truncated)


def refuse_other_width(equation: JaxprEqn) -> str | None:
    """Return the reason why a bitcast is not translated, if operand and result differ in width; else None."""
    sizes = {np.dtype(array_type(variable).dtype).itemsize for variable in (*equation.invars, *equation.outvars)}
    return None if len(sizes) == 1 else "bits of another width"


def refuse_lost_bits(equation: JaxprEqn) -> str | None:
    """Return the reason why a reduction of precision is not translated, if it removes or adds bits; else None."""
    own_format = np.finfo(array_type(equation.outvars[0]).dtype)
    own_lengths = own_format.nexp, own_format.nmant  # bits of the exponent and of the mantissa
    kept_lengths = equation.params["exponent_bits"], equation.params["mantissa_bits"]
    return None if kept_lengths == own_lengths else "fewer bits than the type has"


def integer_power(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.integer_pow``: the operand to a constant whole power, which is a parameter of the equation."""
    return whole_power(build, operands[0], params["y"])


def square(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.square``: the square of the operand."""
    return build.add("mul", operands[0], operands[0])


def reciprocal_root(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.rsqrt``: the reciprocal of the operand's square root, which costs a root and a division."""
    return build.add("div", build.constant(1, dtype), build.add("sqrt", operands[0]))


def same_bits(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.bitcast_convert_type``: the number of the result's dtype that has the operand's bits."""
    return build.add("bitcast", *operands, dtype=dtype)


def rounding(build: Builder, operands: Sequence[Value], params: Parameters, dtype: np.dtype) -> Value:
    """``lax.round``: the whole number nearest to the operand; the equation's parameter is the rule for halves."""
    return nearest_whole(build, operands[0], params["rounding_method"].name)


ELEMENT_RULES: dict[str, TranslationRule] = {
    **{name: rule(same_operation(name), NUMBER_TYPES) for name in ("add", "sub", "neg")},
    **{name: rule(same_operation(name), SCALARS) for name in ("eq", "ne", "lt", "le", "gt", "ge")},
    **{name: rule(larger_or_smaller(name), SCALARS) for name in ("max", "min")},
    **{name: rule(same_operation(name), REAL) for name in ("floor", "ceil")},
    **{name: rule(same_operation(name), WHOLE | TRUTH) for name in ("and", "or", "xor")},
    "abs": rule(same_operation("abs"), REAL | SIGNED_INTEGERS),
    "add_any": rule(same_operation("add"), NUMBER_TYPES),
    "mul": rule(same_operation("mul"), NUMBER_TYPES, out_dtype=no_value),
    "sqrt": rule(same_operation("sqrt"), REAL, accuracy=no_value),
    "div": rule(division("div"), NUMBER_TYPES),
    "rem": rule(division("rem"), NUMBER_TYPES),
    "shift_left": rule(shift("shl"), WHOLE),
    "shift_right_arithmetic": rule(shift("shr", "i"), WHOLE),
    "shift_right_logical": rule(shift("shr", "u"), WHOLE),
    "not": rule(complement, WHOLE | TRUTH),
    "lt_to": rule(in_total_order("lt"), SCALARS),
    "le_to": rule(in_total_order("le"), SCALARS),
    "sign": rule(sign_of, NUMBER_TYPES),
    "clamp": rule(clamp, NUMBER_TYPES),
    "select_n": rule(select_n, SCALARS),
    "convert_element_type": rule(convert, SCALARS, new_dtype=any_value, weak_type=any_value, sharding=no_value),
    "bitcast_convert_type": TranslationRule(same_bits, Specification(
        NUMBER_TYPES, {"new_dtype": any_value}, refuse_other_width)),
    "integer_pow": rule(integer_power, NUMBER_TYPES, y=any_value),
    "square": rule(square, NUMBER_TYPES),
    "rsqrt": rule(reciprocal_root, REAL, accuracy=no_value),
    "round": rule(rounding, REAL, rounding_method=one_of("TO_NEAREST_EVEN", "AWAY_FROM_ZERO")),
    "is_finite": rule(is_finite, REAL | TRUTH),
    "stop_gradient": rule(same_value, SCALARS),
    "copy": rule(same_value, SCALARS),
    "copy_p": rule(same_value, SCALARS),
    "reduce_precision": TranslationRule(same_value, Specification(
        REAL, {"exponent_bits": any_value, "mantissa_bits": any_value}, refuse_lost_bits)),
}  # fmt: skip
"""The rules of elementwise operations, by the name of JAX's primitive; each translation is an :data:`ElementRule`."""
