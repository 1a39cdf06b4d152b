"""What NumPy says of operations on integers and truth values."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks.fuzz.values import MAIN

Column = np.ndarray
NUMPY = ("int64", "int32", "int16", "int8", "uint64", "uint32", "uint16", "uint8", "bool")
"""Types that NumPy has itself."""


def bits(x: Column) -> int:
    """Bits of a type."""
    return 8 * x.dtype.itemsize


def divided(x: Column, y: Column) -> Column:
    """A quotient rounded towards zero; -1 beyond division by zero."""
    if x.dtype.kind == "u":
        return np.where(
            y == 0, x.dtype.type(-1 & int(np.iinfo(x.dtype).max)), x // np.where(y == 0, 1, y).astype(y.dtype)
        )
    least = np.iinfo(x.dtype).min
    safe = np.where((y == 0) | ((x == least) & (y == -1)), 1, y).astype(y.dtype)
    floor = x // safe
    quotient = np.where((floor < 0) & (floor * safe != x), floor + 1, floor).astype(x.dtype)
    return np.where(y == 0, x.dtype.type(-1), quotient)


def remainder(x: Column, y: Column) -> Column:
    """What a quotient rounded towards zero leaves."""
    return np.where(y == 0, x, x - divided(x, y) * y).astype(x.dtype)


def shifted(x: Column, count: Column, kind: str) -> Column:
    """A shift; by the type's bits or more it leaves nothing, or the sign."""
    inside = (count >= 0) & (count < bits(x))
    unsigned, signed = np.dtype(f"u{x.dtype.itemsize}"), np.dtype(f"i{x.dtype.itemsize}")
    some = np.where(inside, count, 0)
    match kind:
        case "left":
            return np.where(inside, np.left_shift(x, some), 0).astype(x.dtype)
        case "logical":
            return np.where(inside, np.right_shift(x.view(unsigned), some.astype(unsigned)), 0).astype(unsigned).view(
                x.dtype)  # fmt: skip
        case _:
            most = np.where(inside, count, bits(x) - 1).astype(signed)
            return np.right_shift(np.ascontiguousarray(x).view(signed), most).view(x.dtype)


def power(x: Column, exponent: int) -> Column:
    """A whole power by squaring."""
    result, square = np.ones_like(x), x
    while exponent:
        result = result * square if exponent & 1 else result
        square = square * square
        exponent >>= 1
    return result


def converted(params: dict[str, Any], x: Column) -> Column:
    """The number in another type; a floating-point number saturates, and NaN is 0."""
    wanted = np.dtype(params["dtype"])
    if wanted.kind == "b":
        return x != 0
    if x.dtype.kind != "f" or wanted.kind == "f":
        return x.astype(wanted)
    limits = np.iinfo(wanted)
    wide = np.trunc(np.where(np.isnan(x), 0, x).astype(np.longdouble))
    inside = np.clip(wide, np.longdouble(limits.min), np.longdouble(limits.max))
    return inside.astype(np.uint64 if wanted.kind == "u" else np.int64).astype(wanted)


def sign(x: Column) -> Column:
    """The sign."""
    return np.sign(x)


def simple(function: Callable[..., Column]) -> Callable[..., Column]:
    """A function without parameters."""
    return lambda params, *operands: function(*operands)


WHOLE: dict[str, Callable[..., Column]] = {
    "add": simple(np.add), "sub": simple(np.subtract), "mul": simple(np.multiply), "div": simple(divided),
    "rem": simple(remainder), "neg": simple(lambda x: (0 - x).astype(x.dtype)), "abs": simple(np.abs),
    "max": simple(np.maximum), "min": simple(np.minimum), "sign": simple(sign), "square": simple(lambda x: x * x),
    "clamp": simple(lambda low, x, high: np.minimum(np.maximum(x, low), high)), "stop_gradient": simple(lambda x: x),
    "eq": simple(np.equal), "ne": simple(np.not_equal), "lt": simple(np.less), "le": simple(np.less_equal),
    "gt": simple(np.greater), "ge": simple(np.greater_equal), "bitwise_and": simple(np.bitwise_and),
    "bitwise_or": simple(np.bitwise_or), "bitwise_xor": simple(np.bitwise_xor), "bitwise_not": simple(np.invert),
    "shift_left": simple(lambda x, count: shifted(x, count, "left")),
    "shift_right_logical": simple(lambda x, count: shifted(x, count, "logical")),
    "shift_right_arithmetic": simple(lambda x, count: shifted(x, count, "arithmetic")),
    "integer_pow": lambda params, x: power(x, params["y"]),
    "reduce_sum": lambda params, x: x.sum(axes(params), dtype=x.dtype),
    "reduce_prod": lambda params, x: x.prod(axes(params), dtype=x.dtype),
    "reduce_max": lambda params, x: x.max(axes(params)), "reduce_min": lambda params, x: x.min(axes(params)),
    "reduce_and": lambda params, x: np.bitwise_and.reduce(x, axes(params)),
    "reduce_or": lambda params, x: np.bitwise_or.reduce(x, axes(params)),
    "reduce_xor": lambda params, x: np.bitwise_xor.reduce(x, axes(params)),
    **{name: lambda params, x, function=function: accumulated(params, x, function) for name, function in (
        ("cumsum", np.add), ("cumprod", np.multiply), ("cummax", np.maximum), ("cummin", np.minimum))},
}  # fmt: skip
"""Operations on integers and truth values by their names."""


def axes(params: dict[str, Any]) -> tuple[int, ...]:
    """The reduced axes of a batch."""
    return tuple(axis + 1 for axis in params["axes"])


def accumulated(params: dict[str, Any], x: Column, function: Any) -> Column:
    """Each element combined with those before."""
    line = x[:, ::-1] if params["reverse"] else x
    result = function.accumulate(line, 1, dtype=x.dtype)
    return result[:, ::-1] if params["reverse"] else result


def bitcast(params: dict[str, Any], x: Column) -> Column | None:
    """The same bits in a type of the same width; None for another."""
    wanted = jnp.dtype(params["dtype"])
    known = (*MAIN, *NUMPY[:-1])
    if wanted.itemsize != x.dtype.itemsize or wanted.name not in known or x.dtype.name not in known:
        return None
    return np.ascontiguousarray(x).view(wanted)
