"""Simulation of one draw from its first to its last sample: streaming metrics, early ends, and the outcome."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.metrics.accumulation import final_values, initial_accumulators, update_accumulators
from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.closed_loop.metrics.margin_kinds import NO_MARGINS
from dssc_jax.closed_loop.metrics.requirements import Requirement, certain_violations, judge, violated, watch
from dssc_jax.closed_loop.metrics.streaming import Accumulator, Measure
from dssc_jax.closed_loop.metrics.window import first_sample, periods_lasting
from dssc_jax.closed_loop.sample import LoopState, Recorded, held_between_samples, step
from dssc_jax.closed_loop.time_loops import scan_recorded, scan_segments, until_all_ended
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import Outcome, Scalar, State


class Run(NamedTuple):
    """The result of one draw, by the names that result files use.

    Args:
        metrics: Metrics over the whole run, or until the draw settled; NaN if it ended early.
        slacks: Slack of each requirement; -inf if the draw ended early.
        outcome: An :class:`~dssc_jax.core.signals.Outcome`, or the code of the first violated requirement.
        failed_at: Time of the step that ended the draw early [s]; NaN if the draw did not end early.
        settled_at: Time at which the draw ended because it had settled [s]; NaN if it did not settle.
        violated_at: Time of the sample at which the violation of each requirement became certain [s]; NaN if the
            requirement is met.
    """

    metrics: dict[str, Scalar]
    slacks: dict[str, Scalar]
    outcome: Scalar
    failed_at: Scalar
    settled_at: Scalar
    violated_at: dict[str, Scalar]


class Progress(NamedTuple):
    """What a time loop over the samples of a draw carries from one sample to the next.

    The sample index k is counted here, because an array of all indices would grow with the duration.

    Args:
        k: Index of the next sample.
        state: State of the loop.
        accumulators: Accumulators of the metrics.
        outcome: The outcome so far.
        steps: Number of samples that the draw has completed.
        in_band: Number of consecutive samples, up to the last one, with errors small enough to settle; () for a loop
            without a rule for settled draws.
        violations: For each requirement whose violation is final, the number of samples after which it was first
            violated, see :func:`~dssc_jax.closed_loop.metrics.requirements.watch`.
    """

    k: Scalar
    state: LoopState
    accumulators: tuple[Accumulator, ...]
    outcome: Scalar
    steps: Scalar
    in_band: State
    violations: tuple[Scalar, ...]


def initial_progress(
    loop: Loop,
    params: LoopParams,
    key: jax.Array,
    measures: tuple[Measure, ...],
    requirements: tuple[Requirement, ...] = (),
    margins: Mapping[str, Scalar] = NO_MARGINS,
) -> Progress:
    """The carry of the time loop before the first sample.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        measures: The metrics to compute.
        requirements: Bounds on some of the metrics.
        margins: Value of each margin of the linearised loop among the measures, by the measure's name.
    """
    zero = jnp.zeros((), dtype=jnp.int32)
    no_samples = jnp.zeros((), dtype=integer_type())
    ok_outcome = jnp.asarray(Outcome.OK, dtype=integer_type())
    in_band = () if loop.settled is None else zero
    state = initial_state(loop, params, key)
    first_violations = as_arrays(tuple(0.0 for requirement in requirements if requirement.violation_is_final))
    return Progress(
        k=zero,
        state=state,
        accumulators=as_arrays(initial_accumulators(measures, margins)),
        outcome=ok_outcome,
        steps=no_samples,
        in_band=in_band,
        violations=first_violations,
    )


def integer_type() -> type[np.integer]:
    """The integer type as long as the loop's real numbers: int64 with float64, int32 with float32.

    With equal lengths, a vector register of the processor holds as many integers as real numbers.
    """
    return np.int64 if jnp.result_type(float) == jnp.float64 else np.int32


def count_in_band(loop: Loop, in_band: State, instant: Instant, k: Scalar) -> State:
    """Number of consecutive samples up to k whose errors are small enough to settle, in every channel.

    Args:
        loop: The models and the clock.
        in_band: The number up to the previous sample; () for a loop without a rule for settled draws.
        instant: The signals at sample k.
        k: Index of the sample.
    """
    if loop.settled is None:
        return in_band
    is_small = k >= first_sample(loop.settled.after, loop.sample_time)
    for sample in instant.channels:
        is_small = is_small & (jnp.abs(sample.e) <= loop.settled.error)
    return jnp.where(is_small, in_band + 1, 0)


def is_running(loop: Loop, progress: Progress) -> Scalar:
    """Whether a draw has neither ended early nor settled, so that the next sample still counts."""
    is_ok = progress.outcome == Outcome.OK
    if loop.settled is None:
        return is_ok
    return is_ok & (progress.in_band < periods_lasting(loop.settled.hold, loop.sample_time))


def make_sample_step(
    loop: Loop,
    params: LoopParams,
    key: jax.Array,
    measures: tuple[Measure, ...],
    requirements: tuple[Requirement, ...],
    freeze: bool,
) -> Callable[[Progress], tuple[Progress, Recorded]]:
    """Return the function that advances a draw by one sample.

    A draw that has ended keeps its outcome and its number of completed samples.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        measures: The metrics to compute.
        requirements: Bounds on some of the metrics.
        freeze: Whether a draw that has ended also keeps its last state and accumulators, so that all later numbers in
            the time loop are finite.
    """
    advance = held_between_samples(loop, params)

    def sample(progress: Progress) -> tuple[Progress, Recorded]:
        """The carry after one sample, and the signals of this sample."""
        state, recorded = step(loop, params, key, progress.state, progress.k, advance)
        accumulators = update_accumulators(
            measures, progress.accumulators, recorded.instant, progress.k, loop.sample_time
        )
        outcome_now, is_ended = outcome_at_sample(recorded)
        is_active = is_running(loop, progress)
        outcome = jnp.where(is_active, outcome_now, progress.outcome)
        is_completed = is_active & jnp.logical_and(recorded.finite, jnp.logical_not(is_ended))
        in_band = count_in_band(loop, progress.in_band, recorded.instant, progress.k)
        violations = watch(
            requirements, measures, accumulators, progress.violations, progress.k + 1, loop.steps, loop.sample_time
        )
        if freeze:
            state, in_band, violations = jax.tree.map(
                partial(jnp.where, is_completed),
                (state, in_band, violations),
                (progress.state, progress.in_band, progress.violations),
            )
            accumulators = jax.tree.map(partial(updated_leaf, is_completed), accumulators, progress.accumulators)
        return Progress(
            k=progress.k + 1,
            state=state,
            accumulators=accumulators,
            outcome=outcome,
            steps=progress.steps + is_completed,
            in_band=in_band,
            violations=violations,
        ), recorded

    return sample


def outcome_at_sample(recorded: Recorded) -> tuple[Scalar, Scalar]:
    """The outcome code of a draw after a sample, and whether the plant's model ends the draw at this sample.

    The model ends a draw at a singular attitude or on the ground. If the state is not finite, the code says so,
    whatever else has happened.
    """
    integer = integer_type()
    outcome = jnp.where(recorded.broken, integer(Outcome.SINGULAR_ATTITUDE), integer(Outcome.OK))
    is_ended = recorded.broken
    if recorded.grounded is not False:  # a plain False: the plant has no ground
        outcome = jnp.where(recorded.grounded, integer(Outcome.INTO_GROUND), outcome)
        is_ended = jnp.logical_or(is_ended, recorded.grounded)
    return jnp.where(recorded.finite, outcome, integer(Outcome.NON_FINITE)), is_ended


def updated_leaf(is_completed: Scalar, new: jax.Array, old: jax.Array) -> jax.Array:
    """A leaf of an accumulator after a sample: a number changes only if the sample is completed.

    An array always changes: it is a delay line of a formula, on which no final value of a metric depends.

    Args:
        is_completed: Whether the draw was running and has completed the sample.
        new: Leaf of the accumulator after the sample.
        old: The same leaf before the sample.
    """
    is_delay_line = jnp.ndim(new) > 0
    return new if is_delay_line else jnp.where(is_completed, new, old)


def simulate_draw(
    loop: Loop,
    params: LoopParams,
    key: jax.Array,
    measures: tuple[Measure, ...] = (),
    requirements: tuple[Requirement, ...] = (),
    axis_name: str | None = None,
    segment: int | None = None,
    margins: Mapping[str, Scalar] = NO_MARGINS,
) -> Run:
    """Simulate one draw without recording it; memory does not grow with the duration.

    A draw ends early at the sample whose state is not finite, or at which the plant's model is no longer valid. The
    metrics of such a draw are NaN and the slacks -inf, regardless of later values in the time loop. A settled draw
    keeps its metrics.

    The state of a draw that has ended is frozen (see :func:`make_sample_step`) in two cases. If derivatives may be
    taken (``axis_name`` is None), later values must be finite. If draws may settle, their metrics must stay.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        measures: The metrics to compute.
        requirements: Bounds on some of the metrics.
        axis_name: Name of the mapped axis of the draws that share the time loop. The loop stops when all of these draws
            have ended. None: the loop has its full length, as derivatives require.
        segment: See :func:`dssc_jax.closed_loop.time_loops.scan_segments`; for ``axis_name`` = None only.
        margins: Value of each margin of the linearised loop among the measures, by the measure's name.
    """
    freeze = axis_name is None or loop.settled is not None
    sample = make_sample_step(loop, params, key, measures, requirements, freeze)
    begin = initial_progress(loop, params, key, measures, requirements, margins)

    def advance(progress: Progress) -> Progress:
        """The carry after one sample, without a record of its signals."""
        next_progress, _ = sample(progress)
        return next_progress

    if axis_name is None:
        end = scan_segments(advance, begin, loop.steps, segment)
    else:
        end = until_all_ended(advance, partial(is_running, loop), begin, loop.steps, axis_name)
    return conclude(loop, measures, requirements, end)


def simulate_recorded(
    loop: Loop,
    params: LoopParams,
    key: jax.Array,
    measures: tuple[Measure, ...] = (),
    requirements: tuple[Requirement, ...] = (),
    stride: int = 1,
    margins: Mapping[str, Scalar] = NO_MARGINS,
) -> tuple[Run, Recorded]:
    """Simulate one draw and record its trajectory; a draw that has ended stays at its last state.

    Args:
        loop: The models and the clock, as for :func:`simulate_draw`, like all arguments but ``stride``.
        params: Parameters of the models.
        key: The draw's random key.
        measures: The metrics to compute.
        requirements: Bounds on some of the metrics.
        stride: Number of samples from one recorded sample to the next.
        margins: Value of each margin of the linearised loop among the measures, by the measure's name.

    Returns:
        The draw's result, and the trajectory with leaves of shape (ceil(steps/stride),).
    """
    advance = make_sample_step(loop, params, key, measures, requirements, freeze=True)

    def sample(progress: Progress) -> tuple[Progress, Recorded]:
        """The carry after one sample, and the signals of a trajectory."""
        next_progress, recorded = advance(progress)
        return next_progress, recorded._replace(controlled=(), grounded=())  # no trajectory needs them

    first_progress = initial_progress(loop, params, key, measures, requirements, margins)
    last_progress, recorded = scan_recorded(sample, first_progress, loop.steps, stride)
    return conclude(loop, measures, requirements, last_progress), recorded


def conclude(loop: Loop, measures: tuple[Measure, ...], requirements: tuple[Requirement, ...], end: Progress) -> Run:
    """The result of a draw from the carry at its end.

    Args:
        loop: The models and the clock.
        measures: The metrics to compute.
        requirements: Bounds on some of the metrics.
        end: The carry after the last sample of the time loop.
    """
    ok = end.outcome == Outcome.OK
    completed = loop.steps if loop.settled is None else end.steps  # a plain number unless draws may settle
    metrics = final_values(measures, end.accumulators, completed, loop.sample_time)
    outcome, slacks = judge(requirements, metrics, end.outcome)
    certain = certain_violations(requirements, measures, end.accumulators, end.violations, completed, loop.sample_time)
    failed_at = jnp.where(ok, jnp.nan, (end.steps + 1) * loop.sample_time)
    violated_at = {}
    for requirement in requirements:
        samples = certain[requirement.label]  # completed when the violation became certain
        is_certain_before_end = ok | (samples <= end.steps)
        time = jnp.where(is_certain_before_end, (samples - 1) * loop.sample_time, failed_at)
        is_violated = violated(slacks[requirement.name])
        violated_at[requirement.violation_name] = jax.lax.stop_gradient(jnp.where(is_violated, time, jnp.nan))
    return Run(
        metrics={name: jnp.where(ok, value, jnp.nan) for name, value in metrics.items()},
        slacks=slacks,
        outcome=outcome,
        failed_at=failed_at,
        settled_at=jnp.where(ok & (end.steps < loop.steps), end.steps * loop.sample_time, jnp.nan),
        violated_at=violated_at,
    )
