"""Metrics of following a reference: the response to a step, gain and lag at one frequency, response envelopes.

A step response is measured from the window's first sample: the step is from the output there, y_0, to the desired
output there, r_0. Its progress is p = (y - y_0)/(r_0 - y_0), 0 at the start and 1 at the goal. Let the window begin
with the step (``after`` equal to its time): where the desired output moves later, the values are NaN.

References:
    K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), section 6.3 (rise time, overshoot, settling time).
"""

import math
import operator
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.closed_loop.metrics.instants import Sample
from dssc_jax.closed_loop.metrics.streaming import RISES, Course, Metric, Span, Window, final_value
from dssc_jax.core.numerics import arithmetic, root_abs
from dssc_jax.core.signals import Scalar
from dssc_jax.lanes.functions.approximations import atan2

LOW = 0.1  # progress at which the rise time starts
HIGH = 0.9  # progress at which the rise time ends
STILL = 1e-6  # share of a step: a desired output that moves by less counts as constant
BEGINS_WITH_STEP = "the window must begin with a step of the reference, which then stays; set `after` to its time"
MOVES = "the reference must move within the window"
Points = tuple[tuple[float, float], ...]
"""A bound over time, by points (t [s], value) in the order of time.

The bound is straight between two points, and jumps where two points have the same time.
"""


class StepSize(NamedTuple):
    """The step of the reference with which a window begins.

    Args:
        samples: Number of samples so far.
        start: Output y_0 at the first sample.
        goal: Desired output r_0 at the first sample.
        moved: Largest distance of the desired output from the goal so far.
    """

    samples: Scalar = 0.0
    start: Scalar = 0.0
    goal: Scalar = 0.0
    moved: Scalar = 0.0

    def next(self, sample: Sample) -> "StepSize":
        """The step after one more sample; the first sample defines its start and goal."""
        is_first = self.samples == 0.0
        desired = sample.reference.y
        goal = jnp.where(is_first, desired, self.goal)
        start = jnp.where(is_first, sample.e + desired, self.start)
        return StepSize(self.samples + 1.0, start, goal, jnp.maximum(self.moved, jnp.abs(desired - goal)))

    def progress(self, sample: Sample) -> Scalar:
        """The progress p of the output from start (0) to goal (1) at a sample; 0 if there is no step."""
        size = self.goal - self.start
        travelled = sample.e + sample.reference.y - self.start
        return jnp.where(size == 0.0, 0.0, travelled / jnp.where(size == 0.0, 1.0, size))

    def result(self, value: Scalar) -> Scalar:
        """The value of a metric of this step; NaN if there was no step, or if the desired output moved after it.

        Args:
            value: The metric, computed as if the step were valid.
        """
        size = jnp.abs(self.goal - self.start)
        is_step = (size > 0.0) & (self.moved <= STILL * size)
        return jnp.where(is_step, value, jnp.nan)


NOT_YET = -1.0  # time of an event that has not happened


class Rise(NamedTuple):
    """The rise of a step response; times are counted in samples from the window's first sample.

    Args:
        step: The step.
        previous: Progress at the previous sample, as a share of the step.
        low: Time at which the progress first passed 10 %; :data:`NOT_YET`: it has not.
        high: Time at which the progress first passed 90 %; :data:`NOT_YET`: it has not.
    """

    step: StepSize = StepSize()
    previous: Scalar = 0.0
    low: Scalar = NOT_YET
    high: Scalar = NOT_YET


def update_rise(acc: Rise, sample: Sample, window: Window) -> Rise:
    """Note the times at which the progress first passes 10 % and 90 %, interpolated between two samples.

    The contract's ``window`` is not read.
    """
    step = acc.step.next(sample)
    p = step.progress(sample)
    gain = p - acc.previous

    def passing_time(passed_at: Scalar, level: float) -> Scalar:
        """Time at which the progress first passed a level [samples since the step].

        Args:
            passed_at: The time noted so far; negative: the level has not been passed yet. A noted time stays.
            level: The level, as a share of the step.
        """
        passes = (passed_at < 0.0) & (p >= level)
        share = (level - acc.previous) / jnp.where(gain > 0.0, gain, 1.0)
        return jnp.where(passes, jnp.maximum(acc.step.samples - 1.0 + share, 0.0), passed_at)

    return Rise(step, p, passing_time(acc.low, LOW), passing_time(acc.high, HIGH))


def rise_time(acc: Rise, window: Window, span: Span) -> Scalar:
    """Time from 10 % to 90 % of the step [s]; infinite if the output does not reach 90 %.

    The contract's ``window`` is not read.
    """
    time = (acc.high - acc.low) * span.sample_time
    return acc.step.result(jnp.where(acc.high < 0.0, jnp.inf, time))


class StepPeak(NamedTuple):
    """The peak of a step response.

    Args:
        step: The step.
        largest: Largest progress so far.
    """

    step: StepSize = StepSize()
    largest: Scalar = 0.0


def update_peak(acc: StepPeak, sample: Sample, window: Window) -> StepPeak:
    """Keep the larger of the largest progress so far and the progress at this sample.

    The contract's ``window`` is not read.
    """
    step = acc.step.next(sample)
    return StepPeak(step, jnp.maximum(acc.largest, step.progress(sample)))


def overshoot(acc: StepPeak, window: Window, span: Span) -> Scalar:
    """Overshoot of the step response [% of the step]: the excess of the largest progress over 1.

    The accumulator holds this progress; the contract's ``window`` and ``span`` are not read.
    """
    return acc.step.result(100.0 * jnp.maximum(acc.largest - 1.0, 0.0))


class StepSettling(NamedTuple):
    """The settling of a step response.

    Args:
        step: The step.
        last_sample: Number of samples up to and including the last one outside the band around the goal.
    """

    step: StepSize = StepSize()
    last_sample: Scalar = 0.0


def update_settling(acc: StepSettling, sample: Sample, window: Window) -> StepSettling:
    """Note the sample if its progress differs from 1 by more than the window's percentage.

    The last such sample stays in the accumulator.
    """
    step = acc.step.next(sample)
    band = 0.01 * window.percent  # share of the step
    is_outside = jnp.abs(step.progress(sample) - 1.0) > band
    return StepSettling(step, jnp.where(is_outside, step.samples, acc.last_sample))


def step_settling_time(acc: StepSettling, window: Window, span: Span) -> Scalar:
    """Time from the window's start after which all samples lie in the band [s]; infinite if the last one does not.

    The contract's ``window`` is not read.
    """
    time = acc.last_sample * span.sample_time
    return acc.step.result(jnp.where(acc.last_sample >= span.sample_count, jnp.inf, time))


class Following(NamedTuple):
    """Sums over the samples, from which the regression of the output y on the reference r follows.

    Args:
        y: Sum of y.
        r: Sum of r.
        r_dot: Sum of r'.
        rr: Sum of r^2.
        dd: Sum of r'^2.
        yr: Sum of y r.
        yd: Sum of y r'.
    """

    y: Scalar = 0.0
    r: Scalar = 0.0
    r_dot: Scalar = 0.0
    rr: Scalar = 0.0
    dd: Scalar = 0.0
    yr: Scalar = 0.0
    yd: Scalar = 0.0


def update_following(acc: Following, sample: Sample, window: Window) -> Following:
    """Add one sample to every sum: its output y, reference r and derivative r', and their products."""
    r = sample.reference.y
    d = sample.reference.y_dot  # r'
    y = sample.e + r
    terms = Following(y=y, r=r, r_dot=d, rr=r * r, dd=d * d, yr=y * r, yd=y * d)
    return jax.tree.map(operator.add, acc, terms)


def phase_components(acc: Following, span: Span) -> tuple[Scalar, Scalar]:
    """Amplitudes of two parts of the output y, relative to the amplitude of a sine reference r.

    The first part is in phase with r, and the second leads r by 90 degrees. They are the regression coefficients of y
    on r and on r'/omega, with the angular frequency omega^2 = var r'/var r. Both are NaN if r does not move.

    Args:
        acc: Sums over the window's samples.
        span: The window's length in samples.
    """
    n = span.sample_count
    rr = acc.rr - acc.r * acc.r / n  # n var r
    dd = acc.dd - acc.r_dot * acc.r_dot / n  # n var r'
    is_moving = (rr > 0.0) & (dd > 0.0)
    quadrature_gain = (acc.yd - acc.y * acc.r_dot / n) / jnp.sqrt(jnp.where(is_moving, rr * dd, 1.0))
    in_phase_gain = (acc.yr - acc.y * acc.r / n) / jnp.where(is_moving, rr, 1.0)
    return jnp.where(is_moving, in_phase_gain, jnp.nan), jnp.where(is_moving, quadrature_gain, jnp.nan)


def following_gain(acc: Following, window: Window, span: Span) -> Scalar:
    """Amplitude of the output over the amplitude of a sine reference, from the two parts of :func:`phase_components`.

    The contract's ``window`` is not read.
    """
    in_phase_gain, quadrature_gain = phase_components(acc, span)
    return root_abs(in_phase_gain * in_phase_gain + quadrature_gain * quadrature_gain)


def following_lag(acc: Following, window: Window, span: Span) -> Scalar:
    """Phase by which the output lags a sine reference, in (-pi, pi] [rad].

    The contract's ``window`` is not read.
    """
    in_phase_gain, quadrature_gain = phase_components(acc, span)
    return atan2(-quadrature_gain, in_phase_gain)


STEP_RESPONSE: dict[str, Metric] = {
    "rise_time": Metric(
        "s", "time in which a step response goes from 10 % to 90 %", update_rise, rise_time, start=Rise(), least=0.0,
        defined_if=BEGINS_WITH_STEP,
    ),
    "overshoot_percent": Metric(
        "%", "overshoot of a step response", update_peak, overshoot, start=StepPeak(), course=RISES, least=0.0,
        defined_if=BEGINS_WITH_STEP,
    ),
    "settling_time_percent": Metric(
        "s", "time after which a step response stays within a per-cent band", update_settling, step_settling_time,
        start=StepSettling(), counted=True, course=RISES, least=0.0, defined_if=BEGINS_WITH_STEP,
        settled_within=lambda window: math.nan,
    ),
    "following_gain": Metric(
        "1", "amplitude of the output over that of a sine reference", update_following, following_gain,
        start=Following(), least=0.0, defined_if=MOVES,
    ),
    "following_lag": Metric(
        "rad", "phase by which the output lags a sine reference", update_following, following_lag, start=Following(),
        defined_if=MOVES,
    ),
}  # fmt: skip


def line_at(points: Points, t: Scalar, default: float) -> Scalar:
    """The value of a bound at t [s]: linear between its points, and ``default`` before and after all of them.

    Where the bound jumps, the later value counts. A time k T_s that rounding moves past a point counts as that point.

    Args:
        points: Pairs of time [s] and value, in ascending order of time; two points at one time are a jump.
        t: Time [s].
        default: Value outside the points, such as the infinity that bounds nothing.
    """
    rounding = 4.0 * jnp.finfo(jnp.result_type(float)).eps * jnp.abs(t)
    value: Scalar = default
    for (begin, begin_value), (end, end_value) in pairwise(points):
        if end > begin:
            share = (t - begin) / (end - begin)
            is_between = (t >= begin - rounding) & (t <= end + rounding)
            value = jnp.where(is_between, begin_value + share * (end_value - begin_value), value)
    return value


def envelope_metric(
    signal: Callable[[Sample], Scalar], unit: str, meaning: str, lower: Points, upper: Points
) -> Metric:
    """The smallest distance of a signal from bounds that change over time, as a metric; negative if a bound is crossed.

    Args:
        signal: Value of the signal at a sample.
        unit: Unit of the signal.
        meaning: Name of the signal in words.
        lower: Points of the lower bound; empty: no bound.
        upper: Points of the upper bound; empty: no bound.
    """

    def update(acc: Scalar, sample: Sample, window: Window) -> Scalar:
        """The smallest distance up to this sample; a bound without points is infinitely far."""
        t = sample.k * sample.dt
        value = signal(sample)
        above_lower = value - line_at(lower, t, -math.inf) if lower else math.inf
        below_upper = line_at(upper, t, math.inf) - value if upper else math.inf
        return jnp.minimum(acc, jnp.minimum(above_lower, below_upper))

    description = f"smallest distance of {meaning} from its envelope"
    return Metric(unit, description, update, final_value, start=math.inf, course=Course.FALLS)


def crossing(lower: Points, upper: Points) -> float | None:
    """The first time among the points at which a lower bound exceeds the upper bound [s]; None if there is none.

    Both bounds are linear between their points, so a crossing shows at one of the points.

    Args:
        lower: Points of the lower bound.
        upper: Points of the upper bound.
    """
    times = {t for t, _ in (*lower, *upper)}
    with arithmetic():
        for t in sorted(times):
            if line_at(lower, t, -math.inf) > line_at(upper, t, math.inf):
                return t
    return None
