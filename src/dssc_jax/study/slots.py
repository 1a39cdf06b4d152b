"""Parsing of the loop's slots: a single part, a sum of winds, a reference, or a part for each channel."""

from collections.abc import Collection, Mapping, Sequence
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
from dssc_jax.study.numbers import Number, dotted_name
from dssc_jax.study.tables import channel_table, common_table, has_dotted, stands_alone

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
"""The kinds of parts by slot; ``trajectory`` has the references of all channels together."""
PER_CHANNEL = ("controller", "sensor", "differentiator", "unmodelled", "disturbance")
"""Slots that have a part for each channel."""
SLOTS = ("plant", "reference", "wind", *PER_CHANNEL)
"""Slots of the loop that a section of the study fills."""
TABLES = (*SLOTS, ACTUATOR, EVENT)
"""Sections of the study file that hold parts of the loop."""


def with_units(component: Component, units: ChannelUnits) -> Component:
    """Copy a component, with the units of a channel in place of the symbols y and u in its numbers."""
    numbers = []
    for number in component.numbers:
        quantity = replace(number.quantity, unit=units.of(number.quantity.unit))
        numbers.append(replace(number, quantity=quantity))
    return replace(component, numbers=tuple(numbers))


def parse_whole(table: TomlTable, slot: str) -> Component:
    """Parse the table of a slot that the loop has once, such as the plant."""
    return parse_component(table, REGISTRIES[slot], slot).under(slot, slot)


def parse_winds(table: TomlTable | list[TomlTable]) -> Component:
    """Parse ``[wind]``, or the tables ``[[wind]]`` into the sum of several winds.

    The numbers of the second wind of a sum have names such as ``wind.1.speed``.

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
        parts.append(parse_component(part, REGISTRIES["wind"], name).under(name, name))
    return Component(
        kind=" + ".join(part.kind for part in parts),
        model=sum_of_winds(tuple(part.model for part in parts)),
        params=tuple(part.params for part in parts),
        numbers=tuple(chain.from_iterable(part.numbers for part in parts)),
    )


def reference_kinds(is_angle: bool) -> Registry:
    """Kinds of references for one channel; for an angle, the form for angles of each kind that has one."""
    if not is_angle:
        return REFERENCES
    entries = {}
    for kind, entry in REFERENCES.items():
        members = {option: model.of_angle or model for option, model in entry.members.items()}
        entries[kind] = entry._replace(members=members)
    return entries


def is_flight(table: TomlTable, channels: Collection[str]) -> bool:
    """Whether the entries common to all channels state a vehicle's trajectory, other than rest at zero."""
    common = common_table(table, channels)
    rests_at_zero = common in ({}, {"kind": "zero"})
    is_trajectory = common.get("kind", "zero") in REGISTRIES["trajectory"]
    return is_trajectory and not rests_at_zero


def parse_reference(
    table: TomlTable, channels: tuple[str, ...], units: tuple[ChannelUnits, ...], angles: Collection[str]
) -> Component:
    """Parse the reference: one signal, or a trajectory in which ``[reference.x]`` replaces the signal of channel x.

    The package's trajectories have a signal for each channel of the vehicle. If a plant that flies has fewer channels,
    it takes the first of these signals. A plant that does not fly takes only rest at zero (:func:`is_flight`). A user's
    trajectory has a signal for each channel of the plant.

    Args:
        table: Table of the reference.
        channels: Names of the channels; one empty name for a plant with one channel.
        units: Units and meanings of each channel.
        angles: Names of the channels whose output is an angle.

    Raises:
        ConfigError: The table is not valid.
    """
    slot = "reference"
    if len(channels) == 1:
        registry = reference_kinds(is_angle=channels[0] in angles)
        return with_units(parse_component(table, registry, slot).under(slot, slot), units[0])
    common = common_table(table, channels)
    joint = parse_component(common, REGISTRIES["trajectory"], slot, default="zero")
    is_of_package = joint.kind in REGISTRIES["trajectory"]
    if is_of_package and len(channels) != len(UAV.channels):
        joint = replace(joint, model=with_channel_count(joint.model, len(channels)))
    signals = {}
    for index, channel in enumerate(channels):
        if channel in table:
            registry = reference_kinds(is_angle=channel in angles)
            signal = parse_component(table[channel], registry, dotted_name(slot, channel))
            signals[index] = with_units(signal, units[index])
    return replaced_signals(joint, signals, channels) if signals else joint.under(slot, slot)


def replaced_signals(joint: Component, signals: Mapping[int, Component], channels: Sequence[str]) -> Component:
    """Replace the signals of some channels in a trajectory.

    Args:
        joint: The trajectory of all channels.
        signals: The new signals, by index of the channel.
        channels: Names of the channels.
    """
    numbers = list(joint.under("reference.joint", "reference").numbers)
    for place, (index, signal) in enumerate(signals.items()):
        numbers += signal.under(f"reference.replacements.{place}", dotted_name("reference", channels[index])).numbers
    model = replace_channels(joint.model, {index: signal.model for index, signal in signals.items()})
    params = ReplacedParams(joint.params, tuple(signal.params for signal in signals.values()))
    return Component(joint.kind, model, params, tuple(numbers))


def parse_channels(table: TomlTable | list[TomlTable], slot: str, channels: tuple[str, ...]) -> list[Component]:
    """Parse one component for each channel.

    A table such as ``[controller.x]`` overrides the common ``[controller]``, or replaces it if the kind differs. All
    channels share a number that no channel overrides: its law has one value in a draw, and a sweep has one axis for it.

    Args:
        table: Table of the slot, which may contain tables of channels; or the list ``[[actuator]]``.
        slot: Name of the slot.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: A table is not valid.
    """
    if isinstance(table, list):
        return parse_chain(table, channels)
    common = common_table(table, channels)
    components = []
    for index, channel in enumerate(channels):
        channel_path = dotted_name(slot, channel)
        override = as_table(table.get(channel, {}), channel_path) if channel else {}
        is_alone = stands_alone(override, common)
        with errors_under(channel_path):
            channel_content = channel_table(common, override)
        component = parse_component(channel_content, REGISTRIES[slot], channel_path if override else slot)
        numbers = []
        for number in component.numbers:
            is_of_channel = is_alone or has_dotted(override, number.name)
            numbers.append(number.under(f"{slot}.{index}", channel_path if is_of_channel else slot))
        components.append(replace(component, numbers=tuple(numbers)))
    return components


COMMAND = "command"
"""Value of ``input`` for a disturbance that adds to the command of a plant with one channel."""


def disturbance_place(table: TomlTable, path: str, channels: Sequence[str], inputs: Sequence[str]) -> str:
    """Place at which a disturbance acts: the name of a channel or of a disturbance input of the plant.

    The channel of a plant with one channel has an empty name; a study calls this place ``command``.

    Args:
        table: Table of the disturbance.
        path: Dotted path of the table, for messages.
        channels: Names of the channels; one empty name for a plant with one channel.
        inputs: Names of the plant's disturbance inputs.

    Raises:
        ConfigError: The plant has no such place.
    """
    has_one_channel = channels == ("",)
    places = {COMMAND: ""} if has_one_channel else {channel: channel for channel in channels}
    places |= {name: name for name in inputs}
    input_name = table.get("input", COMMAND if has_one_channel else None)
    if input_name not in places:
        rule = f"must be a place of the plant at which a disturbance acts, got {input_name!r}"
        raise ConfigError(f"{path}.input", f"{rule}; {nearest(str(input_name), places)}")
    return places[input_name]


def placed_disturbances(
    table: TomlTable | list[TomlTable], channels: Sequence[str], inputs: Sequence[str]
) -> dict[str, list[Component]]:
    """Parse ``[[disturbance]]``, or a single table with ``input``, into the disturbances at each place of the plant.

    The numbers of the disturbances already have their names in the study. Their paths begin at the disturbance itself;
    :func:`disturbance_sum` completes them.

    Args:
        table: The section ``disturbance``.
        channels: Names of the channels; one empty name for a plant with one channel.
        inputs: Names of the plant's disturbance inputs.

    Raises:
        ConfigError: A disturbance is not valid.
    """
    if isinstance(table, dict):
        parts = {"disturbance": table}
    else:
        parts = {f"disturbance.{index}": item for index, item in enumerate(table)}
    disturbances_by_place: dict[str, list[Component]] = {place: [] for place in (*channels, *inputs)}
    for path, part in parts.items():
        entries = as_table(part, path)
        place = disturbance_place(entries, path, channels, inputs)
        entries.pop("input", None)
        disturbances_by_place[place].append(parse_component(entries, DISTURBANCES, path).under("", path))
    return disturbances_by_place


def disturbance_sum(parts: Sequence[Component], path: str) -> Component:
    """Add up the disturbances at one place of the plant.

    Args:
        parts: The disturbances, from :func:`placed_disturbances`; without any, the kind of the sum is ``none``.
        path: Path of the sum in the loop's parameters.
    """
    if not parts:
        return parse_component({"kind": "none"}, DISTURBANCES)
    if len(parts) == 1:
        return parts[0].under(path, name="")  # its numbers have their names already
    numbers: list[Number] = []
    for index, part in enumerate(parts):
        numbers += part.under(f"{path}.{index}", name="").numbers
    kind = " + ".join(part.kind for part in parts)
    model = sum_of_disturbances(tuple(part.model for part in parts))
    params = tuple(part.params for part in parts)
    return Component(kind, model, params, tuple(numbers))


def parse_disturbances(
    table: TomlTable | list[TomlTable], channels: tuple[str, ...], inputs: Sequence[str]
) -> list[Component]:
    """Parse the disturbance at the command of each channel, from ``[disturbance]`` or ``[[disturbance]]``.

    Args:
        table: The section ``disturbance``, a table or a list of tables.
        channels: Names of the channels; one empty name for a plant with one channel.
        inputs: Names of the plant's disturbance inputs.

    Raises:
        ConfigError: A disturbance is not valid.
    """
    if isinstance(table, dict) and "input" not in table:
        return parse_channels(table, "disturbance", channels)
    disturbances_by_place = placed_disturbances(table, channels, inputs)
    sums = []
    for index, channel in enumerate(channels):
        sums.append(disturbance_sum(disturbances_by_place[channel], f"disturbance.{index}"))
    return sums


def parse_inputs(
    table: TomlTable | list[TomlTable], channels: tuple[str, ...], inputs: Sequence[str]
) -> list[Component]:
    """Parse the disturbance at each named input of the plant; its kind is ``none`` where no table names the input.

    Args:
        table: The section ``disturbance``, a table or a list of tables.
        channels: Names of the channels; one empty name for a plant with one channel.
        inputs: Names of the plant's disturbance inputs.

    Raises:
        ConfigError: A disturbance is not valid.
    """
    if isinstance(table, dict) and "input" not in table:
        return [disturbance_sum([], path="") for _ in inputs]
    disturbances_by_place = placed_disturbances(table, channels, inputs)
    sums = []
    for index, name in enumerate(inputs):
        sums.append(disturbance_sum(disturbances_by_place[name], f"inputs.{index}"))
    return sums
