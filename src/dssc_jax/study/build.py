"""Construction of a study from its table: models, parameters, numbers, metrics and requirements."""

from collections.abc import Hashable, Iterable, Mapping
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
from dssc_jax.core.contracts import Plant
from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.quantities import quantities_of
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.trace_memory.memory import remembered
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits
from dssc_jax.study.actuators import ActuatorTable, require_one_form, section_of
from dssc_jax.study.components import Component, as_table
from dssc_jax.study.events import EVENT, events_of, vehicle_events, with_command_events, with_sensor_events
from dssc_jax.study.fitting import fitted_controllers, nominal_params
from dssc_jax.study.measures import measurable_signals, parse_signal_sensors, sensor_tables
from dssc_jax.study.measuring import available_metrics, metric_kinds, parse_measures
from dssc_jax.study.numbers import Number, dotted_name, parameter_numbers
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
from dssc_jax.study.settled_checks import require_changes_before_settling, require_whole_windows
from dssc_jax.study.slots import REGISTRIES, SLOTS, TABLES
from dssc_jax.study.sweeps import check_axes, check_swept_parts
from dssc_jax.study.table_errors import first_error
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
"""Tables whose fields do not depend on a kind, by their section."""


def validate_fixed(table: TomlTable) -> StudyTable:
    """Validate the fixed tables of a study.

    Raises:
        ConfigError: An entry is not valid.
    """
    try:
        return StudyTable.model_validate(table)
    except ValidationError as error:
        parent_path = [str(part) for part in error.errors()[0]["loc"][:-1]]
        nested_table = FIXED_TABLES.get(".".join(parent_path))
        top_table = FIXED_TABLES.get("".join(parent_path[:1]))
        table_model = nested_table or top_table or StudyTable
        raise first_error(error, table_model.model_fields) from None


def with_constants(table: TomlTable, parameters: ParameterTable) -> TomlTable:
    """A study's table in which each expression has become a number, except in the parts of the loop.

    Raises:
        ConfigError: An expression is not valid, or depends on a law.
    """
    unchanged_names = {*TABLES, *TEXTS, "compare", PARAMETERS}
    constants = {}
    for name, value in table.items():
        constants[name] = value if name in unchanged_names else parameters.constants(value, name)
    return constants


class Parts(NamedTuple):
    """Content of a parsed study; the fields are those of :class:`dssc_jax.study.Study`."""

    config: StudyTable
    loop: Loop
    template: LoopParams
    units: tuple[ChannelUnits, ...]
    numbers: dict[str, Number]
    measures: tuple[Measure, ...]
    requirements: tuple[Requirement, ...]


def build(table: TomlTable) -> Parts:
    """Parse every part of a study.

    Raises:
        ConfigError: The table is not valid; the message has the path, the rule and the value of the first error. For a
            name in the wrong section, it has the right section.
    """
    try:
        return parsed_parts(table)
    except ConfigError as error:
        raise with_section(error, table, {"": StudyTable, **FIXED_TABLES}, REGISTRIES) from None


def parsed_parts(table: TomlTable) -> Parts:
    """Parse every part of a study, as in :func:`build`, without the hint at the right section."""
    parameters = ParameterTable.of(as_table(table.get(PARAMETERS, {}), PARAMETERS))
    config = validate_fixed(with_constants(table, parameters))
    require_one_form(config)
    tables = {slot: parameters.resolved(getattr(config, section_of(config, slot)), slot) for slot in SLOTS}
    parameters.resolved(config.compare, "compare")  # raises if an expression is not valid; a comparison reads it later
    plant = parse_plant(tables["plant"], config.loop)
    channels = plant.model.channels or ("",)
    units = parse_units(config.units, plant.model, channels)
    single_parts = parse_single_parts(tables, plant, channels, units)
    inputs = plant.model.inputs(plant.params) if plant.model.inputs else ()
    outputs = plant.model.reported(plant.params)
    measurable = measurable_signals(plant.model, nominal_params(plant.params), outputs, channels, units)
    sensors = sensor_tables(tables["sensor"], measurable)
    measures = tuple(measurable[name] for name in sensors.measures)
    columns = parse_columns({**tables, "sensor": sensors.channels}, inputs, channels, units)
    columns["signal_sensor"] = parse_signal_sensors(sensors, measurable)
    sample_time = config.loop.sample_time
    columns["controller"] = fitted_controllers(columns["controller"], plant, channels, sample_time, measures)
    require_controllers(columns["controller"], channels, measures)
    columns["sensor"] = with_bounded_jitter(columns["sensor"], channels, sample_time)
    columns |= columns_with_events(columns, parameters.resolved(config.event, EVENT), plant, channels)
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
    metrics = metric_kinds(config)
    fields, vehicle_fields = info_fields(loop, template)
    names = available_metrics(fields, vehicle_fields, metrics)
    signals = signals_of(loop, template, units)
    metric_measures, requirements = parse_measures(
        config, names, metrics, channels, units, signals, parameters.constant
    )
    parts = [*single_parts.values(), *chain.from_iterable(columns.values())]
    numbers = merge_numbers(chain.from_iterable(part.numbers for part in parts))
    numbers = {number.name: number for number in parameter_numbers(parameters, numbers.values())} | numbers
    check_axes(config, numbers)
    check_swept_parts(table, config, loop, measurable, numbers)
    require_whole_windows(loop, metric_measures, config.envelope)
    require_changes_before_settling(config, numbers)
    return Parts(
        config=config,
        loop=loop,
        template=template,
        units=units,
        numbers=numbers,
        measures=metric_measures,
        requirements=requirements,
    )


def columns_with_events(
    columns: Mapping[str, list[Component]], tables: list[TomlTable], plant: Component, channels: tuple[str, ...]
) -> dict[str, list[Component]]:
    """The slots that events change: actuators and sensor of each channel, and the events of the vehicle.

    Args:
        columns: Parts of each channel by slot.
        tables: Tables of the events.
        plant: The plant, parsed.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: An event is not valid.
    """
    events = events_of(tables, plant, channels)
    return {
        "unmodelled": with_command_events(columns["unmodelled"], events, channels),
        "sensor": with_sensor_events(columns["sensor"], events, channels),
        "events": list(vehicle_events(events, plant.params.vehicle)) if events else [],
    }


def signals_of(loop: Loop, template: LoopParams, units: tuple[ChannelUnits, ...]) -> dict[str, SampledSignal]:
    """All signals of a loop, by the name of their column in a trajectory."""
    fields, vehicle_fields = info_fields(loop, template)
    reports = [quantities_of(model.info) for model in loop.controller]
    return sampled_signals(fields, vehicle_fields, units, reports, loop.quantities, loop.measures, loop.plant.angles)


def parse_units(table: TomlTable, plant: Plant, channels: tuple[str, ...]) -> tuple[ChannelUnits, ...]:
    """Units and meanings of each channel: those of the plant, overridden by ``[units]`` and ``[units.CHANNEL]``.

    Raises:
        ConfigError: An entry is unknown or not valid.
    """
    units_of_plant = plant.units or (UNNAMED_UNITS,) * len(channels)
    common = {name: value for name, value in table.items() if name not in channels}
    channel_units = []
    for units, channel in zip(units_of_plant, channels, strict=True):
        with errors_under(dotted_name("units", channel if channel in table else "")):
            overrides = as_table(table[channel]) if channel in table else {}
            try:
                changes = UnitsTable.model_validate(common | overrides).model_dump(exclude_none=True)
            except ValidationError as error:
                raise first_error(error, [*UnitsTable.model_fields, *filter(None, channels)]) from None
        channel_units.append(units._replace(**changes))
    return tuple(channel_units)


def merge_numbers(numbers: Iterable[Number]) -> dict[str, Number]:
    """Merge numbers of the same name, which channels share: all their paths, and the unit of the first channel."""
    merged_numbers: dict[str, Number] = {}
    for number in numbers:
        first = merged_numbers.get(number.name)
        merged_numbers[number.name] = replace(first, paths=first.paths + number.paths) if first else number
    return merged_numbers


def time_fields(config: StudyTable) -> TomlTable:
    """Fields of ``Loop`` about time: sampling, integration, and the rule that ends a settled draw early."""
    loop = config.loop
    return {
        "sample_time": loop.sample_time,
        "steps": loop.steps,
        "substeps": loop.substeps,
        "integrator": Integrator(loop.integrator),
        "settled": Settled(**loop.settled.model_dump()) if loop.settled else None,
    }


Fields = tuple[dict[str, tuple[str, ...]], tuple[str, ...]]
"""Names of the fields in each controller's info, by channel, and of those in the plant's info."""


def info_fields(loop: Loop, template: LoopParams) -> Fields:
    """Names of the fields that each controller and the plant report, found by tracing, without computation."""
    leaves, structure = jax.tree.flatten(nominal_params(template))
    shapes = (jax.ShapeDtypeStruct(x.shape, x.dtype) if hasattr(x, "shape") else x for x in leaves)
    return traced_fields(loop, structure, tuple(shapes))


@lru_cache(maxsize=64)
def traced_fields(loop: Loop, structure: Any, leaves: tuple[Hashable, ...]) -> Fields:
    """Compute :func:`info_fields`; the cache serves all variants of a study, whose loading is mostly this trace.

    Args:
        loop: The loop.
        structure: Tree structure of the loop's parameters.
        leaves: Leaves of the parameters, with shape and dtype in place of each array.
    """

    def is_array(leaf: Hashable) -> bool:
        return isinstance(leaf, jax.ShapeDtypeStruct)

    def infos_of(arrays: list[jax.Array]) -> tuple[tuple[Any, ...], Any]:
        next_array = iter(arrays)
        filled_leaves = [next(next_array) if is_array(leaf) else leaf for leaf in leaves]
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
