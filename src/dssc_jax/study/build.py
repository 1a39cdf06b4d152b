"""Construction of the closed loop from a study's tables: look up models, parse numbers, fill channels."""

import copy
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple

import jax
from pydantic import BaseModel, ValidationError

from dssc_jax.closed_loop.infos import fields_of, first_infos
from dssc_jax.closed_loop.loop import Loop, LoopParams, Settled
from dssc_jax.closed_loop.metrics import Measure, available_metrics
from dssc_jax.closed_loop.requirements import Requirement
from dssc_jax.core.adapters import ReplacedParams, replace_channels, sum_of_winds
from dssc_jax.core.contracts import Plant
from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.quantities import extent
from dssc_jax.core.registry import single
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.trace_memory.memory import remembered
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.differentiators import DIFFERENTIATORS
from dssc_jax.models.disturbances import DISTURBANCES
from dssc_jax.models.plants import PLANTS
from dssc_jax.models.references import REFERENCES, TRAJECTORIES
from dssc_jax.models.sensors import SENSORS
from dssc_jax.models.uav import UAV
from dssc_jax.models.wind import WINDS
from dssc_jax.study.components import (
    Component,
    Number,
    as_table,
    dotted,
    explain,
    field_specs,
    parse_component,
    parse_number,
)
from dssc_jax.study.laws import Law
from dssc_jax.study.measuring import kinds_of, measured
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
from dssc_jax.study.sections import params_of, with_section
from dssc_jax.study.tables import has_dotted, merged, set_dotted

REGISTRIES = {
    "plant": {**PLANTS, "uav": single(UAV, "the full UAV: rigid body, rotors, aerodynamics, inner loops (1)")},
    "reference": REFERENCES,
    "trajectory": TRAJECTORIES,
    "controller": CONTROLLERS,
    "sensor": SENSORS,
    "differentiator": DIFFERENTIATORS,
    "unmodelled": UNMODELLED,
    "disturbance": DISTURBANCES,
    "wind": WINDS,
}
PER_CHANNEL = ("controller", "sensor", "differentiator", "unmodelled", "disturbance")
FIXED_TABLES: dict[str, type[BaseModel]] = {
    "loop": LoopTable,
    "loop.settled": SettledTable,
    "units": UnitsTable,
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
        outer = [str(part) for part in error.errors()[0]["loc"][:-1]]
        inside = FIXED_TABLES.get(".".join(outer)) or FIXED_TABLES.get("".join(outer[:1])) or StudyTable
        raise explain(error, inside.model_fields) from None


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
    config = validate_fixed(table)
    plant = parse_whole(config.plant, "plant")
    channels = plant.model.channels or ("",)
    has_several_channels = len(channels) > 1
    units = parse_units(config.units, plant.model, channels)
    wholes = {
        "plant": plant,
        "reference": parse_reference(config.reference, channels, units),
        "wind": parse_winds(config.wind),
    }
    if not has_several_channels and wholes["wind"].kind != "none":
        raise ConfigError("wind.kind", f"the plant '{plant.kind}' does not fly; use a disturbance")
    if not has_several_channels:
        wholes["plant"] = with_units(plant, units[0])
    columns = {slot: parse_channels(getattr(config, slot), slot, channels) for slot in PER_CHANNEL}
    columns = {slot: [*map(with_units, column, units)] for slot, column in columns.items()}
    for name, gains in zip(channels, columns["controller"], strict=True):
        if "l0" not in gains.params._fields:
            raise ConfigError(
                dotted("controller", name), "the gains need the field l0, which defines sigma = e' + l0 e"
            )
    columns["sensor"] = [
        with_bounded_jitter(part, dotted("sensor", name), config.loop.sample_time)
        for name, part in zip(channels, columns["sensor"], strict=True)
    ]
    loop = Loop(
        **{slot: part.model for slot, part in wholes.items()},
        **{slot: tuple(part.model for part in column) for slot, column in columns.items()},
        channels=channels,
        **clock(config),
    )
    template = LoopParams(
        **{slot: part.params for slot, part in wholes.items()},
        **{slot: tuple(part.params for part in column) for slot, column in columns.items()},
    )
    numbers = by_name(n for part in (*wholes.values(), *chain(*columns.values())) for n in part.numbers)
    check_axes(config, numbers)
    check_swept_parts(table, config, channels)
    known = kinds_of(config)
    names = available_metrics(*info_fields(loop, template), known)
    measures, requirements = measured(config, names, known, channels, units)
    check_settled(loop, measures)
    return Parts(config, loop, template, units, numbers, measures, requirements)


def parse_units(table: TomlTable, plant: Plant, channels: tuple[str, ...]) -> tuple[ChannelUnits, ...]:
    """Units and meanings of each channel: the plant's own, overridden by ``[units]`` and ``[units.CHANNEL]``.

    Raises:
        ConfigError: A field is unknown or not valid.
    """
    units_of_plant = plant.units or (UNNAMED_UNITS,) * len(channels)
    common = {name: value for name, value in table.items() if name not in channels}
    named = []
    for units, channel in zip(units_of_plant, channels, strict=True):
        with errors_under(dotted("units", channel if channel in table else "")):
            overrides = as_table(table[channel]) if channel in table else {}
            try:
                changes = UnitsTable.model_validate(common | overrides).model_dump(exclude_none=True)
            except ValidationError as error:
                raise explain(error, [*UnitsTable.model_fields, *filter(None, channels)]) from None
        named.append(units._replace(**changes))
    return tuple(named)


def with_units(component: Component, units: ChannelUnits) -> Component:
    """The component whose numbers have the channel's own units."""
    numbers = (replace(n, quantity=replace(n.quantity, unit=units.of(n.quantity.unit))) for n in component.numbers)
    return replace(component, numbers=tuple(numbers))


def by_name(numbers: Iterable[Number]) -> dict[str, Number]:
    """The numbers by name; one shared by several channels has a path in each, and the first channel's unit."""
    merged_numbers: dict[str, Number] = {}
    for number in numbers:
        first = merged_numbers.get(number.name)
        merged_numbers[number.name] = replace(first, paths=first.paths + number.paths) if first else number
    return merged_numbers


def clock(config: StudyTable) -> TomlTable:
    """The loop's fields about time: sampling, integration, and the end of settled draws."""
    loop = config.loop
    return {
        "sample_time": loop.sample_time,
        "steps": loop.steps,
        "substeps": loop.substeps,
        "integrator": Integrator(loop.integrator),
        "settled": Settled(**loop.settled.model_dump()) if loop.settled else None,
    }


def check_settled(loop: Loop, measures: tuple[Measure, ...]) -> None:
    """Require that every window begins before a draw may end as settled."""
    latest = max(measures, key=lambda measure: measure.window.after)
    if loop.settled and loop.settled.after < latest.window.after:
        rule = f"must be >= {latest.window.after:g} s, where the window of {latest.name} begins"
        raise ConfigError("loop.settled.after", f"{rule}; got {loop.settled.after:g}")


def with_bounded_jitter(sensor: Component, path: str, sample_time: float) -> Component:
    """The sensor whose jitter, if it has one, is at most one sample; axes and margins know the bound, too.

    Raises:
        ConfigError: Its own jitter may exceed the sampling period.
    """
    jitter = getattr(sensor.params, "jitter", None)
    longest = 0.0 if jitter is None else extent(jitter)[1]
    if longest > sample_time:
        rule = f"must be <= loop.sample_time = {sample_time:g} s, got up to {longest:g} s"
        raise ConfigError(dotted(path, "jitter"), rule)
    bounded = (
        replace(n, quantity=replace(n.quantity, at_most=sample_time)) if n.name.endswith(".jitter") else n
        for n in sensor.numbers
    )
    return replace(sensor, numbers=tuple(bounded))


def parse_whole(table: TomlTable, slot: str) -> Component:
    """Parse the component of a slot that the loop has once."""
    component = parse_component(table, REGISTRIES[slot], slot)
    return replace(component, numbers=tuple(number.under(slot, slot) for number in component.numbers))


def parse_winds(table: TomlTable | list[TomlTable]) -> Component:
    """Parse the wind, or the sum of the winds in a list; a number of the second one is called ``wind.1.speed``.

    Raises:
        ConfigError: The list is empty, or a wind is not valid.
    """
    if not isinstance(table, list):
        return parse_whole(table, "wind")
    if not table:
        raise ConfigError("wind", "needs at least one [[wind]]")
    parts = []
    for index, part in enumerate(table):
        name = f"wind.{index}"
        component = parse_component(part, REGISTRIES["wind"], name)
        parts.append(replace(component, numbers=tuple(number.under(name, name) for number in component.numbers)))
    model = sum_of_winds(tuple(part.model for part in parts))
    numbers = tuple(chain.from_iterable(part.numbers for part in parts))
    return Component(" + ".join(part.kind for part in parts), model, tuple(part.params for part in parts), numbers)


def parse_reference(table: TomlTable, channels: tuple[str, ...], units: tuple[ChannelUnits, ...]) -> Component:
    """Parse the reference: one signal, or a trajectory in which ``[reference.x]`` replaces that of channel x."""
    slot = "reference"
    if len(channels) == 1:
        return with_units(parse_whole(table, slot), units[0])
    common = {name: value for name, value in table.items() if name not in channels}
    joint = parse_component(common, REGISTRIES["trajectory"], slot, default="zero")
    named = [channel for channel in channels if channel in table]
    if not named:
        return replace(joint, numbers=tuple(number.under(slot, slot) for number in joint.numbers))
    replacements = {channel: parse_component(table[channel], REFERENCES, dotted(slot, channel)) for channel in named}
    numbers = [number.under(f"{slot}.joint", slot) for number in joint.numbers]
    for place, (channel, part) in enumerate(replacements.items()):
        numbers_of_part = with_units(part, units[channels.index(channel)]).numbers
        numbers += [number.under(f"{slot}.replaced.{place}", dotted(slot, channel)) for number in numbers_of_part]
    models = {channels.index(channel): part.model for channel, part in replacements.items()}
    model = replace_channels(joint.model, models)
    params = ReplacedParams(joint.params, tuple(part.params for part in replacements.values()))
    return Component(joint.kind, model, params, tuple(numbers))


def parse_channels(table: TomlTable, slot: str, channels: tuple[str, ...]) -> list[Component]:
    """Parse one component per channel. A table ``[controller.x]`` overrides ``[controller]``, which applies to all.

    A number that no channel overrides is one number for all channels: one draw of its law, one axis.
    """
    common = {name: value for name, value in table.items() if name not in channels}
    components = []
    for index, channel in enumerate(channels):
        own_path = dotted(slot, channel)
        override = as_table(table.get(channel, {}), own_path) if channel else {}
        component = parse_component(merged(common, override), REGISTRIES[slot], own_path if override else slot)
        numbers = tuple(
            number.under(f"{slot}.{index}", own_path if has_dotted(override, number.name) else slot)
            for number in component.numbers
        )
        components.append(replace(component, numbers=numbers))
    return components


Fields = tuple[dict[str, tuple[str, ...]], tuple[str, ...]]
"""Field names of each controller's info, and of the plant's."""


def info_fields(loop: Loop, template: LoopParams) -> Fields:
    """Field names of each controller's info and of the plant's, found without computing anything."""
    params = jax.tree.map(
        lambda leaf: leaf.median if isinstance(leaf, Law) else leaf, template, is_leaf=lambda x: isinstance(x, Law)
    )
    leaves, structure = jax.tree.flatten(params)
    shapes = (jax.ShapeDtypeStruct(x.shape, x.dtype) if hasattr(x, "shape") else x for x in leaves)
    return traced_fields(loop, structure, tuple(shapes))


@lru_cache(maxsize=64)
def traced_fields(loop: Loop, structure: Any, leaves: tuple[Hashable, ...]) -> Fields:
    """See :func:`info_fields`; tracing a vehicle takes most of a study's loading, and its variants share it."""

    def is_array(leaf: Hashable) -> bool:
        return isinstance(leaf, jax.ShapeDtypeStruct)

    def first(arrays: list[jax.Array]) -> tuple[tuple[Any, ...], Any]:
        remaining = iter(arrays)
        completed = [next(remaining) if is_array(leaf) else leaf for leaf in leaves]
        return first_infos(loop, jax.tree.unflatten(structure, completed))

    def fields() -> Fields:
        with arithmetic():
            controllers, plant = jax.eval_shape(first, [leaf for leaf in leaves if is_array(leaf)])
        reported = {
            channel: fields_of(info, "controller") for channel, info in zip(loop.channels, controllers, strict=True)
        }
        return reported, fields_of(plant, "plant")

    return remembered("fields", fields, loop, jax.tree.unflatten(structure, leaves))


def check_axes(config: StudyTable, numbers: Mapping[str, Number]) -> None:
    """Require that every axis is a number of the loop, and every value of it admissible.

    Raises:
        ConfigError: otherwise.
    """
    for name, values in config.sweep.items():
        with errors_under(f"sweep.{name}"):
            if name.startswith("loop."):
                raise ConfigError("", "the clock is fixed before tracing; run once per value")
            if name not in numbers:
                raise ConfigError("", f"unknown parameter; {nearest_number(name, config, numbers)}")
            if not numbers[name].quantity.law:
                raise ConfigError("", "is fixed before tracing; run once per value")
            for value in (min(values), max(values)):
                try:
                    parse_number(value, numbers[name].quantity)
                except ValueError as error:
                    raise ConfigError("", str(error)) from None


def nearest_number(name: str, config: StudyTable, numbers: Mapping[str, Number]) -> str:
    """Return the end of the message about an unknown number: its part has no numbers, or the nearest name."""
    slot = name.partition(".")[0]
    table = getattr(config, slot) if slot in REGISTRIES.keys() & StudyTable.model_fields.keys() else None
    if isinstance(table, Mapping) and not any(known.startswith(f"{slot}.") for known in numbers):
        field = name.rpartition(".")[2]
        kinds = [kind for kind, entry in REGISTRIES[slot].items() if field in field_specs(params_of(entry))]
        remedy = f"; for '{kinds[0]}' set {slot}.kind = '{kinds[0]}' and {name}" if kinds else ""
        return f"the study's {slot} is of the kind '{table.get('kind')}', which has no numbers{remedy}"
    return nearest(name, numbers)


def check_swept_parts(table: TomlTable, config: StudyTable, channels: tuple[str, ...]) -> None:
    """Require that the rules spanning several fields of a part hold for all swept values.

    The parts are parsed once more, with a law of the swept values in place of each swept number.

    Raises:
        ConfigError: a rule does not hold, or a swept number is used up before tracing.
    """
    table = copy.deepcopy(table)
    for name, values in config.sweep.items():
        set_dotted(table, name, {"choice": list(values)})
    for slot in {name.split(".")[0] for name in config.sweep}:
        try:
            if slot in PER_CHANNEL:
                parse_channels(table[slot], slot, channels)
            elif slot == "reference":
                parse_reference(table[slot], channels, (UNNAMED_UNITS,) * len(channels))
            elif slot == "wind":
                parse_winds(table[slot])
            else:
                parse_whole(table[slot], slot)
        except ConfigError as error:
            raise error.within("sweep") from None
