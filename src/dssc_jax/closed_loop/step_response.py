"""Metrics of following a reference: the response to a step, gain and lag at one frequency, response envelopes.

A step response is measured from the window's first sample: the step is from the output there, y_0, to the desired
output there, r_0. Its progress is p = (y - y_0)/(r_0 - y_0), 0 at the start and 1 at the goal. Let the window begin
with the step (``after`` equal to its time): where the desired output moves later, the values are NaN.

References:
    K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), section 6.3 (rise time, overshoot, settling time).
"""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.closed_loop.instants import Sample
from dssc_jax.closed_loop.metrics import RISES, Course, Metric, Span, Window
from dssc_jax.core.numerics import arithmetic, root_abs
from dssc_jax.core.signals import Scalar
from dssc_jax.lanes.functions.approximations import atan2

LOW = 0.1
HIGH = 0.9
STILL = 1e-6  # share of a step: a desired output that moves by less does not move
BEGINS_WITH_STEP = "the window must begin with a step of the reference, which then stays; set `after` to its time"
MOVES = "the reference must move within the window"
Points = tuple[tuple[float, float], ...]
"""Times [s] and values of a bound, by rising time; two points of one time are a jump."""


class StepSize(NamedTuple):
    """Samples so far, the output at the first of them, the desired output there, and how far that has moved since."""

    samples: Scalar = 0.0
    start: Scalar = 0.0
    goal: Scalar = 0.0
    moved: Scalar = 0.0

    def next(self, sample: Sample) -> "StepSize":
        """The step after one more sample; the first one defines it."""
        first = self.samples == 0.0
        desired = sample.reference.y
        goal = jnp.where(first, desired, self.goal)
        start = jnp.where(first, sample.e + desired, self.start)
        return StepSize(self.samples + 1.0, start, goal, jnp.maximum(self.moved, jnp.abs(desired - goal)))

    def progress(self, sample: Sample) -> Scalar:
        """The share p of the step that the output has covered; 0 where there is no step."""
        size = self.goal - self.start
        travelled = sample.e + sample.reference.y - self.start
        return jnp.where(size == 0.0, 0.0, travelled / jnp.where(size == 0.0, 1.0, size))

    def result(self, value: Scalar) -> Scalar:
        """The value of a metric of this step, or NaN where there is no step or its goal moves."""
        size = jnp.abs(self.goal - self.start)
        return jnp.where((size > 0.0) & (self.moved <= STILL * size), value, jnp.nan)


class Rise(NamedTuple):
    """The step, its last progress, and the times at which 10 % and 90 % were first passed, in samples; -1: not yet."""

    step: StepSize = StepSize()
    previous: Scalar = 0.0
    low: Scalar = -1.0
    high: Scalar = -1.0


def rise(acc: Rise, sample: Sample, window: Window) -> Rise:
    """Note when the progress first passes 10 % and 90 %, between two samples by a straight line."""
    step = acc.step.next(sample)
    p = step.progress(sample)
    gain = p - acc.previous

    def passing_time(passed_at: Scalar, level: float) -> Scalar:
        passes = (passed_at < 0.0) & (p >= level)
        share = (level - acc.previous) / jnp.where(gain > 0.0, gain, 1.0)
        return jnp.where(passes, jnp.maximum(acc.step.samples - 1.0 + share, 0.0), passed_at)

    return Rise(step, p, passing_time(acc.low, LOW), passing_time(acc.high, HIGH))


def rise_time(acc: Rise, window: Window, span: Span) -> Scalar:
    """Time from 10 % to 90 %; infinite if 90 % is not reached."""
    return acc.step.result(jnp.where(acc.high < 0.0, jnp.inf, (acc.high - acc.low) * span.sample_time))


class Peak(NamedTuple):
    """The step, and the largest progress."""

    step: StepSize = StepSize()
    largest: Scalar = 0.0


def largest(acc: Peak, sample: Sample, window: Window) -> Peak:
    """The largest progress so far."""
    step = acc.step.next(sample)
    return Peak(step, jnp.maximum(acc.largest, step.progress(sample)))


def overshoot(acc: Peak, window: Window, span: Span) -> Scalar:
    """How far the largest progress exceeds 1, in per cent."""
    return acc.step.result(100.0 * jnp.maximum(acc.largest - 1.0, 0.0))


class Outside(NamedTuple):
    """The step, and the number of samples up to the last one outside the band."""

    step: StepSize = StepSize()
    last_sample: Scalar = 0.0


def update_outside(acc: Outside, sample: Sample, window: Window) -> Outside:
    """Note a sample whose distance from the goal exceeds the band."""
    step = acc.step.next(sample)
    is_outside = jnp.abs(step.progress(sample) - 1.0) > 0.01 * window.percent
    return Outside(step, jnp.where(is_outside, step.samples, acc.last_sample))


def step_settling(acc: Outside, window: Window, span: Span) -> Scalar:
    """Time from the window's start to the first sample after which all lie in the band; infinite if none do."""
    time = acc.last_sample * span.sample_time
    return acc.step.result(jnp.where(acc.last_sample >= span.sample_count, jnp.inf, time))


class Following(NamedTuple):
    """Sums over the window's samples of y, r, r' and of the products r r, r' r', y r and y r'."""

    y: Scalar = 0.0
    r: Scalar = 0.0
    r_dot: Scalar = 0.0
    rr: Scalar = 0.0
    dd: Scalar = 0.0
    yr: Scalar = 0.0
    yd: Scalar = 0.0


def update_following(acc: Following, sample: Sample, window: Window) -> Following:
    """Add a sample."""
    r = sample.reference.y
    d = sample.reference.y_dot
    y = sample.e + r
    moments = Following(y=y, r=r, r_dot=d, rr=r * r, dd=d * d, yr=y * r, yd=y * d)
    return Following(*(total + value for total, value in zip(acc, moments, strict=True)))


def in_phase(acc: Following, span: Span) -> tuple[Scalar, Scalar]:
    """Two amplitudes over that of a sine r: of the part of y in phase with r, and of the part 90 degrees ahead.

    They are the regression coefficients of y on r, and on r' over the angular frequency. r' is 90 degrees ahead of r,
    and the frequency squared is var r'/var r. Both are NaN if r does not move.
    """
    n = span.sample_count
    rr = acc.rr - acc.r * acc.r / n
    dd = acc.dd - acc.r_dot * acc.r_dot / n
    is_moving = (rr > 0.0) & (dd > 0.0)
    quadrature_gain = (acc.yd - acc.y * acc.r_dot / n) / jnp.sqrt(jnp.where(is_moving, rr * dd, 1.0))
    in_phase_gain = (acc.yr - acc.y * acc.r / n) / jnp.where(is_moving, rr, 1.0)
    return jnp.where(is_moving, in_phase_gain, jnp.nan), jnp.where(is_moving, quadrature_gain, jnp.nan)


def following_gain(acc: Following, window: Window, span: Span) -> Scalar:
    """Amplitude of y over that of r."""
    in_phase_gain, quadrature_gain = in_phase(acc, span)
    return root_abs(in_phase_gain * in_phase_gain + quadrature_gain * quadrature_gain)


def following_lag(acc: Following, window: Window, span: Span) -> Scalar:
    """Phase of r less that of y, in (-pi, pi] [rad]."""
    in_phase_gain, quadrature_gain = in_phase(acc, span)
    return atan2(-quadrature_gain, in_phase_gain)


STEP_RESPONSE: dict[str, Metric] = {
    "rise_time": Metric(
        "s", "time in which a step response goes from 10 % to 90 %", rise, rise_time, start=Rise(), least=0.0,
        defined_if=BEGINS_WITH_STEP,
    ),
    "overshoot_percent": Metric(
        "%", "overshoot of a step response", largest, overshoot, start=Peak(), course=RISES, least=0.0,
        defined_if=BEGINS_WITH_STEP,
    ),
    "settling_time_percent": Metric(
        "s", "time after which a step response stays within a per-cent band", update_outside, step_settling,
        start=Outside(), counted=True, course=RISES, least=0.0, defined_if=BEGINS_WITH_STEP,
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
    """A bound at t: straight between two points, and ``default`` before the first and after the last one."""
    early = 4.0 * jnp.finfo(jnp.result_type(float)).eps * jnp.abs(t)
    value: Scalar = default
    for (begin, low), (end, high) in pairwise(points):
        if end > begin:
            share = (t - begin) / (end - begin)
            value = jnp.where((t >= begin - early) & (t <= end + early), low + share * (high - low), value)
    return value


def envelope_metric(
    signal: Callable[[Sample], Scalar], unit: str, meaning: str, lower: Points, upper: Points
) -> Metric:
    """The smallest distance of a signal from its bounds over time; negative if it crosses one.

    Args:
        signal: The signal at a sample.
        unit: Its unit.
        meaning: What it is.
        lower: Points of the lower bound; empty: none.
        upper: Points of the upper bound; empty: none.
    """

    def update(acc: Scalar, sample: Sample, window: Window) -> Scalar:
        t = sample.k * sample.dt
        value = signal(sample)
        above_lower = value - line_at(lower, t, -math.inf) if lower else math.inf
        below_upper = line_at(upper, t, math.inf) - value if upper else math.inf
        return jnp.minimum(acc, jnp.minimum(above_lower, below_upper))

    description = f"smallest distance of {meaning} from its envelope"
    return Metric(unit, description, update, lambda acc, *_: acc, start=math.inf, course=Course.FALLS)


def crossing(lower: Points, upper: Points) -> float | None:
    """The first time of a point at which the lower bound lies above the upper one; None if it never does."""
    with arithmetic():
        for t in sorted({point[0] for point in (*lower, *upper)}):
            if line_at(lower, t, -math.inf) > line_at(upper, t, math.inf):
                return t
    return None
