"""The disturbance that a plant shows: an interval of its mean over a sample, and how fast it changes.

Over a sample, y'' = -a_p y' + k_p (v + d) gives exactly

    mean d = ((y'_k - y'_(k-1)) + a_p (y_k - y_(k-1)))/(k_p T_s) - mean v

where v is the command after delay or lag. k_p, a_p and the lag's time constant are known in intervals only. So is v,
hence d: the interval below holds the mean of d for every plant of the certificate. In the settled loop v = -u_av + u_n
is nearly constant, the interval is narrow, and d = u_av - u_n.

Let F be the low-pass F_k = F_(k-1) + w (d_k - F_(k-1)), w = T_s/(tau + T_s). The values that F_(k-1) averages are
tau + T_s older than d_k in the mean. So |d'| <= D implies |d_k - F_(k-1)| <= (tau + T_s) D.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.signals import Scalar
from dssc_jax.flight_code.premises import DisturbancePremises, Interval

LAGS_AVERAGED = 10
"""tau in time constants of all lags, and at least in samples."""
UNKNOWN = 1e30
"""End of the interval of a command that is not known."""
PASSED_MEAN_AT = 1.7933
PASSED_MEAN_PEAK = 0.29843
"""Where (1 - exp(-h) (1 + h))/h has its peak, and a bound of it."""


class EnclosingInterval(NamedTuple):
    """Lower and upper end of an interval that holds a number."""

    low: Scalar
    high: Scalar


class SeenDisturbance(NamedTuple):
    """State between two samples.

    Args:
        y: Output at the last sample.
        y_dot: Its rate.
        fresh: 1 if the last sample was measured, else 0.
        commands: Earlier commands that a delay holds back, latest first.
        lags: Output of each lag.
        acting: What acts on the plant over the sample that begins.
        average: The low-pass of the disturbance.
        averaging: 1 if there is an average, else 0.
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
    """Bounds that the disturbance exceeds, whatever the plant within its intervals: of its size, and of its slope."""

    level: jax.Array
    slope: jax.Array


def roundings() -> float:
    """Allowance for the roundings of a formula, relative to the numbers in it."""
    return 8.0 * float(jnp.finfo(jnp.result_type(float)).eps)


def averaging_time(premises: DisturbancePremises, dt: float) -> float:
    """The time constant tau [s] of the average."""
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

    The disturbance is enclosed if this sample and the last were both measured. Its slope is judged if there is also an
    average of earlier samples.

    Args:
        premises: The plant's intervals, and the bounds of the disturbance.
        state: The state before this sample.
        y: Output; any number if it was not measured.
        y_dot: Rate of the output.
        measured: Whether both were measured.
        command: The command that acts from now on.
        dt: T_s [s].

    Returns:
        The state after this sample, and the flags.
    """
    resumed = measured & jnp.greater(state.fresh, 0.0)
    seen = mean_disturbance(premises, state, y, y_dot, dt)
    averaged = resumed & jnp.greater(state.averaging, 0.0)
    weight = dt / (averaging_time(premises, dt) + dt)
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

    (A + a_p B)/k_p takes its extremes where both k_p and a_p are at an end of their intervals.
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
    """Delayed commands, lags at the end of the sample that begins, and the mean of what acts until then."""
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
    """held + the sum of ratio (x - held) over parts (x, ratio), which rises with held and with every x."""
    low = held.low
    high = held.high
    for x, (smallest, largest) in parts:
        lower = x.low - held.low
        upper = x.high - held.high
        low = low + jnp.minimum(smallest * lower, largest * lower)
        high = high + jnp.maximum(smallest * upper, largest * upper)
    return EnclosingInterval(low, high)


class LagRatios(NamedTuple):
    """Intervals of the ratios of a lag over a sample with the input v held, for h = T_s/mu.

    One lag x' = (v - x)/mu ends at v + decay (x - v), and its mean is v + mean (x - v). A second one behind it, z, ends
    at v + decay (z - v) + passed (x - v), and its mean is v + mean (z - v) + passed_mean (x - v).
    """

    decay: Interval  # exp(-h)
    mean: Interval  # (1 - exp(-h))/h
    passed: Interval  # h exp(-h)
    passed_mean: Interval  # (1 - exp(-h) (1 + h))/h


def lag_ratios(premises: DisturbancePremises, dt: float) -> LagRatios:
    """The intervals of the ratios; the first two fall with h, the others rise to a single peak."""
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
