"""Parsing of ``[sensor] measures``: the signals that a study measures besides y and y', and the sensor of each."""

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
"""Entry of ``[sensor]`` with the names of the measured signals."""
WHOLE_STATE = "state"
"""Value of ``measures`` that stands for all states of a linear plant."""
USUAL_SENSOR = "ideal"
"""Default kind of all sensors in a study that measures signals besides y and y'."""
RATE_FIELDS = ("velocity", "jitter")
"""Prefixes of the sensor's fields that need the derivative of the measured signal."""


class SensorTables(NamedTuple):
    """The section ``[sensor]``, split into the sensors of y and y' and the sensors of other signals.

    Args:
        channels: Table of the sensors of y and y', with common entries and tables of channels.
        measures: Names of the other measured signals.
        signals: Table of a sensor by the name of its signal, for each measured signal that has such a table.
    """

    channels: TomlTable
    measures: tuple[str, ...]
    signals: dict[str, TomlTable]


def measurable_signals(
    plant: Plant, params: Params, outputs: Sequence[NamedSignal], channels: Sequence[str], units: Sequence[ChannelUnits]
) -> dict[str, NamedSignal]:
    """Signals that a study can measure, by name: states of a linear plant, y and y' of each channel, named outputs.

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
        order = len(plant.linear(params).a)
        for index in range(1, order + 1):
            state = state_signal(str(index))
            signals[state.name] = state
    for channel, channel_units in zip(channels, units, strict=True):
        name = f"{channel}_y" if channel else "y"
        meaning = channel_units.output_meaning
        signals[name] = NamedSignal(name, channel_units.output, meaning, periodic=channel in plant.angles)
        rate_name = f"{name}_dot"
        signals[rate_name] = NamedSignal(rate_name, channel_units.of("y/s"), f"derivative of {meaning}")
    for signal in scalar_signals(plant, outputs):
        if signal.name in signals:
            raise ConfigError(
                f"plant.outputs.{signal.name}",
                f"has the name of the {signals[signal.name].meaning}; give it another one",
            )
        signals[signal.name] = signal
    return signals


def state_signal(index: str) -> NamedSignal:
    """Signal of one state of a linear plant, by the index of the state from 1; the unit is unknown, and so empty."""
    return NamedSignal(name=f"{STATE}{index}", unit="", meaning=f"{WHOLE_STATE} {index} of the plant")


def scalar_signals(plant: Plant, outputs: Sequence[NamedSignal]) -> list[NamedSignal]:
    """Outputs of a plant as scalar signals: the scalar outputs, and the components of vectors such as ``wind_x``.

    Outputs that are tuples, such as one value for each rotor, are left out: their type does not tell their length.
    """
    types = get_type_hints(plant.info) if plant.info is not None else {}
    signals = []
    for signal in outputs:
        output_type = types.get(signal.name)
        components = getattr(output_type, "_fields", ())  # of a NamedTuple such as Vec3
        if components:
            for component in components:
                meaning = f"{signal.meaning} {component}"
                signals.append(signal._replace(name=f"{signal.name}_{component}", meaning=meaning))
        elif get_origin(output_type) is not tuple:
            signals.append(signal)
    return signals


def sensor_tables(table: TomlTable, measurable: Mapping[str, NamedSignal]) -> SensorTables:
    """Split the section ``[sensor]`` into the sensors of y and y', and the sensors of other signals.

    Args:
        table: The section.
        measurable: Signals that the study can measure, by name.

    Raises:
        ConfigError: ``measures`` is neither a list of measurable signals nor the word ``state`` for all states, or a
            signal has a table of a sensor but is not among ``measures``.
    """
    measured_names = parse_measured_names(table.get(MEASURES, []), measurable)
    signals = {name: as_table(table[name], f"sensor.{name}") for name in measured_names if name in table}
    channels = {name: value for name, value in table.items() if name != MEASURES and name not in signals}
    for name, value in channels.items():
        is_channel = f"{name}_y" in measurable
        if name in measurable and not is_channel and isinstance(value, Mapping):
            rule = f"is the sensor of a signal that is not measured; list it in {MEASURES}"
            raise ConfigError(f"sensor.{name}", rule)
    default = {"kind": USUAL_SENSOR} if measured_names else {}
    return SensorTables(default | channels, measured_names, signals)


def parse_measured_names(value: object, measurable: Mapping[str, NamedSignal]) -> tuple[str, ...]:
    """Parse the entry ``measures``: a list of signals, each once, or the word ``state`` for all states.

    Args:
        value: The entry.
        measurable: Signals that the study can measure, by name.

    Raises:
        ConfigError: The entry is neither, or a signal cannot be measured or occurs twice.
    """
    place = f"sensor.{MEASURES}"
    if value == WHOLE_STATE:
        states = [name for name in measurable if measurable[name] == state_signal(name.removeprefix(STATE))]
        if not states:
            raise ConfigError(place, "the plant has no linear part, so its state has no names")
        return tuple(states)
    if not isinstance(value, list | tuple) or not all(isinstance(name, str) for name in value):
        raise ConfigError(place, f"must be a list of signals, or '{WHOLE_STATE}', got {value!r}")
    for index, name in enumerate(value):
        if name not in measurable:
            raise ConfigError(f"{place}.{index}", f"'{name}' cannot be measured; {nearest(name, measurable)}")
        if name in value[:index]:
            raise ConfigError(f"{place}.{index}", f"'{name}' is measured already")
    return tuple(value)


def parse_signal_sensors(tables: SensorTables, measurable: Mapping[str, NamedSignal]) -> list[Component]:
    """Parse the sensor of each measured signal besides y and y'; a signal without a table has an ideal sensor.

    Args:
        tables: The section ``[sensor]``, split.
        measurable: Signals that the study can measure, by name.

    Raises:
        ConfigError: A table is not valid, or states a field that needs the signal's derivative, which is not measured.
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
        units = ChannelUnits(output=measurable[name].unit or "1")  # the signal's unit in place of the symbol y
        numbers = []
        for number in component.numbers:
            if number.name.startswith(RATE_FIELDS):
                continue
            quantity = replace(number.quantity, unit=units.of(number.quantity.unit))
            numbers.append(replace(number.under(f"signal_sensor.{index}", path), quantity=quantity))
        sensors.append(replace(component, numbers=tuple(numbers)))
    return sensors


def require_signals(controller: Controller, gains: Params, measures: Sequence[NamedSignal]) -> None:
    """Require that the study measures the signals that a controller takes.

    A controller may name its signals. Otherwise its gains determine how many signals it takes; unless this number is 0,
    the study must measure as many signals.

    Args:
        controller: Model of the controller.
        gains: Gains of the controller.
        measures: Signals that the study measures besides y and y'.

    Raises:
        ConfigError: A signal is not measured, or has another unit, or another number of signals is measured.
    """
    if controller.signals:
        require_named_signals(controller.signals, measures)
        return
    count = controller.takes(gains)  # 0: it takes y and y' alone
    if count and count != len(measures):
        names = ", ".join(signal.name for signal in measures) or "none"
        rule = f"takes {count} measured signals, and {len(measures)} are measured: {names}; list them in [sensor]"
        raise ConfigError("controller", f"{rule} {MEASURES}")


def require_named_signals(required_signals: Sequence[NamedSignal], measures: Sequence[NamedSignal]) -> None:
    """Require that the study measures each signal that a controller names, in the unit that the controller declares.

    Args:
        required_signals: Signals that the controller names.
        measures: Signals that the study measures besides y and y'.

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
        unit = measured_signals[signal.name].unit  # empty if it is unknown
        if unit and signal.unit != unit:
            rule = f"takes '{signal.name}' in {signal.unit}, and the study measures it in {unit}"
            raise ConfigError("controller", rule)
