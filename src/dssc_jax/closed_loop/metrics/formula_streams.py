"""Robustness of a formula of signal temporal logic at every sample, by sliding windows over delay lines.

The robustness is positive where the formula holds (:mod:`dssc_jax.closed_loop.metrics.formulas` defines it). A formula
looks up to its horizon into the future, so the present sample k gives its robustness at sample k - horizon.

An operator takes the smallest or largest value of a sliding window. A window of 2, 4, 8, ... samples combines two
windows of half its size, the older of which comes out of a delay line. The two may overlap, since minimum, maximum and
``until`` are idempotent.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.metrics.formula_tree import Always, And, Comparison, Formula, Not, Or, Until, horizon
from dssc_jax.core.signals import Scalar

Combination: TypeAlias = Callable[[Scalar, Scalar], Scalar]
"""A function of two robustnesses, such as their minimum."""


class Extremes(NamedTuple):
    """Minimum and maximum of two numbers, exact or smooth.

    Args:
        minimum: ``(a, b) -> minimum``.
        maximum: ``(a, b) -> maximum``.
    """

    minimum: Combination
    maximum: Combination


EXACT = Extremes(jnp.minimum, jnp.maximum)


def smooth_minimum(width: float, a: Scalar, b: Scalar) -> Scalar:
    """The smooth minimum -w ln(exp(-a/w) + exp(-b/w)), which has derivatives everywhere.

    It lies below min(a, b), by at most w ln 2. The form in the code cannot overflow.

    Args:
        width: Width w of the smoothing, in the unit of a and b.
        a: First value.
        b: Second value.
    """
    return jnp.minimum(a, b) - width * jnp.log1p(jnp.exp(-jnp.abs(a - b) / width))


def smooth_extremes(width: float) -> Extremes:
    """A smooth minimum of this width (:func:`smooth_minimum`), and the maximum -min(-a, -b) that follows from it."""
    minimum = partial(smooth_minimum, width)
    return Extremes(minimum, lambda a, b: -minimum(-a, -b))


Aggregate: TypeAlias = tuple[Scalar, ...]
"""The value of a sliding window: one number, or two for ``until``."""


class DelayLines:
    """Delays of values by whole samples: ring buffers that lie one after the other in one array.

    Each call of :meth:`delayed` uses the next delay line, a part of the array. Therefore the calls must come in the
    same order at every sample.

    Args:
        memory: The array, shape (``size``,) once all lines are counted; None: only count its size.
        k: Index of the sample.
    """

    def __init__(self, memory: jax.Array | np.ndarray | None = None, k: Scalar = 0) -> None:
        """Begin a sample, at which no line is in use yet."""
        self.memory = memory
        self.k = k
        self.size = 0  # numbers in the lines so far

    def delayed(self, value: Scalar, samples: int) -> Scalar:
        """Pass a value into the next delay line, and return the value that this line received ``samples`` samples ago.

        Args:
            value: The present value.
            samples: Length of the delay; 0: the value itself, without a line.

        Returns:
            The delayed value; 0 before the line is full.
        """
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
        combine = self.extremes.minimum if isinstance(formula, Always) else self.extremes.maximum
        width = formula.end - formula.begin + 1
        return self.extreme_of_window(combine, self.value(formula.inner), width)

    def aligned(self, formulas: Sequence[Formula]) -> list[Scalar]:
        """The robustness of several formulas at one instant.

        The formula with the longest horizon sets the instant; the values of all others, known earlier, are delayed.
        """
        latest = max(map(horizon, formulas))
        return [self.lines.delayed(self.value(formula), latest - horizon(formula)) for formula in formulas]

    def window(self, value: Aggregate, width: int, combine: Callable[[Aggregate, Aggregate], Aggregate]) -> Aggregate:
        """The combination of a signal's last ``width`` values.

        Args:
            value: The present value.
            width: Number of values.
            combine: ``(older, newer) -> combination`` of two windows, associative.
        """
        span = 1  # number of values in the window so far
        while span < width:
            step = min(span, width - span)
            older = tuple(self.lines.delayed(part, step) for part in value)
            value = combine(older, value)
            span += step
        return value

    def extreme_of_window(self, combine: Combination, value: Scalar, width: int) -> Scalar:
        """The minimum or maximum of a signal's last ``width`` values.

        Args:
            combine: Minimum or maximum of two numbers.
            value: The present value.
            width: Number of values.
        """
        (extreme,) = self.window((value,), width, lambda older, newer: (combine(older[0], newer[0]),))
        return extreme

    def until(self, formula: Until) -> Scalar:
        """The robustness of ``before until goal``.

        A sliding window from ``begin`` to ``end`` combines pairs: the robustness of ``until`` within the window, and
        the smallest robustness of ``before`` in the window. If ``begin`` is later than the instant itself, ``before``
        must also hold from the instant to ``begin``, so its smallest robustness there bounds the result.
        """
        minimum, maximum = self.extremes
        before, goal = self.aligned((formula.before, formula.goal))

        def combine(older: Aggregate, newer: Aggregate) -> Aggregate:
            """The pair of a joint window, from the pairs of its older and its newer part.

            The goal comes in the older part, or it comes in the newer part and ``before`` has held in all of the older
            one.
            """
            older_until, older_before = older
            newer_until, newer_before = newer
            return maximum(older_until, minimum(older_before, newer_until)), minimum(older_before, newer_before)

        width = formula.end - formula.begin + 1
        value, _ = self.window((goal, before), width, combine)
        if not formula.begin:
            return value
        smallest_before = self.extreme_of_window(minimum, before, formula.begin)
        return minimum(self.lines.delayed(smallest_before, width), value)
