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


class Happening(NamedTuple):
    """An event with its place in the study, and the channel of its part; empty: all of them."""

    path: str
    part: Component
    channel: str


def events_of(tables: list[TomlTable], plant: Component, channels: tuple[str, ...]) -> list[Happening]:
    """The events of a study whose plant is a vehicle.

    Raises:
        ConfigError: one is not valid, or the plant is no vehicle.
    """
    if tables and not isinstance(getattr(plant.params, "vehicle", None), Vehicle):
        raise ConfigError(EVENT, f"happens to a vehicle, and the plant '{plant.kind}' is none")
    return parse_events(tables, channels)


def parse_events(tables: list[TomlTable], channels: tuple[str, ...]) -> list[Happening]:
    """The events of a study; without a kind, one is that of a rotor.

    Raises:
        ConfigError: one is not valid.
    """
    if len(tables) > MOST_EVENTS:
        raise ConfigError(EVENT, f"takes at most {MOST_EVENTS} events, got {len(tables)}")
    found = []
    for index, table in enumerate(tables):
        path = f"{EVENT}.{index}"
        channel = table.get("channel", "")
        part = parse_component({k: v for k, v in table.items() if k != "channel"}, EVENTS, path, default="rotor")
        if channel and (channel not in channels or isinstance(part.model, VehicleEvent)):
            told = "has no channel" if isinstance(part.model, VehicleEvent) else nearest(str(channel), channels)
            raise ConfigError(f"{path}.channel", f"must be a channel that the event changes, got {channel!r}; {told}")
        found.append(Happening(path, part, channel))
    return found


def require_rest(happening: Happening, mass: Scalar) -> None:
    """Require that a dropped mass leaves some; raises ConfigError."""
    dropped = extent(getattr(happening.part.params, "mass", 0.0))[0]
    if extent(mass)[0] + dropped <= 0.0:
        raise ConfigError(f"{happening.path}.mass", f"must leave some of the vehicle's mass, got {dropped:g} kg")


def vehicle_events(events: list[Happening], vehicle: Vehicle) -> tuple[Component, ...]:
    """The events of the vehicle, with the paths of their numbers in the loop's parameters.

    Raises:
        ConfigError: a rotor does not exist, or nothing remains of the mass.
    """
    found: list[Component] = []
    for happening in events:
        part = happening.part
        if not isinstance(part.model, VehicleEvent):
            continue
        rotor = getattr(part.params, "rotor", None)
        if rotor is not None and extent(rotor)[1] > vehicle.rotors:
            raise ConfigError(f"{happening.path}.rotor", f"must be <= {vehicle.rotors}, the number of rotors")
        require_rest(happening, vehicle.mass)
        numbers = tuple(number.under(f"events.{len(found)}", happening.path) for number in part.numbers)
        found.append(replace(part, numbers=numbers))
    return tuple(found)


def moved(numbers: tuple[Number, ...], place: str, destination: str) -> tuple[Number, ...]:
    """Numbers of a part whose parameters move from a place to another; numbers of other places stay."""
    after = []
    for number in numbers:
        paths = []
        for path in number.paths:
            inside = path.removeprefix(f"{place}.")
            paths.append(path if inside == path else f"{destination}.{inside}")
        after.append(replace(number, paths=tuple(paths)))
    return tuple(after)


def behind_first(part: Component, place: str) -> Component:
    """Unmodelled dynamics as the elements of a chain behind its first one, which is yet to be added."""
    if not part.elements:
        numbers = moved(part.numbers, place, f"{place}.1")
        return replace(part, params=(part.params,), numbers=numbers, elements=(Element(part.kind, part.model),))
    numbers = part.numbers
    for index in reversed(range(len(part.elements))):
        numbers = moved(numbers, f"{place}.{index}", f"{place}.{index + 1}")
    return replace(part, numbers=numbers)


def with_sensor_events(column: list[Component], events: list[Happening], channels: tuple[str, ...]) -> list[Component]:
    """The sensor of each channel, with the events that it has."""
    column = list(column)
    for happening in events:
        event = happening.part.model
        if not isinstance(event, SensorEvent):
            continue
        for index, channel in enumerate(channels):
            if happening.channel not in ("", channel):
                continue
            inner = column[index]
            place = f"sensor.{index}"
            event_numbers = tuple(number.under(f"{place}.event", happening.path) for number in happening.part.numbers)
            column[index] = Component(
                f"{inner.kind} with {happening.part.kind}",
                event.wrap(inner.model),
                Wrapped(inner.params, happening.part.params),
                (*moved(inner.numbers, place, f"{place}.inner"), *event_numbers),
            )
    return column


def with_command_events(column: list[Component], events: list[Happening], channels: tuple[str, ...]) -> list[Component]:
    """The unmodelled dynamics of each channel, with the events of its command before them."""
    column = list(column)
    for happening in events:
        event = happening.part.model
        if not isinstance(event, CommandEvent):
            continue
        for index, channel in enumerate(channels):
            if happening.channel not in ("", channel):
                continue
            inner = column[index]
            place = f"unmodelled.{index}"
            if inner.kind == "none":
                event_numbers = tuple(number.under(place, happening.path) for number in happening.part.numbers)
                column[index] = Component(happening.part.kind, event.model, happening.part.params, event_numbers)
                continue
            actuators = behind_first(inner, place)
            event_numbers = tuple(number.under(f"{place}.0", happening.path) for number in happening.part.numbers)
            elements = (Element(happening.part.kind, event.model), *actuators.elements)
            column[index] = Component(
                f"{happening.part.kind} + {actuators.kind}",
                chain(elements),
                (happening.part.params, *actuators.params),
                (*event_numbers, *actuators.numbers),
                elements,
            )
    return column
