"""Events ``[[event]]`` of a study: changes of the vehicle, of a channel's sensor, or of a channel's command."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from dssc_jax.core.chains import Element, chain
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.events import CommandEvent, SensorEvent, VehicleEvent, Wrapped
from dssc_jax.core.quantities import extent
from dssc_jax.core.signals import Scalar
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.events import EVENTS
from dssc_jax.models.uav.vehicle import Vehicle
from dssc_jax.study.components import Component, parse_component
from dssc_jax.study.numbers import Number

EVENT = "event"
MOST_EVENTS = 12


class StudyEvent(NamedTuple):
    """An event of a study.

    Args:
        path: Dotted path of the event's table, such as ``event.0``.
        part: The event, parsed.
        channel: Channel whose sensor or command the event changes; empty for every channel.
    """

    path: str
    part: Component
    channel: str

    def under(self, place: str) -> Component:
        """The event as a part of the loop, at the path ``place`` of the loop's parameters."""
        return self.part.under(place, self.path)


def events_of(tables: list[TomlTable], plant: Component, channels: tuple[str, ...]) -> list[StudyEvent]:
    """Parse the events of a study, and require that the plant is a vehicle.

    Args:
        tables: Tables ``[[event]]``.
        plant: The plant, parsed.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: An event is not valid, or the plant is no vehicle.
    """
    if tables and not isinstance(getattr(plant.params, "vehicle", None), Vehicle):
        raise ConfigError(EVENT, f"happens to a vehicle, and the plant '{plant.kind}' is none")
    return parse_events(tables, channels)


def parse_events(tables: list[TomlTable], channels: tuple[str, ...]) -> list[StudyEvent]:
    """Parse the tables ``[[event]]``; a table without ``kind`` is a fault of a rotor.

    Args:
        tables: Tables ``[[event]]``.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: An event is not valid.
    """
    if len(tables) > MOST_EVENTS:
        raise ConfigError(EVENT, f"takes at most {MOST_EVENTS} events, got {len(tables)}")
    study_events = []
    for index, table in enumerate(tables):
        path = f"{EVENT}.{index}"
        channel = table.get("channel", "")
        kind_table = {name: value for name, value in table.items() if name != "channel"}
        part = parse_component(kind_table, EVENTS, path, default="rotor")
        is_of_vehicle = isinstance(part.model, VehicleEvent)
        if channel and (channel not in channels or is_of_vehicle):
            hint = "has no channel" if is_of_vehicle else nearest(str(channel), channels)
            raise ConfigError(f"{path}.channel", f"must be a channel that the event changes, got {channel!r}; {hint}")
        require_order(part, path)
        study_events.append(StudyEvent(path, part, channel))
    return study_events


def require_order(part: Component, path: str) -> None:
    """Require that an event with an end can last for a time: its latest end lies after its earliest begin.

    Args:
        part: The event, parsed.
        path: Dotted path of the event, for messages.

    Raises:
        ConfigError: The event ends before or when it begins, for all values of its laws.
    """
    until = getattr(part.params, "until", None)
    if until is None:
        return
    _, latest_end = extent(until)
    earliest_begin, _ = extent(part.params.at)
    if latest_end <= earliest_begin:
        rule = f"must be > {path}.at = {part.params.at}, or the event never happens; got {until}"
        raise ConfigError(f"{path}.until", rule)


def require_remaining_mass(study_events: list[StudyEvent], mass: Scalar) -> None:
    """Require that mass remains when the lightest vehicle has dropped the heaviest loads of all events.

    Args:
        study_events: Events of the vehicle. The parameter ``mass`` of an event is the change of mass [kg], negative
            for a dropped load.
        mass: Mass of the vehicle [kg], or its law.

    Raises:
        ConfigError: All dropped loads together may weigh as much as the vehicle.
    """
    remaining, _ = extent(mass)
    for study_event in study_events:
        least_change, _ = extent(getattr(study_event.part.params, "mass", 0.0))
        if least_change >= 0.0:
            continue
        remaining += least_change
        if remaining <= 0.0:
            rule = f"must leave some of the vehicle's mass, got {least_change:g} kg and {remaining:g} kg of all"
            raise ConfigError(f"{study_event.path}.mass", rule)


def vehicle_events(events: list[StudyEvent], vehicle: Vehicle) -> tuple[Component, ...]:
    """The events that act on the vehicle itself, as parts of the loop, after checks of rotors and mass.

    Args:
        events: All events of the study.
        vehicle: The vehicle, whose numbers may be laws.

    Raises:
        ConfigError: A rotor does not exist, or no mass may remain.
    """
    components: list[Component] = []
    events_of_vehicle = [study_event for study_event in events if isinstance(study_event.part.model, VehicleEvent)]
    require_remaining_mass(events_of_vehicle, vehicle.mass)
    for study_event in events_of_vehicle:
        part = study_event.part
        rotor = getattr(part.params, "rotor", None)  # number of the rotor, from 1; None: the event is of no rotor
        if rotor is not None:
            _, largest_rotor = extent(rotor)
            if largest_rotor > vehicle.rotors:
                raise ConfigError(f"{study_event.path}.rotor", f"must be <= {vehicle.rotors}, the number of rotors")
        numbers = tuple(with_existing_rotors(number, vehicle.rotors) for number in part.numbers)
        place = f"events.{len(components)}"
        components.append(replace(part, numbers=numbers).under(place, study_event.path))
    return tuple(components)


def with_existing_rotors(number: Number, rotors: int) -> Number:
    """Bound the number ``rotor`` of an event by the number of rotors, also in sweeps; any other number stays."""
    if number.name != "rotor":
        return number
    return replace(number, quantity=replace(number.quantity, at_most=rotors))


def with_moved_paths(numbers: tuple[Number, ...], place: str, destination: str) -> tuple[Number, ...]:
    """Copy numbers, with ``destination`` in place of ``place`` at the beginning of their paths; other paths stay.

    Args:
        numbers: The numbers.
        place: Place in the loop's parameters, such as ``sensor.0``.
        destination: The new place, such as ``sensor.0.inner``.
    """
    moved_numbers = []
    for number in numbers:
        paths = []
        for path in number.paths:
            if path.startswith(f"{place}."):
                paths.append(f"{destination}.{path.removeprefix(f'{place}.')}")
            else:
                paths.append(path)
        moved_numbers.append(replace(number, paths=tuple(paths)))
    return tuple(moved_numbers)


def behind_first(part: Component, place: str) -> Component:
    """Move actuators to the second and the further places of a chain, so that an event fits before them.

    Args:
        part: A single actuator, or a chain.
        place: Place of the actuators in the loop's parameters, such as ``unmodelled.0``.

    Returns:
        A chain whose first element is still missing; the caller adds it. The elements and the parameters are those of
        ``part``; the paths of the numbers already count the elements from index 1.
    """
    if not part.elements:  # a single actuator
        numbers = with_moved_paths(part.numbers, place, f"{place}.1")
        return replace(part, params=(part.params,), numbers=numbers, elements=(Element(part.kind, part.model),))
    numbers = part.numbers
    for index in reversed(range(len(part.elements))):  # the last one first, so that no two share an index
        numbers = with_moved_paths(numbers, f"{place}.{index}", f"{place}.{index + 1}")
    return replace(part, numbers=numbers)


def sensor_with_event(sensor: Component, study_event: StudyEvent, place: str) -> Component:
    """Wrap a sensor so that an event changes its readings.

    Args:
        sensor: The sensor.
        study_event: The event.
        place: Place of the sensor in the loop's parameters, such as ``sensor.0``.
    """
    event = study_event.under(f"{place}.event")
    sensor_numbers = with_moved_paths(sensor.numbers, place, f"{place}.inner")
    return Component(
        kind=f"{sensor.kind} with {event.kind}",
        model=event.model.wrap(sensor.model),
        params=Wrapped(sensor.params, event.params),
        numbers=(*sensor_numbers, *event.numbers),
    )


def chain_with_event(actuators: Component, study_event: StudyEvent, place: str) -> Component:
    """Make the chain of an event, which changes the command, and the actuators that follow the event.

    Args:
        actuators: The actuators of a channel.
        study_event: The event.
        place: Place of the actuators in the loop's parameters, such as ``unmodelled.0``.
    """
    event_model = study_event.part.model.model  # the actuator by which a command event acts
    if actuators.kind == "none":
        return replace(study_event.under(place), model=event_model)
    event = study_event.under(f"{place}.0")
    moved_actuators = behind_first(actuators, place)
    elements = (Element(event.kind, event_model), *moved_actuators.elements)
    return Component(
        kind=f"{event.kind} + {moved_actuators.kind}",
        model=chain(elements),
        params=(event.params, *moved_actuators.params),
        numbers=(*event.numbers, *moved_actuators.numbers),
        elements=elements,
    )


CHANNEL_EVENTS: dict[str, tuple[type, Callable[[Component, StudyEvent, str], Component]]] = {
    "unmodelled": (CommandEvent, chain_with_event),
    "sensor": (SensorEvent, sensor_with_event),
}
"""Type of the events that change the parts of a slot, and the function (part, event, place) that adds an event."""


def with_channel_events(
    column: Sequence[Component], events: list[StudyEvent], channels: tuple[str, ...], slot: str
) -> list[Component]:
    """Add to the part of each channel in a slot the events that change this part.

    Args:
        column: Part of each channel.
        events: All events of the study.
        channels: Names of the channels; one empty name for a plant with one channel.
        slot: A slot of :data:`CHANNEL_EVENTS`.
    """
    event_type, add_event = CHANNEL_EVENTS[slot]
    parts = list(column)
    for study_event in events:
        if not isinstance(study_event.part.model, event_type):
            continue
        for index, channel in enumerate(channels):
            if study_event.channel in ("", channel):
                parts[index] = add_event(parts[index], study_event, f"{slot}.{index}")
    return parts
