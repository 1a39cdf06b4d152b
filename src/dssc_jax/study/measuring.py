"""Parsing of a study's metrics and requirements into measures, each a metric over a window, and their bounds."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from dssc_jax.closed_loop.metrics.instants import Sample
from dssc_jax.closed_loop.metrics.requirements import Requirement
from dssc_jax.closed_loop.metrics.signal_metrics import SIGNAL_METRICS, SampledSignal, metrics_of_signals
from dssc_jax.closed_loop.metrics.step_response import envelope_metric
from dssc_jax.closed_loop.metrics.streaming import BRIEF, METRICS, Measure, Metric, Scope, suffixed
from dssc_jax.closed_loop.metrics.window import Window, first_sample, samples_before_end
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.signals import Scalar
from dssc_jax.study.available_metrics import AvailableMetrics, kind_name
from dssc_jax.study.formula_requirements import Constants, formula_requirement, formula_signals
from dssc_jax.study.margin_requirements import margin_requirement
from dssc_jax.study.schema import EnvelopeTable, RequirementTable, StudyTable

ROUNDING = 1e-9  # relative tolerance of compared times


class EnvelopeSignal(NamedTuple):
    """A signal of a channel that an envelope can bound.

    Args:
        unit: Unit of the signal; y and u stand for the units of the channel's output and command.
        meaning: Meaning in words.
        value: (sample of the channel) -> value of the signal.
    """

    unit: str
    meaning: str
    value: Callable[[Sample], Scalar]


ENVELOPE_SIGNALS = {
    "y": EnvelopeSignal("y", "the output y", lambda sample: sample.e + sample.reference.y),
    "e": EnvelopeSignal("y", "the output error e", lambda sample: sample.e),
    "sigma": EnvelopeSignal("y/s", "sigma", lambda sample: sample.sigma),
    "u": EnvelopeSignal("u", "the robust command u", lambda sample: sample.u),
    "u_total": EnvelopeSignal("u", "the command u + u_n", lambda sample: sample.u_total),
}


def parse_measures(
    config: StudyTable,
    loop_metrics: AvailableMetrics,
    signals: Mapping[str, SampledSignal],
    parameters: Constants,
) -> tuple[tuple[Measure, ...], tuple[Requirement, ...]]:
    """Parse the metrics and the requirements of a study.

    Args:
        config: Tables of the study.
        loop_metrics: Metrics that the loop can have, without those of signals.
        signals: Signals of the loop by name.
        parameters: (text of an expression, place that needs the value) -> value, a plain number.

    Returns:
        - The measures: the reported metrics over the window of ``[metrics]``, then those that only requirements need.
        - The requirements.

    Raises:
        ConfigError: A metric is unknown or not available, no metric is named, a requirement is not valid, or a window
            contains no sample.
    """
    available = loop_metrics.with_signal_metrics(signal_metrics_of(config, signals))
    require_samples(config, available.default_window, "metrics.after")
    measures = reported_measures(config, available)
    signals_of_formulas = formula_signals(signals)
    requirements: list[Requirement] = []
    for index, table in enumerate(config.requirement):
        place = f"requirement.{index}"
        if table.formula is not None:
            requirement = formula_requirement(table, place, config, signals_of_formulas, parameters)
            name = requirement.measure.name
            if name in measures or name in available.names:
                raise ConfigError(f"{place}.name", f"'{name}' is taken; choose another name")
        elif table.margin is not None:
            requirement = margin_requirement(table, place, available.channels)
            require_new(requirement, requirements, place)
        else:
            requirement = metric_requirement(table, place, config, available)
            require_new(requirement, requirements, place)
        measures.setdefault(requirement.measure.name, requirement.measure)
        requirements.append(requirement)
    for requirement in envelope_requirements(config, available):
        measures[requirement.measure.name] = requirement.measure
        requirements.append(requirement)
    if not measures:
        raise ConfigError("metrics.names", "names none, and nothing is required: nothing would be measured; name one")
    if config.plot.metric is not None and config.plot.metric not in measures:
        raise ConfigError(
            "plot.metric", f"unknown metric '{config.plot.metric}'; {nearest(config.plot.metric, measures)}"
        )
    return tuple(measures.values()), tuple(requirements)


def reported_measures(config: StudyTable, available: AvailableMetrics) -> dict[str, Measure]:
    """Measures that results report besides the required ones, by name, over the window of ``[metrics]``.

    Raises:
        ConfigError: ``metrics.names`` has an unknown kind.
    """
    kinds = kinds_to_report(config, available)
    measures = {}
    for name, metric in available.names.items():
        if metric.kind in kinds:
            measures[name] = available.measure(name, available.default_window)
    return measures


def kinds_to_report(config: StudyTable, available: AvailableMetrics) -> Sequence[str]:
    """Kinds of metric that results report besides the required ones.

    If the study does not state ``metrics.names``, a loop with one channel reports all common kinds. A loop with several
    channels reports a few kinds of each channel, and all kinds of the vehicle.

    Args:
        config: Tables of the study.
        available: Metrics that the loop can have.

    Raises:
        ConfigError: ``metrics.names`` has an unknown kind.
    """
    if config.metrics.names is None:
        if len(available.channels) == 1:
            return tuple(METRICS)
        kinds_of_vehicle = [kind for kind, metric in METRICS.items() if metric.scope is Scope.VEHICLE]
        return (*BRIEF, *kinds_of_vehicle)
    kinds = [kind_name(name) for name in config.metrics.names]
    for index, kind in enumerate(kinds):
        if kind not in available.kinds:
            raise ConfigError(f"metrics.names.{index}", f"unknown metric '{kind}'; {nearest(kind, available.kinds)}")
    return kinds


def metric_requirement(
    table: RequirementTable, place: str, config: StudyTable, available: AvailableMetrics
) -> Requirement:
    """Parse a requirement that bounds a metric of the loop from above or below.

    Args:
        table: Table of the requirement, which has a metric.
        place: Dotted path of the table, such as ``requirement.0``.
        config: Tables of the study.
        available: Metrics that the loop can have.

    Raises:
        ConfigError: The loop does not have the metric, its window contains no sample, or the bound is below the
            metric's least value.
    """
    name = required_metric(table)
    available.require(name, f"{place}.metric")
    window = table.window(available.default_window)
    require_samples(config, window, f"{place}.after")
    requirement = Requirement(available.measure(name, window), *table.bounds)
    require_meaningful(requirement, place)
    return requirement


def require_meaningful(requirement: Requirement, place: str) -> None:
    """Require that a bound is not below the least value that its metric can have, such as 0 for a magnitude.

    Raises:
        ConfigError: The bound is below the least value: every draw would violate it as an upper bound, and no draw as a
            lower bound.
    """
    measure = requirement.measure
    for bound_name, bound in (("max", requirement.maximum), ("min", requirement.minimum)):
        if bound is not None and bound < measure.metric.least:
            rule = f"must be >= {measure.metric.least:g} {measure.unit}, as every {measure.kind} is; got {bound:g}"
            raise ConfigError(f"{place}.{bound_name}", rule)


def require_new(requirement: Requirement, requirements: Sequence[Requirement], place: str) -> None:
    """Require that no earlier requirement bounds the same measure on the same side.

    Args:
        requirement: The new requirement.
        requirements: The earlier requirements.
        place: Dotted path of the new requirement's table, for messages.

    Raises:
        ConfigError: An earlier requirement bounds it.
    """
    if any(requirement.name == earlier.name for earlier in requirements):
        rule = f"'{requirement.measure.label}' is bounded on this side already; keep the stricter one"
        raise ConfigError(place, rule)


def required_metric(table: RequirementTable) -> str:
    """Name of the metric that a requirement bounds, such as ``rms_phi`` for the kind ``rms`` of the signal ``phi``."""
    assert table.metric is not None
    kind = kind_name(table.metric)
    return kind if table.signal is None else suffixed(kind, table.signal)


def signal_metrics_of(config: StudyTable, signals: Mapping[str, SampledSignal]) -> dict[str, Metric]:
    """Make the metrics of signals that a study reports or requires, by name.

    Raises:
        ConfigError: A requirement's signal, or its kind of metric, is unknown.
    """
    for index, table in enumerate(config.requirement):
        if table.signal is not None and table.signal not in signals:
            rule = f"'{table.signal}' is no signal of this loop; {nearest(table.signal, signals)}"
            raise ConfigError(f"requirement.{index}.signal", rule)
        metric = table.metric or ""
        if table.signal is not None and metric not in SIGNAL_METRICS:
            rule = f"'{metric}' is no metric of a signal; {nearest(metric, SIGNAL_METRICS)}"
            raise ConfigError(f"requirement.{index}.metric", rule)
    required_names = [required_metric(table) for table in config.requirement if table.metric is not None]
    return metrics_of_signals([*required_names, *(config.metrics.names or ())], signals)


def envelope_requirements(config: StudyTable, available: AvailableMetrics) -> list[Requirement]:
    """Parse each envelope as a requirement: the signal's least distance from its bounds must not be negative.

    Args:
        config: Tables of the study.
        available: Metrics that the loop can have, with names and units of its channels.

    Raises:
        ConfigError: An envelope names no channel of the loop, or begins after the last sample.
    """
    requirements: list[Requirement] = []
    names: list[str] = []
    for index, table in enumerate(config.envelope):
        require_envelope(table, f"envelope.{index}", config, available.channels)
        channel = table.channel or ""
        channel_index = available.channels.index(channel)
        units = available.units[channel_index]
        kind = f"envelope_{table.signal}"
        signal = ENVELOPE_SIGNALS[table.signal]
        metric = envelope_metric(signal.value, signal.unit, units.describe(signal.meaning), table.lower, table.upper)
        name = suffixed(kind, channel)
        names.append(name)
        count = names.count(name)  # several envelopes may bound one signal
        measure = Measure(
            name=name if count == 1 else f"{name}_{count}",
            kind=kind,
            window=replace(available.default_window, after=0.0, until=math.inf),
            channel=channel_index,
            custom=metric,
            units=units,
            channel_name=channel,
            default_window=available.default_window,
        )
        requirements.append(Requirement(measure, minimum=0.0))
    return requirements


def require_envelope(table: EnvelopeTable, place: str, config: StudyTable, channels: tuple[str, ...]) -> None:
    """Require that an envelope bounds a channel of the loop, and begins within the flight.

    Args:
        table: Table of the envelope.
        place: Dotted path of the table, such as ``envelope.0``.
        config: Tables of the study.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: The envelope names no channel of the loop, or begins after the last sample.
    """
    channel = table.channel or ""
    if channel not in channels:
        valid_names = ", ".join(filter(None, channels)) or "none, since the plant has a single one"
        rule = f"must be one of the channels, {valid_names}; got {channel!r}"
        raise ConfigError(f"{place}.channel", rule)
    first_times = [points[0][0] for points in (table.lower, table.upper) if points]  # of points (time, value)
    begin = min(first_times)
    end = (config.loop.steps - 1) * config.loop.sample_time
    if begin > end * (1.0 + ROUNDING):
        raise ConfigError(place, f"begins at {begin:g} s, after the last sample at {end:g} s")


def require_samples(config: StudyTable, window: Window, place: str) -> None:
    """Require that a window contains a sample and ends within the flight.

    Args:
        config: Tables of the study.
        window: The window.
        place: Dotted name of the window's field ``after``, for messages.

    Raises:
        ConfigError: The window contains no sample, or ends after the flight.
    """
    clock = config.loop
    first_index = first_sample(window.after, clock.sample_time)
    if first_index >= clock.steps:
        end = (clock.steps - 1) * clock.sample_time
        raise ConfigError(place, f"must be <= the time of the last sample {end:g} s, got {window.after:g}")
    end_place = f"{place.removesuffix('after')}until"
    if math.isfinite(window.until) and window.until > clock.duration * (1.0 + ROUNDING):
        rule = f"must be <= the duration {clock.duration:g} s, got {window.until:g}"
        raise ConfigError(end_place, f"{rule}; leave it out for a window up to the end, or set loop.duration")
    if samples_before_end(window, clock.sample_time, clock.steps) <= first_index:
        rule = f"no sample lies in the window from after = {window.after:g} s to until = {window.until:g} s"
        raise ConfigError(end_place, f"{rule}; T_s is {clock.sample_time:g} s")
