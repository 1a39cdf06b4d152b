"""Metrics in streaming form, whose memory does not grow with the duration.

A metric consists of an accumulator and two pure functions: ``update`` adds a sample of the window, and ``value``
computes the metric from the accumulator at the end.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from dssc_jax.closed_loop.metrics.instants import Instant, Sample
from dssc_jax.closed_loop.metrics.margin_kinds import NO_MARGINS, LoopMargin
from dssc_jax.closed_loop.metrics.stretches import Stretch, longest, stretch
from dssc_jax.closed_loop.metrics.window import WHOLE_RUN, Span, Window, first_sample, in_window, span_of
from dssc_jax.core.errors import errors_in_code
from dssc_jax.core.numerics import root_abs
from dssc_jax.core.signals import Scalar
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits

Accumulator: TypeAlias = Any
"""A number, or a NamedTuple of numbers."""

MetricInput: TypeAlias = Any
"""The :class:`Sample` of a channel for a metric of channels, or the :class:`Instant` for a metric of the vehicle."""


class Scope(StrEnum):
    """The object that a metric describes: one channel, or the vehicle as a whole."""

    CHANNEL = "channel"
    VEHICLE = "vehicle"


class Course(StrEnum):
    """How the value of a metric changes as samples are added: a rising value that exceeds a bound never returns."""

    RISES = "rises"
    FALLS = "falls"
    OPEN = "open"


class Metric(NamedTuple):
    """A number that is computed from a flight sample by sample.

    Args:
        unit: Unit, with the symbols ``y`` and ``u`` of :mod:`dssc_jax.core.units` for those of the channel.
        meaning: Meaning in words.
        update: ``(accumulator, sample, window) -> accumulator``; a vehicle's metric receives the :class:`Instant`.
        value: ``(accumulator, window, span) -> value``.
        needs: Fields that the info of the controller, or of the vehicle, must have.
        scope: One channel, or the vehicle as a whole.
        start: The accumulator before the first sample: a number, or a ``NamedTuple`` of numbers.
        counted: Whether the value counts samples, as a time or a share; rounding then changes it by whole samples.
        course: How the value changes as samples are added.
        certain_after: ``accumulator -> number of samples after which the sign of the final value was certain``.
        margin: The margin of the linearised loop whose value is the accumulator; None: a metric of the flight.
        least: The least value that is possible, such as 0 for a size.
        defined_if: Condition for a value other than NaN, in words; empty: none.
        settled_within: ``window -> bound`` on |e| at the end of a settled draw. Within it, the value at the draw's end
            is that of the whole run. NaN: the bound differs between draws. None: no bound is needed.
    """

    unit: str
    meaning: str
    update: Callable[[Accumulator, MetricInput, Window], Accumulator]
    value: Callable[[Accumulator, Window, Span], Scalar]
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
    def worst(self) -> float:
        """The value that replaces NaN: the limit of stability for a margin, else the infinity on the bad side."""
        if self.margin is not None:
            return self.margin.kind.worst
        return -math.inf if self.certain_after is not None or self.course == Course.FALLS else math.inf


RISES = Course.RISES


def peak(signal: Callable[[MetricInput], Scalar]) -> Callable[[Scalar, MetricInput, Window], Scalar]:
    """The update of the running maximum of a signal's size."""
    return lambda acc, sample, window: jnp.maximum(acc, jnp.abs(signal(sample)))


def total(signal: Callable[[MetricInput], Scalar]) -> Callable[[Scalar, MetricInput, Window], Scalar]:
    """The update of the running sum of a signal."""
    return lambda acc, sample, window: acc + signal(sample)


def update_variation(acc: Scalar, sample: Sample, window: Window) -> Scalar:
    """Add the size of the robust command's change to this sample; the window's first sample has none."""
    first = first_sample(window.after, sample.dt)
    change = jnp.abs(sample.u - sample.u_previous)
    return acc + (change if first == 0 else jnp.where(sample.k == first, 0.0, change))


def final_value(acc: Scalar, window: Window, span: Span) -> Scalar:
    """The accumulator itself, as the value of a running maximum or total."""
    return acc


def mean(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Mean over the window, of an accumulated sum."""
    return acc / span.sample_count


def root_mean(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Root of the mean over the window, of an accumulated sum of squares."""
    return root_abs(acc / span.sample_count)


def last_outside(acc: Scalar, sample: Sample, window: Window) -> Scalar:
    """Number of samples up to the last one with |e| > band, a float that is exact in float32 up to 16 million."""
    return jnp.where(jnp.abs(sample.e) > window.band, jnp.asarray(sample.k + 1, jnp.result_type(float)), acc)


def settling_time(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Time from the window's start to the end of the last sample outside the band; infinite if that is the last one."""
    time = jnp.maximum(acc * span.sample_time - window.after, 0.0)
    return jnp.where(acc >= span.steps, jnp.inf, time)


def sampling_ratio(sample: Sample) -> Scalar:
    """Gain of the sampled loop over its stability limit: (k_p T_s/(k_o tau_av)) (1 + T_s/(2 tau_m))/2.

    Above 1 the sampled loop chatters or diverges. The limit is exact for constant functions and sigma' = k_p u;
    state-dependent functions enter with their values at the sample. The info reports 1/(k_o tau_av) times tau_m.
    """
    info = sample.info
    dt = sample.dt
    return 0.5 * sample.k_p * dt * info.integral_gain * (info.tau_m + 0.5 * dt)


def position_error(instant: Instant) -> Scalar:
    """Distance from the desired position [m]; the first three channels are x, y, z."""
    return root_abs(sum(jnp.square(sample.e) for sample in instant.channels[:3]))


def as_float(flag: Scalar, like: Scalar) -> Scalar:
    """1 if the flag holds, else 0, in the type of another number."""
    return jnp.where(flag, jnp.ones_like(like), jnp.zeros_like(like))


def rms(
    unit: str,
    meaning: str,
    signal: Callable[[MetricInput], Scalar],
    needs: tuple[str, ...] = (),
    scope: Scope = Scope.CHANNEL,
) -> Metric:
    """The metric of a signal's rms over the window; other arguments as of :class:`Metric`."""

    def square(sample: MetricInput) -> Scalar:
        value = signal(sample)
        return value * value

    return Metric(unit, meaning, total(square), root_mean, needs, scope, least=0.0)


def largest_absolute(
    unit: str,
    meaning: str,
    signal: Callable[[MetricInput], Scalar],
    needs: tuple[str, ...] = (),
    scope: Scope = Scope.CHANNEL,
) -> Metric:
    """The metric of a signal's largest absolute value; other arguments as of :class:`Metric`."""
    return Metric(unit, meaning, peak(signal), final_value, needs, scope, course=Course.RISES, least=0.0)


def share_of_time(
    meaning: str, indicator: Callable[[MetricInput], Scalar], needs: tuple[str, ...], scope: Scope = Scope.CHANNEL
) -> Metric:
    """The metric of the share of time for which an indicator is 1 and not 0; other arguments as of :class:`Metric`."""
    update = total(indicator)
    return Metric("1", f"share of time {meaning}", update, mean, needs, scope, counted=True, least=0.0)


def outside_sliding(sample: Sample) -> Scalar:
    """1 if the predictor is outside sliding, else 0."""
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
        stretch(rotor_limited),
        longest,
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
        """The window in words; empty if no value of it needs mention."""
        return self.window.words(self.default_window)

    @property
    def metric(self) -> Metric:
        """The metric."""
        return self.custom or METRICS[self.kind]

    @property
    def label(self) -> str:
        """Kind and channel, without the window."""
        return suffixed(self.kind, self.channel_name)

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return self.units.of(self.metric.unit)

    @property
    def meaning(self) -> str:
        """Meaning of the value in the words of the channel; a custom metric keeps its own words."""
        return self.units.named(self.metric.meaning) if self.custom is None else self.metric.meaning

    def of(self, instant: Instant) -> Sample | Instant:
        """The argument with which the metric is updated."""
        return instant if self.channel is None else instant.channels[self.channel]


def suffixed(kind: str, channel: str) -> str:
    """A metric's name followed by that of its channel, if the channel has one."""
    return f"{kind}_{channel}" if channel else kind


def starts(measures: tuple[Measure, ...], margins: Mapping[str, Scalar] = NO_MARGINS) -> tuple[Accumulator, ...]:
    """Every accumulator before the first sample.

    Args:
        measures: The measures.
        margins: Value of each margin of the linearised loop among them, by name; it is the margin's accumulator.
    """
    return tuple(m.metric.start if m.metric.margin is None else margins[m.name] for m in measures)


def update_all(
    measures: tuple[Measure, ...], accumulators: tuple[Accumulator, ...], instant: Instant, k: Scalar, t_s: float
) -> tuple[Accumulator, ...]:
    """Every accumulator after sample k; those whose window does not contain the sample are unchanged.

    Args:
        measures: The measures.
        accumulators: Their accumulators before the sample.
        instant: The loop at the sample.
        k: Index of the sample.
        t_s: Sample time T_s [s].
    """
    updated = []
    for measure, acc in zip(measures, accumulators, strict=True):
        with errors_in_code(f"metric '{measure.kind}'", measure.metric.update):
            new_acc = measure.metric.update(acc, measure.of(instant), measure.window)
            require_like(new_acc, acc)
        is_inside = in_window(measure.window, k, t_s)
        updated.append(new_acc if is_inside is None else jax.tree.map(partial(jnp.where, is_inside), new_acc, acc))
    return tuple(updated)


def values(
    measures: tuple[Measure, ...], accumulators: tuple[Accumulator, ...], steps: Scalar, t_s: float
) -> dict[str, Scalar]:
    """The value of every measure, by name, at the end of a run of ``steps`` samples with sample time T_s [s]."""
    computed = {}
    for measure, acc in zip(measures, accumulators, strict=True):
        span = span_of(measure.window, steps, t_s)
        with errors_in_code(f"metric '{measure.kind}'", measure.metric.value):
            value = measure.metric.value(acc, measure.window, span)
            require_like(value, 0.0)
        computed[measure.name] = value
    return computed


def require_like(value: Accumulator, pattern: Accumulator) -> None:
    """Require that a result of a metric's code has the structure of a pattern, with arrays of the same shapes.

    Raises:
        TypeError: It has another structure, or other shapes.
    """
    structure = jax.tree.structure(value)
    expected = jax.tree.structure(pattern)
    if structure != expected:
        raise TypeError(f"it must return {expected}, got {structure}")
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(value)]
    if shapes != [jnp.shape(leaf) for leaf in jax.tree.leaves(pattern)]:
        raise TypeError(f"it must return numbers, got arrays of shapes {shapes}")
