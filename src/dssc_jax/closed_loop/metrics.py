"""Metrics in streaming form, whose memory does not grow with the duration.

A metric is the start of its accumulator and two pure functions, ``update`` and ``value``, of the samples in a window.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from dssc_jax.closed_loop.margin_kinds import NO_MARGINS, LoopMargin
from dssc_jax.closed_loop.spans import Span, first_sample, in_window, span_of
from dssc_jax.closed_loop.stretches import Stretch, longest, stretch
from dssc_jax.closed_loop.window import WHOLE_RUN, Window
from dssc_jax.core.errors import errors_in_code
from dssc_jax.core.numerics import root_abs
from dssc_jax.core.signals import Info, ReferencePoint, Scalar
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits


class Sample(NamedTuple):
    """The signals of one channel at a sample instant, for metrics.

    ``k`` is the sample index. ``e``, ``e_dot`` and ``sigma`` are true, ``y_measured``, ``y_dot_measured`` and
    ``sigma_measured`` are what the controller sees. ``u`` is the robust command and ``u_previous`` its previous value
    (at the first sample: ``u``); ``k_p`` is the draw's own input gain. The output is y = e + ``reference.y``.
    """

    k: Scalar
    dt: float
    e: Scalar
    sigma: Scalar
    sigma_measured: Scalar
    u: Scalar
    u_previous: Scalar
    u_total: Scalar
    k_p: Scalar
    info: Info
    reference: ReferencePoint = ReferencePoint(0.0, 0.0, 0.0)
    e_dot: Scalar = 0.0
    y_measured: Scalar = 0.0
    y_dot_measured: Scalar = 0.0


class Instant(NamedTuple):
    """The whole loop at one sample.

    Args:
        t: Time [s].
        dt: Sample time [s].
        channels: The sample of each channel.
        plant: What the plant's monitor reports.
        measured: Readings of the measured signals.
    """

    t: Scalar
    dt: Scalar
    channels: tuple[Sample, ...]
    plant: Info
    measured: tuple[Scalar, ...] = ()


Accumulator: TypeAlias = Any
"""What a metric accumulates: a number, or a NamedTuple of numbers."""

Observed: TypeAlias = Any
"""What a metric sees: a :class:`Sample` of its channel, or the :class:`Instant` of the vehicle."""


class Scope(StrEnum):
    """Scope of a metric: each channel, or the vehicle as a whole."""

    CHANNEL = "channel"
    VEHICLE = "vehicle"


class Course(StrEnum):
    """How a metric's value changes while samples are added: a bound that a rising value exceeds stays exceeded."""

    RISES = "rises"
    FALLS = "falls"
    OPEN = "open"


class Metric(NamedTuple):
    """A streaming measure.

    Args:
        unit: Unit, with the symbols ``y`` and ``u`` of :mod:`dssc_jax.core.units` for those of the channel.
        meaning: Long name.
        update: ``(accumulator, sample, window) -> accumulator``; a vehicle's metric receives the :class:`Instant`.
        value: ``(accumulator, window, span) -> value``.
        needs: Fields of the controller's (the vehicle's) info that the metric requires.
        scope: A channel, or the vehicle as a whole.
        start: The accumulator before the first sample: a number, or a ``NamedTuple`` of numbers.
        counted: Whether the value counts samples, as a time or as a share; rounding changes it by whole samples.
        course: How the value changes while samples are added.
        certain_after: ``accumulator -> number of samples after which the sign of the final value was certain``.
        margin: For a margin of the linearised loop: which one, and where. The accumulator starts at its value.
        least: The least value that it can have: 0 of a size.
        defined_if: What has to be so that its value is not NaN, in words; empty: nothing.
        settled_within: ``window -> bound`` on |e| at the end of a settled draw, by which its value is that of the
            whole run. NaN: the bound differs between draws. None: no bound is needed.
    """

    unit: str
    meaning: str
    update: Callable[[Accumulator, Observed, Window], Accumulator]
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
        """The value as which a draw without one counts: -inf of a minimum, 0 or the like of a margin."""
        if self.margin is not None:
            return self.margin.kind.worst
        return -math.inf if self.certain_after is not None or self.course == Course.FALLS else math.inf


RISES = Course.RISES


def peak(of: Callable[[Observed], Scalar]) -> Callable[[Scalar, Observed, Window], Scalar]:
    """Running maximum of |.|."""
    return lambda acc, sample, window: jnp.maximum(acc, jnp.abs(of(sample)))


def total(of: Callable[[Observed], Scalar]) -> Callable[[Scalar, Observed, Window], Scalar]:
    """Running sum."""
    return lambda acc, sample, window: acc + of(sample)


def variation(acc: Scalar, sample: Sample, window: Window) -> Scalar:
    """Add the change to this sample's u; the window's first sample has none."""
    first = first_sample(window.after, sample.dt)
    change = jnp.abs(sample.u - sample.u_previous)
    return acc + (change if first == 0 else jnp.where(sample.k == first, 0.0, change))


def itself(acc: Scalar, window: Window, span: Span) -> Scalar:
    """The accumulator."""
    return acc


def mean(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Mean over the window."""
    return acc / span.sample_count


def root_mean(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Root of the mean over the window."""
    return root_abs(acc / span.sample_count)


def last_outside(acc: Scalar, sample: Sample, window: Window) -> Scalar:
    """Number of samples up to the last one with |e| > band; a count is exact in float32 up to 16 million."""
    return jnp.where(jnp.abs(sample.e) > window.band, jnp.asarray(sample.k + 1, jnp.result_type(float)), acc)


def settling(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Time from the window's start to the end of the last sample outside; infinite if that ends the run."""
    time = jnp.maximum(acc * span.sample_time - window.after, 0.0)
    return jnp.where(acc >= span.steps, jnp.inf, time)


def sampling_ratio(sample: Sample) -> Scalar:
    """(k_p T_s/(k_o tau_av)) (1 + T_s/(2 tau_m))/2: above 1 the sampled loop chatters or diverges.

    The stability limit is exact for constant functions and sigma' = k_p u; state-dependent functions enter with their
    values at the sample. k_p is the draw's own, so the largest ratio over the draws occurs at k_max.
    """
    info = sample.info
    dt = sample.dt
    return 0.5 * sample.k_p * dt * info.integral_gain * (info.tau_m + 0.5 * dt)


def position_error(instant: Instant) -> Scalar:
    """Distance from the desired position; the first three channels are x, y, z."""
    return root_abs(sum(jnp.square(sample.e) for sample in instant.channels[:3]))


def as_float(flag: Scalar, like: Scalar) -> Scalar:
    """1 if the flag holds, else 0."""
    return jnp.where(flag, jnp.ones_like(like), jnp.zeros_like(like))


def share_of_time(meaning: str, holds: Callable[[Sample], Scalar], needs: tuple[str, ...]) -> Metric:
    """The share of time for which a flag of a channel holds."""
    update = total(lambda sample: as_float(holds(sample), sample.e))
    return Metric("1", f"share of time {meaning}", update, mean, needs=needs, counted=True, least=0.0)


def vehicle_metric(
    unit: str,
    meaning: str,
    update: Callable[[Accumulator, Instant, Window], Accumulator],
    value: Callable[[Accumulator, Window, Span], Scalar],
    start: Accumulator = 0.0,
    counted: bool = False,
    course: Course = Course.OPEN,
) -> Metric:
    """A metric of the vehicle, which is a size."""
    return Metric(unit, meaning, update, value, FLYING, Scope.VEHICLE, start, counted, course, least=0.0)


def rotor_limited(instant: Instant) -> Scalar:
    """1 if a rotor is at its limit, else 0."""
    return as_float(instant.plant.rotor_limited, instant.plant.tilt)


def lift_bounded(instant: Instant) -> Scalar:
    """1 if the wanted lift is at its lower bound, else 0."""
    return as_float(instant.plant.lift_bounded, instant.plant.tilt)


SLIDING = ("sliding_margin",)
SAMPLING = ("integral_gain", "tau_m")
FLYING = ("tilt",)
METRICS: dict[str, Metric] = {
    "error_rms": Metric("y", "rms of the output error e", total(lambda s: s.e * s.e), root_mean, least=0.0),
    "error_max": Metric("y", "largest |e|", peak(lambda s: s.e), itself, course=RISES, least=0.0),
    "sigma_rms": Metric("y/s", "rms of sigma", total(lambda s: s.sigma * s.sigma), root_mean, least=0.0),
    "sigma_max": Metric("y/s", "largest |sigma|", peak(lambda s: s.sigma), itself, course=RISES, least=0.0),
    "settling_time": Metric(
        "s",
        "time after which |e| stays within the band",
        last_outside,
        settling,
        counted=True,
        course=RISES,
        least=0.0,
        settled_within=lambda window: window.band,
    ),
    "command_tv": Metric("u", "total variation of the robust command u", variation, itself, course=RISES, least=0.0),
    "command_rms": Metric("u", "rms of the robust command u", total(lambda s: s.u * s.u), root_mean, least=0.0),
    "command_max": Metric("u", "largest |u|", peak(lambda s: s.u), itself, course=RISES, least=0.0),
    "total_command_max": Metric("u", "largest |u + u_n|", peak(lambda s: s.u_total), itself, course=RISES, least=0.0),
    "outside_sliding": share_of_time("outside sliding", lambda s: s.info.sliding_margin < 0.0, SLIDING),
    "sampling_ratio": Metric(
        "1", "largest sampling ratio", peak(sampling_ratio), itself, SAMPLING, course=RISES, least=0.0
    ),
    "sampling_ratio_above_1": share_of_time(
        "with a sampling ratio above 1", lambda s: sampling_ratio(s) > 1.0, SAMPLING
    ),
    "position_error_rms": vehicle_metric(
        "m", "rms of the position error", total(lambda i: jnp.square(position_error(i))), root_mean
    ),
    "position_error_max": vehicle_metric("m", "largest position error", peak(position_error), itself, course=RISES),
    "tilt_max": vehicle_metric("rad", "largest tilt of body z", peak(lambda i: i.plant.tilt), itself, course=RISES),
    "rotor_limited": vehicle_metric(
        "1", "share of time with a rotor at its limit", total(rotor_limited), mean, counted=True
    ),
    "rotor_limited_longest": vehicle_metric(
        "s",
        "longest uninterrupted time with a rotor at its limit",
        stretch(rotor_limited),
        longest,
        Stretch(),
        counted=True,
        course=RISES,
    ),
    "lift_bounded": vehicle_metric(
        "1", "share of time with the wanted lift at its lower bound", total(lift_bounded), mean, counted=True
    ),
}
BRIEF = ("error_rms", "error_max", "command_tv", "command_max", "outside_sliding", "sampling_ratio")
"""Metrics of each channel that a plant with several channels reports unless the study lists others."""


@dataclass(frozen=True)
class Measure:
    """One metric of one channel, or of the vehicle, over one window.

    Args:
        name: Its name in results.
        kind: The metric's name.
        window: The samples that count.
        channel: Index of the channel; None: the vehicle.
        custom: The streaming form, for a kind that is not in :data:`METRICS`.
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
        """The window in words, empty if it is the default one from the start on."""
        return self.window.words(self.default_window)

    @property
    def metric(self) -> Metric:
        """The streaming form."""
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
        """Long name of the value; a user's own metric keeps its words."""
        return self.units.named(self.metric.meaning) if self.custom is None else self.metric.meaning

    def of(self, instant: Instant) -> Sample | Instant:
        """The argument with which the metric is updated."""
        return instant if self.channel is None else instant.channels[self.channel]


def suffixed(kind: str, channel: str) -> str:
    """A metric's name followed by that of its channel, if the channel has one."""
    return f"{kind}_{channel}" if channel else kind


def starts(measures: tuple[Measure, ...], margins: Mapping[str, Scalar] = NO_MARGINS) -> tuple[Accumulator, ...]:
    """Every accumulator before the first sample; those of margins start at their values, which are by measure."""
    return tuple(m.metric.start if m.metric.margin is None else margins[m.name] for m in measures)


def update_all(
    measures: tuple[Measure, ...], accumulators: tuple[Accumulator, ...], instant: Instant, k: Scalar, t_s: float
) -> tuple[Accumulator, ...]:
    """Every accumulator after sample k."""
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
    """Every metric at the end of a run of ``steps`` samples."""
    computed = {}
    for measure, acc in zip(measures, accumulators, strict=True):
        span = span_of(measure.window, steps, t_s)
        with errors_in_code(f"metric '{measure.kind}'", measure.metric.value):
            value = measure.metric.value(acc, measure.window, span)
            require_like(value, 0.0)
        computed[measure.name] = value
    return computed


def require_like(value: Accumulator, pattern: Accumulator) -> None:
    """Require that a metric's code returns numbers, or arrays, in the structure that it began with.

    Raises:
        TypeError: It returns another structure, or an array.
    """
    structure = jax.tree.structure(value)
    expected = jax.tree.structure(pattern)
    if structure != expected:
        raise TypeError(f"it must return {expected}, got {structure}")
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(value)]
    if shapes != [jnp.shape(leaf) for leaf in jax.tree.leaves(pattern)]:
        raise TypeError(f"it must return numbers, got arrays of shapes {shapes}")
