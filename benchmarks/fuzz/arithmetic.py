"""What NumPy says of operations on float64 and float32: IEEE arithmetic, and functions in extended precision.

XLA takes subnormal numbers for zeros on a CPU and contracts products and sums within a kernel. It therefore cannot
judge strict arithmetic, and its functions have errors of their own.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import special

Column = np.ndarray
EXTENDED = np.longdouble


def largest(x: Column, y: Column) -> Column:
    """The larger number; NaN if either is; 0 is larger than -0."""
    return np.where((x == 0) & (y == 0), x + y, np.maximum(x, y))


def smallest(x: Column, y: Column) -> Column:
    """The smaller number; NaN if either is; -0 is smaller than 0."""
    return -largest(-x, -y)


def sign(x: Column) -> Column:
    """The sign; NaN and zeros are their own."""
    return np.where((x == 0) | np.isnan(x), x, np.copysign(np.ones_like(x), x))


def away_from_zero(x: Column) -> Column:
    """The nearest whole number, halves away from zero."""
    whole = np.trunc(x)
    half = np.abs(x - whole) >= 0.5
    return np.where(half, whole + np.copysign(np.ones_like(x), x), np.copysign(whole, x))


def whole_power(x: Column, exponent: int) -> Column:
    """A whole power by squaring."""
    if exponent < 0:
        return np.ones_like(x) / whole_power(x, -exponent)
    result, square = np.ones_like(x), x
    while exponent:
        result = result * square if exponent & 1 else result
        square = square * square
        exponent >>= 1
    return result


def rounded(params: dict[str, Any], x: Column) -> Column:
    """The nearest whole number."""
    return np.rint(x) if params["method"] == "TO_NEAREST_EVEN" else away_from_zero(x)


def simple(function: Callable[..., Column]) -> Callable[..., Column]:
    """A function without parameters."""
    return lambda params, *operands: function(*operands)


EXACT: dict[str, Callable[..., Column]] = {
    "add": simple(np.add), "sub": simple(np.subtract), "mul": simple(np.multiply), "div": simple(np.divide),
    "rem": simple(np.fmod), "neg": simple(np.negative), "abs": simple(np.abs), "sqrt": simple(np.sqrt),
    "max": simple(largest), "min": simple(smallest), "floor": simple(np.floor), "ceil": simple(np.ceil),
    "sign": simple(sign), "square": simple(lambda x: x * x), "is_finite": simple(np.isfinite),
    "reciprocal": simple(lambda x: np.ones_like(x) / x), "nextafter": simple(np.nextafter),
    "clamp": simple(lambda low, x, high: smallest(largest(x, low), high)),
    "eq": simple(np.equal), "ne": simple(np.not_equal), "lt": simple(np.less), "le": simple(np.less_equal),
    "gt": simple(np.greater), "ge": simple(np.greater_equal), "stop_gradient": simple(lambda x: x),
    "round": rounded, "integer_pow": lambda params, x: whole_power(x, params["y"]),
    "rsqrt": simple(lambda x: np.ones_like(x) / np.sqrt(x)),
}  # fmt: skip
"""Operations in the precision of their operands."""

FUNCTIONS: dict[str, Callable[..., Column]] = {
    "exp": np.exp, "exp2": np.exp2, "expm1": np.expm1, "log": np.log, "log1p": np.log1p, "sin": np.sin, "cos": np.cos,
    "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "sinh": np.sinh, "cosh": np.cosh,
    "tanh": np.tanh, "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh, "cbrt": np.cbrt,
    "logistic": lambda x: 1 / (1 + np.exp(-x)), "pow": np.power, "atan2": np.arctan2,
    "erf_inv": lambda x: np.copysign(special.erfinv(x.astype(np.float64)), x).astype(EXTENDED),
}  # fmt: skip
"""Elementary functions, for operands in extended precision."""

UNITS = {"tan": 4, "expm1": 3, "tanh": 4, "atan": 3, "asin": 3, "acos": 4, "erf_inv": 6, "sinh": 4, "cosh": 4,
         "logistic": 4, "atan2": 4}  # fmt: skip
"""Units in the last place within which a function is right; 2 for every other."""


def function_value(name: str, operands: list[Column], dtype: np.dtype) -> tuple[Column, Column]:
    """A function's value rounded to a type, and where a result of 0 or infinity is due to the range of the type."""
    wide = [operand.astype(EXTENDED) for operand in operands]
    exact = FUNCTIONS[name](*wide)
    value = exact.astype(dtype)
    beyond = ((value == 0) & (exact != 0)) | (np.isinf(value) & np.isfinite(exact))
    return value, beyond


def stepped(x: Column, steps: Column | int) -> Column:
    """The numbers so many units in the last place further, infinity at most."""
    integer = np.int64 if x.dtype == np.float64 else np.int32
    bits = np.ascontiguousarray(x).view(integer).astype(np.int64)
    least = int(np.iinfo(integer).min)
    order = np.where(bits < 0, least - bits, bits)
    infinite = int(np.array(np.inf, x.dtype).view(integer))
    moved = np.clip(order + np.asarray(steps, np.int64), -infinite, infinite)
    back = np.where(moved < 0, least - moved, moved).astype(integer).view(x.dtype)
    return np.where(np.isnan(x), x, back)
