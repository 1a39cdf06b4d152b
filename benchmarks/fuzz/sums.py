"""Sums, products and extremes of arrays of floating-point numbers, with the error that another order may bring."""

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.fuzz.arithmetic import EXTENDED

Judged = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A value; its admitted absolute error; where an intermediate result may leave the type's range."""


def axes_of(params: dict[str, Any]) -> tuple[int, ...]:
    """The reduced axes of a batch."""
    return tuple(axis + 1 for axis in params["axes"])


def finite_size(x: np.ndarray) -> np.ndarray:
    """Magnitudes; 0 of what is not finite."""
    return np.where(np.isfinite(x), np.abs(x), 0)


def judged_sum(total: np.ndarray, size: np.ndarray, terms: int, dtype: np.dtype) -> Judged:
    """A sum in extended precision, and the sum of the magnitudes of its finite terms."""
    limits = np.finfo(dtype)
    error = (size * (terms * EXTENDED(limits.eps)) + terms * EXTENDED(limits.smallest_subnormal)).astype(np.float64)
    unclear = size > 0.5 * EXTENDED(limits.max)
    exact = np.isnan(total) | np.isinf(total) | (size == 0)
    return total.astype(dtype), np.where(exact, 0.0, error), unclear & ~np.isnan(total)


def reduce_sum(params: dict[str, Any], x: np.ndarray) -> Judged:
    wide, axes = x.astype(EXTENDED), axes_of(params)
    terms = int(np.prod([x.shape[axis] for axis in axes]))
    return judged_sum(wide.sum(axes), finite_size(wide).sum(axes), terms, x.dtype)


def judged_product(product: np.ndarray, exponents: np.ndarray, terms: int, axis: Any, dtype: np.dtype) -> Judged:
    """A product in extended precision; the exponents of its factors tell whether a part of it can leave the range."""
    limits = np.finfo(dtype)
    up = np.maximum(exponents, 0.0).sum(axis) > limits.maxexp - 2
    down = np.minimum(exponents, 0.0).sum(axis) < limits.minexp + 2
    value = product.astype(dtype)
    with np.errstate(all="ignore"):
        error = np.abs(value.astype(np.float64)) * (terms * float(limits.eps))
    return value, np.where(np.isfinite(error), error, 0.0), (up | down) & ~np.isnan(product)


def exponents_of(x: np.ndarray) -> np.ndarray:
    """The binary logarithm of each magnitude; 0 of what is 0 or not finite."""
    wide = np.abs(x.astype(EXTENDED))
    usual = np.isfinite(wide) & (wide > 0)
    return np.where(usual, np.log2(np.where(usual, wide, 1)), 0).astype(np.float64)


def reduce_prod(params: dict[str, Any], x: np.ndarray) -> Judged:
    axes = axes_of(params)
    terms = int(np.prod([x.shape[axis] for axis in axes]))
    return judged_product(x.astype(EXTENDED).prod(axes), exponents_of(x), terms, axes, x.dtype)


def extreme(function: Callable[..., np.ndarray]) -> Callable[[dict[str, Any], np.ndarray], Judged]:
    """The largest or smallest along axes."""

    def rule(params: dict[str, Any], x: np.ndarray) -> Judged:
        value = function(x, axes_of(params))
        return value, np.zeros(value.shape), zeros_of_both_signs(x, axes_of(params), value)

    return rule


def zeros_of_both_signs(x: np.ndarray, axes: Any, value: np.ndarray) -> np.ndarray:
    """Where the largest is a zero and zeros of both signs are among the numbers."""
    zero, negative = x == 0, np.signbit(x)
    return (zero & negative).any(axes) & (zero & ~negative).any(axes) & (value == 0)


def cumulative(name: str) -> Callable[[dict[str, Any], np.ndarray], Judged]:
    """Sums, products or extremes of all numbers so far, along the one axis of an array."""

    def rule(params: dict[str, Any], x: np.ndarray) -> Judged:
        line = x[:, ::-1] if params["reverse"] else x
        wide, terms = line.astype(EXTENDED), x.shape[1]
        no_error, never = np.zeros(x.shape), np.zeros(x.shape, bool)
        if name == "cumsum":
            parts = judged_sum(np.cumsum(wide, 1), np.cumsum(finite_size(wide), 1), terms, x.dtype)
        elif name == "cumprod":
            exponents = exponents_of(line)
            up = np.cumsum(np.maximum(exponents, 0.0), 1)
            down = np.cumsum(np.minimum(exponents, 0.0), 1)
            ranges = np.stack([up, down], -1)
            parts = judged_product(np.cumprod(wide, 1), ranges, terms, -1, x.dtype)
        else:
            both = np.maximum if name == "cummax" else np.minimum
            value = both.accumulate(line, 1)
            parts = value, no_error, never | (value == 0)
        value, error, unclear = (part[:, ::-1] if params["reverse"] else part for part in parts)
        return value, error, unclear

    return rule


def dot_general(params: dict[str, Any], left: np.ndarray, right: np.ndarray) -> Judged:
    rows = left.astype(EXTENDED)
    column = right.astype(EXTENDED)
    products = rows * (column[:, None, :] if left.ndim == 3 else column)
    value, error, unclear = judged_sum(products.sum(-1), finite_size(products).sum(-1), left.shape[-1] + 1, left.dtype)
    beyond = np.isfinite(products) & (np.abs(products) > 0.5 * EXTENDED(np.finfo(left.dtype).max))
    return value, error, unclear | beyond.any(-1)


def scattered_error(operands: list[np.ndarray]) -> Any:
    """The error of numbers combined at indices that may be equal."""
    target, _, update = operands
    dtype = target.dtype
    if dtype.kind != "f":
        return np.zeros(1)
    size = np.abs(target.astype(EXTENDED)).reshape(len(target), -1).max(1) + np.abs(update.astype(EXTENDED)) * 2
    with np.errstate(all="ignore"):
        error = (size * np.finfo(dtype).eps * 2).astype(np.float64)
    return np.where(np.isfinite(error), error, 0.0).reshape((-1,) + (1,) * (target.ndim - 1))


RULES: dict[str, Callable[..., Judged]] = {
    "reduce_sum": reduce_sum, "reduce_prod": reduce_prod, "reduce_max": extreme(np.max), "reduce_min": extreme(np.min),
    **{name: cumulative(name) for name in ("cumsum", "cumprod", "cummax", "cummin")}, "dot_general": dot_general,
    "reduce": lambda params, x: reduce_sum({"axes": (0,)}, x),
}  # fmt: skip
"""Operations on arrays of floating-point numbers, batched along the first axis."""
