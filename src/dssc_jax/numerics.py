"""Functions that are safe where the plain ones are not. Each says why."""

from collections.abc import Sequence

import jax.numpy as jnp

from dssc_jax.types import Scalar

SERIES_BELOW = 0.05
SERIES_TERMS = 13  # 0.05^13 / 15 < 1e-17


def root_abs(x: Scalar, floor: float = 0.0) -> Scalar:
    """r = max(|x|, floor^2)^(1/2), with gradient 0 at x = 0, where the slope of the root is infinite."""
    magnitude = jnp.abs(x)
    positive = magnitude > floor**2
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, magnitude, 1.0)), floor)


def over_log_defect(x: Scalar) -> Scalar:
    """x^2 / (x - ln(1 + x)) for x >= 0, whose singularity at 0 is removable: the limit is 2.

    Below 0.05 the difference cancels; there 1/2 - x/3 + x^2/4 - ... stands for (x - ln(1 + x))/x^2.
    """
    small = x < SERIES_BELOW
    near = jnp.where(small, x, 0.0)
    series = jnp.zeros_like(near)
    for k in reversed(range(SERIES_TERMS)):
        series = 1.0 / (k + 2) - near * series
    far = jnp.where(small, 1.0, x)
    return jnp.where(small, 1.0 / series, far * far / (far - jnp.log1p(far)))


def sign(x: Scalar) -> Scalar:
    """sgn x with sgn 0 = 0."""
    return jnp.sign(x)


def saturate(x: Scalar, limit: Scalar) -> Scalar:
    """X clipped to [-limit, limit]."""
    return jnp.clip(x, -limit, limit)


def dot(left: Sequence[Scalar], right: Sequence[Scalar]) -> Scalar:
    """Sum of products of two short tuples, spelled out: scalars in a step compile to scalar arithmetic."""
    total: Scalar = 0.0
    for a, b in zip(left, right, strict=True):
        total = total + a * b
    return total
