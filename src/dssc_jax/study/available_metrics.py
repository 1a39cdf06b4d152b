"""The metrics that a study can name: all kinds, and those for which its loop reports the signals."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from dssc_jax.closed_loop.metrics.performance import PERFORMANCE
from dssc_jax.closed_loop.metrics.step_response import STEP_RESPONSE
from dssc_jax.closed_loop.metrics.streaming import METRICS, Measure, Metric, Scope, suffixed
from dssc_jax.closed_loop.metrics.window import Window
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits
from dssc_jax.study.importing import import_object
from dssc_jax.study.schema import StudyTable

PACKAGE_METRICS = METRICS | PERFORMANCE | STEP_RESPONSE
"""The package's metrics by kind; metrics that take any signal, such as ``rms``, are not among them."""


def metric_kinds(config: StudyTable) -> dict[str, Metric]:
    """All kinds of metric by name: those of the package, and those that a study names as ``package.module:object``.

    Raises:
        ConfigError: An object cannot be imported, is no metric, or has the same name as another metric.
    """
    metrics = dict(PACKAGE_METRICS)
    names_by_place: dict[str, str] = {}
    for index, name in enumerate(config.metrics.names or ()):
        names_by_place[f"metrics.names.{index}"] = name
    for index, table in enumerate(config.requirement):
        if table.metric is not None:
            names_by_place[f"requirement.{index}.metric"] = table.metric
    for place, name in names_by_place.items():
        if ":" not in name:
            continue
        metric = import_object(name, place)
        if not isinstance(metric, Metric):
            raise ConfigError(place, f"'{name}' must be a Metric, got {type(metric).__name__}")
        known_metric = metrics.setdefault(kind_name(name), metric)
        if known_metric is not metric:
            raise ConfigError(place, f"there is another metric of the name '{kind_name(name)}'; rename the object")
    return metrics


def kind_name(name: str) -> str:
    """Name of a kind of metric in results; for a user's ``package.module:object``, the name of the object."""
    _, _, last_name = name.rpartition(":")
    return last_name


class NamedMetric(NamedTuple):
    """A metric that a loop can have.

    Args:
        kind: Kind of the metric, such as ``error_rms``.
        channel: Index of the channel that the metric describes; None for a metric of the vehicle or of a signal.
    """

    kind: str
    channel: int | None


def available_metrics(
    channels: Mapping[str, Sequence[str]], vehicle: Sequence[str], kinds: Mapping[str, Metric]
) -> dict[str, NamedMetric]:
    """Metrics that a loop can have, by name: those whose needed fields its controllers or its plant report.

    Args:
        channels: Names of the fields in the controller's info of each channel, by the channel's name.
        vehicle: Names of the fields in the plant's info.
        kinds: All kinds of metric by name.
    """
    metrics: dict[str, NamedMetric] = {}
    for kind, metric in kinds.items():
        if metric.scope is Scope.VEHICLE:
            if set(metric.needs) <= set(vehicle):
                metrics[kind] = NamedMetric(kind, None)
            continue
        for index, (channel, fields) in enumerate(channels.items()):
            if set(metric.needs) <= set(fields):
                metrics[suffixed(kind, channel)] = NamedMetric(kind, index)
    return metrics


class AvailableMetrics(NamedTuple):
    """The metrics that a loop can have, with the units and names that their measures need.

    Args:
        names: The metrics by name.
        kinds: All kinds of metric by name, including those of signals and of users.
        channels: Names of the channels; one empty name for a plant with one channel.
        units: Units and meanings of each channel.
        default_window: Window of ``[metrics]``.
    """

    names: Mapping[str, NamedMetric]
    kinds: Mapping[str, Metric]
    channels: tuple[str, ...]
    units: tuple[ChannelUnits, ...]
    default_window: Window

    def with_signal_metrics(self, metrics: Mapping[str, Metric]) -> "AvailableMetrics":
        """Add metrics of signals, given by name; each of them is a kind of its own."""
        names = {name: NamedMetric(name, None) for name in metrics}
        return self._replace(names={**self.names, **names}, kinds={**self.kinds, **metrics})

    def measure(self, name: str, window: Window) -> Measure:
        """Make the measure of a metric over a window; its name contains the window unless that is the default one."""
        kind, channel = self.names[name]
        is_of_channel = channel is not None
        return Measure(
            name=name + window.suffix(self.default_window),
            kind=kind,
            window=window,
            channel=channel,
            custom=None if kind in METRICS else self.kinds[kind],
            units=self.units[channel] if is_of_channel else UNNAMED_UNITS,
            channel_name=self.channels[channel] if is_of_channel else "",
            default_window=self.default_window,
        )

    def require(self, name: str, place: str) -> None:
        """Require that the loop has the metric of this name.

        Args:
            name: Name of the metric.
            place: Place of the study that names it, for messages.

        Raises:
            ConfigError: The metric is unknown, or the loop lacks a signal that it needs.
        """
        if name in self.names:
            return
        if name.endswith("_margin"):
            rule = f"'{name}' belongs to the linearised loop"
            raise ConfigError(place, f'{rule}; write margin = "{name.removesuffix("_margin")}" in place of the metric')
        for channel in self.channels:
            for kind, metric in self.kinds.items():
                if metric.needs and suffixed(kind, channel) == name:
                    needs = ", ".join(metric.needs)
                    raise ConfigError(place, f"'{name}' needs {needs}, which this loop does not have")
        raise ConfigError(place, f"unknown metric '{name}'; {nearest(name, self.names)}")
