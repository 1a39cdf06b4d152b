"""Checks of a study whose draws end early once they have settled, by the rule ``[loop.settled]``."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

from jax.tree_util import keystr, tree_flatten_with_path

from dssc_jax.closed_loop.loop import Loop, LoopParams, Settled
from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.closed_loop.metrics.window import first_sample
from dssc_jax.core.contracts import Disturbance, Reference
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.events import AnyEvent
from dssc_jax.core.quantities import extent
from dssc_jax.core.signals import Params
from dssc_jax.core.wind import Wind
from dssc_jax.study.events import StudyEvent
from dssc_jax.study.numbers import Number
from dssc_jax.study.schema import EnvelopeTable, StudyTable

ChangingPart: TypeAlias = Reference | Wind | Disturbance | AnyEvent
"""A part that changes over time, and declares the time of its last change."""


def require_whole_windows(loop: Loop, measures: tuple[Measure, ...], envelopes: Sequence[EnvelopeTable]) -> None:
    """Require that an early end of a settled draw changes no metric and no envelope.

    Args:
        loop: The loop.
        measures: All metrics.
        envelopes: Tables of the envelopes.

    Raises:
        ConfigError: A draw may end before a window begins or an envelope ends, or it may end outside of the band in
            which a metric counts the draw as settled.
    """
    settled = loop.settled
    if settled is None:
        return
    latest = max(measures, key=lambda measure: measure.window.after)
    if first_sample(settled.after, loop.sample_time) < first_sample(latest.window.after, loop.sample_time):
        rule = f"must be >= {latest.window.after:g} s, where the window of {latest.name} begins"
        raise ConfigError("loop.settled.after", f"{rule}; got {settled.after:g}")
    for index, envelope in enumerate(envelopes):
        last_time = max(time for time, _ in (*envelope.lower, *envelope.upper))
        duration = loop.steps * loop.sample_time
        if settled.after < min(last_time, duration):
            raise ConfigError(
                f"envelope.{index}",
                f"bounds '{envelope.signal}' up to {last_time:g} s, and [loop.settled] may end a draw from "
                f"{settled.after:g} s on; let it begin after the envelope, or take it out",
            )
    for measure in measures:
        if measure.metric.settled_within is not None:
            require_within_band(settled, measure.name, measure.metric.settled_within(measure.window))


def require_within_band(settled: Settled, metric: str, band: float) -> None:
    """Require that a draw which ends as settled lies in the band in which a metric counts the draw as settled.

    Args:
        settled: The rule that ends a draw.
        metric: Name of the metric.
        band: Largest |e| in the band [unit of y]; NaN: the band depends on the draw.

    Raises:
        ConfigError: A draw may end outside of the band.
    """
    if math.isnan(band):
        rule = f"may end a draw outside of the band of {metric}, which is a share of the draw's own step"
        raise ConfigError("loop.settled", f"{rule}; take it out, or take settling_time in place of that metric")
    if settled.error > band:
        rule = f"must be <= {band:g}, the band of {metric}, outside of which a draw would end"
        remedy = "lower it, raise the metric's settling_band, or list metrics.names without that metric"
        raise ConfigError("loop.settled.error", f"{rule}; got {settled.error:g}. Remedy: {remedy}")


def require_seen_signals(
    config: StudyTable, loop: Loop, template: LoopParams, numbers: Mapping[str, Number], events: Sequence[StudyEvent]
) -> None:
    """Require that no reference, wind, disturbance or event changes after a draw may have ended as settled.

    Args:
        config: Fixed tables of the study.
        loop: The loop.
        template: Parameters of the loop, with laws.
        numbers: Numbers of the loop by name.
        events: Events of the study.

    Raises:
        ConfigError: A part may change after that time, or does not declare the time of its last change.
    """
    if config.loop.settled is None:
        return
    params = with_largest_values(config, template, numbers.values())
    require_seen("reference", loop.reference, params.reference, config)
    require_seen("wind", loop.wind, params.wind, config)
    for model, values in zip(loop.disturbance, params.disturbance, strict=True):
        require_seen("disturbance", model, values, config)
    for name, model, values in zip(loop.input_names, loop.inputs, params.inputs, strict=True):
        require_seen(f"disturbance.{name}", model, values, config)
    for event in events:
        part = event.under("params")
        require_seen(
            event.path, part.model, with_largest_values(config, {"params": part.params}, part.numbers)["params"], config
        )


def with_largest_values(config: StudyTable, template: Params, numbers: Iterable[Number]) -> Params:
    """Replace each number in parameters by the largest value that its law or its axis admits."""
    largest_values = {}
    for number in numbers:
        _, largest = extent(number.value)
        for path in number.paths:
            largest_values[path] = max(config.sweep.get(number.name, (largest,)))
    leaves, structure = tree_flatten_with_path(template)
    values = [largest_values.get(keystr(path, simple=True, separator="."), leaf) for path, leaf in leaves]
    return structure.unflatten(values)


def require_seen(table: str, model: ChangingPart, params: Params, config: StudyTable) -> None:
    """Require that a part does not change after a draw may have ended as settled.

    Args:
        table: Name of the part's table in the study, for messages.
        model: The part.
        params: Parameters of the part, each at its largest value, which gives the latest change.
        config: Fixed tables of the study, with the rule that ends a draw.

    Raises:
        ConfigError: The part may change after that time, or does not declare the time of its last change.
    """
    settled = config.loop.settled
    assert settled is not None
    remedy = "a draw that ends as settled before it would never show it"
    if model.last_change is None:
        raise ConfigError("loop.settled", f"[{table}] does not declare its last_change, and {remedy}; take it out")
    latest = float(model.last_change(params))
    if math.isinf(latest):
        raise ConfigError("loop.settled", f"[{table}] may do something new at any time, and {remedy}; take it out")
    if min(latest, config.loop.duration) > settled.after:
        rule = f"must be >= {min(latest, config.loop.duration):g} s, up to which [{table}] does something new"
        raise ConfigError("loop.settled.after", f"{rule}: {remedy}; got {settled.after:g}")


def require_changes_before_settling(config: StudyTable, numbers: Mapping[str, Number]) -> None:
    """Require that no time at which something begins or ends lies after a draw may have ended as settled.

    Args:
        config: Fixed tables of the study.
        numbers: Numbers of the loop by name, with the times of steps, winds and events.

    Raises:
        ConfigError: A step, a wind or an event may begin or end later.
    """
    settled = config.loop.settled
    if settled is None:
        return
    for name, number in numbers.items():
        is_time_of_change = number.quantity.begins or number.quantity.ends
        if not is_time_of_change:
            continue
        times = config.sweep[name] if name in config.sweep else extent(number.value)
        latest = min(max(times), config.loop.duration)
        happens_within_flight = min(times) < config.loop.duration
        if happens_within_flight and latest > settled.after:
            change = "begins" if number.quantity.begins else "ends"
            rule = f"must be >= {latest:g} s, since {name} is a time at which something {change}"
            remedy = "a draw that ends as settled before it would never show it"
            raise ConfigError("loop.settled.after", f"{rule}: {remedy}; got {settled.after:g}")
