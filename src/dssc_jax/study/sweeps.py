"""Checks of a study's axes: each is a number of the loop, whose part is valid for all values of the axis."""

import copy
from collections.abc import Mapping
from typing import Any

from dssc_jax.closed_loop.loop import Loop
from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.units import UNNAMED_UNITS
from dssc_jax.study.actuators import ACTUATOR
from dssc_jax.study.events import EVENT, parse_events, vehicle_events
from dssc_jax.study.fields import field_specs
from dssc_jax.study.measures import parse_signal_sensors, sensor_tables
from dssc_jax.study.numbers import Number, parse_number
from dssc_jax.study.parameters import ParameterTable
from dssc_jax.study.schema import StudyTable
from dssc_jax.study.sections import params_of
from dssc_jax.study.slots import (
    PER_CHANNEL,
    REGISTRIES,
    TABLES,
    parse_channels,
    parse_disturbances,
    parse_inputs,
    parse_reference,
    parse_whole,
    parse_winds,
)
from dssc_jax.study.table_errors import value_errors_at
from dssc_jax.study.tables import PARAMETERS, set_dotted


def check_axes(config: StudyTable, numbers: Mapping[str, Number]) -> None:
    """Require that every axis is a number of the loop that may be swept, and that its values are admissible.

    Raises:
        ConfigError: An axis is no number of the loop or may not be swept, or a value is not admissible.
    """
    for name, values in config.sweep.items():
        with errors_under(f"sweep.{name}"):
            if name.startswith("loop."):
                raise ConfigError("", "the clock is fixed before tracing; run once per value")
            if name not in numbers:
                raise ConfigError("", f"unknown parameter; {nearest_number(name, config, numbers)}")
            if numbers[name].expression:
                raise ConfigError("", numbers[name].follows)
            if not numbers[name].quantity.law:
                raise ConfigError("", "is fixed before tracing; run once per value")
            critical_values = [min(values), max(values)]  # a quantity admits an interval
            if numbers[name].quantity.whole:
                critical_values = list(values)
            for value in critical_values:
                with value_errors_at(""):
                    parse_number(value, numbers[name].quantity)


def nearest_number(name: str, config: StudyTable, numbers: Mapping[str, Number]) -> str:
    """End of the message about an unknown number: the nearest name, or that its part has no numbers.

    Args:
        name: Dotted name of the unknown number.
        config: Fixed tables of the study.
        numbers: Numbers of the loop by name.
    """
    slot, _, _ = name.partition(".")
    parent, _, field = name.rpartition(".")
    is_slot = slot in REGISTRIES and slot in StudyTable.model_fields
    table = getattr(config, slot) if is_slot else None
    has_numbers = any(number_name.startswith(f"{slot}.") for number_name in numbers)
    if isinstance(table, Mapping) and not has_numbers:
        kinds = [kind for kind, entry in REGISTRIES[slot].items() if field in field_specs(params_of(entry))]
        remedy = f"; for '{kinds[0]}' set {slot}.kind = '{kinds[0]}' and {name}" if kinds else ""
        return f"the study's {slot} is of the kind '{table.get('kind')}', which has no numbers{remedy}"
    has_siblings = any(number_name.startswith(f"{parent}.") for number_name in numbers)
    is_index_of_empty_list = field.isdecimal() and not has_siblings
    if is_index_of_empty_list:
        return f"{nearest(name, numbers)}; if {parent} is a list that is empty, state it in the study first"
    return nearest(name, numbers)


def check_swept_parts(
    table: TomlTable,
    config: StudyTable,
    loop: Loop,
    measurable: Mapping[str, NamedSignal],
    numbers: Mapping[str, Number],
) -> None:
    """Require that parts are valid for all swept values, also by rules that concern several fields of a part.

    The function parses the parts once more, with a law ``choice`` of the swept values in place of each swept number.

    Args:
        table: Table of the study.
        config: Fixed tables of the study.
        loop: The loop.
        measurable: Signals that sensors can measure, by name.
        numbers: Numbers of the loop by name.

    Raises:
        ConfigError: A rule does not hold, or a part needs a swept number before tracing.
    """
    if not config.sweep:
        return
    table = copy.deepcopy(table)
    for name, values in config.sweep.items():
        set_dotted(table, name, {"choice": list(values)})
    slots = {name.partition(".")[0] for name in config.sweep}
    if PARAMETERS in slots:  # any part may depend on a parameter
        slots = {slot for slot in TABLES if slot in table}
    try:
        parameters = ParameterTable.from_toml(table.get(PARAMETERS, {}))
        for slot in sorted(slots):
            parse_slot(slot, parameters.resolved(table[slot], slot), loop, measurable)
        if loop.events:
            check_swept_events(table, parameters, loop.channels)
        check_expressions(parameters, config, numbers)
    except ConfigError as error:
        raise error.within("sweep") from None


def parse_slot(slot: str, table: Any, loop: Loop, measurable: Mapping[str, NamedSignal]) -> None:
    """Parse the table of a slot only to check the rules of its parts; the result of parsing is dropped.

    Args:
        slot: Name of the slot.
        table: Table of the slot, with laws in place of swept numbers.
        loop: The loop, for its channels and inputs.
        measurable: Signals that sensors can measure, by name.

    Raises:
        ConfigError: A rule does not hold.
    """
    channels = loop.channels
    match slot:
        case "disturbance":
            parse_disturbances(table, channels, loop.input_names)
            parse_inputs(table, channels, loop.input_names)
        case "sensor":
            sensors = sensor_tables(table, measurable)
            parse_channels(sensors.channels, slot, channels)
            parse_signal_sensors(sensors, measurable)
        case "reference":
            parse_reference(table, channels, (UNNAMED_UNITS,) * len(channels), loop.plant.angles)
        case "wind":
            parse_winds(table)
        case _ if slot == EVENT:
            parse_events(table, channels)
        case _ if slot in (*PER_CHANNEL, ACTUATOR):
            parse_channels(table, slot, channels)
        case _:
            parse_whole(table, slot)


def check_swept_events(table: TomlTable, parameters: ParameterTable, channels: tuple[str, ...]) -> None:
    """Require that the events of a vehicle are possible for all swept values of the events and of the vehicle.

    Args:
        table: Table of the study, with laws in place of swept numbers.
        parameters: Parameters of the study, with laws in place of swept parameters.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: A rotor does not exist, or no mass may remain.
    """
    plant = parse_whole(parameters.resolved(table["plant"], "plant"), "plant")
    vehicle_events(parse_events(parameters.resolved(table[EVENT], EVENT), channels), plant.params.vehicle)


def check_expressions(parameters: ParameterTable, config: StudyTable, numbers: Mapping[str, Number]) -> None:
    """Require that numbers which follow from swept parameters are admissible for all swept values.

    Args:
        parameters: Parameters, with a law of the swept values in place of each swept parameter.
        config: Fixed tables of the study.
        numbers: Numbers of the loop by name.

    Raises:
        ConfigError: A number is not admissible.
    """
    for name, number in numbers.items():
        if number.expression and config.sweep.keys() & set(number.expression.names):
            with value_errors_at(name):
                parse_number(parameters.expression(number.expression.text), number.quantity)
