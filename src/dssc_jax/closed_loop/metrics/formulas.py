"""Formulas of signal temporal logic over the samples of a flight: their robustness, with memory of a fixed size.

A flight satisfies a formula or violates it. The robustness rho tells by how much: it is positive if the flight
satisfies the formula, and negative if it does not. With times in samples, and comparisons as margins that are positive
where they hold,

    rho(not p, k) = -rho(p, k),   rho(p and q, k) = min(rho(p, k), rho(q, k)),   rho(p or q, k) = max(...),
    rho(always[a,b] p, k) = min of rho(p, j) over k + a <= j <= k + b,   eventually: the max,
    rho(p until[a,b] q, k) = max over the same j of min(rho(q, j), min of rho(p, i) over k <= i < j).

The value of a flight is rho(formula, 0). An outermost operator is needed at one instant only, and keeps the smallest or
largest value so far (:class:`Latch`). An operator within another one is needed at many instants, and takes the smallest
or largest value of a sliding window (:mod:`dssc_jax.closed_loop.metrics.formula_streams`).

References:
    A. Donze, O. Maler, "Robust satisfaction of temporal logic over real-valued signals", FORMATS 2010, definition 3.
    A. Donze, T. Ferrere, O. Maler, "Efficient robust monitoring for STL", CAV 2013.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.metrics.formula_streams import (
    EXACT,
    Combination,
    DelayLines,
    Extremes,
    Stream,
    smooth_extremes,
)
from dssc_jax.closed_loop.metrics.formula_tree import (
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Not,
    Or,
    Timed,
    Until,
    horizon,
    parts_of,
)
from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.closed_loop.metrics.streaming import Metric, Scope, Span
from dssc_jax.closed_loop.metrics.window import Window
from dssc_jax.core.signals import Scalar

FAR = 1e30
"""A robustness, or a number of samples, larger than any other.

It is finite, because the difference of two infinities is NaN.
"""


class Latch(NamedTuple):
    """The memory, during a flight, of a formula whose robustness is needed at one sample only.

    Args:
        value: Robustness of the formula over the samples so far.
        smallest_before: For ``until``, the smallest robustness of ``before`` so far; :data:`FAR` for other formulas.
        decision: Number of samples after which the truth of the formula was certain; 0: it is not certain yet.
    """

    value: Scalar
    smallest_before: Scalar
    decision: Scalar


class LatchedFormula(NamedTuple):
    """A formula whose robustness is needed at one sample only.

    Args:
        formula: The formula.
        at: Index of the sample.
    """

    formula: Formula
    at: int


def latched_formulas(formula: Formula, at: int = 0) -> Iterator[LatchedFormula]:
    """Yield the parts of a formula whose values are needed at one sample only; each has a :class:`Latch`.

    These parts are the outermost temporal operators of the formula, and the comparisons outside of all such operators.

    Args:
        formula: The formula.
        at: The sample at which the formula is evaluated.
    """
    match formula:
        case Not() | And() | Or():
            for part in parts_of(formula):
                yield from latched_formulas(part, at)
        case Always() | Eventually() if formula.begin == formula.end:  # its inner formula, at one later sample
            yield from latched_formulas(formula.inner, at + formula.begin)
        case _:
            yield LatchedFormula(formula, at)


def initial_latch(latched: LatchedFormula) -> Latch:
    """The latch of a formula before the first sample, with values that the first robustness replaces.

    A latch that keeps the largest value starts at -:data:`FAR`, and one that keeps the smallest value at :data:`FAR`.
    """
    keeps_largest = isinstance(latched.formula, Eventually | Until)
    return Latch(value=-FAR if keeps_largest else FAR, smallest_before=FAR, decision=0.0)


def next_latch(latched: LatchedFormula, latch: Latch, stream: Stream, k: Scalar) -> Latch:
    """The latch of a formula after sample k.

    ``always`` keeps the smallest robustness in its interval; ``eventually`` and ``until`` keep the largest. The first
    violation decides ``always``, and the first success decides the other two. ``until`` is also decided once ``before``
    has failed: it can never hold again.

    Args:
        latched: The formula, a temporal operator or a comparison, and the sample at which its value is needed.
        latch: The latch before the sample.
        stream: Evaluates the formula's parts, delayed by the longest of their horizons.
        k: Index of the sample.
    """
    formula = latched.formula
    minimum, maximum = stream.extremes
    if isinstance(formula, Comparison):
        return latch._replace(value=jnp.where(k == latched.at, stream.margin(formula), latch.value))
    assert isinstance(formula, Timed)
    parts = parts_of(formula)
    instant = k - max(map(horizon, parts))  # sample to which the values of the parts belong
    values = stream.aligned(parts)
    value = values[-1]  # of the inner formula, or of the goal of `until`
    is_in_window = (instant >= latched.at + formula.begin) & (instant <= latched.at + formula.end)
    smallest_before = latch.smallest_before
    if isinstance(formula, Until):
        before, _ = values
        value = minimum(smallest_before, value)
        is_waiting = (instant >= latched.at) & (instant < latched.at + formula.end)
        smallest_before = jnp.where(is_waiting, minimum(smallest_before, before), smallest_before)
    combine = minimum if isinstance(formula, Always) else maximum
    value = jnp.where(is_in_window, combine(latch.value, value), latch.value)
    is_certain = value < 0.0 if isinstance(formula, Always) else value >= 0.0
    if isinstance(formula, Until):
        is_certain = is_certain | (smallest_before < 0.0)
    is_decided_now = is_certain & (latch.decision == 0.0)
    samples = jnp.asarray(k + 1, jnp.result_type(float))
    return Latch(value, smallest_before, jnp.where(is_decided_now, samples, latch.decision))


class Judgement(NamedTuple):
    """The verdict on a formula at the end of a flight.

    Args:
        value: Robustness of the formula.
        decision: Number of samples after which the truth of the formula was certain.
    """

    value: Scalar
    decision: Scalar


def judge_formula(formula: Formula, latches: Iterator[Latch], extremes: Extremes, at: int = 0) -> Judgement:
    """The verdict on a formula, from the latches of its parts at the end of a flight.

    Args:
        formula: The formula.
        latches: The latches of the formula's :func:`latched_formulas`, in the same order; each is taken once.
        extremes: Exact or smooth minimum and maximum.
        at: The sample at which the formula is evaluated.
    """
    match formula:
        case Not():
            inner = judge_formula(formula.inner, latches, extremes, at)
            return Judgement(-inner.value, inner.decision)
        case And() | Or():
            is_conjunction = isinstance(formula, And)
            combine = extremes.minimum if is_conjunction else extremes.maximum
            parts = [judge_formula(part, latches, extremes, at) for part in formula.parts]
            return reduce(partial(judge_jointly, combine, is_conjunction), parts)
        case Always() | Eventually() if formula.begin == formula.end:  # its inner formula, at one later sample
            return judge_formula(formula.inner, latches, extremes, at + formula.begin)
        case _:
            latch = next(latches)
            was_decided = latch.decision > 0.0
            latest_decision = float(at + horizon(formula) + 1)  # all samples on which it depends
            return Judgement(latch.value, jnp.where(was_decided, latch.decision, latest_decision))


def judge_jointly(combine: Combination, is_conjunction: bool, first: Judgement, second: Judgement) -> Judgement:
    """The verdict on "first and second", or on "first or second".

    One false part decides "and", and one true part decides "or". Otherwise the verdict is certain once both parts are.

    Args:
        combine: Minimum for "and", maximum for "or".
        is_conjunction: Whether the formula is "and".
        first: Verdict on the first part.
        second: Verdict on the second part.
    """
    first_alone = jnp.where((first.value < 0.0) == is_conjunction, first.decision, FAR)
    second_alone = jnp.where((second.value < 0.0) == is_conjunction, second.decision, FAR)
    by_one_part = jnp.minimum(first_alone, second_alone)
    by_both_parts = jnp.maximum(first.decision, second.decision)
    return Judgement(combine(first.value, second.value), jnp.where(by_one_part < FAR, by_one_part, by_both_parts))


class Evaluation(NamedTuple):
    """The memory of a formula's evaluation during a flight.

    Args:
        latches: Latch of each of the formula's :func:`latched_formulas`.
        memory: The array of all delay lines, shape (:func:`memory_size`,); () for a formula without delay lines.
    """

    latches: tuple[Latch, ...]
    memory: jax.Array | np.ndarray | tuple[()]


class FormulaState(NamedTuple):
    """The accumulator of a formula's metric.

    Args:
        exact: Evaluation of the exact robustness, which gives the value.
        smooth: Evaluation of the smooth robustness, which gives the derivatives; () if the exact one gives these, too.
    """

    exact: Evaluation
    smooth: Evaluation | tuple[()] = ()


def initial_evaluation(formula: Formula) -> Evaluation:
    """The state of a formula's evaluation before the first sample."""
    latches = tuple(map(initial_latch, latched_formulas(formula)))
    size = memory_size(formula)
    return Evaluation(latches, np.zeros(size) if size else ())


def memory_size(formula: Formula) -> int:
    """Number of values that the delay lines of a formula hold together.

    To count the values, the formula is evaluated once with plain zeros in place of signals.
    """
    stream = Stream(lambda comparison: 0.0, DelayLines(), Extremes(min, max))
    for latched in latched_formulas(formula):
        if isinstance(latched.formula, Timed):
            stream.aligned(parts_of(latched.formula))
    return stream.lines.size


def next_evaluation(formula: Formula, extremes: Extremes, state: Evaluation, instant: Instant) -> Evaluation:
    """The state of a formula's evaluation after a sample.

    Args:
        formula: The formula.
        extremes: Exact or smooth minimum and maximum.
        state: The state before the sample.
        instant: The signals at the sample.
    """
    k = instant.channels[0].k  # the same in all channels
    memory = None if isinstance(state.memory, tuple) else state.memory  # (): the formula has no delay line
    lines = DelayLines(memory, k)
    stream = Stream(lambda comparison: comparison.margin(instant), lines, extremes)
    latches = []
    for latched, latch in zip(latched_formulas(formula), state.latches, strict=True):
        latches.append(next_latch(latched, latch, stream, k))
    return Evaluation(tuple(latches), state.memory if lines.memory is None else lines.memory)


@jax.custom_jvp
def with_slope_of(value: Scalar, substitute: Scalar) -> Scalar:
    """The value, with the derivatives of the substitute in place of its own.

    :func:`slope_of_substitute` defines these derivatives; the number ``substitute`` itself is not used.
    """
    return value


@with_slope_of.defjvp
def slope_of_substitute(at: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    """The JVP of :func:`with_slope_of`: the value itself, with the tangent of the substitute.

    Args:
        at: The value, and the substitute.
        tangents: Tangents of both; that of the value is not read.
    """
    value, _ = at
    _, substitute_tangent = tangents
    return value, substitute_tangent


@dataclass(frozen=True)
class RobustnessUpdate:
    """The function that adds a sample to a formula's metric, its field ``update``.

    Args:
        formula: The formula.
        width: Width of the smooth minimum.
    """

    formula: Formula
    width: float

    def __call__(self, state: FormulaState, instant: Instant, window: Window) -> FormulaState:
        """The metric's accumulator after a sample; a formula has its own instants, so ``window`` is not read."""
        exact = next_evaluation(self.formula, EXACT, state.exact, instant)
        if not isinstance(state.smooth, Evaluation):
            return FormulaState(exact)
        return FormulaState(exact, next_evaluation(self.formula, smooth_extremes(self.width), state.smooth, instant))


@dataclass(frozen=True)
class RobustnessValue:
    """The function that gives a formula's robustness at the end of a flight, the field ``value`` of its metric.

    Args:
        formula: The formula.
        width: Width of the smooth minimum.
    """

    formula: Formula
    width: float

    def __call__(self, state: FormulaState, window: Window, span: Span) -> Scalar:
        """The exact robustness; if there is a smooth robustness, with the derivatives of the smooth one.

        A formula has its own instants, so ``window`` and ``span`` are not read.
        """
        exact = judge_formula(self.formula, iter(state.exact.latches), EXACT)
        if not isinstance(state.smooth, Evaluation):
            return exact.value
        smooth = judge_formula(self.formula, iter(state.smooth.latches), smooth_extremes(self.width))
        return with_slope_of(exact.value, smooth.value)


@dataclass(frozen=True)
class DecisionTime:
    """The function that tells when a formula's truth was certain, the field ``certain_after`` of its metric."""

    formula: Formula

    def __call__(self, state: FormulaState) -> Scalar:
        """Number of samples after which the formula's truth was certain, from the state at the end of a flight."""
        return judge_formula(self.formula, iter(state.exact.latches), EXACT).decision


def formula_metric(formula: Formula, unit: str, meaning: str, width: float) -> Metric:
    """The robustness of a formula as a metric.

    Args:
        formula: The formula.
        unit: Unit of its comparisons.
        meaning: The formula in words.
        width: Width of the smooth minimum in that unit, which gives the derivatives; 0: the exact minimum gives them.
    """
    evaluation = initial_evaluation(formula)
    start = FormulaState(exact=evaluation, smooth=evaluation if width else ())
    update = RobustnessUpdate(formula, width)
    value = RobustnessValue(formula, width)
    return Metric(unit, meaning, update, value, scope=Scope.VEHICLE, start=start, certain_after=DecisionTime(formula))
