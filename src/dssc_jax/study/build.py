"""From a study's tables to the closed loop: models looked up, numbers parsed, channels filled."""

import copy
from typing import Any, NamedTuple

import jax
from pydantic import BaseModel, ValidationError

from dssc_jax.controllers import CONTROLLERS, DIFFERENTIATORS
from dssc_jax.environment import DISTURBANCES, REFERENCES, SENSORS, TRAJECTORIES, WINDS
from dssc_jax.errors import ConfigError, meant
from dssc_jax.integrators import Integrator
from dssc_jax.loop import Loop, LoopParams, Settled, start, step
from dssc_jax.metrics import Measure, available
from dssc_jax.plants import PLANTS
from dssc_jax.requirements import Requirement
from dssc_jax.study.components import Component, as_table, explain, parse_component, parse_number
from dssc_jax.study.laws import Law
from dssc_jax.study.measuring import kinds_of, measured
from dssc_jax.study.schema import (
    LoopTable,
    MetricsTable,
    PlotTable,
    RequirementTable,
    SettledTable,
    StudyTable,
    TuneTable,
)
from dssc_jax.study.tables import has_dotted, merged, set_dotted
from dssc_jax.types import Quantity, single
from dssc_jax.uav import UAV
from dssc_jax.unmodelled import UNMODELLED

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
    "metrics": MetricsTable,
    "requirement": RequirementTable,
    "plot": PlotTable,
    "tune": TuneTable,
}


def validate_fixed(table: dict[str, Any]) -> StudyTable:
    """The fixed tables, validated."""
    try:
        return StudyTable.model_validate(table)
    except ValidationError as error:
        above = [str(part) for part in error.errors()[0]["loc"][:-1]]
        inside = FIXED_TABLES.get(".".join(above)) or FIXED_TABLES.get("".join(above[:1])) or StudyTable
        raise explain(error, inside.model_fields) from None


class Parts(NamedTuple):
    """A study's table, made out: see the arguments of :class:`dssc_jax.study.Study`."""

    config: StudyTable
    loop: Loop
    template: LoopParams
    quantities: dict[str, Quantity]
    short: dict[str, str]
    measures: tuple[Measure, ...]
    requirements: tuple[Requirement, ...]


def build(table: dict[str, Any]) -> Parts:
    """Look up and parse every part of a study.

    Raises:
        ConfigError: dotted path, rule and value of the first thing that is wrong.
    """
    config = validate_fixed(table)
    plant = parse_component(config.plant, REGISTRIES["plant"], "plant")
    channels = plant.model.channels or ("",)
    several = len(channels) > 1
    trajectories = REGISTRIES["trajectory" if several else "reference"]
    wholes = {
        "plant": plant,
        "reference": parse_component(config.reference, trajectories, "reference"),
        "wind": parse_component(config.wind, REGISTRIES["wind"], "wind"),
    }
    if not several and wholes["wind"].kind != "none":
        raise ConfigError("wind.kind", f"the plant '{plant.kind}' does not fly; use a disturbance")
    parts = {slot: parse_channels(getattr(config, slot), slot, channels) for slot in PER_CHANNEL}
    for name, gains in zip(channels, parts["controller"], strict=True):
        if "l0" not in gains.params._fields:
            path = f"controller.{name}" if name else "controller"
            raise ConfigError(path, "the gains need the field l0, which defines sigma = e' + l0 e")
    loop = Loop(
        plant=plant.model,
        reference=wholes["reference"].model,
        wind=wholes["wind"].model,
        **{slot: tuple(part.model for part in column) for slot, column in parts.items()},
        channels=channels,
        sample_time=config.loop.sample_time,
        steps=config.loop.steps,
        substeps=config.loop.substeps,
        integrator=Integrator(config.loop.integrator),
        settled=Settled(**config.loop.settled.model_dump()) if config.loop.settled else None,
    )
    template = LoopParams(
        **{slot: part.params for slot, part in wholes.items()},
        **{slot: tuple(part.params for part in column) for slot, column in parts.items()},
    )
    everything = [*wholes.values(), *(part for column in parts.values() for part in column)]
    short = {long: brief for part in everything for long, brief in part.short.items()}
    quantities = {short.get(name, name): q for part in everything for name, q in part.quantities.items()}
    known = kinds_of(config)
    names = available(*info_fields(loop, template), known)
    measures, requirements = measured(config, names, known, plant.model)
    check_settled(loop, measures)
    parts_found = Parts(config, loop, template, quantities, short, measures, requirements)
    check_axes(parts_found)
    prepare_box(table, parts_found)
    return parts_found


def check_settled(loop: Loop, measures: tuple[Measure, ...]) -> None:
    """Require that every window has begun before a draw may be over."""
    latest = max(measures, key=lambda measure: measure.window.after)
    if loop.settled and loop.settled.after < latest.window.after:
        rule = f"must be >= {latest.window.after:g} s, where the window of {latest.name} begins"
        raise ConfigError("loop.settled.after", f"{rule}; got {loop.settled.after:g}")


def parse_channels(table: dict[str, Any], slot: str, channels: tuple[str, ...]) -> list[Component]:
    """One component a channel. A table ``[controller.x]`` overrides what ``[controller]`` says for all.

    A number that a channel does not override is one number for all channels: one draw of its law, one axis.
    """
    registry = REGISTRIES[slot]
    common = {name: value for name, value in table.items() if name not in channels}
    found = []
    for index, channel in enumerate(channels):
        own = as_table(table.get(channel, {}), f"{slot}.{channel}") if channel else {}
        path = f"{slot}.{channel}" if own else slot
        part = parse_component(merged(common, own), registry, path)
        place = f"{slot}.{index}"  # where the template has it
        short = {}
        for name in part.quantities:
            rest = name.removeprefix(path)
            brief = part.short.get(name, name)
            if own and not has_dotted(own, brief.removeprefix(f"{path}.")):
                brief = f"{slot}{brief.removeprefix(path)}"
            short[f"{place}{rest}"] = brief
        part.quantities = {f"{place}{name.removeprefix(path)}": q for name, q in part.quantities.items()}
        part.short = short
        found.append(part)
    return found


def info_fields(loop: Loop, template: LoopParams) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Names in each controller's info and in the plant's, found without computing anything."""
    params = jax.tree.map(
        lambda leaf: leaf.median if isinstance(leaf, Law) else leaf, template, is_leaf=lambda x: isinstance(x, Law)
    )

    def first() -> Any:
        key = jax.random.key(0)
        return step(loop, params, key, start(loop, params, key), 0)[1].instant

    instant = jax.eval_shape(first)
    infos = {
        name: getattr(sample.info, "_fields", ()) for name, sample in zip(loop.channels, instant.channels, strict=True)
    }
    return infos, getattr(instant.plant, "_fields", ())


def check_axes(parts: Parts) -> None:
    """Every axis is a number of the loop, and every value admissible.

    Raises:
        ConfigError: otherwise.
    """
    for name, values in parts.config.sweep.items():
        if name.startswith("loop."):
            raise ConfigError(f"sweep.{name}", "the clock is fixed before tracing; run once per value with --set")
        if name not in parts.quantities:
            raise ConfigError(f"sweep.{name}", f"unknown parameter; {nearest(name, parts)}")
        if not parts.quantities[name].law:
            raise ConfigError(f"sweep.{name}", "is fixed before tracing; run once per value with --set")
        for value in values:
            try:
                parse_number(value, parts.quantities[name])
            except ValueError as error:
                raise ConfigError(f"sweep.{name}", str(error)) from None


def nearest(name: str, parts: Parts) -> str:
    """The end of the message about an unknown number: that its part has none at all, or what was meant."""
    slot = name.partition(".")[0]
    table = getattr(parts.config, slot) if slot in REGISTRIES.keys() & StudyTable.model_fields.keys() else None
    if table is not None and not any(known.startswith(f"{slot}.") for known in parts.quantities):
        return f"the study's {slot} is of the kind '{table['kind']}', which has no numbers"
    return meant(name, parts.quantities)


def prepare_box(table: dict[str, Any], parts: Parts) -> None:
    """What spans several fields must hold for all swept values: they stand as laws in a trial of every part.

    Raises:
        ConfigError: it does not, or a swept number is one that is used up before tracing.
    """
    table = copy.deepcopy(table)
    for name, values in parts.config.sweep.items():
        set_dotted(table, name, {"choice": list(values)})
    for slot in {name.split(".")[0] for name in parts.config.sweep}:
        try:
            if slot in PER_CHANNEL:
                parse_channels(table[slot], slot, parts.loop.channels)
            else:
                registry = "trajectory" if slot == "reference" and len(parts.loop.channels) > 1 else slot
                parse_component(table[slot], REGISTRIES[registry], slot)
        except ConfigError as error:
            raise error.within("sweep") from None
