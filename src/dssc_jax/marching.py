"""Ways through time other than a plain scan; the carry has the index ``k`` of the next sample."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from dssc_jax.types import Scalar

BETWEEN_LOOKS = 64  # samples between two looks at whether any draw still flies

C = TypeVar("C")


def until_all_ended(
    sample: Callable[[C], C], flying: Callable[[C], Scalar], at: C, steps: int, together: str, turn: int = 1
) -> C:
    """Sample after sample, until ``steps`` are done or no draw of the mapped axis ``together`` flies any more.

    The look is common to all draws of the axis, so that time and what depends on it alone stay scalars.

    Args:
        sample: One sample.
        flying: Whether a draw goes on.
        at: The carry at the start.
        steps: Samples in all.
        together: The mapped axis.
        turn: Samples of a turn of the compiled loop, of which ``steps`` and ``BETWEEN_LOOKS`` are multiples.
    """

    traced_once = jax.jit(sample)

    def turned(at: C) -> C:
        for _ in range(turn):
            at = traced_once(at)
        return at

    def any_flies(at: C) -> Scalar:
        return jax.lax.pmax(jnp.where(flying(at), 1, 0), together)

    def block(carry: tuple[C, Scalar]) -> tuple[C, Scalar]:
        last = jnp.minimum(carry[0].k + BETWEEN_LOOKS, steps)  # type: ignore[attr-defined]

        def before(at: Any) -> Scalar:
            return at.k < last

        after = jax.lax.while_loop(before, turned, carry[0])
        return after, any_flies(after)

    def goes_on(carry: tuple[C, Scalar]) -> Scalar:
        return (carry[0].k < steps) & (carry[1] > 0)  # type: ignore[attr-defined]

    return jax.lax.while_loop(goes_on, block, (at, any_flies(at)))[0]


def in_stretches(sample: Callable[[C], C], at: C, steps: int, segment: int | None = None) -> C:
    """Sample after sample to the end, so that derivatives can follow.

    Args:
        sample: One sample.
        at: The carry at the start.
        steps: Samples in all.
        segment: Samples of a stretch. Reverse mode keeps the carry at the start of each, and computes what is within
            again when it comes to it. None: it keeps every carry.
    """

    def ahead(at: C, count: int) -> C:
        return jax.lax.scan(lambda at, _: (sample(at), None), at, length=count)[0]

    if segment is None:
        return ahead(at, steps)
    stretch = jax.checkpoint(lambda at: ahead(at, segment))
    at = jax.lax.scan(lambda at, _: (stretch(at), None), at, length=steps // segment)[0]
    return ahead(at, steps % segment)
