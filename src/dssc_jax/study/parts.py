"""All parts of a loop, parsed from the tables of a study, and the rules between the parts."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from pydantic import ValidationError

from dssc_jax.closed_loop.loop import Loop, LoopParams, Settled
from dssc_jax.core.contracts import Plant
from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.quantities import extent
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits
from dssc_jax.study.actuators import section_of
from dssc_jax.study.components import Component, as_table
from dssc_jax.study.events import (
    CHANNEL_EVENTS,
    EVENT,
    StudyEvent,
    events_of,
    vehicle_events,
    with_channel_events,
)
from dssc_jax.study.fitting import fitted_controllers
from dssc_jax.study.laws import nominal_params
from dssc_jax.study.measures import measurable_signals, parse_signal_sensors, require_signals, sensor_tables
from dssc_jax.study.numbers import Number, dotted_name
from dssc_jax.study.parameters import ParameterTable
from dssc_jax.study.schema import LoopTable, StudyTable, UnitsTable
from dssc_jax.study.slots import (
    PER_CHANNEL,
    SLOTS,
    is_flight,
    parse_channels,
    parse_disturbances,
    parse_inputs,
    parse_reference,
    parse_whole,
    parse_winds,
    with_units,
)
from dssc_jax.study.table_errors import first_error
from dssc_jax.study.tables import common_table

DECLARATION_OF_FLIGHT = "a Plant of your own that reads `drive.wind` declares `flies=True` (docs/extending.md)"


class LoopParts(NamedTuple):
    """All parts of a loop, parsed.

    Args:
        shared_parts: Plant, reference and wind, by slot.
        repeated_parts: Parts that a loop may have several times, by slot. Most slots have a part for each channel. The
            slot ``events`` has the events of the vehicle, ``inputs`` the disturbance at each named input, and
            ``signal_sensor`` the sensor of each measured signal besides y and y'.
        channels: Names of the channels; one empty name for a plant with one channel.
        units: Units and meanings of each channel.
        inputs: Named disturbance inputs of the plant.
        outputs: Named outputs of the plant.
        measurable: Signals that sensors can measure, by name.
        measures: Signals that the study measures besides y and y'.
        events: Events of the study; they are also among the parts of the vehicle, of sensors or of commands.
    """

    shared_parts: dict[str, Component]
    repeated_parts: dict[str, list[Component]]
    channels: tuple[str, ...]
    units: tuple[ChannelUnits, ...]
    inputs: tuple[NamedSignal, ...]
    outputs: tuple[NamedSignal, ...]
    measurable: dict[str, NamedSignal]
    measures: tuple[NamedSignal, ...]
    events: list[StudyEvent]

    def loop(self, config: StudyTable) -> Loop:
        """Make the loop: the models of all parts in their slots, and the clock of the study."""
        has_events = bool(self.repeated_parts["events"])
        rotors = self.shared_parts["plant"].params.vehicle.rotors if has_events else 0  # 0: not needed
        return Loop(
            **{slot: part.model for slot, part in self.shared_parts.items()},
            **{slot: tuple(part.model for part in parts) for slot, parts in self.repeated_parts.items()},
            channels=self.channels,
            measures=self.measures,
            input_names=tuple(signal.name for signal in self.inputs),
            outputs=self.outputs,
            rotors=rotors,
            **time_fields(config),
        )

    @property
    def template(self) -> LoopParams:
        """Parameters of all parts in their slots; the leaves are numbers, laws and expressions."""
        return LoopParams(
            **{slot: part.params for slot, part in self.shared_parts.items()},
            **{slot: tuple(part.params for part in parts) for slot, parts in self.repeated_parts.items()},
        )

    @property
    def numbers(self) -> list[Number]:
        """Records of the numbers of all parts; a number that channels share has a record for each channel."""
        parts = list(self.shared_parts.values())
        for parts_of_slot in self.repeated_parts.values():
            parts += parts_of_slot
        records: list[Number] = []
        for part in parts:
            records += part.numbers
        return records


def parse_parts(config: StudyTable, parameters: ParameterTable) -> LoopParts:
    """Parse all parts of a loop, and check that they fit together.

    A slot is a place for parts, such as ``plant`` or ``controller``. Some slots have one part that serves the whole
    loop. The other slots have several parts, mostly one for each channel.

    Args:
        config: Tables of the study, one for each slot.
        parameters: Parameters of the study, which expressions in the tables may name.

    Returns:
        The parts, with the loop's channels, signals and units.

    Raises:
        ConfigError: A table is not valid, or parts do not fit together.
    """
    # the table of each slot, with parsed expressions of the parameters
    tables = {slot: parameters.resolved(getattr(config, section_of(config, slot)), slot) for slot in SLOTS}
    parameters.resolved(config.compare, "compare")  # raises if an expression is not valid; a comparison reads it later
    # the plant, which tells the channels; then the other shared parts
    plant = parse_plant(tables["plant"], config.loop)
    channels = plant.model.channels or ("",)  # the only channel of a plant with one has no name
    units = parse_units(config.units, plant.model, channels)
    shared_parts = parse_shared_parts(tables, plant, channels, units)
    # the signals that the plant takes and reports, and those that sensors measure
    inputs = plant.model.inputs(plant.params) if plant.model.inputs else ()
    outputs = plant.model.reported(plant.params)
    measurable = measurable_signals(plant.model, nominal_params(plant.params), outputs, channels, units)
    sensors = sensor_tables(tables["sensor"], measurable)
    measures = tuple(measurable[name] for name in sensors.measures)
    # the repeated parts; controllers with a fit are fitted to this plant
    repeated_parts = parse_repeated_parts({**tables, "sensor": sensors.channels}, inputs, channels, units)
    repeated_parts["signal_sensor"] = parse_signal_sensors(sensors, measurable)
    sample_time = config.loop.sample_time
    repeated_parts["controller"] = fitted_controllers(
        repeated_parts["controller"], plant, channels, sample_time, measures
    )
    require_controllers(repeated_parts["controller"], channels, measures)
    repeated_parts["sensor"] = with_bounded_jitter(repeated_parts["sensor"], channels, sample_time)
    # events: of each channel, then of the vehicle
    events = events_of(parameters.resolved(config.event, EVENT), plant, channels)
    for slot in CHANNEL_EVENTS:
        repeated_parts[slot] = with_channel_events(repeated_parts[slot], events, channels, slot)
    repeated_parts["events"] = list(vehicle_events(events, plant.params.vehicle)) if events else []
    return LoopParts(
        shared_parts=shared_parts,
        repeated_parts=repeated_parts,
        channels=channels,
        units=units,
        inputs=inputs,
        outputs=outputs,
        measurable=measurable,
        measures=measures,
        events=events,
    )


def parse_plant(table: TomlTable, clock: LoopTable) -> Component:
    """Parse the plant, and check that the software on board, if there is any, can run at the study's clock.

    Args:
        table: Table of the plant.
        clock: Duration and sampling of the study.

    Raises:
        ConfigError: The table is not valid, or the software cannot run at this clock.
    """
    plant = parse_whole(table, "plant")
    if plant.model.software is not None:
        with errors_under("plant"):
            plant.model.software.check_clock(plant.params, clock.sample_time, clock.substeps)
    return plant


def parse_shared_parts(
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
        ConfigError: A table is not valid, or a plant that does not fly has a wind or the trajectory of a vehicle.
    """
    parts = {
        "plant": plant,
        "reference": parse_reference(tables["reference"], channels, units, plant.model.angles),
        "wind": parse_winds(tables["wind"]),
    }
    if not plant.model.flies:
        is_users_plant = ":" in plant.kind
        declaration = f"; {DECLARATION_OF_FLIGHT}" if is_users_plant else ""
        if parts["wind"].kind != "none":
            raise ConfigError("wind.kind", f"the plant '{plant.kind}' does not fly; use a disturbance{declaration}")
        if len(channels) > 1 and is_flight(tables["reference"], channels):
            rule = f"is a vehicle's, and the plant '{plant.kind}' does not fly; give a channel its own, such as"
            raise ConfigError("reference", f"{rule} [reference.{channels[0]}]{declaration}")
    if len(channels) == 1:
        parts["plant"] = with_units(plant, units[0])
    return parts


def parse_repeated_parts(
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
    repeated_parts = {}
    for slot in PER_CHANNEL:
        if slot == "disturbance":
            parts = parse_disturbances(tables[slot], channels, input_names)
        else:
            parts = parse_channels(tables[slot], slot, channels)
        repeated_parts[slot] = [with_units(part, unit) for part, unit in zip(parts, units, strict=True)]
    repeated_parts["inputs"] = []
    disturbances = parse_inputs(tables["disturbance"], channels, input_names)
    for part, signal in zip(disturbances, inputs, strict=True):
        units_of_input = units[0]._replace(command=signal.unit or UNNAMED_UNITS.command)  # for the symbol u
        repeated_parts["inputs"].append(with_units(part, units_of_input))
    return repeated_parts


def require_controllers(
    controllers: Sequence[Component], channels: Sequence[str], measures: tuple[NamedSignal, ...]
) -> None:
    """Require that each controller gets the measured signals that it takes, and that its gains have the error pole l0.

    The error pole defines sigma = e' + l0 e.

    Args:
        controllers: Controller of each channel, parsed.
        channels: Names of the channels; one empty name for a plant with one channel.
        measures: Signals that the study measures besides y and y'.

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
    """Bound the jitter of each sensor by the sample time; the bound also holds in sweeps and margins.

    Args:
        sensors: Sensor of each channel, parsed.
        channels: Names of the channels; one empty name for a plant with one channel.
        sample_time: Sample time T_s [s].

    Raises:
        ConfigError: A jitter may exceed the sample time.
    """
    bounded_sensors = []
    for sensor, channel in zip(sensors, channels, strict=True):
        jitter = getattr(sensor.params, "jitter", None)
        if jitter is not None:
            _, longest = extent(jitter)
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


def parse_units(table: TomlTable, plant: Plant, channels: tuple[str, ...]) -> tuple[ChannelUnits, ...]:
    """Units and meanings of each channel: the plant's, overridden by ``[units]``, then by ``[units.CHANNEL]``.

    Args:
        table: The section ``[units]``.
        plant: Model of the plant.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: An entry is unknown or not valid.
    """
    units_of_plant = plant.units or (UNNAMED_UNITS,) * len(channels)
    common = common_table(table, channels)
    valid_names = [*UnitsTable.model_fields, *filter(None, channels)]
    channel_units = []
    for units, channel in zip(units_of_plant, channels, strict=True):
        place = dotted_name("units", channel) if channel in table else "units"
        with errors_under(place):
            overrides = as_table(table.get(channel, {}))
            try:
                changes = UnitsTable.model_validate(common | overrides).model_dump(exclude_none=True)
            except ValidationError as error:
                raise first_error(error, valid_names) from None
        channel_units.append(units._replace(**changes))
    return tuple(channel_units)


def time_fields(config: StudyTable) -> TomlTable:
    """Fields of ``Loop`` that concern time: sampling, integration, and the rule that ends a settled draw early."""
    loop = config.loop
    return {
        "sample_time": loop.sample_time,
        "steps": loop.steps,
        "substeps": loop.substeps,
        "integrator": Integrator(loop.integrator),
        "settled": Settled(**loop.settled.model_dump()) if loop.settled else None,
    }
