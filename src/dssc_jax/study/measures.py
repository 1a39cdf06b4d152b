"""Parsing of ``[sensor] measures``: the signals that are measured besides y and y', and a sensor for each."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, get_origin, get_type_hints

from dssc_jax.closed_loop.readings import STATE
from dssc_jax.core.contracts import Controller, Plant
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.signals import Params
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.units import ChannelUnits
from dssc_jax.models.sensors import SENSORS
from dssc_jax.study.components import Component, as_table, parse_component

MEASURES = "measures"
WHOLE_STATE = "state"
"""Value of ``measures`` that stands for all states of a linear plant."""
USUAL_SENSOR = "ideal"
"""Default kind of all sensors in a study that measures further signals."""
RATE_FIELDS = ("velocity", "jitter")
"""Prefixes of the sensor's fields that need the derivative of the measured signal."""


class SensorTables(NamedTuple):
    """The section ``[sensor]``, split.

    Args:
        channels: Table of the sensors of y and y'.
        measures: Names of the other measured signals.
        signals: Table of the sensor of each measured signal that has one.
    """

    channels: TomlTable
    measures: tuple[str, ...]
    signals: dict[str, TomlTable]


def measurable_signals(
    plant: Plant, params: Params, outputs: Sequence[NamedSignal], channels: Sequence[str], units: Sequence[ChannelUnits]
) -> dict[str, NamedSignal]:
    """Signals that a study can measure, by name: the state of a linear plant, y and y' of each channel, and outputs.

    Args:
        plant: Model of the plant.
        params: Parameters of the plant.
        outputs: Named outputs of the plant.
        channels: Names of the channels; one empty name for a plant with one channel.
        units: Units and meanings of each channel.

    Raises:
        ConfigError: An output has the name of another signal.
    """
    signals = {}
    if plant.linear is not None:
        for index in range(1, len(plant.linear(params).a) + 1):
            state = state_signal(str(index))
            signals[state.name] = state
    for channel, channel_units in zip(channels, units, strict=True):
        prefix = f"{channel}_" if channel else ""
        signals[f"{prefix}y"] = NamedSignal(
            f"{prefix}y", channel_units.output, channel_units.output_meaning, periodic=channel in plant.angles
        )
        rate = channel_units.of("y/s")
        signals[f"{prefix}y_dot"] = NamedSignal(f"{prefix}y_dot", rate, f"derivative of {channel_units.output_meaning}")
    for signal in scalar_signals(plant, outputs):
        if signal.name in signals:
            raise ConfigError(
                f"plant.outputs.{signal.name}",
                f"has the name of the {signals[signal.name].meaning}; give it another one",
            )
        signals[signal.name] = signal
    return signals


def state_signal(index: str) -> NamedSignal:
    """Signal of one state of a linear plant, whose unit is unknown; the index counts from 1."""
    return NamedSignal(f"{STATE}{index}", "", f"{WHOLE_STATE} {index} of the plant")


def scalar_signals(plant: Plant, outputs: Sequence[NamedSignal]) -> list[NamedSignal]:
    """Outputs of a plant as scalar signals: the scalar outputs, and the components of vectors such as ``wind_x``.

    Tuples, such as one value for each rotor, are left out, since their type does not tell their length.
    """
    types = get_type_hints(plant.info) if plant.info is not None else {}
    signals = []
    for signal in outputs:
        kind = types.get(signal.name)
        fields = getattr(kind, "_fields", ())
        if not fields and get_origin(kind) is not tuple:
            signals.append(signal)
        for field in fields:
            meaning = f"{signal.meaning} {field}"
            signals.append(signal._replace(name=f"{signal.name}_{field}", meaning=meaning))
    return signals


def sensor_tables(table: TomlTable, measurable: Mapping[str, NamedSignal]) -> SensorTables:
    """Split the section ``[sensor]`` into the sensors of y and y', and those of other signals.

    Args:
        table: The section.
        measurable: Signals that the study can measure, by name.

    Raises:
        ConfigError: ``measures`` is neither a list of such signals nor the word ``state`` for all states, or a signal
            has a sensor but is not listed.
    """
    measured_names = table.get(MEASURES, [])
    if measured_names == WHOLE_STATE:
        measured_names = [name for name in measurable if measurable[name] == state_signal(name.removeprefix(STATE))]
        if not measured_names:
            raise ConfigError(f"sensor.{MEASURES}", "the plant has no linear part, so its state has no names")
    if not isinstance(measured_names, list | tuple) or not all(isinstance(name, str) for name in measured_names):
        rule = f"must be a list of signals, or '{WHOLE_STATE}', got {measured_names!r}"
        raise ConfigError(f"sensor.{MEASURES}", rule)
    for index, name in enumerate(measured_names):
        if name not in measurable:
            rule = f"'{name}' cannot be measured; {nearest(name, measurable)}"
            raise ConfigError(f"sensor.{MEASURES}.{index}", rule)
        if name in measured_names[:index]:
            raise ConfigError(f"sensor.{MEASURES}.{index}", f"'{name}' is measured already")
    signals = {name: as_table(table[name], f"sensor.{name}") for name in measured_names if name in table}
    channels = {name: value for name, value in table.items() if name != MEASURES and name not in signals}
    for name, value in channels.items():
        is_channel = f"{name}_y" in measurable
        if name in measurable and not is_channel and isinstance(value, Mapping):
            rule = f"is the sensor of a signal that is not measured; list it in {MEASURES}"
            raise ConfigError(f"sensor.{name}", rule)
    default = {"kind": USUAL_SENSOR} if measured_names else {}
    return SensorTables(default | channels, tuple(measured_names), signals)


def parse_signal_sensors(tables: SensorTables, measurable: Mapping[str, NamedSignal]) -> list[Component]:
    """Parse the sensor of each measured signal besides y and y'; one without a table is ideal.

    Raises:
        ConfigError: A table is not valid, or states a field that needs the derivative of the signal.
    """
    sensors = []
    for index, name in enumerate(tables.measures):
        table = tables.signals.get(name, {"kind": USUAL_SENSOR})
        path = f"sensor.{name}"
        component = parse_component(table, SENSORS, path)
        for field in table:
            if field.startswith(RATE_FIELDS):
                rule = "needs the signal's derivative, which is measured of y alone; leave it out"
                raise ConfigError(f"{path}.{field}", rule)
        units = ChannelUnits(output=measurable[name].unit or "1")
        numbers = []
        for number in component.numbers:
            if not number.name.startswith(RATE_FIELDS):
                quantity = replace(number.quantity, unit=units.of(number.quantity.unit))
                numbers.append(replace(number.under(f"signal_sensor.{index}", path), quantity=quantity))
        sensors.append(replace(component, numbers=tuple(numbers)))
    return sensors


def require_signals(controller: Controller, gains: Params, measures: Sequence[NamedSignal]) -> None:
    """Require that the study measures the signals that a controller takes, by name, or else by number.

    Raises:
        ConfigError: It does not.
    """
    if controller.signals:
        require_named_signals(controller.signals, measures)
        return
    count = controller.takes(gains)
    if count and count != len(measures):
        names = ", ".join(signal.name for signal in measures) or "none"
        rule = f"takes {count} measured signals, and {len(measures)} are measured: {names}; list them in [sensor]"
        raise ConfigError("controller", f"{rule} {MEASURES}")


def require_named_signals(required_signals: Sequence[NamedSignal], measures: Sequence[NamedSignal]) -> None:
    """Require that the study measures signals in the unit in which a controller takes them.

    Raises:
        ConfigError: A signal is not measured, or has another unit.
    """
    measured_signals = {signal.name: signal for signal in measures}
    for signal in required_signals:
        if signal.name not in measured_signals:
            rule = f"takes the measured signal '{signal.name}', which is not in [sensor] {MEASURES}: list it there"
            if measured_signals:
                rule += f", or name it in the code as the study does; {nearest(signal.name, measured_signals)}"
            raise ConfigError("controller", rule)
        unit = measured_signals[signal.name].unit
        if unit and signal.unit != unit:
            rule = f"takes '{signal.name}' in {signal.unit}, and the study measures it in {unit}"
            raise ConfigError("controller", rule)
