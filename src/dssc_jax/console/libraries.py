"""Print the controllers that a library in C exports, and the lines by which a study uses it."""

from pathlib import Path
from typing import TypedDict

from dssc_jax.console.terminal import show_line, show_table
from dssc_jax.core.native.description import NativeController
from dssc_jax.core.native.libraries import (
    TRIED_SAMPLES,
    WITHOUT_EFFECT,
    NativeLibrary,
    default_values,
    parameters_without_effect,
    samples_not_finite,
)
from dssc_jax.models.controllers.library import KIND


class ParameterSummary(TypedDict):
    """A parameter of a controller.

    Args:
        default: Default value.
        unit: Unit.
        meaning: Meaning.
        admissible: Interval of the admissible values.
        default_admissible: Whether the default lies in the interval.
    """

    default: float
    unit: str
    meaning: str
    admissible: str
    default_admissible: bool


class ControllerSummary(TypedDict):
    """A controller of a library.

    Args:
        sample_time: Period between two calls [s].
        precision: Size of the controller's numbers [bit].
        bytes: Size of the state of one flight [byte].
        parameters: Parameters by name.
        measured: Units of the measured signals, by name.
        telemetry: Units of the telemetry, by name.
        samples_not_finite: Number of samples of a trial flight at which the command is not finite.
        without_effect: Parameters that change no command of a trial flight.
    """

    sample_time: float
    precision: int
    bytes: int
    parameters: dict[str, ParameterSummary]
    measured: dict[str, str]
    telemetry: dict[str, str]
    samples_not_finite: int
    without_effect: list[str]


class LibrarySummary(TypedDict):
    """A library: file, digest (SHA-256), and controllers by name."""

    file: str
    sha256: str
    controllers: dict[str, ControllerSummary]


def library_summary(library: NativeLibrary) -> LibrarySummary:
    """Describe a library and its controllers, for JSON."""
    controllers = {controller.name: controller_summary(controller) for controller in library.controllers}
    return {"file": library.file, "sha256": library.sha256, "controllers": controllers}


def controller_summary(controller: NativeController) -> ControllerSummary:
    """Describe a controller, for JSON."""
    parameters: dict[str, ParameterSummary] = {}
    for (name, default), number in zip(default_values(controller).items(), controller.parameters, strict=True):
        quantity = number.quantity
        parameters[name] = {
            "default": default,
            "unit": quantity.unit,
            "meaning": quantity.meaning,
            "admissible": quantity.interval,
            "default_admissible": quantity.violated_by(default, default) is None,
        }
    return {
        "sample_time": controller.sample_time,
        "precision": 8 * controller.number_size,
        "bytes": controller.size,
        "parameters": parameters,
        "measured": {number.name: number.quantity.unit for number in controller.measured},
        "telemetry": {number.name: number.quantity.unit for number in controller.telemetry},
        "samples_not_finite": samples_not_finite(controller),
        "without_effect": list(parameters_without_effect(controller)),
    }


def show_library(library: NativeLibrary, file: Path) -> None:
    """Print the controllers of a library with warnings, and the lines by which a study uses the library.

    Args:
        library: The library.
        file: Path of the library, for these lines.
    """
    for name, summary in library_summary(library)["controllers"].items():
        memory = f"{summary['bytes']} bytes a flight"
        show_line(f"{name}: every {summary['sample_time']:g} s, {summary['precision']} bits a number, {memory}")
        rows = []
        for parameter, number in summary["parameters"].items():
            default = f"{number['default']:g}"
            rows.append((parameter, default, number["unit"], number["meaning"], number["admissible"]))
        if rows:
            show_table(("parameter", "default", "unit", "meaning", "admissible"), rows)
        measured_signals = ", ".join(f"{signal} [{unit}]" for signal, unit in summary["measured"].items())
        if measured_signals:
            show_line(f"measured signals: {measured_signals}; a study lists them in [sensor] measures")
        reported = ", ".join(f"{field} [{unit}]" for field, unit in summary["telemetry"].items())
        show_line(f"telemetry: {reported or 'none'}")
        for parameter, number in summary["parameters"].items():
            if not number["default_admissible"]:
                default = f"the default of {parameter}, {number['default']:g}"
                show_line(f"warning: {default}, is not {number['admissible']}: a study has to state it")
        for parameter in summary["without_effect"]:
            show_line(f"warning: {parameter} {WITHOUT_EFFECT}")
        bad_samples = summary["samples_not_finite"]
        if bad_samples:
            trial = f"{bad_samples} of {TRIED_SAMPLES} samples of a trial flight with the default parameters"
            show_line(f"warning: its command is not finite in {trial}")
    show_line(f"\nin a study, run with --allow-native:\n\n[controller]\nkind = {KIND!r}\nfile = '{file}'")
    if len(library.controllers) > 1:
        show_line(f"name = '{library.controllers[0].name}'")
