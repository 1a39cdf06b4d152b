"""Time loops over the samples of a draw: with early ends, with checkpoints for derivatives, or with a recording."""

from collections.abc import Callable
from typing import Protocol, TypeVar

import jax
import jax.numpy as jnp

from dssc_jax.core.signals import Scalar

CHECK_INTERVAL = 64  # samples between two checks whether any draw is still running


class Carry(Protocol):
    """The state of a time loop between samples."""

    @property
    def k(self) -> Scalar:
        """Index of the next sample."""
        ...


C = TypeVar("C", bound=Carry)
R = TypeVar("R")


def until_all_ended(
    sample: Callable[[C], C], is_active: Callable[[C], Scalar], first_carry: C, steps: int, axis_name: str
) -> C:
    """Advance sample by sample until ``steps`` are done, or until no draw of a mapped axis is running.

    All draws of the axis share the loop, so the time and values that depend only on it stay scalars.

    Args:
        sample: Advances the carry by one sample.
        is_active: Whether the draw of a carry is still running.
        first_carry: The carry at the start.
        steps: Total number of samples.
        axis_name: Name of the axis that ``vmap`` maps over the draws.
    """

    def any_running(at: C) -> Scalar:
        return jax.lax.pmax(jnp.where(is_active(at), 1, 0), axis_name)

    def block(carry: tuple[C, Scalar]) -> tuple[C, Scalar]:
        end = jnp.minimum(carry[0].k + CHECK_INTERVAL, steps)
        next_carry = jax.lax.while_loop(lambda at: at.k < end, sample, carry[0])
        return next_carry, any_running(next_carry)

    def goes_on(carry: tuple[C, Scalar]) -> Scalar:
        return (carry[0].k < steps) & (carry[1] > 0)

    return jax.lax.while_loop(goes_on, block, (first_carry, any_running(first_carry)))[0]


def scan_segments(sample: Callable[[C], C], first_carry: C, steps: int, segment: int | None) -> C:
    """Advance sample by sample through all ``steps``, in a form that can be differentiated.

    Args:
        sample: Advances the carry by one sample.
        first_carry: The carry at the start.
        steps: Total number of samples.
        segment: Number of samples between checkpoints. Reverse mode stores the carry at each checkpoint and recomputes
            those between. None: reverse mode stores every carry.
    """

    def advance(at: C, count: int) -> C:
        return jax.lax.scan(lambda at, _: (sample(at), None), at, length=count)[0]

    if segment is None:
        return advance(first_carry, steps)
    checkpointed = jax.checkpoint(lambda at: advance(at, segment))
    at = jax.lax.scan(lambda at, _: (checkpointed(at), None), first_carry, length=steps // segment)[0]
    return advance(at, steps % segment)


def scan_recorded(sample: Callable[[C], tuple[C, R]], begin: C, steps: int, stride: int) -> tuple[C, R]:
    """Advance sample by sample through all ``steps``, and record every ``stride``-th sample.

    Args:
        sample: Advances the carry by one sample, and returns the record of that sample.
        begin: The carry at the start.
        steps: Total number of samples.
        stride: Distance of two recorded samples.

    Returns:
        The carry at the end, and the records with leaves of shape (ceil(steps/stride),).
    """

    def recorded_then_skipped(at: C, _: None) -> tuple[C, R]:
        end = jnp.minimum(at.k + stride, steps)
        at, record = sample(at)
        return jax.lax.while_loop(lambda at: at.k < end, lambda at: sample(at)[0], at), record

    if stride == 1:
        return jax.lax.scan(lambda at, _: sample(at), begin, length=steps)
    return jax.lax.scan(recorded_then_skipped, begin, length=-(-steps // stride))
