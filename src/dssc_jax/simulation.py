"""One draw from start to end: streaming metrics, the freeze of a draw that is over, and the verdict."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.loop import Loop, LoopParams, LoopState, Recorded, as_arrays, start, step
from dssc_jax.marching import in_stretches, until_all_ended
from dssc_jax.metrics import Instant, Measure, starts, update_all, values
from dssc_jax.requirements import Requirement, judge
from dssc_jax.types import Outcome, Scalar


class Run(NamedTuple):
    """A finished draw.

    Args:
        metrics: Over the whole run, or until the draw settled; NaN where it ended early.
        margins: Of the requirements; -inf where it ended early.
        outcome: An :class:`~dssc_jax.types.Outcome`.
        failed_at: Time of the step that ended it early [s]; NaN: none.
        settled_at: Time from which on nothing was simulated, since it had settled [s]; NaN: none.
    """

    metrics: dict[str, Scalar]
    margins: dict[str, Scalar]
    outcome: Scalar
    failed_at: Scalar
    settled_at: Scalar


class Progress(NamedTuple):
    """The scan's carry; the sample's index is carried, not scanned over: an array would grow with the duration.

    Args:
        k: Index of the next sample.
        state: Of the loop.
        accumulators: Of the metrics.
        outcome: So far.
        steps: Samples that were flown.
        calm: Samples in a row, up to the last, with errors small enough to settle; without a rule for it, empty.
    """

    k: Scalar
    state: LoopState
    accumulators: tuple[Any, ...]
    outcome: Scalar
    steps: Scalar
    calm: Any


def calmed(loop: Loop, calm: Any, instant: Instant, k: Scalar) -> Any:
    """Samples in a row with small errors, sample k included."""
    if loop.settled is None:
        return calm
    small = k >= round(loop.settled.after / loop.sample_time)
    for sample in instant.channels:
        small = small & (jnp.abs(sample.e) <= loop.settled.error)
    return jnp.where(small, calm + 1, 0)


def flying(loop: Loop, at: Progress) -> Scalar:
    """Whether a draw goes on: it has neither ended early nor settled."""
    whole = at.outcome == Outcome.OK
    return whole if loop.settled is None else whole & (at.calm < round(loop.settled.hold / loop.sample_time))


def samples_a_turn(loop: Loop) -> int:
    """Samples that one turn of the compiled loop advances.

    A turn ends where it began, in the same buffers: what is written while its old value is still read is copied. Two
    samples in a turn copy less than half as often, which saves a loop of one channel a tenth of its time and more. A
    loop of several computes so much beside that it would only compile twice as long.
    """
    return 2 if len(loop.channels) == 1 and loop.steps % 2 == 0 else 1


def simulate(
    loop: Loop,
    params: LoopParams,
    key: jax.Array,
    measures: tuple[Measure, ...] = (),
    requirements: tuple[Requirement, ...] = (),
    every: int | None = None,
    together: str | None = None,
    segment: int | None = None,
) -> tuple[Run, Recorded | None]:
    """One draw from start to end.

    A draw that becomes non-finite, or whose plant breaks, is frozen at that step: state and accumulators keep
    their last values, its metrics are NaN and its margins -inf, and the batch goes on. One that has settled is frozen
    too, and keeps the metrics that it has.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        key: The draw's own random key.
        measures: What to measure.
        requirements: Bounds of some of the measures.
        every: Record one sample of so many; None: none, so that memory does not grow with the duration.
        together: Name of the mapped axis of the draws that are simulated together: time stops when all of them have
            ended. None: time runs to its end, as derivatives need it.
        segment: See :func:`dssc_jax.marching.in_stretches`.

    Returns:
        The outcome, and the trajectory with leaves of shape (ceil(steps/every),), if any.
    """

    def sample(at: Progress, _: None = None) -> tuple[Progress, Recorded]:
        after, recorded = step(loop, params, key, at.state, at.k)
        updated = update_all(measures, at.accumulators, recorded.instant, at.k, loop.sample_time)
        ended = jnp.where(recorded.whole, Outcome.OK, Outcome.SINGULAR_ATTITUDE)
        ended = jnp.where(recorded.finite, ended, Outcome.NON_FINITE)
        flown = flying(loop, at)
        outcome = jnp.where(flown, ended, at.outcome).astype(jnp.int32)
        alive = flown & (outcome == Outcome.OK)
        calm = calmed(loop, at.calm, recorded.instant, at.k)
        if together is None or loop.settled:  # frozen; else nobody sees what follows but by outcome and metrics
            after, updated, calm = jax.tree.map(
                lambda new, old: jnp.where(alive, new, old),
                (after, updated, calm),
                (at.state, at.accumulators, at.calm),
            )
        return Progress(at.k + 1, after, updated, outcome, at.steps + alive, calm), recorded

    def block(at: Progress, _: None) -> tuple[Progress, Recorded]:
        last = jnp.minimum(at.k + (every or 1), loop.steps)
        at, recorded = sample(at)
        return jax.lax.while_loop(lambda at: at.k < last, lambda at: sample(at)[0], at), recorded

    count = jnp.zeros((), dtype=jnp.int32)
    calm = () if loop.settled is None else count
    at = Progress(count, start(loop, params, key), as_arrays(starts(measures)), count, count, calm)
    if every is None and together is not None:
        goes_on = partial(flying, loop)
        end = until_all_ended(lambda at: sample(at)[0], goes_on, at, loop.steps, together, samples_a_turn(loop))
        recorded = None
    elif every is None:
        end, recorded = in_stretches(lambda at: sample(at)[0], at, loop.steps, segment), None
    elif every == 1:
        end, recorded = jax.lax.scan(sample, at, length=loop.steps)
    else:
        end, recorded = jax.lax.scan(block, at, length=-(-loop.steps // every))
    alive = end.outcome == Outcome.OK
    flown = loop.steps if loop.settled is None else end.steps
    found = values(measures, end.accumulators, flown, loop.sample_time)
    outcome, margins = judge(requirements, found, end.outcome)
    run = Run(
        metrics={name: jnp.where(alive, value, jnp.nan) for name, value in found.items()},
        margins=margins,
        outcome=outcome,
        failed_at=jnp.where(alive, jnp.nan, (end.steps + 1) * loop.sample_time),
        settled_at=jnp.where(alive & (end.steps < loop.steps), end.steps * loop.sample_time, jnp.nan),
    )
    return run, recorded
