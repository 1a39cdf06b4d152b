"""Formulas of signal temporal logic over the samples of a flight: their robustness, with memory of a fixed size.

A formula is true or false of a flight, and its robustness says by how much: positive if it is true, negative if it is
false. With times in samples, and comparisons as margins that are positive where they hold,

    rho(not p, k) = -rho(p, k),   rho(p and q, k) = min(rho(p, k), rho(q, k)),   rho(p or q, k) = max(...),
    rho(always[a,b] p, k) = min of rho(p, j) over k + a <= j <= k + b,   eventually: the max,
    rho(p until[a,b] q, k) = max over the same j of min(rho(q, j), min of rho(p, i) over k <= i < j).

The value of a flight is rho(formula, 0). An operator whose value is needed at one instant only, as the outermost ones,
keeps the smallest or largest value so far (:class:`Latch`). One that is needed at many instants takes the smallest
value of a sliding window: windows of 2, 4, 8, ... samples are each made of two of half the size, the older of which
comes out of a delay line. Windows that overlap do no harm, since minimum, maximum and ``until`` count no sample twice.

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

from dssc_jax.closed_loop.formula_tree import (
    Always,
    Any,
    Comparison,
    Eventually,
    Every,
    Formula,
    Not,
    Timed,
    Until,
    horizon,
    parts_of,
)
from dssc_jax.closed_loop.metrics import Instant, Metric, Scope, Span
from dssc_jax.closed_loop.window import Window
from dssc_jax.core.signals import Scalar

FAR = 1e30
"""Beyond every robustness; a finite number, since differences of infinities are none."""


Combination: TypeAlias = Callable[[Scalar, Scalar], Scalar]


class Extremes(NamedTuple):
    """The smaller and the larger of two numbers."""

    smaller: Combination
    larger: Combination


EXACT = Extremes(jnp.minimum, jnp.maximum)


def softly_smaller(width: float, a: Scalar, b: Scalar) -> Scalar:
    """-w ln(exp(-a/w) + exp(-b/w)): smooth, and below the smaller number by at most w ln 2."""
    return jnp.minimum(a, b) - width * jnp.log1p(jnp.exp(-jnp.abs(a - b) / width))


def smooth(width: float) -> Extremes:
    """Extremes with derivatives everywhere, for a width > 0."""
    smaller = partial(softly_smaller, width)
    return Extremes(smaller, lambda a, b: -smaller(-a, -b))


Pair: TypeAlias = tuple[Scalar, ...]


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
        """The value of some samples ago; before the first sample, zero."""
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
    """Values of formulas at every sample, each as soon as it is decided: ``horizon`` samples later.

    Args:
        margin: Margin of a comparison at the present sample.
        lines: The delay lines, which are used in the same order at every sample.
        extremes: Exact or smooth.
    """

    margin: Callable[[Comparison], Scalar]
    lines: DelayLines
    extremes: Extremes

    def value(self, formula: Formula) -> Scalar:
        """The robustness of a formula ``horizon`` samples ago."""
        match formula:
            case Comparison():
                return self.margin(formula)
            case Not():
                return -self.value(formula.inner)
            case Every():
                return reduce(self.extremes.smaller, self.aligned(formula.parts))
            case Any():
                return reduce(self.extremes.larger, self.aligned(formula.parts))
            case Until():
                return self.until(formula)
        smaller, larger = self.extremes
        combine = smaller if isinstance(formula, Always) else larger
        width = formula.end - formula.begin + 1
        (value,) = self.window((self.value(formula.inner),), width, lambda old, new: (combine(old[0], new[0]),))
        return value

    def aligned(self, formulas: Sequence[Formula]) -> list[Scalar]:
        """The values of several formulas at one instant: those that are decided earlier wait."""
        latest = max(map(horizon, formulas))
        return [self.lines.delayed(self.value(formula), latest - horizon(formula)) for formula in formulas]

    def window(self, value: Pair, width: int, combine: Callable[[Pair, Pair], Pair]) -> Pair:
        """The combination of the last ``width`` values, the older one as the first argument."""
        span = 1
        while span < width:
            step = min(span, width - span)
            older = tuple(self.lines.delayed(part, step) for part in value)
            value = combine(older, value)
            span += step
        return value

    def until(self, formula: Until) -> Scalar:
        """The robustness of ``until``: over a window, the pair of its value and the smallest value of ``before``."""
        smaller, larger = self.extremes
        before, goal = self.aligned(parts_of(formula))

        def combine(old: Pair, new: Pair) -> Pair:
            return larger(old[0], smaller(old[1], new[0])), smaller(old[1], new[1])

        width = formula.end - formula.begin + 1
        value, _ = self.window((goal, before), width, combine)
        if not formula.begin:
            return value
        (held,) = self.window((before,), formula.begin, lambda old, new: (smaller(old[0], new[0]),))
        return smaller(self.lines.delayed(held, width), value)


class Latch(NamedTuple):
    """What is kept of a formula that is needed at one instant.

    Args:
        value: Its robustness so far.
        held: For ``until``, the smallest value of ``before`` so far.
        decided: Number of samples after which its truth was certain before its end; 0: not yet.
    """

    value: Scalar
    held: Scalar
    decided: Scalar


class Required(NamedTuple):
    """A formula that is needed at one instant, the sample ``at``."""

    formula: Formula
    at: int


def required(formula: Formula, at: int = 0) -> Iterator[Required]:
    """The formulas with a latch: the outermost operators in time, and comparisons outside of such."""
    match formula:
        case Not() | Every() | Any():
            for part in parts_of(formula):
                yield from required(part, at)
        case Always() | Eventually() if formula.begin == formula.end:
            yield from required(formula.inner, at + formula.begin)
        case _:
            yield Required(formula, at)


def first_latch(of: Required) -> Latch:
    """The latch before the first sample."""
    return Latch(-FAR if isinstance(of.formula, Eventually | Until) else FAR, FAR, 0.0)


def next_latch(of: Required, latch: Latch, stream: Stream, k: Scalar) -> Latch:
    """The latch after sample ``k``."""
    formula = of.formula
    smaller, larger = stream.extremes
    if isinstance(formula, Comparison):
        return latch._replace(value=jnp.where(k == of.at, stream.margin(formula), latch.value))
    assert isinstance(formula, Timed)
    parts = parts_of(formula)
    instant = k - max(map(horizon, parts))
    *before, value = stream.aligned(parts)
    inside = (instant >= of.at + formula.begin) & (instant <= of.at + formula.end)
    held = latch.held
    if before:
        value = smaller(held, value)
        waits = (instant >= of.at) & (instant < of.at + formula.end)
        held = jnp.where(waits, smaller(held, before[0]), held)
    combine = smaller if isinstance(formula, Always) else larger
    value = jnp.where(inside, combine(latch.value, value), latch.value)
    certain = value < 0.0 if isinstance(formula, Always) else value >= 0.0
    if before:
        certain = certain | (held < 0.0)
    samples = jnp.asarray(k + 1, jnp.result_type(float))
    return Latch(value, held, jnp.where(certain & (latch.decided == 0.0), samples, latch.decided))


class Judgement(NamedTuple):
    """The robustness of a formula, and the number of samples after which its truth is certain."""

    value: Scalar
    certain: Scalar


def judged(formula: Formula, latches: Iterator[Latch], extremes: Extremes, at: int = 0) -> Judgement:
    """A formula at the end of a flight, from its latches in the order of :func:`required`."""
    match formula:
        case Not():
            inner = judged(formula.inner, latches, extremes, at)
            return Judgement(-inner.value, inner.certain)
        case Every() | Any():
            combine = extremes.smaller if isinstance(formula, Every) else extremes.larger
            parts = [judged(part, latches, extremes, at) for part in formula.parts]
            return reduce(partial(together, combine, isinstance(formula, Every)), parts)
        case Always() | Eventually() if formula.begin == formula.end:
            return judged(formula.inner, latches, extremes, at + formula.begin)
    latch = next(latches)
    end = float(at + horizon(formula) + 1)
    return Judgement(latch.value, jnp.where(latch.decided > 0.0, latch.decided, end))


def together(combine: Combination, every: bool, first: Judgement, second: Judgement) -> Judgement:
    """The conjunction of two judgements, or their disjunction: one part may decide it, or both must be certain."""
    decisive = [jnp.where((part.value < 0.0) == every, part.certain, FAR) for part in (first, second)]
    early = jnp.minimum(*decisive)
    late = jnp.maximum(first.certain, second.certain)
    return Judgement(combine(first.value, second.value), jnp.where(early < FAR, early, late))


class Machine(NamedTuple):
    """All that is kept of a formula during a flight."""

    latches: tuple[Latch, ...]
    memory: jax.Array | np.ndarray | tuple[()]


class FormulaState(NamedTuple):
    """The exact robustness, and the smooth one whose derivatives it has; () without."""

    exact: Machine
    smooth: Machine | tuple[()] = ()


def first_machine(formula: Formula) -> Machine:
    """The state before the first sample."""
    latches = tuple(map(first_latch, required(formula)))
    size = memory_size(formula)
    return Machine(latches, np.zeros(size) if size else ())


def memory_size(formula: Formula) -> int:
    """Numbers that the delay lines of a formula hold."""
    stream = Stream(lambda comparison: 0.0, DelayLines(), Extremes(min, max))
    for of in required(formula):
        if isinstance(of.formula, Timed):
            stream.aligned(parts_of(of.formula))
    return stream.lines.size


def next_machine(formula: Formula, extremes: Extremes, machine: Machine, instant: Instant) -> Machine:
    """The state after a sample."""
    k = instant.channels[0].k
    lines = DelayLines(None if isinstance(machine.memory, tuple) else machine.memory, k)
    stream = Stream(lambda comparison: comparison.margin(instant), lines, extremes)
    pairs = zip(required(formula), machine.latches, strict=True)
    latches = tuple(next_latch(of, latch, stream, k) for of, latch in pairs)
    return Machine(latches, machine.memory if lines.memory is None else lines.memory)


@jax.custom_jvp
def with_slope_of(value: Scalar, substitute: Scalar) -> Scalar:
    """A value with the derivatives of another number."""
    return value


@with_slope_of.defjvp
def slope_of_substitute(at: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    """The value, and the tangent of its substitute."""
    return at[0], tangents[1]


@dataclass(frozen=True)
class RobustnessUpdate:
    """The update of a formula's metric."""

    formula: Formula
    width: float

    def __call__(self, state: FormulaState, instant: Instant, window: Window) -> FormulaState:
        """The state after a sample."""
        exact = next_machine(self.formula, EXACT, state.exact, instant)
        if not isinstance(state.smooth, Machine):
            return FormulaState(exact)
        return FormulaState(exact, next_machine(self.formula, smooth(self.width), state.smooth, instant))


@dataclass(frozen=True)
class RobustnessValue:
    """The value of a formula's metric."""

    formula: Formula
    width: float

    def __call__(self, state: FormulaState, window: Window, span: Span) -> Scalar:
        """The robustness, with derivatives of the smooth one."""
        value = judged(self.formula, iter(state.exact.latches), EXACT).value
        if not isinstance(state.smooth, Machine):
            return value
        return with_slope_of(value, judged(self.formula, iter(state.smooth.latches), smooth(self.width)).value)


@dataclass(frozen=True)
class Certainty:
    """The number of samples after which the truth of a formula is certain."""

    formula: Formula

    def __call__(self, state: FormulaState) -> Scalar:
        """From the state at the end of a flight."""
        return judged(self.formula, iter(state.exact.latches), EXACT).certain


def formula_metric(formula: Formula, unit: str, meaning: str, width: float) -> Metric:
    """The robustness of a formula as a metric.

    Args:
        formula: The formula.
        unit: Unit of its comparisons.
        meaning: The formula in words.
        width: Width of the smooth minimum whose derivatives it has, in that unit; 0: the exact one.
    """
    machine = first_machine(formula)
    start = FormulaState(machine, machine if width else ())
    update = RobustnessUpdate(formula, width)
    return Metric(unit, meaning, update, RobustnessValue(formula, width), scope=Scope.VEHICLE, start=start,
                  certain_after=Certainty(formula))  # fmt: skip
