"""An enclosure of the disturbance from measurements: an interval of its mean over a sample, and of its slope.

Over a sample, y'' = -a_p y' + k_p (v + d) gives exactly

    mean d = ((y'_k - y'_(k-1)) + a_p (y_k - y_(k-1)))/(k_p T_s) - mean v

where v is the command after delay or lag. Only intervals of k_p, a_p and the lag's time constant are known, so that v
and d are known as intervals, too. The interval of d that is computed here contains the mean of d for every plant of the
certificate. In the settled loop v = -u_av + u_n is nearly constant, the interval is narrow, and d = u_av - u_n.

Let F be the low-pass F_k = F_(k-1) + w (d_k - F_(k-1)) with w = T_s/(tau + T_s). The values of d in F_(k-1) are on
average tau + T_s older than d_k. Therefore |d'| <= D implies |d_k - F_(k-1)| <= (tau + T_s) D.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.signals import Scalar
from dssc_jax.flight_code.premises import DisturbancePremises, Interval

LAGS_AVERAGED = 10
"""tau as a multiple of the sum of the lags' time constants, or of the sample time if that is longer."""
UNKNOWN = 1e30
"""Upper end of the interval of an unknown command; the lower end is its negative."""
PASSED_MEAN_AT = 1.7933
"""The h at which (1 - exp(-h) (1 + h))/h has its peak."""
PASSED_MEAN_PEAK = 0.29843
"""A bound of this peak, from above."""


class EnclosingInterval(NamedTuple):
    """Lower and upper end of an interval that contains an unknown number."""

    low: Scalar
    high: Scalar


class SeenDisturbance(NamedTuple):
    """State of the enclosure between two samples.

    Args:
        y: Output at the last sample at which it was measured.
        y_dot: Rate of the output at that sample.
        fresh: 1 if y and y' were measured at the last sample, else 0.
        commands: Earlier commands that the delay holds back, latest first.
        lags: Output of each lag.
        acting: Mean of v, the command after delay and lags, over the sample that begins.
        average: The low-pass F of the disturbance.
        averaging: 1 if ``average`` can be continued, else 0; a missing measurement ends it.
    """

    y: Scalar
    y_dot: Scalar
    fresh: Scalar
    commands: tuple[EnclosingInterval, ...]
    lags: tuple[EnclosingInterval, ...]
    acting: EnclosingInterval
    average: EnclosingInterval
    averaging: Scalar


class SeenFlags(NamedTuple):
    """Whether the disturbance exceeds the bound of its size, and of its slope, for every plant of the certificate."""

    level: jax.Array
    slope: jax.Array


def roundings() -> float:
    """Allowance for the roundings of a formula, relative to the numbers in it.

    The allowance is eight rounding errors of the present precision.
    """
    return 8.0 * float(jnp.finfo(jnp.result_type(float)).eps)


def averaging_time(premises: DisturbancePremises, dt: float) -> float:
    """The time constant tau [s] of the average.

    Args:
        premises: The bounds, with the largest time constant of the lags.
        dt: T_s [s].
    """
    return LAGS_AVERAGED * max(dt, premises.lag_order * premises.mu[1])


def initial_seen(premises: DisturbancePremises) -> SeenDisturbance:
    """The state before the first sample: nothing measured, and all earlier commands 0."""
    zero = EnclosingInterval(0.0, 0.0)
    delayed_commands = (zero,) * (len(premises.delay_weights) - 1)
    return SeenDisturbance(
        y=0.0,
        y_dot=0.0,
        fresh=0.0,
        commands=delayed_commands,
        lags=(zero,) * premises.lag_order,
        acting=zero,
        average=zero,
        averaging=0.0,
    )


def see(
    premises: DisturbancePremises,
    state: SeenDisturbance,
    y: Scalar,
    y_dot: Scalar,
    measured: jax.Array,
    command: Scalar,
    dt: float,
) -> tuple[SeenDisturbance, SeenFlags]:
    """Enclose the disturbance of the last sample, and compare it with the bounds of the premises.

    The size of the disturbance is compared if y and y' were measured at this sample and at the last one. The slope is
    compared if, in addition, there is an average of earlier samples. A missing measurement restarts the average.

    Args:
        premises: The plant's intervals, and the bounds of the disturbance.
        state: The state before this sample.
        y: Output; any number if it was not measured.
        y_dot: Rate of the output; any number if it was not measured.
        measured: Whether y and y' were both measured.
        command: The controller's command from this sample on.
        dt: T_s [s].

    Returns:
        The state after this sample, and the flags.
    """
    resumed = measured & jnp.greater(state.fresh, 0.0)
    seen = mean_disturbance(premises, state, y, y_dot, dt)
    averaged = resumed & jnp.greater(state.averaging, 0.0)
    weight = dt / (averaging_time(premises, dt) + dt)
    # dt/weight = tau + T_s; the low-pass adds up roundings over about 1/weight samples
    allowed = dt / weight * premises.slope + roundings() / weight * (jnp.abs(seen.low) + jnp.abs(seen.high))
    rises = jnp.greater(seen.low - state.average.high, allowed)
    falls = jnp.less(seen.high - state.average.low, -allowed)
    flags = SeenFlags(
        resumed & (jnp.greater(seen.low, premises.level) | jnp.less(seen.high, -premises.level)),
        averaged & (rises | falls),
    )
    low = jnp.where(averaged, state.average.low + weight * (seen.low - state.average.low), seen.low)
    high = jnp.where(averaged, state.average.high + weight * (seen.high - state.average.high), seen.high)
    average = EnclosingInterval(
        jnp.where(resumed, low, state.average.low), jnp.where(resumed, high, state.average.high)
    )
    commands, lags, acting = acting_command(premises, state, command, dt)
    after = SeenDisturbance(
        y=jnp.where(measured, y, state.y),
        y_dot=jnp.where(measured, y_dot, state.y_dot),
        fresh=jnp.where(measured, 1.0, 0.0),
        commands=commands,
        lags=lags,
        acting=acting,
        average=average,
        averaging=jnp.where(resumed, 1.0, 0.0),
    )
    return after, flags


def mean_disturbance(
    premises: DisturbancePremises, state: SeenDisturbance, y: Scalar, y_dot: Scalar, dt: float
) -> EnclosingInterval:
    """The interval of the mean of d since the last sample, for all k_p and a_p within their intervals.

    With the changes A of y' and B of y per second, mean d = (A + a_p B)/k_p - mean v. The quotient has its extremes
    where k_p and a_p are both at an end of their intervals. The arguments are those of :func:`see`.
    """
    change = (y_dot - state.y_dot) / dt
    speed = (y - state.y) / dt
    first = change + premises.a_p[0] * speed
    second = change + premises.a_p[1] * speed
    smaller = jnp.minimum(first, second)
    larger = jnp.maximum(first, second)
    lowest = jnp.minimum(smaller / premises.k_p[0], smaller / premises.k_p[1])
    highest = jnp.maximum(larger / premises.k_p[0], larger / premises.k_p[1])
    damping = max(map(abs, premises.a_p))
    sizes = jnp.abs(y_dot) + jnp.abs(state.y_dot) + damping * (jnp.abs(y) + jnp.abs(state.y))
    held = jnp.abs(state.acting.low) + jnp.abs(state.acting.high)
    memory = 1.0 + premises.lag_order * premises.mu[1] / dt  # samples over which roundings of the lags add up
    rounding = roundings() / (premises.k_p[0] * dt) * sizes + memory * roundings() * held
    return EnclosingInterval(lowest - state.acting.high - rounding, highest - state.acting.low + rounding)


def acting_command(
    premises: DisturbancePremises, state: SeenDisturbance, command: Scalar, dt: float
) -> tuple[tuple[EnclosingInterval, ...], tuple[EnclosingInterval, ...], EnclosingInterval]:
    """Delayed commands, lags at the end of the sample that begins, and the mean of what acts until then.

    Args:
        premises: Intervals of delay and lags.
        state: The state before the sample.
        command: The controller's new command; unknown if it is not finite.
        dt: T_s [s].

    Returns:
        The delayed commands, latest first; the output of each lag at the end of the sample; and the mean of v over it.
    """
    known = jnp.abs(command) < UNKNOWN
    newest = EnclosingInterval(jnp.where(known, command, -UNKNOWN), jnp.where(known, command, UNKNOWN))
    ages = (newest, *state.commands)
    weights = premises.delay_weights
    held = EnclosingInterval(
        sum(weight * aged.low for weight, aged in zip(weights, ages, strict=True)),
        sum(weight * aged.high for weight, aged in zip(weights, ages, strict=True)),
    )
    if not state.lags:
        return ages[:-1], (), held
    ratios = lag_ratios(premises, dt)
    first = state.lags[0]
    if len(state.lags) == 1:
        return ages[:-1], (between(held, (first, ratios.decay)),), between(held, (first, ratios.mean))
    second = state.lags[1]
    ends = (between(held, (first, ratios.decay)), between(held, (second, ratios.decay), (first, ratios.passed)))
    return ages[:-1], ends, between(held, (second, ratios.mean), (first, ratios.passed_mean))


def between(held: EnclosingInterval, *parts: tuple[EnclosingInterval, Interval]) -> EnclosingInterval:
    """held + the sum of ratio (x - held) over parts (x, ratio), which rises with held and with every x.

    The lower end of the result therefore follows from the lower ends of all intervals, and the upper end from the upper
    ends. Each ratio takes the end of its interval that makes the result wider.

    Args:
        held: Interval of the input over the sample.
        parts: Interval of x and interval of its ratio, for each part.
    """
    low = held.low
    high = held.high
    for x, (smallest, largest) in parts:
        lower = x.low - held.low
        upper = x.high - held.high
        low = low + jnp.minimum(smallest * lower, largest * lower)
        high = high + jnp.maximum(smallest * upper, largest * upper)
    return EnclosingInterval(low, high)


class LagRatios(NamedTuple):
    """Intervals of the factors that describe lags over a sample with constant input v, for h = T_s/mu.

    A lag x' = (v - x)/mu ends the sample at v + decay (x - v), and its mean over the sample is v + mean (x - v). Behind
    it, a second lag z' = (x - z)/mu ends at v + decay (z - v) + passed (x - v), and its mean is v + mean (z - v) +
    passed_mean (x - v). On the right, x and z are the outputs at the start of the sample.
    """

    decay: Interval  # exp(-h)
    mean: Interval  # (1 - exp(-h))/h
    passed: Interval  # h exp(-h)
    passed_mean: Interval  # (1 - exp(-h) (1 + h))/h


def lag_ratios(premises: DisturbancePremises, dt: float) -> LagRatios:
    """The intervals of the ratios; the first two fall with h, the others rise to a single peak.

    If the peak lies within the interval of h, it is the upper end of the ratio's interval.

    Args:
        premises: The interval of the lag's time constant mu.
        dt: T_s [s].
    """
    ends = (dt / premises.mu[1], dt / premises.mu[0])
    decay = tuple(math.exp(-h) for h in ends)
    mean = tuple(-math.expm1(-h) / h for h in ends)
    passed = tuple(h * math.exp(-h) for h in ends)
    passed_mean = tuple((-math.expm1(-h) - h * math.exp(-h)) / h for h in ends)
    highest = 1.0 / math.e if ends[0] < 1.0 < ends[1] else max(passed)
    highest_mean = PASSED_MEAN_PEAK if ends[0] < PASSED_MEAN_AT < ends[1] else max(passed_mean)
    return LagRatios(
        (min(decay), max(decay)), (min(mean), max(mean)), (min(passed), highest), (min(passed_mean), highest_mean)
    )
