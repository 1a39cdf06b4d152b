"""Metrics of any signal by the signal's name, which is the name of its column in a trajectory."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.closed_loop.loop import signal_name
from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.closed_loop.metrics.streaming import (
    Accumulator,
    Course,
    FinalValue,
    Metric,
    Scope,
    SignalReader,
    Span,
    Update,
    final_value,
    mean,
    peak_update,
    root_mean,
    suffixed,
    sum_update,
)
from dssc_jax.closed_loop.metrics.window import Window
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.named import NamedSignal, quantity_of, signals_in
from dssc_jax.core.numerics import wrap_angle
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.units import ChannelUnits


class SampledSignal(NamedTuple):
    """A signal of the loop that metrics and formulas can name, such as ``x_e``.

    Args:
        unit: Unit.
        meaning: Meaning in words.
        value: Reads the signal from all signals at a sample.
        periodic: Whether the signal is an angle that jumps by a turn where it leaves (-pi, pi].
    """

    unit: str
    meaning: str
    value: SignalReader
    periodic: bool = False


class Variation(NamedTuple):
    """The total variation of a signal during a flight.

    Args:
        last: Value at the last sample.
        sum: Sum of the sizes of all changes from sample to sample.
        begun: 1 once there was a sample, else 0: the first sample is no change.
    """

    last: Scalar = 0.0
    sum: Scalar = 0.0
    begun: Scalar = 0.0


def channel_field_reader(index: int, field: str) -> SignalReader:
    """Return the function that reads a field of a channel's sample, such as ``e``."""
    return lambda instant: getattr(instant.channels[index], field)


def output_reader(index: int) -> SignalReader:
    """Return the function that reads a channel's output y = e + y_m."""
    return lambda instant: instant.channels[index].e + instant.channels[index].reference.y


def output_rate_reader(index: int) -> SignalReader:
    """Return the function that reads the derivative of a channel's output, y' = e' + y_m'."""
    return lambda instant: instant.channels[index].e_dot + instant.channels[index].reference.y_dot


def desired_output_reader(index: int) -> SignalReader:
    """Return the function that reads a channel's desired output y_m."""
    return lambda instant: instant.channels[index].reference.y


def controller_signal_reader(index: int, field: str) -> SignalReader:
    """Return the function that reads a signal that a channel's controller reports."""
    return lambda instant: signals_in(instant.channels[index].info)[field]


def plant_signal_reader(field: str) -> SignalReader:
    """Return the function that reads a signal that the plant reports."""
    return lambda instant: signals_in(instant.plant)[field]


def measured_signal_reader(index: int) -> SignalReader:
    """Return the function that reads the sensor's reading of a measured signal, by the signal's index."""
    return lambda instant: instant.measured[index]


CHANNEL_SIGNALS = {
    "e": Quantity("y", "output error e"),
    "e_dot": Quantity("y/s", "derivative e' of the output error"),
    "sigma": Quantity("y/s", "sigma"),
    "y_measured": Quantity("y", "output y as the controller sees it"),
    "y_dot_measured": Quantity("y/s", "output's derivative y' as the controller sees it"),
    "sigma_measured": Quantity("y/s", "sigma as the controller sees it"),
    "u": Quantity("u", "robust command u"),
    "u_total": Quantity("u", "command u + u_n"),
}
"""Fields of a channel's sample that are signals."""
WITHIN_A_TURN = ("y", "e", "y_measured")
"""Signals of a channel that stay within half a turn of the reference, or of 0, if the output is an angle."""
TIME = "t"
"""Name of the time in trajectories and formulas."""


def sampled_signals(
    controller_fields: Mapping[str, Sequence[str]],
    plant_fields: Sequence[str],
    units: Sequence[ChannelUnits],
    reports: Sequence[Mapping[str, Quantity]],
    outputs: Mapping[str, Quantity],
    measured: Sequence[NamedSignal],
    angles: Collection[str],
) -> dict[str, SampledSignal]:
    """Every signal of a loop that metrics and formulas can name, by the name of its column in a trajectory.

    Args:
        controller_fields: Names of the signals in each controller's info, by channel.
        plant_fields: Names of the signals in the plant's info.
        units: Units and meanings of each channel.
        reports: Unit and meaning of the signals that each channel's controller declares.
        outputs: Unit and meaning of the signals that the plant declares.
        measured: The measured signals.
        angles: Channels whose output is an angle.

    Raises:
        ConfigError: A controller or the plant reports a signal under the name of another one.
    """
    signals: dict[str, SampledSignal] = {}
    for index, (channel, fields) in enumerate(controller_fields.items()):
        for name, signal in channel_signals(index, fields, units[index], reports[index]).items():
            periodic = channel in angles and name in WITHIN_A_TURN
            signals[signal_name(channel, name)] = signal._replace(periodic=periodic)
    for index, measure in enumerate(measured):
        meaning = f"measured {measure.quantity.meaning}"
        signals[f"measured_{measure.name}"] = SampledSignal(
            measure.unit or "1", meaning, measured_signal_reader(index), measure.periodic
        )
    for name in plant_fields:
        require_free("plant", name, {TIME, *signals})
        quantity = quantity_of(name, outputs) or Quantity("1", name)
        signals[name] = SampledSignal(
            quantity.unit or "1", quantity.meaning, plant_signal_reader(name), quantity.periodic
        )
    return signals


def channel_signals(
    index: int, fields: Sequence[str], units: ChannelUnits, reports: Mapping[str, Quantity]
) -> dict[str, SampledSignal]:
    """Every signal of one channel, by its name without the channel's name, such as ``e``.

    Args:
        index: Index of the channel.
        fields: Names of the signals in the info of the channel's controller.
        units: Units and meanings of the channel's output y and command u.
        reports: Unit and meaning of the signals that the controller declares, by name.

    Raises:
        ConfigError: The controller reports a signal under the name of another one.
    """
    signals: dict[str, SampledSignal] = {}

    def add(name: str, quantity: Quantity, value: SignalReader) -> None:
        """Add a signal of the channel.

        Args:
            name: Name of the signal, without the channel's name.
            quantity: Unit and meaning, with the symbols y and u, which the channel's own units and words replace.
            value: Reads the signal.
        """
        signals[name] = SampledSignal(units.of(quantity.unit), units.describe(quantity.meaning), value)

    add("y", Quantity("y", "output y"), output_reader(index))
    add("y_dot", Quantity("y/s", "derivative y' of the output"), output_rate_reader(index))
    add("y_ref", Quantity("y", "desired output y_m"), desired_output_reader(index))
    for name, quantity in CHANNEL_SIGNALS.items():
        add(name, quantity, channel_field_reader(index, name))
    for name in fields:
        require_free("controller", name, {TIME, *signals})
        add(name, reports.get(name, Quantity("1", name)), controller_signal_reader(index, name))
    return signals


def require_free(part: str, name: str, names: Collection[str]) -> None:
    """Require that a signal that a part reports does not have the name of another signal of the loop.

    Args:
        part: The part, ``controller`` or ``plant``, for the message.
        name: Name of the reported signal.
        names: Names of the other signals.

    Raises:
        ConfigError: The name is among those of the other signals.
    """
    if name in names:
        raise ConfigError(part, f"reports '{name}', which is another signal of the loop; give it a name of its own")


def variation_update(signal: SignalReader, periodic: bool = False) -> Update:
    """Return the ``update`` of a metric that adds up a signal's total variation.

    Args:
        signal: Reads the signal.
        periodic: Whether the signal is an angle that jumps by a turn where it leaves (-pi, pi]. A change of the angle
            then counts along the shorter way.
    """

    def update(acc: Variation, instant: Instant, window: Window) -> Variation:
        """The variation after one more sample; the first sample changes nothing."""
        value = signal(instant)
        change = wrap_angle(value - acc.last) if periodic else value - acc.last
        size = jnp.where(acc.begun > 0.0, jnp.abs(change), 0.0)
        return Variation(value, acc.sum + size, jnp.minimum(acc.begun + 1.0, 1.0))

    return update


def total_variation(acc: Variation, window: Window, span: Span) -> Scalar:
    """The sum of the sizes of all changes of a signal.

    The accumulator holds it; the contract's ``window`` and ``span`` are not read.
    """
    return acc.sum


def extreme_update(extreme: Callable[[Scalar, Scalar], Scalar], signal: SignalReader) -> Update:
    """Return the ``update`` of a metric that keeps a signal's smallest or largest value.

    Args:
        extreme: Minimum or maximum of two numbers.
        signal: Reads the signal.
    """
    return lambda acc, instant, window: extreme(acc, signal(instant))


def square_update(signal: SignalReader) -> Update:
    """Return the ``update`` of a metric that adds up the square of a signal."""
    return sum_update(lambda instant: jnp.square(signal(instant)))


def last_update(signal: SignalReader) -> Update:
    """Return the ``update`` of a metric that keeps the last value of a signal."""
    return lambda acc, instant, window: signal(instant)


class SignalMetric(NamedTuple):
    """A kind of metric that applies to any signal, such as its rms.

    The fields are those of a :class:`~dssc_jax.closed_loop.metrics.streaming.Metric`, but ``update`` and
    ``periodic_update`` are functions that make the update for a given signal.

    Args:
        meaning: Words before the meaning of the signal.
        update: Returns the metric's update for a signal.
        value: Computes the metric from the accumulator at the end.
        start: The accumulator before the first sample.
        course: Whether the value can only rise, only fall, or do both as samples are added.
        least: The least possible value.
        periodic_update: As ``update``, for an angle that jumps by a whole turn; None: ``update`` serves for angles,
            too.
    """

    meaning: str
    update: Callable[[SignalReader], Update]
    value: FinalValue = final_value
    start: Accumulator = 0.0
    course: Course = Course.OPEN
    least: float = -math.inf
    periodic_update: Callable[[SignalReader], Update] | None = None


SIGNAL_METRICS: dict[str, SignalMetric] = {
    "rms": SignalMetric("rms of the", square_update, root_mean, least=0.0),
    "max_abs": SignalMetric("largest size of the", peak_update, course=Course.RISES, least=0.0),
    "highest": SignalMetric("highest", partial(extreme_update, jnp.maximum), start=-jnp.inf, course=Course.RISES),
    "lowest": SignalMetric("lowest", partial(extreme_update, jnp.minimum), start=jnp.inf, course=Course.FALLS),
    "mean": SignalMetric("mean", sum_update, mean),
    "final": SignalMetric("last", last_update),
    "variation": SignalMetric(
        meaning="total variation of the",
        update=variation_update,
        value=total_variation,
        start=Variation(),
        course=Course.RISES,
        least=0.0,
        periodic_update=partial(variation_update, periodic=True),
    ),
}
"""The kinds of metric that apply to any signal, by their names in a study."""


def signal_metric(kind: str, signal: SampledSignal) -> Metric:
    """The metric of one kind for one signal.

    Args:
        kind: A key of :data:`SIGNAL_METRICS`, such as ``rms``.
        signal: The signal, with its unit and meaning.
    """
    form = SIGNAL_METRICS[kind]
    make_update = form.update
    if signal.periodic and form.periodic_update is not None:
        make_update = form.periodic_update
    return Metric(
        signal.unit,
        f"{form.meaning} {signal.meaning}",
        make_update(signal.value),
        form.value,
        scope=Scope.VEHICLE,
        start=form.start,
        course=form.course,
        least=form.least,
    )


def metrics_of_signals(names: Sequence[str], signals: Mapping[str, SampledSignal]) -> dict[str, Metric]:
    """The metrics of signals that a study names, by their names.

    Args:
        names: Names of metrics; a metric of a signal has a name of kind and signal, such as ``rms_tyre_force``.
        signals: The signals of the loop by name.
    """
    metrics = {}
    for kind in SIGNAL_METRICS:
        for column, signal in signals.items():
            metric_name = suffixed(kind, column)
            if metric_name in names:
                metrics[metric_name] = signal_metric(kind, signal)
    return metrics
