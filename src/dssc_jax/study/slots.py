"""Parsing of the loop's slots: one part for the whole loop, a sum of winds, a reference, or one part a channel."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import chain

from dssc_jax.core.adapters import (
    ReplacedParams,
    replace_channels,
    sum_of_disturbances,
    sum_of_winds,
    with_channel_count,
)
from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.units import ChannelUnits
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.differentiators import DIFFERENTIATORS
from dssc_jax.models.disturbances import DISTURBANCES
from dssc_jax.models.events import EVENTS
from dssc_jax.models.plants import PLANTS
from dssc_jax.models.references import REFERENCES, TRAJECTORIES
from dssc_jax.models.sensors import SENSORS
from dssc_jax.models.uav import UAV
from dssc_jax.models.wind import WINDS
from dssc_jax.study.actuators import ACTUATOR, parse_chain
from dssc_jax.study.components import Component, as_table, parse_component
from dssc_jax.study.events import EVENT
from dssc_jax.study.numbers import dotted_name
from dssc_jax.study.tables import channel_table, has_dotted, stands_alone

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
    "event": EVENTS,
}
PER_CHANNEL = ("controller", "sensor", "differentiator", "unmodelled", "disturbance")
SLOTS = ("plant", "reference", "wind", *PER_CHANNEL)
TABLES = (*SLOTS, ACTUATOR, EVENT)
"""Sections of the study file that hold parts of the loop."""


def with_units(component: Component, units: ChannelUnits) -> Component:
    """The component whose numbers have the channel's own units."""
    numbers = (replace(n, quantity=replace(n.quantity, unit=units.of(n.quantity.unit))) for n in component.numbers)
    return replace(component, numbers=tuple(numbers))


def parse_whole(table: TomlTable, slot: str, registry: Registry | None = None) -> Component:
    """Parse the component of a slot that the loop has once; without a registry, from that of the slot."""
    component = parse_component(table, REGISTRIES[slot] if registry is None else registry, slot)
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


def of_angles(registry: Registry) -> Registry:
    """The references of a registry in their forms for an output that is an angle."""
    entries = {}
    for kind, entry in registry.items():
        members = {option: model.of_angle or model for option, model in entry.members.items()}
        entries[kind] = entry._replace(members=members)
    return entries


def parse_reference(
    table: TomlTable, channels: tuple[str, ...], units: tuple[ChannelUnits, ...], angles: Collection[str]
) -> Component:
    """Parse the reference: one signal, or a trajectory in which ``[reference.x]`` replaces that of channel x.

    ``angles`` are the channels whose output is an angle.

    The package's trajectories have a point for each of the vehicle's channels. A plant with fewer channels takes the
    first points; further channels of a plant with more stay at zero. A trajectory of the user's has a point for each of
    the plant's channels.
    """
    slot = "reference"
    if len(channels) == 1:
        registry = of_angles(REFERENCES) if channels[0] in angles else REFERENCES
        return with_units(parse_whole(table, slot, registry), units[0])
    common = {name: value for name, value in table.items() if name not in channels}
    joint = parse_component(common, REGISTRIES["trajectory"], slot, default="zero")
    if joint.kind in REGISTRIES["trajectory"] and len(channels) != len(UAV.channels):
        joint = replace(joint, model=with_channel_count(joint.model, len(channels)))
    replaced_channels = [channel for channel in channels if channel in table]
    if not replaced_channels:
        return replace(joint, numbers=tuple(number.under(slot, slot) for number in joint.numbers))
    replacements = {}
    for channel in replaced_channels:
        registry = of_angles(REFERENCES) if channel in angles else REFERENCES
        replacements[channel] = parse_component(table[channel], registry, dotted_name(slot, channel))
    numbers = [number.under(f"{slot}.joint", slot) for number in joint.numbers]
    for place, (channel, part) in enumerate(replacements.items()):
        numbers_of_part = with_units(part, units[channels.index(channel)]).numbers
        numbers += [number.under(f"{slot}.replaced.{place}", dotted_name(slot, channel)) for number in numbers_of_part]
    models = {channels.index(channel): part.model for channel, part in replacements.items()}
    model = replace_channels(joint.model, models)
    params = ReplacedParams(joint.params, tuple(part.params for part in replacements.values()))
    return Component(joint.kind, model, params, tuple(numbers))


def parse_channels(table: TomlTable | list[TomlTable], slot: str, channels: tuple[str, ...]) -> list[Component]:
    """Parse one component per channel; a list is the chain ``[[actuator]]``.

    A table ``[controller.x]`` overrides ``[controller]``, which applies to all; one of another kind replaces it.
    A number that no channel overrides is one number for all channels: one draw of its law, one axis.
    """
    if isinstance(table, list):
        return parse_chain(table, channels)
    common = {name: value for name, value in table.items() if name not in channels}
    components = []
    for index, channel in enumerate(channels):
        channel_path = dotted_name(slot, channel)
        override = as_table(table.get(channel, {}), channel_path) if channel else {}
        is_alone = stands_alone(override, common)
        with errors_under(channel_path):
            channel_content = channel_table(common, override)
        component = parse_component(channel_content, REGISTRIES[slot], channel_path if override else slot)
        numbers = tuple(
            number.under(f"{slot}.{index}", channel_path if is_alone or has_dotted(override, number.name) else slot)
            for number in component.numbers
        )
        components.append(replace(component, numbers=numbers))
    return components


COMMAND = "command"
"""The place of a disturbance at the plant's command, if the plant has one channel."""


def place_of(table: TomlTable, path: str, channels: Sequence[str], inputs: Sequence[str]) -> str:
    """The place at which a disturbance acts: a channel's name, empty for the only one, or an input's.

    Raises:
        ConfigError: the plant has no such place.
    """
    places = {channel or COMMAND: channel for channel in channels} | {name: name for name in inputs}
    input_name = table.get("input", COMMAND if channels == ("",) else None)
    if input_name not in places:
        rule = f"must be a place of the plant at which a disturbance acts, got {input_name!r}"
        raise ConfigError(f"{path}.input", f"{rule}; {nearest(str(input_name), places)}")
    return places[input_name]


def placed_disturbances(
    table: TomlTable | list[TomlTable], channels: Sequence[str], inputs: Sequence[str]
) -> dict[str, list[Component]]:
    """The disturbances of ``[[disturbance]]`` by their places; of one table with ``input``, the single one.

    Raises:
        ConfigError: one is not valid.
    """
    parts = {"disturbance": table} if isinstance(table, dict) else {f"disturbance.{i}": t for i, t in enumerate(table)}
    disturbances_by_place: dict[str, list[Component]] = {place: [] for place in (*channels, *inputs)}
    for path, part in parts.items():
        entries = as_table(part, path)
        place = place_of(entries, path, channels, inputs)
        entries.pop("input", None)
        disturbances_by_place[place].append(parse_component(entries, DISTURBANCES, path))
        component = disturbances_by_place[place][-1]
        numbers = tuple(number.under("", path) for number in component.numbers)
        disturbances_by_place[place][-1] = replace(component, numbers=numbers)
    return disturbances_by_place


def disturbance_sum(parts: Sequence[Component], path: str) -> Component:
    """The sum of the disturbances at one place, whose parameters are at a path."""
    if not parts:
        return parse_component({"kind": "none"}, DISTURBANCES)
    numbers = []
    for index, part in enumerate(parts):
        parent_path = path if len(parts) == 1 else f"{path}.{index}"
        numbers += [
            replace(n, paths=tuple(dotted_name(parent_path, inner_path) for inner_path in n.paths))
            for n in part.numbers
        ]
    params = parts[0].params if len(parts) == 1 else tuple(part.params for part in parts)
    kind = " + ".join(part.kind for part in parts)
    return Component(kind, sum_of_disturbances(tuple(part.model for part in parts)), params, tuple(numbers))


def parse_disturbances(
    table: TomlTable | list[TomlTable], channels: tuple[str, ...], inputs: Sequence[str]
) -> list[Component]:
    """The disturbance of each channel: by its table, or the sum of those of ``[[disturbance]]`` at its command.

    Raises:
        ConfigError: one is not valid.
    """
    if isinstance(table, dict) and "input" not in table:
        return parse_channels(table, "disturbance", channels)
    disturbances_by_place = placed_disturbances(table, channels, inputs)
    return [
        disturbance_sum(disturbances_by_place[channel], f"disturbance.{index}")
        for index, channel in enumerate(channels)
    ]


def parse_inputs(
    table: TomlTable | list[TomlTable], channels: tuple[str, ...], inputs: Sequence[str]
) -> list[Component]:
    """The disturbance at each input that the plant names; see :func:`parse_disturbances`."""
    if isinstance(table, dict) and "input" not in table:
        return [disturbance_sum([], "") for _ in inputs]
    disturbances_by_place = placed_disturbances(table, channels, inputs)
    return [disturbance_sum(disturbances_by_place[name], f"inputs.{index}") for index, name in enumerate(inputs)]
