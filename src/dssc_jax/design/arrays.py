"""Formulas that take numbers, NumPy arrays or traced values alike."""

from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.types import Scalar


def namespace(*values: Scalar) -> ModuleType:
    """``jax.numpy`` where a value is JAX's, else NumPy, which computes in float64 whatever JAX's precision."""
    return jnp if any(isinstance(value, jax.Array) for value in values) else np


def greater(first: Scalar, second: Scalar) -> Scalar:
    """The greater of two values."""
    return namespace(first, second).maximum(first, second)


def ratio_where(condition: Scalar, numerator: Scalar, denominator: Scalar) -> Scalar:
    """numerator/denominator where the condition holds, else NaN; the denominator may vanish elsewhere."""
    xp = namespace(condition, numerator, denominator)
    return xp.where(condition, numerator / xp.where(condition, denominator, 1.0), xp.nan)
