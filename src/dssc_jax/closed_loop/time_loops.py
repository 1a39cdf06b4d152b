"""Time loops over the samples of a draw: with early ends, with checkpoints for derivatives, or with a recording."""

import math
from collections.abc import Callable
from typing import Protocol, TypeVar

import jax
import jax.numpy as jnp

from dssc_jax.core.signals import Scalar

CHECK_INTERVAL = 64  # samples between two checks whether any draw is still running


class Carry(Protocol):
    """The state of a time loop between samples, of any type that counts its samples in ``k``."""

    @property
    def k(self) -> Scalar:
        """Index of the next sample."""
        ...


C = TypeVar("C", bound=Carry)
R = TypeVar("R")


def until_all_ended(
    sample: Callable[[C], C], is_active: Callable[[C], Scalar], first_carry: C, steps: int, axis_name: str
) -> C:
    """Advance sample by sample until ``steps`` are done, or until no draw is running; returns the last carry.

    All draws of a mapped axis share the loop, so k and all that depends on k alone stay scalars. To save time, the loop
    checks only once in :data:`CHECK_INTERVAL` samples whether a draw is running.

    Args:
        sample: Advances the carry by one sample.
        is_active: Whether the draw of a carry is still running.
        first_carry: The carry at the start.
        steps: Total number of samples.
        axis_name: Name of the axis that ``vmap`` maps over the draws.
    """

    def any_running(carry: C) -> Scalar:
        """1 if a draw of the axis is running, else 0; the same number for all draws."""
        return jax.lax.pmax(jnp.where(is_active(carry), 1, 0), axis_name)

    def advance_block(carry_and_check: tuple[C, Scalar]) -> tuple[C, Scalar]:
        """The carry after the samples up to the next check, and the result of this check."""
        carry, _ = carry_and_check
        end = jnp.minimum(carry.k + CHECK_INTERVAL, steps)
        next_carry = jax.lax.while_loop(lambda carry: carry.k < end, sample, carry)
        return next_carry, any_running(next_carry)

    def goes_on(carry_and_check: tuple[C, Scalar]) -> Scalar:
        """Whether samples are left, and a draw was running at the last check."""
        carry, is_any_running = carry_and_check
        return (carry.k < steps) & (is_any_running > 0)

    last_carry, _ = jax.lax.while_loop(goes_on, advance_block, (first_carry, any_running(first_carry)))
    return last_carry


def scan_segments(sample: Callable[[C], C], first_carry: C, steps: int, segment: int | None) -> C:
    """Advance sample by sample through all ``steps``, in a form that can be differentiated; returns the last carry.

    Args:
        sample: Advances the carry by one sample.
        first_carry: The carry at the start.
        steps: Total number of samples.
        segment: Number of samples between checkpoints. Reverse-mode differentiation stores the carry at each checkpoint
            only, and computes the carries between two checkpoints again. None: it stores every carry.
    """

    def repeat(advance: Callable[[C], C], carry: C, count: int) -> C:
        """The carry after ``count`` calls of ``advance``.

        The scan counts the calls; its body returns None in place of a record.
        """
        end, _ = jax.lax.scan(lambda carry, _: (advance(carry), None), carry, length=count)
        return end

    if segment is None:
        return repeat(sample, first_carry, steps)
    advance_segment = jax.checkpoint(lambda carry: repeat(sample, carry, segment))
    last_checkpoint = repeat(advance_segment, first_carry, steps // segment)
    return repeat(sample, last_checkpoint, steps % segment)


def scan_recorded(sample: Callable[[C], tuple[C, R]], begin: C, steps: int, stride: int) -> tuple[C, R]:
    """Advance sample by sample through all ``steps``, and record every ``stride``-th sample.

    Args:
        sample: Advances the carry by one sample, and returns the record of that sample.
        begin: The carry at the start.
        steps: Total number of samples.
        stride: Number of samples from one recorded sample to the next.

    Returns:
        The carry at the end, and the records with leaves of shape (ceil(steps/stride),).
    """

    def record_then_skip(carry: C, _: None) -> tuple[C, R]:
        """Record one sample, and advance to the next sample that is recorded."""
        end = jnp.minimum(carry.k + stride, steps)
        carry, record = sample(carry)
        return jax.lax.while_loop(lambda carry: carry.k < end, lambda carry: sample(carry)[0], carry), record

    if stride == 1:
        return jax.lax.scan(lambda carry, _: sample(carry), begin, length=steps)
    records = math.ceil(steps / stride)
    return jax.lax.scan(record_then_skip, begin, length=records)
