"""Formulas of signal temporal logic over the samples of a flight: their robustness, with memory of a fixed size.

A flight satisfies a formula or violates it. The robustness rho tells by how much: it is positive if the flight
satisfies the formula, and negative if it does not. With times in samples, and comparisons as margins that are positive
where they hold,

    rho(not p, k) = -rho(p, k),   rho(p and q, k) = min(rho(p, k), rho(q, k)),   rho(p or q, k) = max(...),
    rho(always[a,b] p, k) = min of rho(p, j) over k + a <= j <= k + b,   eventually: the max,
    rho(p until[a,b] q, k) = max over the same j of min(rho(q, j), min of rho(p, i) over k <= i < j).

The value of a flight is rho(formula, 0). An outermost operator is needed at one instant only, and keeps the smallest or
largest value so far (:class:`Latch`). An operator within another one is needed at many instants, and takes the smallest
or largest value of a sliding window. A window of 2, 4, 8, ... samples combines two windows of half its size, the older
of which comes out of a delay line. The two may overlap, since minimum, maximum and ``until`` are idempotent.

References:
    A. Donze, O. Maler, "Robust satisfaction of temporal logic over real-valued signals", FORMATS 2010, definition 3.
    A. Donze, T. Ferrere, O. Maler, "Efficient robust monitoring for STL", CAV 2013.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

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
"""A robustness larger than any other; finite, because the difference of two infinities is NaN."""


Combination: TypeAlias = Callable[[Scalar, Scalar], Scalar]


class Extremes(NamedTuple):
    """Minimum and maximum of two numbers, exact or smooth."""

    minimum: Combination
    maximum: Combination


EXACT = Extremes(jnp.minimum, jnp.maximum)


def smooth_minimum(width: float, a: Scalar, b: Scalar) -> Scalar:
    """-w ln(exp(-a/w) + exp(-b/w)) for a width w: smooth, and below min(a, b) by at most w ln 2."""
    return jnp.minimum(a, b) - width * jnp.log1p(jnp.exp(-jnp.abs(a - b) / width))


def smooth_extremes(width: float) -> Extremes:
    """A minimum and a maximum with derivatives everywhere; see :func:`smooth_minimum`."""
    minimum = partial(smooth_minimum, width)
    return Extremes(minimum, lambda a, b: -minimum(-a, -b))


Aggregate: TypeAlias = tuple[Scalar, ...]
"""The value of a sliding window: one number, or two for ``until``."""


class DelayLines:
    """Delays of values by whole samples, all in one array.

    Args:
        memory: The array; None: only its size is counted.
        k: Index of the sample.
    """

    def __init__(self, memory: jax.Array | np.ndarray | None = None, k: Scalar = 0) -> None:
        self.memory = memory
        self.k = k
        self.size = 0

    def delayed(self, value: Scalar, samples: int) -> Scalar:
        """The value that this line received some samples ago; 0 before the first sample."""
        if not samples:
            return value
        start = self.size
        self.size += samples
        if self.memory is None:
            return value
        place = start + jax.lax.rem(jnp.asarray(self.k, jnp.int32), np.int32(samples))
        old = jax.lax.dynamic_index_in_dim(self.memory, place, keepdims=False)
        self.memory = jax.lax.dynamic_update_index_in_dim(self.memory, value, place, 0)
        return old


@dataclass
class Stream:
    """Evaluation of formulas at every sample, with a delay: the present sample k gives the value at k - horizon.

    Args:
        margin: Margin of a comparison at the present sample.
        lines: The delay lines, which are used in the same order at every sample.
        extremes: Exact or smooth minimum and maximum.
    """

    margin: Callable[[Comparison], Scalar]
    lines: DelayLines
    extremes: Extremes

    def value(self, formula: Formula) -> Scalar:
        """The robustness of a formula at ``horizon(formula)`` samples before the present one."""
        match formula:
            case Comparison():
                return self.margin(formula)
            case Not():
                return -self.value(formula.inner)
            case And():
                return reduce(self.extremes.minimum, self.aligned(formula.parts))
            case Or():
                return reduce(self.extremes.maximum, self.aligned(formula.parts))
            case Until():
                return self.until(formula)
        minimum, maximum = self.extremes
        combine = minimum if isinstance(formula, Always) else maximum
        width = formula.end - formula.begin + 1
        (value,) = self.window((self.value(formula.inner),), width, lambda old, new: (combine(old[0], new[0]),))
        return value

    def aligned(self, formulas: Sequence[Formula]) -> list[Scalar]:
        """The values of several formulas at one instant, set by the longest horizon; the others are delayed."""
        latest = max(map(horizon, formulas))
        return [self.lines.delayed(self.value(formula), latest - horizon(formula)) for formula in formulas]

    def window(self, value: Aggregate, width: int, combine: Callable[[Aggregate, Aggregate], Aggregate]) -> Aggregate:
        """The combination of a signal's last ``width`` values.

        Args:
            value: The present value.
            width: Number of values.
            combine: Associative function of an older and a newer value.
        """
        span = 1
        while span < width:
            step = min(span, width - span)
            older = tuple(self.lines.delayed(part, step) for part in value)
            value = combine(older, value)
            span += step
        return value

    def until(self, formula: Until) -> Scalar:
        """The robustness of ``until``: over a window, the pair of its value and the smallest value of ``before``."""
        minimum, maximum = self.extremes
        condition, goal = self.aligned(parts_of(formula))

        def combine(old: Aggregate, new: Aggregate) -> Aggregate:
            return maximum(old[0], minimum(old[1], new[0])), minimum(old[1], new[1])

        width = formula.end - formula.begin + 1
        value, _ = self.window((goal, condition), width, combine)
        if not formula.begin:
            return value
        (smallest_before,) = self.window((condition,), formula.begin, lambda old, new: (minimum(old[0], new[0]),))
        return minimum(self.lines.delayed(smallest_before, width), value)


class Latch(NamedTuple):
    """State of a formula whose robustness is needed at one instant only.

    Args:
        value: Its robustness so far.
        smallest_before: For ``until``, the smallest robustness of ``before`` so far.
        decision: Number of samples after which its truth was certain; 0: not yet.
    """

    value: Scalar
    smallest_before: Scalar
    decision: Scalar


class LatchedFormula(NamedTuple):
    """A formula whose robustness is needed at one instant only, the sample ``at``."""

    formula: Formula
    at: int


def latched_formulas(formula: Formula, at: int = 0) -> Iterator[LatchedFormula]:
    """The parts of a formula that are needed at one instant: its outermost temporal operators, and comparisons.

    Args:
        formula: The formula.
        at: The sample at which it is evaluated.
    """
    match formula:
        case Not() | And() | Or():
            for part in parts_of(formula):
                yield from latched_formulas(part, at)
        case Always() | Eventually() if formula.begin == formula.end:
            yield from latched_formulas(formula.inner, at + formula.begin)
        case _:
            yield LatchedFormula(formula, at)


def initial_latch(latched: LatchedFormula) -> Latch:
    """The latch before the first sample."""
    return Latch(-FAR if isinstance(latched.formula, Eventually | Until) else FAR, FAR, 0.0)


def next_latch(latched: LatchedFormula, latch: Latch, stream: Stream, k: Scalar) -> Latch:
    """The latch of a formula after sample k; ``stream`` evaluates its parts."""
    formula = latched.formula
    minimum, maximum = stream.extremes
    if isinstance(formula, Comparison):
        return latch._replace(value=jnp.where(k == latched.at, stream.margin(formula), latch.value))
    assert isinstance(formula, Timed)
    parts = parts_of(formula)
    instant = k - max(map(horizon, parts))
    *operands, value = stream.aligned(parts)
    is_in_window = (instant >= latched.at + formula.begin) & (instant <= latched.at + formula.end)
    smallest_before = latch.smallest_before
    if operands:  # of `until`
        value = minimum(smallest_before, value)
        is_waiting = (instant >= latched.at) & (instant < latched.at + formula.end)
        smallest_before = jnp.where(is_waiting, minimum(smallest_before, operands[0]), smallest_before)
    combine = minimum if isinstance(formula, Always) else maximum
    value = jnp.where(is_in_window, combine(latch.value, value), latch.value)
    is_certain = value < 0.0 if isinstance(formula, Always) else value >= 0.0
    if operands:
        is_certain = is_certain | (smallest_before < 0.0)
    samples = jnp.asarray(k + 1, jnp.result_type(float))
    return Latch(value, smallest_before, jnp.where(is_certain & (latch.decision == 0.0), samples, latch.decision))


class Judgement(NamedTuple):
    """The robustness of a formula, and the number of samples after which its truth is certain."""

    value: Scalar
    decision: Scalar


def judgement(formula: Formula, latches: Iterator[Latch], extremes: Extremes, at: int = 0) -> Judgement:
    """A formula's robustness, and the number of samples that decide its truth, from the latches at the end of a flight.

    Args:
        formula: The formula.
        latches: The latches of the formulas of :func:`latched_formulas`, in its order.
        extremes: Exact or smooth minimum and maximum.
        at: The sample at which the formula is evaluated.
    """
    match formula:
        case Not():
            inner = judgement(formula.inner, latches, extremes, at)
            return Judgement(-inner.value, inner.decision)
        case And() | Or():
            combine = extremes.minimum if isinstance(formula, And) else extremes.maximum
            parts = [judgement(part, latches, extremes, at) for part in formula.parts]
            return reduce(partial(joint_judgement, combine, isinstance(formula, And)), parts)
        case Always() | Eventually() if formula.begin == formula.end:  # its inner formula, at one later sample
            return judgement(formula.inner, latches, extremes, at + formula.begin)
        case _:
            latch = next(latches)
            latest_decision = float(at + horizon(formula) + 1)  # all samples that it needs, if fewer do not decide it
            return Judgement(latch.value, jnp.where(latch.decision > 0.0, latch.decision, latest_decision))


def joint_judgement(combine: Combination, conjunction: bool, first: Judgement, second: Judgement) -> Judgement:
    """The judgement of a conjunction (or disjunction) of two parts, certain once one part decides it or both are.

    Args:
        combine: Minimum for a conjunction, maximum for a disjunction.
        conjunction: Whether it is a conjunction.
        first: Judgement of the first part.
        second: Judgement of the second part.
    """
    decisive = [jnp.where((part.value < 0.0) == conjunction, part.decision, FAR) for part in (first, second)]
    early = jnp.minimum(*decisive)
    late = jnp.maximum(first.decision, second.decision)
    return Judgement(combine(first.value, second.value), jnp.where(early < FAR, early, late))


class Evaluation(NamedTuple):
    """State of a formula's evaluation during a flight: its latches, and the array of its delay lines, () if none."""

    latches: tuple[Latch, ...]
    memory: jax.Array | np.ndarray | tuple[()]


class FormulaState(NamedTuple):
    """State of a formula's metric: evaluations of the exact and the smooth robustness; () without a smooth one."""

    exact: Evaluation
    smooth: Evaluation | tuple[()] = ()


def initial_evaluation(formula: Formula) -> Evaluation:
    """The state before the first sample."""
    latches = tuple(map(initial_latch, latched_formulas(formula)))
    size = memory_size(formula)
    return Evaluation(latches, np.zeros(size) if size else ())


def memory_size(formula: Formula) -> int:
    """Number of values in the delay lines of a formula."""
    stream = Stream(lambda comparison: 0.0, DelayLines(), Extremes(min, max))
    for latched in latched_formulas(formula):
        if isinstance(latched.formula, Timed):
            stream.aligned(parts_of(latched.formula))
    return stream.lines.size


def next_evaluation(formula: Formula, extremes: Extremes, state: Evaluation, instant: Instant) -> Evaluation:
    """The state of a formula's evaluation after a sample."""
    k = instant.channels[0].k
    lines = DelayLines(None if isinstance(state.memory, tuple) else state.memory, k)
    stream = Stream(lambda comparison: comparison.margin(instant), lines, extremes)
    pairs = zip(latched_formulas(formula), state.latches, strict=True)
    latches = tuple(next_latch(latched, latch, stream, k) for latched, latch in pairs)
    return Evaluation(latches, state.memory if lines.memory is None else lines.memory)


@jax.custom_jvp
def with_slope_of(value: Scalar, substitute: Scalar) -> Scalar:
    """The value, with the derivatives of a substitute in place of its own."""
    return value


@with_slope_of.defjvp
def slope_of_substitute(at: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    """The value, and the tangent of the substitute."""
    return at[0], tangents[1]


@dataclass(frozen=True)
class RobustnessUpdate:
    """The field ``update`` of a formula's metric; ``width`` is that of the smooth minimum."""

    formula: Formula
    width: float

    def __call__(self, state: FormulaState, instant: Instant, window: Window) -> FormulaState:
        """The state after a sample."""
        exact = next_evaluation(self.formula, EXACT, state.exact, instant)
        if not isinstance(state.smooth, Evaluation):
            return FormulaState(exact)
        return FormulaState(exact, next_evaluation(self.formula, smooth_extremes(self.width), state.smooth, instant))


@dataclass(frozen=True)
class RobustnessValue:
    """The field ``value`` of a formula's metric; ``width`` is that of the smooth minimum."""

    formula: Formula
    width: float

    def __call__(self, state: FormulaState, window: Window, span: Span) -> Scalar:
        """The exact robustness, with the derivatives of the smooth one."""
        value = judgement(self.formula, iter(state.exact.latches), EXACT).value
        if not isinstance(state.smooth, Evaluation):
            return value
        return with_slope_of(
            value, judgement(self.formula, iter(state.smooth.latches), smooth_extremes(self.width)).value
        )


@dataclass(frozen=True)
class DecisionTime:
    """The field ``certain_after`` of a formula's metric."""

    formula: Formula

    def __call__(self, state: FormulaState) -> Scalar:
        """The number of samples after which the formula's truth was certain, from the state at the end of a flight."""
        return judgement(self.formula, iter(state.exact.latches), EXACT).decision


def formula_metric(formula: Formula, unit: str, meaning: str, width: float) -> Metric:
    """The robustness of a formula as a metric.

    Args:
        formula: The formula.
        unit: Unit of its comparisons.
        meaning: The formula in words.
        width: Width of the smooth minimum in that unit, from which derivatives follow; 0: those of the exact one.
    """
    evaluation = initial_evaluation(formula)
    start = FormulaState(evaluation, evaluation if width else ())
    update = RobustnessUpdate(formula, width)
    value = RobustnessValue(formula, width)
    return Metric(unit, meaning, update, value, scope=Scope.VEHICLE, start=start, certain_after=DecisionTime(formula))
