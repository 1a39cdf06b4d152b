"""Metrics in streaming form, whose memory does not grow with the duration.

A metric consists of an accumulator and two pure functions: ``update`` adds a sample of the window, and ``value``
computes the metric from the accumulator at the end.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple, TypeAlias

import jax.numpy as jnp

from dssc_jax.closed_loop.metrics.instants import Instant, Sample
from dssc_jax.closed_loop.metrics.margin_kinds import LoopMargin
from dssc_jax.closed_loop.metrics.stretches import Stretch, longest_duration, stretch_update
from dssc_jax.closed_loop.metrics.window import WHOLE_RUN, Span, Window, first_sample
from dssc_jax.core.numerics import root_abs
from dssc_jax.core.signals import Scalar
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits

Accumulator: TypeAlias = Any
"""What a metric remembers of the samples so far: a number, or a NamedTuple of numbers."""

MetricInput: TypeAlias = Any
"""The :class:`Sample` of a channel for a metric of channels, or the :class:`Instant` for a metric of the vehicle."""

Update: TypeAlias = Callable[[Accumulator, MetricInput, Window], Accumulator]
"""``(accumulator, sample, window) -> accumulator`` after the sample; the sample is of :data:`MetricInput`."""

FinalValue: TypeAlias = Callable[[Accumulator, Window, Span], Scalar]
"""``(accumulator, window, span) -> value`` of a metric at the end of its window."""

SignalReader: TypeAlias = Callable[[MetricInput], Scalar]
"""Reads a signal at a sample of :data:`MetricInput`."""


class Scope(StrEnum):
    """The object that a metric describes: one channel, or the vehicle as a whole."""

    CHANNEL = "channel"
    VEHICLE = "vehicle"


class Course(StrEnum):
    """The direction in which the value of a metric can change as samples are added.

    A value that can only rise never returns once it has exceeded a bound, so the violation is certain at once.
    """

    RISES = "rises"  # it never falls
    FALLS = "falls"  # it never rises
    OPEN = "open"  # it may do both


class Metric(NamedTuple):
    """A number that is computed from a flight sample by sample.

    Args:
        unit: Unit, in which the symbols ``y`` and ``u`` stand for the units of the channel's output and command
            (:mod:`dssc_jax.core.units`).
        meaning: Meaning in words.
        update: Adds a sample of the window to the accumulator.
        value: Computes the metric from the accumulator at the end.
        needs: Fields that the info of the controller, or of the vehicle, must have.
        scope: One channel, or the vehicle as a whole.
        start: The accumulator before the first sample: a number, or a ``NamedTuple`` of numbers.
        counted: Whether the value counts samples, as a time or a share does; rounding then changes it by whole samples.
        course: Whether the value can only rise, only fall, or do both as samples are added.
        certain_after: ``accumulator -> number of samples after which the sign of the final value was certain``.
        margin: The margin of the linearised loop whose value is the accumulator; None: a metric of the flight.
        least: The least possible value, such as 0 for a size.
        defined_if: Condition, in words, under which the value is not NaN; empty: there is no condition.
        settled_within: ``window -> bound`` on |e|. A draw that has settled below the bound and ends early has the value
            of the whole run. NaN: the bound differs between draws. None: no bound is needed.
    """

    unit: str
    meaning: str
    update: Update
    value: FinalValue
    needs: tuple[str, ...] = ()
    scope: Scope = Scope.CHANNEL
    start: Accumulator = 0.0
    counted: bool = False
    course: Course = Course.OPEN
    certain_after: Callable[[Accumulator], Scalar] | None = None
    margin: LoopMargin | None = None
    least: float = -math.inf
    defined_if: str = ""
    settled_within: Callable[[Window], float] | None = None

    @property
    def is_large_good(self) -> bool:
        """Whether large values are good.

        They are for most margins, for the robustness of a formula, and for a metric that can only fall, such as a
        smallest distance. For all other metrics small values are good.
        """
        if self.margin is not None:
            return self.margin.kind.good == "large"
        is_robustness = self.certain_after is not None
        return is_robustness or self.course == Course.FALLS

    @property
    def worst(self) -> float:
        """The value that replaces NaN: the limit of stability for a margin, else the infinity on the bad side."""
        if self.margin is not None:
            return self.margin.kind.worst
        return -math.inf if self.is_large_good else math.inf


RISES = Course.RISES


def peak_update(signal: SignalReader) -> Update:
    """Return the ``update`` of a metric that keeps the largest absolute value of a signal."""
    return lambda acc, sample, window: jnp.maximum(acc, jnp.abs(signal(sample)))


def sum_update(signal: SignalReader) -> Update:
    """Return the ``update`` of a metric that adds up a signal."""
    return lambda acc, sample, window: acc + signal(sample)


def update_variation(acc: Scalar, sample: Sample, window: Window) -> Scalar:
    """Add |u_k - u_(k-1)|, where u is the robust command at this sample and at the previous one.

    The window's first sample adds nothing. At sample 0 the loop already sets u_(k-1) = u_k, so a window from sample 0
    needs no test.
    """
    first = first_sample(window.after, sample.dt)
    change = jnp.abs(sample.u - sample.u_previous)
    return acc + (change if first == 0 else jnp.where(sample.k == first, 0.0, change))


def final_value(acc: Scalar, window: Window, span: Span) -> Scalar:
    """The accumulator itself, for a metric that keeps a maximum or a sum; ``window`` and ``span`` are not read."""
    return acc


def mean(acc: Scalar, window: Window, span: Span) -> Scalar:
    """The mean over the window's samples, from their accumulated sum; the contract's ``window`` is not read."""
    return acc / span.sample_count


def root_mean(acc: Scalar, window: Window, span: Span) -> Scalar:
    """The rms over the window's samples, from their accumulated sum of squares; ``window`` is not read."""
    return root_abs(acc / span.sample_count)


def last_outside(acc: Scalar, sample: Sample, window: Window) -> Scalar:
    """Number of samples up to and including the last one whose error is outside the band, |e| > ``window.band``.

    The number is real, and exact in float32 up to 16 million samples.
    """
    samples = jnp.asarray(sample.k + 1, jnp.result_type(float))
    return jnp.where(jnp.abs(sample.e) > window.band, samples, acc)


def settling_time(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Time from the window's start to the end of the last sample outside the band [s].

    The time is infinite if the window's last sample is outside, too.

    Args:
        acc: Result of :func:`last_outside` at the end of the flight.
        window: The window.
        span: The window's length in samples.
    """
    time = jnp.maximum(acc * span.sample_time - window.after, 0.0)
    return jnp.where(acc >= span.steps, jnp.inf, time)


def sampling_ratio(sample: Sample) -> Scalar:
    """Gain of the sampled loop over its stability limit: (k_p T_s/(k_o tau_av)) (1 + T_s/(2 tau_m))/2.

    Above 1 the sampled loop chatters or diverges. The limit is exact for the plant sigma' = k_p u with constant
    functions k_o, tau_av and tau_m of the controller. If these functions vary, their values at the sample count.
    """
    info = sample.info  # integral_gain: 1/(k_o tau_av tau_m)
    dt = sample.dt
    return 0.5 * sample.k_p * dt * info.integral_gain * (info.tau_m + 0.5 * dt)


def position_error(instant: Instant) -> Scalar:
    """Distance of a vehicle from its desired position [m]."""
    axes = instant.channels[:3]  # x, y, z
    return root_abs(sum(jnp.square(axis.e) for axis in axes))


def as_float(flag: Scalar, like: Scalar) -> Scalar:
    """The number 1 if the flag holds, else 0.

    Args:
        flag: A boolean.
        like: A number whose type the result gets; its value does not matter.
    """
    return jnp.where(flag, jnp.ones_like(like), jnp.zeros_like(like))


def rms(
    unit: str,
    meaning: str,
    signal: SignalReader,
    needs: tuple[str, ...] = (),
    scope: Scope = Scope.CHANNEL,
) -> Metric:
    """The metric that is a signal's rms over the window.

    Args:
        unit: Unit of the signal.
        meaning: Meaning of the metric in words.
        signal: Reads the signal at a sample.
        needs: As in :class:`Metric`.
        scope: As in :class:`Metric`.
    """

    def square(sample: MetricInput) -> Scalar:
        """The square of the signal."""
        value = signal(sample)
        return value * value

    return Metric(unit, meaning, sum_update(square), root_mean, needs, scope, least=0.0)


def largest_absolute(
    unit: str,
    meaning: str,
    signal: SignalReader,
    needs: tuple[str, ...] = (),
    scope: Scope = Scope.CHANNEL,
) -> Metric:
    """The metric that is a signal's largest absolute value over the window.

    Args:
        unit: Unit of the signal.
        meaning: Meaning of the metric in words.
        signal: Reads the signal at a sample.
        needs: As in :class:`Metric`.
        scope: As in :class:`Metric`.
    """
    return Metric(unit, meaning, peak_update(signal), final_value, needs, scope, course=Course.RISES, least=0.0)


def share_of_time(
    meaning: str, indicator: SignalReader, needs: tuple[str, ...], scope: Scope = Scope.CHANNEL
) -> Metric:
    """The metric that is the share of the window's samples at which an indicator is 1.

    Args:
        meaning: Words after "share of time".
        indicator: Reads the indicator, 1 or 0, at a sample.
        needs: As in :class:`Metric`.
        scope: As in :class:`Metric`.
    """
    update = sum_update(indicator)
    return Metric("1", f"share of time {meaning}", update, mean, needs, scope, counted=True, least=0.0)


def outside_sliding(sample: Sample) -> Scalar:
    """The number 1 if the predictor does not slide, so that its output sigma_hat leaves sigma; else 0."""
    return as_float(sample.info.sliding_margin < 0.0, sample.e)


def sampling_ratio_above_1(sample: Sample) -> Scalar:
    """1 if the sampling ratio exceeds 1, else 0."""
    return as_float(sampling_ratio(sample) > 1.0, sample.e)


def rotor_limited(instant: Instant) -> Scalar:
    """1 if a rotor is at its limit, else 0."""
    return as_float(instant.plant.rotor_limited, instant.plant.tilt)


def lift_bounded(instant: Instant) -> Scalar:
    """1 if the wanted lift is at its lower bound, else 0."""
    return as_float(instant.plant.lift_bounded, instant.plant.tilt)


# fields that the info of controller or plant must have for a metric: of a predictor, of DSSC, of a vehicle
SLIDING = ("sliding_margin",)
SAMPLING = ("integral_gain", "tau_m")
FLYING = ("tilt",)
VEHICLE = Scope.VEHICLE
METRICS: dict[str, Metric] = {
    "error_rms": rms("y", "rms of the output error e", lambda s: s.e),
    "error_max": largest_absolute("y", "largest |e|", lambda s: s.e),
    "sigma_rms": rms("y/s", "rms of sigma", lambda s: s.sigma),
    "sigma_max": largest_absolute("y/s", "largest |sigma|", lambda s: s.sigma),
    "settling_time": Metric(
        "s",
        "time after which |e| stays within the band",
        last_outside,
        settling_time,
        counted=True,
        course=RISES,
        least=0.0,
        settled_within=lambda window: window.band,
    ),
    "command_tv": Metric(
        "u", "total variation of the robust command u", update_variation, final_value, course=RISES, least=0.0
    ),
    "command_rms": rms("u", "rms of the robust command u", lambda s: s.u),
    "command_max": largest_absolute("u", "largest |u|", lambda s: s.u),
    "total_command_max": largest_absolute("u", "largest |u + u_n|", lambda s: s.u_total),
    "outside_sliding": share_of_time("outside sliding", outside_sliding, SLIDING),
    "sampling_ratio": largest_absolute("1", "largest sampling ratio", sampling_ratio, SAMPLING),
    "sampling_ratio_above_1": share_of_time("with a sampling ratio above 1", sampling_ratio_above_1, SAMPLING),
    "position_error_rms": rms("m", "rms of the position error", position_error, FLYING, VEHICLE),
    "position_error_max": largest_absolute("m", "largest position error", position_error, FLYING, VEHICLE),
    "tilt_max": largest_absolute("rad", "largest tilt of body z", lambda i: i.plant.tilt, FLYING, VEHICLE),
    "rotor_limited": share_of_time("with a rotor at its limit", rotor_limited, FLYING, VEHICLE),
    "rotor_limited_longest": Metric(
        "s",
        "longest uninterrupted time with a rotor at its limit",
        stretch_update(rotor_limited),
        longest_duration,
        FLYING,
        VEHICLE,
        Stretch(),
        counted=True,
        course=RISES,
        least=0.0,
    ),
    "lift_bounded": share_of_time("with the wanted lift at its lower bound", lift_bounded, FLYING, VEHICLE),
}
BRIEF = ("error_rms", "error_max", "command_tv", "command_max", "outside_sliding", "sampling_ratio")
"""Metrics of each channel that a plant with several channels reports unless the study lists others."""


@dataclass(frozen=True)
class Measure:
    """One metric of one channel, or of the vehicle, over one window.

    Args:
        name: Name in results.
        kind: Name of the metric.
        window: The samples that count.
        channel: Index of the channel; None: the vehicle.
        custom: The metric, if its name is not in :data:`METRICS`.
        units: Units and meanings of the channel's output and command.
        channel_name: The channel's name; empty for the vehicle and for the single channel of a SISO plant.
        default_window: The window of the study's ``[metrics]``.
    """

    name: str
    kind: str
    window: Window
    channel: int | None = 0
    custom: Metric | None = None
    units: ChannelUnits = UNNAMED_UNITS
    channel_name: str = ""
    default_window: Window = WHOLE_RUN

    @property
    def window_text(self) -> str:
        """The window in words, such as `` after 2 s``; empty if all values of the window are the usual ones."""
        return self.window.words(self.default_window, self.units.output)

    @property
    def metric(self) -> Metric:
        """The metric itself: the study's own, or the package's metric of this kind."""
        return self.custom or METRICS[self.kind]

    @property
    def label(self) -> str:
        """Kind and channel, such as ``error_max_x``, without the window."""
        return suffixed(self.kind, self.channel_name)

    @property
    def unit(self) -> str:
        """Unit of the value, with the channel's own units in place of the symbols ``y`` and ``u``."""
        return self.units.of(self.metric.unit)

    @property
    def meaning(self) -> str:
        """Meaning of the value in the words of the channel; a custom metric keeps its own words."""
        return self.units.describe(self.metric.meaning) if self.custom is None else self.metric.meaning

    def of(self, instant: Instant) -> Sample | Instant:
        """The signals with which the metric is updated: of its channel, or of the whole loop for a vehicle's metric."""
        return instant if self.channel is None else instant.channels[self.channel]


def suffixed(kind: str, channel: str) -> str:
    """A metric's name with its channel's name, such as ``error_max_x``; without a channel, the metric's name alone."""
    return f"{kind}_{channel}" if channel else kind
