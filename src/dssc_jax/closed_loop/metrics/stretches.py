"""The longest uninterrupted stretch of samples at which a flag holds, in streaming form."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax.numpy as jnp

from dssc_jax.closed_loop.metrics.window import Span, Window
from dssc_jax.core.signals import Scalar

S = TypeVar("S")
"""The input of the metric at a sample."""


class Stretch(NamedTuple):
    """The samples at which a flag has held without interruption.

    Args:
        lasting: Number of samples in the present stretch; 0 if the flag does not hold.
        longest: Number of samples in the longest stretch so far.
    """

    lasting: Scalar = 0.0
    longest: Scalar = 0.0


def stretch_update(flag: Callable[[S], Scalar]) -> Callable[[Stretch, S, Window], Stretch]:
    """Return the ``update`` of a metric that finds the longest stretch of samples at which a flag (1 or 0) holds."""

    def update(acc: Stretch, sample: S, window: Window) -> Stretch:
        """The stretches after one more sample, which lengthens the present stretch if its flag is 1, or ends it."""
        lasting = (acc.lasting + 1.0) * flag(sample)
        return Stretch(lasting, jnp.maximum(acc.longest, lasting))

    return update


def longest_duration(acc: Stretch, window: Window, span: Span) -> Scalar:
    """Duration of the longest stretch [s]; the contract's ``window`` is not read."""
    return acc.longest * span.sample_time
