"""Print warnings about a study: numbers without effect, noise, unusual vehicles, errors of integration."""

from collections.abc import Mapping

from dssc_jax.cli.output import say
from dssc_jax.closed_loop.rehearsal import faults_by_part
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.native.libraries import WITHOUT_EFFECT
from dssc_jax.core.quantities import extent
from dssc_jax.core.units import scaled_symbols
from dssc_jax.design import noise_warning, rate_warning
from dssc_jax.design.fast_records import record_warnings
from dssc_jax.design.plant_checks import plant_warnings
from dssc_jax.engine.integration import integration_error
from dssc_jax.engine.unread_numbers import unread_numbers
from dssc_jax.models.uav.parameters import UavParams
from dssc_jax.models.uav.plausibility import implausible, unusual_power
from dssc_jax.study import Described, Study
from dssc_jax.study.actuators import kind_in

DRAG_NAMES = ("plant.vehicle.structure_drag", "plant.vehicle.propeller_drag")
"""Beginnings of the names of a vehicle's drag coefficients."""


def warn_of_vehicle(study: Study) -> None:
    """Warn if a vehicle has no drag, so that wind has no effect, or numbers that multirotors usually do not have."""
    plant = study.template.plant
    if not isinstance(plant, UavParams):
        return
    vehicle = plant.vehicle
    has_wind = kind_in(study.config, "wind") != "none"
    has_swept_drag = any(name.startswith(DRAG_NAMES) for name in study.axes)
    if has_wind and not vehicle.has_drag and not has_swept_drag:
        say(
            "warning: the wind has no effect, because the vehicle has no drag: give plant.vehicle.structure_drag or "
            "propeller_drag"
        )
    table = study.config.plant.get("vehicle")
    texts = implausible(vehicle, table) if isinstance(table, dict) else []
    if plant.battery is not None:
        texts += unusual_power(vehicle, plant.battery)
    for text in texts:
        say(f"warning: {text}")


def warn_of_signals(study: Study) -> None:
    """Warn of sensors whose measured signals no controller reads.

    If a controller reads measured signals, warn of those that are exact while [sensor] is not, or the reverse.
    """
    loop = study.loop
    if not loop.measures:
        return
    for model, gains in zip(loop.controller, study.template.controller, strict=True):
        if model.takes(gains):
            warn_of_exact_signals(study)
            return
    sensors = [f"[sensor.{signal.name}]" for signal in loop.measures if signal.name in study.config.sensor]
    if sensors:
        say(
            f"warning: the controller reads y and y' through the kind of [sensor] itself; {', '.join(sensors)} act on "
            "signals that it does not read"
        )


def warn_of_exact_signals(study: Study) -> None:
    """Warn if y or y' has an exact sensor as a measured signal, and another one in [sensor], or the reverse.

    The controller reads a measured signal through its own table, [sensor.y], and the error through [sensor].
    """
    kind = kind_in(study.config, "sensor")
    if kind == "ideal":
        kind_of_y = study.config.sensor.get("y", {}).get("kind", kind)
        if kind_of_y != "ideal":
            say(
                "warning: [sensor.y] acts on y as a measured signal; the error, such as that of an integral, is read "
                "through [sensor], which is exact: give [sensor] that kind and its numbers, too"
            )
        return
    measured_names = [signal.name for signal in study.loop.measures]
    for name in ("y", "y_dot"):
        if name in measured_names and name not in study.config.sensor:
            say(
                f"warning: {name} in [sensor] measures is exact, though kind = '{kind}' of [sensor] is not: a "
                f"measured signal has its own sensor; give [sensor.{name}] that kind and its numbers"
            )


def warn_of_times(study: Study) -> None:
    """Warn of events that begin after the end of the simulation, or that may end before they begin."""
    duration = study.config.loop.duration
    for name, number in study.numbers.items():
        if not number.quantity.begins or name in study.axes:
            continue
        earliest, _ = extent(number.value)
        if earliest >= duration:
            say(f"warning: {name} = {earliest:g} s is not before the end of the loop, {duration:g} s: it never happens")
    for name, number in study.numbers.items():
        begin = study.numbers.get(f"{name.rpartition('.')[0]}.at")
        if not number.quantity.ends or begin is None or begin.expression or number.expression:
            continue
        earliest_end, _ = extent(number.value)
        _, latest_begin = extent(begin.value)
        if earliest_end < latest_begin:
            say(f"warning: {name} may be before {begin.name}: in draws with such times the event never happens")


def warn_of_idle_gains(study: Study) -> None:
    """Warn of each gain in the study that has no effect on the commands of a controller in C."""
    table = study.table["controller"]
    for channel, model in zip(study.loop.channels, study.loop.controller, strict=True):
        for gain in model.without_effect:
            is_in_study = gain in table or gain in table.get(channel, {})  # for all channels, or for this one
            if is_in_study:
                say(f"warning: the gain {gain} of {model.native} {WITHOUT_EFFECT}")


def warn_of_units(study: Study) -> None:
    """Warn of parameters whose unit is a multiple of an SI unit, because formulas take their numbers unconverted."""
    for name in study.parameter_names:
        unit = study.numbers[name].quantity.unit
        for symbol, (factor, base) in scaled_symbols(unit).items():
            size = f"in formulas in SI units, 1 {symbol} is {factor:g} {base}"
            say(f"warning: {name} has the unit {unit}, which is a label; its numbers are taken as they are, and {size}")


def warn_of_study(study: Study) -> None:
    """Warn of numbers without effect, of unusual units and vehicles, and of noise, rates or sensors that mislead.

    There are no warnings about a study whose code is not imported. They were printed where its draws were computed.

    Raises:
        ConfigError: A function of a user's part raises an exception.
    """
    if isinstance(study, Described):
        return
    with faults_by_part(study.loop):
        unread_names = unread_numbers(study)
        texts = [noise_warning(study), rate_warning(study), *plant_warnings(study), *record_warnings(study)]
    for name in unread_names:
        say(f"warning: {name} is uncertain, and no result depends on it: the code of this part does not read it")
    warn_of_idle_gains(study)
    for name in study.unused_parameters():
        say(f"warning: {name} is named by nothing in the study, so that it has no effect")
    warn_of_units(study)
    warn_of_vehicle(study)
    warn_of_signals(study)
    warn_of_times(study)
    for text in texts:
        if text is not None:
            say(f"warning: {text}")


def checked_integration(study: Study) -> JsonObject | None:
    """Estimate the error of integration between the samples, as JSON; None if the study's code is not imported."""
    return None if isinstance(study, Described) else integration_error(study).to_dict()


def warn_of_integration(integration: Mapping[str, object] | None) -> None:
    """Print the warning of a check of the integration, if it has one.

    Args:
        integration: Result of :func:`checked_integration`; None if there was no check.
    """
    if integration and integration["warning"]:
        say(f"warning: {integration['warning']}")
