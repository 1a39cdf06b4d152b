"""Helpers for formulas that accept numbers, NumPy arrays or traced values."""

from typing import Any, TypeAlias

from dssc_jax.core.numerics import namespace

Numeric: TypeAlias = Any
"""A number, a NumPy array, or a traced value."""


def greater(first: Numeric, second: Numeric) -> Numeric:
    """The greater of two values, element by element."""
    return namespace(first, second).maximum(first, second)


def ratio_where(condition: Numeric, numerator: Numeric, denominator: Numeric) -> Numeric:
    """numerator/denominator where a condition holds; NaN elsewhere, where the denominator may be 0."""
    xp = namespace(condition, numerator, denominator)
    safe_denominator = xp.where(condition, denominator, 1.0)
    return xp.where(condition, numerator / safe_denominator, xp.nan)
