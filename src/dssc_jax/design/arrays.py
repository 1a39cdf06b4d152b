"""Helpers for formulas that accept numbers, NumPy arrays or traced values."""

from types import ModuleType
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

Numeric: TypeAlias = Any
"""A number, a NumPy array, or a traced value."""


def namespace(*values: Numeric) -> ModuleType:
    """``jax.numpy`` if a value is JAX's, else NumPy, which uses float64 for every precision of JAX."""
    return jnp if any(isinstance(value, jax.Array) for value in values) else np


def greater(first: Numeric, second: Numeric) -> Numeric:
    """The greater of two values."""
    return namespace(first, second).maximum(first, second)


def ratio_where(condition: Numeric, numerator: Numeric, denominator: Numeric) -> Numeric:
    """numerator/denominator if the condition holds, else NaN; the denominator may vanish elsewhere."""
    xp = namespace(condition, numerator, denominator)
    return xp.where(condition, numerator / xp.where(condition, denominator, 1.0), xp.nan)
