"""Construction of the closed loop from a study's tables: look up models, parse numbers, fill channels."""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple

import jax
from pydantic import BaseModel, ValidationError

from dssc_jax.closed_loop.infos import fields_of, first_infos
from dssc_jax.closed_loop.loop import Loop, LoopParams, Settled
from dssc_jax.closed_loop.metrics import Measure
from dssc_jax.closed_loop.rehearsal import rehearse
from dssc_jax.closed_loop.requirements import Requirement
from dssc_jax.closed_loop.signal_metrics import SampledSignal, sampled_signals
from dssc_jax.closed_loop.window import first_sample
from dssc_jax.core.contracts import Plant
from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.quantities import extent, quantities_of
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.trace_memory.memory import remembered
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits
from dssc_jax.study.actuators import ActuatorTable, require_one_form, section_of
from dssc_jax.study.components import as_table
from dssc_jax.study.events import EVENT, events_of, vehicle_events, with_command_events, with_sensor_events
from dssc_jax.study.fitting import fitted_controllers, nominal_params
from dssc_jax.study.measures import measurable, parse_signal_sensors, sensor_tables
from dssc_jax.study.measuring import available_metrics, kinds_of, parse_measures
from dssc_jax.study.numbers import Number, dotted, parameter_numbers
from dssc_jax.study.parameters import TEXTS, ParameterTable
from dssc_jax.study.parts import (
    parse_columns,
    parse_plant,
    parse_single_parts,
    require_controllers,
    with_bounded_jitter,
)
from dssc_jax.study.schema import (
    EnvelopeTable,
    LoopTable,
    MetricsTable,
    PlotTable,
    RequirementTable,
    SettledTable,
    StudyTable,
    TuneTable,
    UnitsTable,
)
from dssc_jax.study.sections import with_section
from dssc_jax.study.slots import (
    REGISTRIES,
    SLOTS,
    TABLES,
)
from dssc_jax.study.sweeps import check_axes, check_swept_parts
from dssc_jax.study.table_errors import explain
from dssc_jax.study.tables import PARAMETERS

FIXED_TABLES: dict[str, type[BaseModel]] = {
    "loop": LoopTable,
    "loop.settled": SettledTable,
    "units": UnitsTable,
    "actuator": ActuatorTable,
    "metrics": MetricsTable,
    "requirement": RequirementTable,
    "envelope": EnvelopeTable,
    "plot": PlotTable,
    "tune": TuneTable,
}


def validate_fixed(table: TomlTable) -> StudyTable:
    """The fixed tables, validated."""
    try:
        return StudyTable.model_validate(table)
    except ValidationError as error:
        parent_path = [str(part) for part in error.errors()[0]["loc"][:-1]]
        nested_table = FIXED_TABLES.get(".".join(parent_path))
        top_table = FIXED_TABLES.get("".join(parent_path[:1]))
        table_model = nested_table or top_table or StudyTable
        raise explain(error, table_model.model_fields) from None


def with_constants(table: TomlTable, parameters: ParameterTable) -> TomlTable:
    """The study's table with a number in place of each expression outside of the loop's parts.

    Raises:
        ConfigError: one is not valid, or depends on a law.
    """
    unchanged_names = {*TABLES, *TEXTS, "compare", PARAMETERS}
    return {
        name: value if name in unchanged_names else parameters.constants(value, name) for name, value in table.items()
    }


class Parts(NamedTuple):
    """A study's table, parsed: see the arguments of :class:`dssc_jax.study.Study`."""

    config: StudyTable
    loop: Loop
    template: LoopParams
    units: tuple[ChannelUnits, ...]
    numbers: dict[str, Number]
    measures: tuple[Measure, ...]
    requirements: tuple[Requirement, ...]


def build(table: TomlTable) -> Parts:
    """Look up and parse every part of a study.

    Raises:
        ConfigError: Dotted path, rule and value of the first error, and the section that a misplaced name belongs to.
    """
    try:
        return parsed_parts(table)
    except ConfigError as error:
        raise with_section(error, table, {"": StudyTable, **FIXED_TABLES}, REGISTRIES) from None


def parsed_parts(table: TomlTable) -> Parts:
    """The parts of a study; see :func:`build`."""
    parameters = ParameterTable.of(as_table(table.get(PARAMETERS, {}), PARAMETERS))
    config = validate_fixed(with_constants(table, parameters))
    require_one_form(config)
    tables = {slot: parameters.resolved(getattr(config, section_of(config, slot)), slot) for slot in SLOTS}
    parameters.resolved(config.compare, "compare")  # read when controllers are compared
    plant = parse_plant(tables["plant"], config.loop)
    channels = plant.model.channels or ("",)
    units = parse_units(config.units, plant.model, channels)
    single_parts = parse_single_parts(tables, plant, channels, units)
    inputs = plant.model.inputs(plant.params) if plant.model.inputs else ()
    outputs = plant.model.reported(plant.params)
    measurable_signals = measurable(plant.model, nominal_params(plant.params), outputs, channels, units)
    sensors = sensor_tables(tables["sensor"], measurable_signals)
    measures = tuple(measurable_signals[name] for name in sensors.measures)
    columns = parse_columns({**tables, "sensor": sensors.channels}, inputs, channels, units)
    columns["signal_sensor"] = parse_signal_sensors(sensors, measurable_signals)
    sample_time = config.loop.sample_time
    columns["controller"] = fitted_controllers(columns["controller"], plant, channels, sample_time, measures)
    require_controllers(columns["controller"], channels, measures)
    columns["sensor"] = with_bounded_jitter(columns["sensor"], channels, sample_time)
    events = events_of(parameters.resolved(config.event, EVENT), plant, channels)
    columns["unmodelled"] = with_command_events(columns["unmodelled"], events, channels)
    columns["sensor"] = with_sensor_events(columns["sensor"], events, channels)
    columns["events"] = list(vehicle_events(events, plant.params.vehicle)) if events else []
    loop = Loop(
        **{slot: part.model for slot, part in single_parts.items()},
        **{slot: tuple(part.model for part in column) for slot, column in columns.items()},
        channels=channels,
        measures=measures,
        input_names=tuple(signal.name for signal in inputs),
        outputs=outputs,
        rotors=plant.params.vehicle.rotors if columns["events"] else 0,
        **time_fields(config),
    )
    template = LoopParams(
        **{slot: part.params for slot, part in single_parts.items()},
        **{slot: tuple(part.params for part in column) for slot, column in columns.items()},
    )
    metrics = kinds_of(config)
    fields, vehicle_fields = info_fields(loop, template)
    names = available_metrics(fields, vehicle_fields, metrics)
    signals = signals_of(loop, template, units)
    metric_measures, requirements = parse_measures(
        config, names, metrics, channels, units, signals, parameters.constant
    )
    numbers = by_name(n for part in (*single_parts.values(), *chain(*columns.values())) for n in part.numbers)
    numbers = {number.name: number for number in parameter_numbers(parameters, numbers.values())} | numbers
    check_axes(config, numbers)
    check_swept_parts(table, config, loop, measurable_signals, numbers)
    check_settled(loop, metric_measures, config.envelope)
    check_settled_changes(config, numbers)
    return Parts(
        config=config,
        loop=loop,
        template=template,
        units=units,
        numbers=numbers,
        measures=metric_measures,
        requirements=requirements,
    )


def signals_of(loop: Loop, template: LoopParams, units: tuple[ChannelUnits, ...]) -> dict[str, SampledSignal]:
    """Every signal of a loop, by the name of its column in a trajectory."""
    fields, vehicle_fields = info_fields(loop, template)
    reports = [quantities_of(model.info) for model in loop.controller]
    return sampled_signals(fields, vehicle_fields, units, reports, loop.quantities, loop.measures, loop.plant.angles)


def parse_units(table: TomlTable, plant: Plant, channels: tuple[str, ...]) -> tuple[ChannelUnits, ...]:
    """Units and meanings of each channel: the plant's own, overridden by ``[units]`` and ``[units.CHANNEL]``.

    Raises:
        ConfigError: A field is unknown or not valid.
    """
    units_of_plant = plant.units or (UNNAMED_UNITS,) * len(channels)
    common = {name: value for name, value in table.items() if name not in channels}
    channel_units = []
    for units, channel in zip(units_of_plant, channels, strict=True):
        with errors_under(dotted("units", channel if channel in table else "")):
            overrides = as_table(table[channel]) if channel in table else {}
            try:
                changes = UnitsTable.model_validate(common | overrides).model_dump(exclude_none=True)
            except ValidationError as error:
                raise explain(error, [*UnitsTable.model_fields, *filter(None, channels)]) from None
        channel_units.append(units._replace(**changes))
    return tuple(channel_units)


def by_name(numbers: Iterable[Number]) -> dict[str, Number]:
    """The numbers by name; one shared by several channels has a path in each, and the first channel's unit."""
    merged_numbers: dict[str, Number] = {}
    for number in numbers:
        first = merged_numbers.get(number.name)
        merged_numbers[number.name] = replace(first, paths=first.paths + number.paths) if first else number
    return merged_numbers


def time_fields(config: StudyTable) -> TomlTable:
    """The loop's fields about time: sampling, integration, and the rule that ends a settled draw early."""
    loop = config.loop
    return {
        "sample_time": loop.sample_time,
        "steps": loop.steps,
        "substeps": loop.substeps,
        "integrator": Integrator(loop.integrator),
        "settled": Settled(**loop.settled.model_dump()) if loop.settled else None,
    }


def check_settled(loop: Loop, measures: tuple[Measure, ...], envelopes: Sequence[EnvelopeTable]) -> None:
    """Require that every metric and envelope is that of the whole run, also where a draw ends as settled.

    Raises:
        ConfigError: A window begins, or an envelope ends, after a draw may have ended; or a draw may end outside of the
            band in which a metric calls it settled.
    """
    settled = loop.settled
    if settled is None:
        return
    latest = max(measures, key=lambda measure: measure.window.after)
    if first_sample(settled.after, loop.sample_time) < first_sample(latest.window.after, loop.sample_time):
        rule = f"must be >= {latest.window.after:g} s, where the window of {latest.name} begins"
        raise ConfigError("loop.settled.after", f"{rule}; got {settled.after:g}")
    for index, envelope in enumerate(envelopes):
        end = max(point[0] for point in (*envelope.lower, *envelope.upper))
        if settled.after < min(end, loop.steps * loop.sample_time):
            raise ConfigError(
                f"envelope.{index}",
                f"bounds '{envelope.signal}' up to {end:g} s, and [loop.settled] may end a draw from "
                f"{settled.after:g} s on; let it begin after the envelope, or take it out",
            )
    for measure in measures:
        if measure.metric.settled_within is None:
            continue
        band = measure.metric.settled_within(measure.window)
        if math.isnan(band):
            rule = f"may end a draw outside of the band of {measure.name}, which is a share of the draw's own step"
            raise ConfigError("loop.settled", f"{rule}; take it out, or take settling_time in place of that metric")
        if settled.error > band:
            rule = f"must be <= {band:g}, the band of {measure.name}, outside of which a draw would end"
            remedy = "lower it, raise the metric's settling_band, or list metrics.names without that metric"
            raise ConfigError("loop.settled.error", f"{rule}; got {settled.error:g}. Remedy: {remedy}")


def check_settled_changes(config: StudyTable, numbers: Mapping[str, Number]) -> None:
    """Require that nothing begins or ends after a draw may have ended as settled.

    Raises:
        ConfigError: A step, a wind or an event may come later.
    """
    settled = config.loop.settled
    if settled is None:
        return
    for name, number in numbers.items():
        if not number.quantity.begins and not number.quantity.ends:
            continue
        times = config.sweep.get(name) or extent(number.value)
        latest = min(max(times), config.loop.duration)
        if min(times) < config.loop.duration and latest > settled.after:
            change = "begins" if number.quantity.begins else "ends"
            rule = f"must be >= {latest:g} s, since {name} is a time at which something {change}"
            remedy = "a draw that ends as settled before it would never show it"
            raise ConfigError("loop.settled.after", f"{rule}: {remedy}; got {settled.after:g}")


Fields = tuple[dict[str, tuple[str, ...]], tuple[str, ...]]
"""Field names of each controller's info, and of the plant's."""


def info_fields(loop: Loop, template: LoopParams) -> Fields:
    """Field names of each controller's info and of the plant's, found without computing anything."""
    leaves, structure = jax.tree.flatten(nominal_params(template))
    shapes = (jax.ShapeDtypeStruct(x.shape, x.dtype) if hasattr(x, "shape") else x for x in leaves)
    return traced_fields(loop, structure, tuple(shapes))


@lru_cache(maxsize=64)
def traced_fields(loop: Loop, structure: Any, leaves: tuple[Hashable, ...]) -> Fields:
    """See :func:`info_fields`; tracing a vehicle takes most of a study's loading, and its variants share it."""

    def is_array(leaf: Hashable) -> bool:
        return isinstance(leaf, jax.ShapeDtypeStruct)

    def infos_of(arrays: list[jax.Array]) -> tuple[tuple[Any, ...], Any]:
        remaining = iter(arrays)
        filled_leaves = [next(remaining) if is_array(leaf) else leaf for leaf in leaves]
        params = jax.tree.unflatten(structure, filled_leaves)
        rehearse(loop, params)
        return first_infos(loop, params)

    def fields() -> Fields:
        with arithmetic():
            controllers, plant = jax.eval_shape(infos_of, [leaf for leaf in leaves if is_array(leaf)])
        controller_fields = {
            channel: fields_of(info, "controller") for channel, info in zip(loop.channels, controllers, strict=True)
        }
        return controller_fields, fields_of(plant, "plant")

    return remembered("fields", fields, loop, jax.tree.unflatten(structure, leaves))
