"""All parts of a loop, parsed from the tables of a study, and the rules between the parts."""

from collections.abc import Sequence
from dataclasses import replace

from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.quantities import extent
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits
from dssc_jax.study.components import Component
from dssc_jax.study.measures import require_signals
from dssc_jax.study.numbers import dotted_name
from dssc_jax.study.schema import LoopTable
from dssc_jax.study.slots import (
    PER_CHANNEL,
    parse_channels,
    parse_disturbances,
    parse_inputs,
    parse_reference,
    parse_whole,
    parse_winds,
    with_units,
)


def parse_plant(table: TomlTable, clock: LoopTable) -> Component:
    """Parse the plant, and check that its software on board can run at the study's clock.

    Raises:
        ConfigError: The table is not valid, or the software cannot run at this clock.
    """
    plant = parse_whole(table, "plant")
    if plant.model.software is not None:
        with errors_under("plant"):
            plant.model.software.check_clock(plant.params, clock.sample_time, clock.substeps)
    return plant


def parse_single_parts(
    tables: TomlTable, plant: Component, channels: tuple[str, ...], units: tuple[ChannelUnits, ...]
) -> dict[str, Component]:
    """Parse the parts that a loop has once: reference and wind, besides the plant.

    Args:
        tables: Table of each slot.
        plant: The plant, parsed.
        channels: Names of the channels; one empty name for a plant with one channel.
        units: Units and meanings of each channel.

    Returns:
        Plant, reference and wind by slot.

    Raises:
        ConfigError: A table is not valid, or a plant that does not fly has a wind.
    """
    parts = {
        "plant": plant,
        "reference": parse_reference(tables["reference"], channels, units, plant.model.angles),
        "wind": parse_winds(tables["wind"]),
    }
    if len(channels) == 1:
        if parts["wind"].kind != "none":
            raise ConfigError("wind.kind", f"the plant '{plant.kind}' does not fly; use a disturbance")
        parts["plant"] = with_units(plant, units[0])
    return parts


def parse_columns(
    tables: TomlTable, inputs: Sequence[NamedSignal], channels: tuple[str, ...], units: tuple[ChannelUnits, ...]
) -> dict[str, list[Component]]:
    """Parse the parts that a loop has once for each channel, and the disturbance of each named input.

    Args:
        tables: Table of each slot.
        inputs: Named disturbance inputs of the plant.
        channels: Names of the channels; one empty name for a plant with one channel.
        units: Units and meanings of each channel.

    Returns:
        The part of each channel by slot, and under ``inputs`` the disturbance of each named input.

    Raises:
        ConfigError: A table is not valid.
    """
    input_names = [signal.name for signal in inputs]
    columns = {}
    for slot in PER_CHANNEL:
        if slot == "disturbance":
            parts = parse_disturbances(tables[slot], channels, input_names)
        else:
            parts = parse_channels(tables[slot], slot, channels)
        columns[slot] = [with_units(part, unit) for part, unit in zip(parts, units, strict=True)]
    columns["inputs"] = []
    disturbances = parse_inputs(tables["disturbance"], channels, input_names)
    for part, signal in zip(disturbances, inputs, strict=True):
        units_of_input = units[0]._replace(command=signal.unit or UNNAMED_UNITS.command)
        columns["inputs"].append(with_units(part, units_of_input))
    return columns


def require_controllers(
    controllers: Sequence[Component], channels: Sequence[str], measures: tuple[NamedSignal, ...]
) -> None:
    """Require that each controller gets the measured signals that it takes, and has the gain l0.

    Raises:
        ConfigError: A controller lacks a signal, or has no l0.
    """
    for part in controllers:
        require_signals(part.model, part.params, measures)
    for channel, part in zip(channels, controllers, strict=True):
        if "l0" not in part.params._fields:
            rule = "the gains need the field l0, which defines sigma = e' + l0 e"
            raise ConfigError(dotted_name("controller", channel), rule)


def with_bounded_jitter(sensors: Sequence[Component], channels: Sequence[str], sample_time: float) -> list[Component]:
    """Limit the jitter of sensors to the sample time [s], also in sweeps and margins.

    Raises:
        ConfigError: A jitter may exceed the sample time.
    """
    bounded_sensors = []
    for sensor, channel in zip(sensors, channels, strict=True):
        jitter = getattr(sensor.params, "jitter", None)
        longest = 0.0 if jitter is None else extent(jitter)[1]
        if longest > sample_time:
            rule = f"must be <= loop.sample_time = {sample_time:g} s, got up to {longest:g} s"
            raise ConfigError(dotted_name("sensor", channel, "jitter"), rule)
        numbers = []
        for number in sensor.numbers:
            if number.name.endswith(".jitter"):
                number = replace(number, quantity=replace(number.quantity, at_most=sample_time))
            numbers.append(number)
        bounded_sensors.append(replace(sensor, numbers=tuple(numbers)))
    return bounded_sensors
