"""A controller in C: ``init``, ``reset`` and ``step`` of a shared object, called for each draw and sample.

Its parameters are gains that may have laws. Its memory beside them is the state, as words of the size of its numbers: a
call gets the words and gives the next ones, so the controller is a pure function like any other. It computes in its own
precision, whatever the loop's.
"""

from functools import cache
from typing import Annotated, Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.contracts import Controller
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.native.allowed import loaded_native
from dssc_jax.core.native.description import NativeController
from dssc_jax.core.native.libraries import (
    NativeLibrary,
    default_values,
    initial_memory,
    parameters_without_effect,
    provide_function,
)
from dssc_jax.core.native.named_types import named_type
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import Command, Info, Measurement, Params, ReferencePoint, Scalar
from dssc_jax.core.smoothness import not_smooth
from dssc_jax.core.toml import TomlTable
from dssc_jax.lanes.foreign import ForeignFunction, MemoryPlace, call
from dssc_jax.models.controllers.nominal import L0

KIND = "library"
"""Name of the kind in a study's tables; the search for native code in a study uses it."""

FLAG = Quantity("1", "return value of the step: 0, or a number that tells why the command is not the usual one")
WITHOUT_DERIVATIVE = (
    "is native code, which has no derivative; what samples draws (run, margin, compare, falsify) needs none"
)

Words: TypeAlias = tuple[jax.Array, ...]
"""The state: the controller's memory without its parameters, in words as large as its numbers."""


class LibraryGains(NamedTuple):
    """Gains of a library before its file is loaded; the parameters that it exports are further fields."""

    l0: Annotated[Scalar, L0] = 1.0


class NativeCalls:
    """The functions of one controller of a library, in the form in which lanes call them.

    Telemetry may cost more than the command, and most flights do not record it. If the library has a step without
    telemetry, a sample therefore makes two calls, and the compiler drops the one whose results are not used.

    Args:
        library: The library.
        controller: The controller.
    """

    def __init__(self, library: NativeLibrary, controller: NativeController) -> None:
        self.library = library
        self.controller = controller
        real = np.dtype(f"f{controller.real}")
        word = np.dtype(f"u{controller.real}")
        parameters = tuple(MemoryPlace(real, number.offset) for number in controller.parameters)
        occupied = {place.offset for place in parameters}
        starts = [start for start in range(0, controller.size, controller.real) if start not in occupied]
        words = tuple(MemoryPlace(word, start) for start in starts)
        signals = tuple(MemoryPlace(real, offset) for offset in controller.inputs)
        commands = tuple(MemoryPlace(real, offset) for offset in controller.commands)
        telemetry = tuple(MemoryPlace(real, number.offset) for number in controller.telemetry)
        flag = MemoryPlace(np.dtype(np.uint32), controller.flag)
        size = controller.exchange + controller.real
        reset = provide_function(library, controller, "reset", controller.reset)
        step = provide_function(library, controller, "step", controller.step)
        self.reset = ForeignFunction(reset, size, parameters + words, words)
        operands = parameters + words + signals
        outputs = (*words, *commands, flag)
        self.step = ForeignFunction(step, size, operands, outputs + telemetry)
        self.step_without_telemetry: ForeignFunction | None = None
        quiet = controller.step_without_telemetry
        if quiet is not None:
            symbol = provide_function(library, controller, "step_without_telemetry", quiet)
            self.step_without_telemetry = ForeignFunction(symbol, size, operands, outputs)
        memory = np.append(initial_memory(controller), np.zeros(controller.real, np.uint8))
        self.begin = [memory[start : start + controller.real].view(word)[0] for start in starts]

    def values(self, gains: Params) -> list[Scalar]:
        """The values of the library's parameters, in its order."""
        return [getattr(gains, number.name) for number in self.controller.parameters]

    def call(self, function: ForeignFunction, *operands: Scalar) -> list[jax.Array]:
        """The results of a call.

        Raises:
            ConfigError: The loop's precision lacks the type of the library's numbers.
        """
        bits = 8 * self.controller.real
        if bits > 8 * jnp.result_type(float).itemsize:
            raise ConfigError("loop.precision", f"must be {bits}, the precision of {self.label}")
        return call(function, *operands)

    def sample(self, *operands: Scalar) -> list[jax.Array]:
        """The results of a sample: the words of the state, u, u_n, the flag, then the telemetry.

        Raises:
            ConfigError: The loop's precision lacks the type of the library's numbers.
        """
        results = self.call(self.step, *operands)
        if self.step_without_telemetry is not None:
            outputs = self.call(self.step_without_telemetry, *operands)
            results[: len(outputs)] = outputs
        return results

    @property
    def label(self) -> str:
        """The controller's name and file, for messages."""
        return f"the controller {self.controller.name} in {self.library.file}"


@cache
def controller_of(library: NativeLibrary, name: str) -> Controller:
    """The controller with this name in a library."""
    (controller,) = (candidate for candidate in library.controllers if candidate.name == name)
    calls = NativeCalls(library, controller)
    info = info_type(controller)

    def init(gains: Params, measurement: Measurement, reference: ReferencePoint) -> Words:
        return tuple(calls.call(calls.reset, *calls.values(gains), *calls.begin))

    def step(
        gains: Params, state: Words, measurement: Measurement, reference: ReferencePoint, dt: Scalar
    ) -> tuple[Words, Command, Info]:
        if isinstance(dt, float) and not np.isclose(dt, controller.sample_time, rtol=1e-9, atol=0.0):
            rule = f"must be {controller.sample_time:g} s, a constant of {calls.label}, got {dt:g} s"
            raise ConfigError("loop.sample_time", rule)
        signals = (measurement.y, measurement.y_dot, *reference, *measurement.signals[: len(controller.measured)])
        results = calls.sample(*calls.values(gains), *state, *signals)
        words = tuple(results[: len(state)])
        robust, nominal, flag, *telemetry = (x.astype(jnp.result_type(float)) for x in results[len(state) :])
        return words, Command(robust, nominal), info(*telemetry, flag)

    return Controller(
        gains_type(controller, default_values(controller)),
        init,
        step,
        smooth=not_smooth(WITHOUT_DERIVATIVE),
        takes=lambda gains: len(controller.measured),
        signals=named_signals(controller),
        info=info,
        native=library.file,
        without_effect=parameters_without_effect(controller),
    )


def named_signals(controller: NativeController) -> tuple[NamedSignal, ...]:
    """The measured signals that the controller reads in addition to y and y'."""
    return tuple(NamedSignal.of(number.name, number.quantity) for number in controller.measured)


def gains_type(controller: NativeController, defaults: dict[str, float]) -> Any:
    """The type of the gains: the library's parameters with its defaults, and l0 for the metrics."""
    quantities = {number.name: number.quantity for number in controller.parameters}
    return named_type("Gains", {"l0": L0} | quantities, {"l0": 1.0} | defaults)


def info_type(controller: NativeController) -> Any:
    """The type of the controller's info: its telemetry, and the flag of its step."""
    telemetry = {number.name: number.quantity for number in controller.telemetry}
    return named_type("Info", {**telemetry, "flag": FLAG}, {})


def loaded_controller(table: TomlTable) -> Controller:
    """The controller that a study's table names by file, digest and name.

    Raises:
        ConfigError: Its library is not loaded, or has no such controller.
    """
    file = table.get("file")
    library = loaded_native(table, "a shared object that dssc-jax library built")
    if not isinstance(library, NativeLibrary):
        raise ConfigError("file", f"'{file}' is an FMU; set kind = \"fmu\"")
    names = [controller.name for controller in library.controllers]
    name = table.get("name", names[0])
    if name not in names:
        raise ConfigError("name", f"'{file}' has no controller {name!r}; {nearest(str(name), names)}")
    if "name" not in table and len(names) > 1:
        raise ConfigError("name", f"is required: '{file}' has the controllers {', '.join(names)}")
    return controller_of(library, str(name))


def unloaded(reason: str) -> Controller:
    """A placeholder for native code in lists of kinds, before a file is loaded; no study gets it.

    Args:
        reason: Why the code has no derivative.
    """
    return Controller(
        LibraryGains,
        init=lambda gains, measurement, reference: (),
        step=lambda gains, state, measurement, reference, dt: (state, Command(0.0, 0.0), ()),
        smooth=not_smooth(reason),
        native="a file",
    )


LIBRARY = Entry(
    {None: unloaded(WITHOUT_DERIVATIVE)},
    "a controller in C of your own; the parameters that its file exports are further fields",
    loaded=loaded_controller,
    keys={
        "file": "shared object, relative to the study's folder; `dssc-jax library` builds one",
        "name": "which of its controllers, if it has several",
        "sha256": "digest of the file, which must match; read from the file if absent",
    },
    native=True,
)
