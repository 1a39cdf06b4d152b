"""Events ``[[event]]`` of a study: those of the vehicle, and those of a channel's sensor or command."""

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
        channel: Channel whose sensor or command it changes; empty for every channel.
    """

    path: str
    part: Component
    channel: str

    def under(self, place: str) -> Component:
        """The event as a part whose numbers lie at a place of the loop's parameters."""
        return self.part.under(place, self.path)


def events_of(tables: list[TomlTable], plant: Component, channels: tuple[str, ...]) -> list[StudyEvent]:
    """Parse the events of a study, whose plant must be a vehicle if there are any.

    Raises:
        ConfigError: An event is not valid, or the plant is no vehicle.
    """
    if tables and not isinstance(getattr(plant.params, "vehicle", None), Vehicle):
        raise ConfigError(EVENT, f"happens to a vehicle, and the plant '{plant.kind}' is none")
    return parse_events(tables, channels)


def parse_events(tables: list[TomlTable], channels: tuple[str, ...]) -> list[StudyEvent]:
    """Parse the tables ``[[event]]``; one without a kind is an event of a rotor.

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
    """Require that an event with an end can end after it begins.

    Raises:
        ConfigError: It ends before it begins for all values of its laws.
    """
    until = getattr(part.params, "until", None)
    if until is not None and extent(until)[1] <= extent(part.params.at)[0]:
        rule = f"must be > {path}.at = {part.params.at}, or the event never happens; got {until}"
        raise ConfigError(f"{path}.until", rule)


def require_remaining_mass(study_events: list[StudyEvent], mass: Scalar) -> None:
    """Require that mass remains when all loads have been dropped.

    Args:
        study_events: Events of the vehicle.
        mass: Mass of the vehicle [kg], or its law.

    Raises:
        ConfigError: All dropped loads together may weigh as much as the vehicle.
    """
    remaining = extent(mass)[0]
    for study_event in study_events:
        mass_change = min(0.0, extent(getattr(study_event.part.params, "mass", 0.0))[0])
        remaining += mass_change
        if mass_change < 0.0 and remaining <= 0.0:
            rule = f"must leave some of the vehicle's mass, got {mass_change:g} kg and {remaining:g} kg of all"
            raise ConfigError(f"{study_event.path}.mass", rule)


def vehicle_events(events: list[StudyEvent], vehicle: Vehicle) -> tuple[Component, ...]:
    """The events that act on the vehicle itself, as parts of the loop.

    Raises:
        ConfigError: A rotor does not exist, or no mass may remain.
    """
    components: list[Component] = []
    events_of_vehicle = [study_event for study_event in events if isinstance(study_event.part.model, VehicleEvent)]
    require_remaining_mass(events_of_vehicle, vehicle.mass)
    for study_event in events_of_vehicle:
        part = study_event.part
        rotor = getattr(part.params, "rotor", None)
        if rotor is not None and extent(rotor)[1] > vehicle.rotors:
            raise ConfigError(f"{study_event.path}.rotor", f"must be <= {vehicle.rotors}, the number of rotors")
        numbers = tuple(with_existing_rotors(number, vehicle.rotors) for number in part.numbers)
        place = f"events.{len(components)}"
        components.append(replace(part, numbers=numbers).under(place, study_event.path))
    return tuple(components)


def with_existing_rotors(number: Number, rotors: int) -> Number:
    """Limit the number ``rotor`` of an event to the number of rotors, also in sweeps; other numbers stay."""
    if number.name != "rotor":
        return number
    return replace(number, quantity=replace(number.quantity, at_most=rotors))


def with_moved_paths(numbers: tuple[Number, ...], place: str, destination: str) -> tuple[Number, ...]:
    """Numbers whose parameters move from a place in the loop's parameters to another; numbers of other places stay."""
    moved_numbers = []
    for number in numbers:
        paths = []
        for path in number.paths:
            inner_path = path.removeprefix(f"{place}.")
            paths.append(path if inner_path == path else f"{destination}.{inner_path}")
        moved_numbers.append(replace(number, paths=tuple(paths)))
    return tuple(moved_numbers)


def behind_first(part: Component, place: str) -> Component:
    """Actuators at a place of the loop, moved so that one more element fits before them in their chain."""
    if not part.elements:
        numbers = with_moved_paths(part.numbers, place, f"{place}.1")
        return replace(part, params=(part.params,), numbers=numbers, elements=(Element(part.kind, part.model),))
    numbers = part.numbers
    for index in reversed(range(len(part.elements))):
        numbers = with_moved_paths(numbers, f"{place}.{index}", f"{place}.{index + 1}")
    return replace(part, numbers=numbers)


def with_sensor_events(column: list[Component], events: list[StudyEvent], channels: tuple[str, ...]) -> list[Component]:
    """The sensor of each channel, wrapped by the events that change it.

    Args:
        column: Sensor of each channel.
        events: All events of the study.
        channels: Names of the channels.
    """
    sensors = list(column)
    for study_event in events:
        if not isinstance(study_event.part.model, SensorEvent):
            continue
        for index, channel in enumerate(channels):
            if study_event.channel in ("", channel):
                sensors[index] = wrapped_sensor(sensors[index], study_event, f"sensor.{index}")
    return sensors


def wrapped_sensor(sensor: Component, study_event: StudyEvent, place: str) -> Component:
    """A sensor with an event, at a place of the loop's parameters."""
    event = study_event.under(f"{place}.event")
    sensor_numbers = with_moved_paths(sensor.numbers, place, f"{place}.inner")
    return Component(
        kind=f"{sensor.kind} with {event.kind}",
        model=event.model.wrap(sensor.model),
        params=Wrapped(sensor.params, event.params),
        numbers=(*sensor_numbers, *event.numbers),
    )


def with_command_events(
    column: list[Component], events: list[StudyEvent], channels: tuple[str, ...]
) -> list[Component]:
    """The actuators of each channel, preceded by the events that change its command.

    Args:
        column: Actuators, or other unmodelled dynamics, of each channel.
        events: All events of the study.
        channels: Names of the channels.
    """
    actuators = list(column)
    for study_event in events:
        if not isinstance(study_event.part.model, CommandEvent):
            continue
        for index, channel in enumerate(channels):
            if study_event.channel in ("", channel):
                actuators[index] = chain_with_event(actuators[index], study_event, f"unmodelled.{index}")
    return actuators


def chain_with_event(actuators: Component, study_event: StudyEvent, place: str) -> Component:
    """The chain of an event and the actuators behind it, at a place of the loop's parameters."""
    event_model = study_event.part.model.model
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
