"""The longest uninterrupted stretch of samples at which a flag holds, in streaming form."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax.numpy as jnp

from dssc_jax.closed_loop.metrics.window import Span, Window
from dssc_jax.core.signals import Scalar

S = TypeVar("S")
"""The input of the metric at a sample."""


class Stretch(NamedTuple):
    """Number of samples in the current uninterrupted stretch, and in the longest one so far."""

    lasting: Scalar = 0.0
    longest: Scalar = 0.0


def stretch(flag: Callable[[S], Scalar]) -> Callable[[Stretch, S, Window], Stretch]:
    """The update of the longest run of consecutive samples at which a flag (1 or 0) holds."""

    def update(acc: Stretch, sample: S, window: Window) -> Stretch:
        lasting = (acc.lasting + 1.0) * flag(sample)
        return Stretch(lasting, jnp.maximum(acc.longest, lasting))

    return update


def longest(acc: Stretch, window: Window, span: Span) -> Scalar:
    """Duration of the longest stretch [s]."""
    return acc.longest * span.sample_time
