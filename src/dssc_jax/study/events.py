"""Events ``[[event]]`` of a study: those of the vehicle, and those around the parts of its channels."""

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
    """An event with its place in the study, and the channel of its part; empty: all of them."""

    path: str
    part: Component
    channel: str


def events_of(tables: list[TomlTable], plant: Component, channels: tuple[str, ...]) -> list[StudyEvent]:
    """The events of a study whose plant is a vehicle.

    Raises:
        ConfigError: one is not valid, or the plant is no vehicle.
    """
    if tables and not isinstance(getattr(plant.params, "vehicle", None), Vehicle):
        raise ConfigError(EVENT, f"happens to a vehicle, and the plant '{plant.kind}' is none")
    return parse_events(tables, channels)


def parse_events(tables: list[TomlTable], channels: tuple[str, ...]) -> list[StudyEvent]:
    """The events of a study; without a kind, one is that of a rotor.

    Raises:
        ConfigError: one is not valid.
    """
    if len(tables) > MOST_EVENTS:
        raise ConfigError(EVENT, f"takes at most {MOST_EVENTS} events, got {len(tables)}")
    study_events = []
    for index, table in enumerate(tables):
        path = f"{EVENT}.{index}"
        channel = table.get("channel", "")
        part = parse_component({k: v for k, v in table.items() if k != "channel"}, EVENTS, path, default="rotor")
        if channel and (channel not in channels or isinstance(part.model, VehicleEvent)):
            hint = "has no channel" if isinstance(part.model, VehicleEvent) else nearest(str(channel), channels)
            raise ConfigError(f"{path}.channel", f"must be a channel that the event changes, got {channel!r}; {hint}")
        require_order(part, path)
        study_events.append(StudyEvent(path, part, channel))
    return study_events


def require_order(part: Component, path: str) -> None:
    """Require that an event that ends can end after it begins.

    Raises:
        ConfigError: It ends before it begins, whatever its laws give.
    """
    until = getattr(part.params, "until", None)
    if until is not None and extent(until)[1] <= extent(part.params.at)[0]:
        rule = f"must be > {path}.at = {part.params.at}, or the event never happens; got {until}"
        raise ConfigError(f"{path}.until", rule)


def require_remaining_mass(study_events: list[StudyEvent], mass: Scalar) -> None:
    """Require that some mass remains when all loads are dropped.

    Raises:
        ConfigError: all dropped loads together may weigh as much as the vehicle.
    """
    remaining = extent(mass)[0]
    for study_event in study_events:
        mass_change = min(0.0, extent(getattr(study_event.part.params, "mass", 0.0))[0])
        remaining += mass_change
        if mass_change < 0.0 and remaining <= 0.0:
            rule = f"must leave some of the vehicle's mass, got {mass_change:g} kg and {remaining:g} kg of all"
            raise ConfigError(f"{study_event.path}.mass", rule)


def vehicle_events(events: list[StudyEvent], vehicle: Vehicle) -> tuple[Component, ...]:
    """The events of the vehicle, with the paths of their numbers in the loop's parameters.

    Raises:
        ConfigError: a rotor does not exist, or nothing remains of the mass.
    """
    components: list[Component] = []
    events_of_vehicle = [study_event for study_event in events if isinstance(study_event.part.model, VehicleEvent)]
    require_remaining_mass(events_of_vehicle, vehicle.mass)
    for study_event in events_of_vehicle:
        part = study_event.part
        rotor = getattr(part.params, "rotor", None)
        if rotor is not None and extent(rotor)[1] > vehicle.rotors:
            raise ConfigError(f"{study_event.path}.rotor", f"must be <= {vehicle.rotors}, the number of rotors")
        numbers = (with_existing_rotors(number, vehicle.rotors) for number in part.numbers)
        place = f"events.{len(components)}"
        components.append(replace(part, numbers=tuple(number.under(place, study_event.path) for number in numbers)))
    return tuple(components)


def with_existing_rotors(number: Number, rotors: int) -> Number:
    """A number of an event; a rotor's number has the number of rotors as its limit, which sweeps respect, too."""
    return replace(number, quantity=replace(number.quantity, at_most=rotors)) if number.name == "rotor" else number


def with_moved_paths(numbers: tuple[Number, ...], place: str, destination: str) -> tuple[Number, ...]:
    """Numbers of a part whose parameters move from a place to another; numbers of other places stay."""
    moved_numbers = []
    for number in numbers:
        paths = []
        for path in number.paths:
            inner_path = path.removeprefix(f"{place}.")
            paths.append(path if inner_path == path else f"{destination}.{inner_path}")
        moved_numbers.append(replace(number, paths=tuple(paths)))
    return tuple(moved_numbers)


def behind_first(part: Component, place: str) -> Component:
    """Unmodelled dynamics as the elements of a chain behind its first one, which is yet to be added."""
    if not part.elements:
        numbers = with_moved_paths(part.numbers, place, f"{place}.1")
        return replace(part, params=(part.params,), numbers=numbers, elements=(Element(part.kind, part.model),))
    numbers = part.numbers
    for index in reversed(range(len(part.elements))):
        numbers = with_moved_paths(numbers, f"{place}.{index}", f"{place}.{index + 1}")
    return replace(part, numbers=numbers)


def with_sensor_events(column: list[Component], events: list[StudyEvent], channels: tuple[str, ...]) -> list[Component]:
    """The sensor of each channel, with the events that it has."""
    column = list(column)
    for study_event in events:
        event = study_event.part.model
        if not isinstance(event, SensorEvent):
            continue
        for index, channel in enumerate(channels):
            if study_event.channel not in ("", channel):
                continue
            inner = column[index]
            place = f"sensor.{index}"
            event_numbers = tuple(
                number.under(f"{place}.event", study_event.path) for number in study_event.part.numbers
            )
            column[index] = Component(
                f"{inner.kind} with {study_event.part.kind}",
                event.wrap(inner.model),
                Wrapped(inner.params, study_event.part.params),
                (*with_moved_paths(inner.numbers, place, f"{place}.inner"), *event_numbers),
            )
    return column


def with_command_events(
    column: list[Component], events: list[StudyEvent], channels: tuple[str, ...]
) -> list[Component]:
    """The unmodelled dynamics of each channel, with the events of its command before them."""
    column = list(column)
    for study_event in events:
        event = study_event.part.model
        if not isinstance(event, CommandEvent):
            continue
        for index, channel in enumerate(channels):
            if study_event.channel not in ("", channel):
                continue
            inner = column[index]
            place = f"unmodelled.{index}"
            if inner.kind == "none":
                event_numbers = tuple(number.under(place, study_event.path) for number in study_event.part.numbers)
                column[index] = Component(study_event.part.kind, event.model, study_event.part.params, event_numbers)
                continue
            actuators = behind_first(inner, place)
            event_numbers = tuple(number.under(f"{place}.0", study_event.path) for number in study_event.part.numbers)
            elements = (Element(study_event.part.kind, event.model), *actuators.elements)
            column[index] = Component(
                kind=f"{study_event.part.kind} + {actuators.kind}",
                model=chain(elements),
                params=(study_event.part.params, *actuators.params),
                numbers=(*event_numbers, *actuators.numbers),
                elements=elements,
            )
    return column
