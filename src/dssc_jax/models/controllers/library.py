"""A controller in C: ``init``, ``reset`` and ``step`` of a shared object, called for each draw and sample.

The controller's parameters are gains that may have laws. The rest of its memory is the state, kept as words of the size
of the controller's numbers. A call gets the words and gives the next ones, so that the controller is a pure function
like any other. It computes in its own precision, whatever the precision of the loop.
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
from dssc_jax.lanes.foreign import ForeignFunction, MemoryPlace
from dssc_jax.lanes.foreign import call as call_foreign
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
    """Gains of a library whose file is not loaded yet; the parameters that the file exports are further fields."""

    l0: Annotated[Scalar, L0] = 1.0


class MemoryLayout(NamedTuple):
    """Places of a controller's numbers in the exchange, the memory that the controller's functions get.

    Args:
        parameters: The parameters.
        words: The state: all memory of the controller beside the parameters, in words as large as its numbers.
        signals: The signals that a step reads.
        commands: u and u_n, which a step writes.
        flag: The flag that a step returns.
        telemetry: The telemetry that a step writes.
    """

    parameters: tuple[MemoryPlace, ...]
    words: tuple[MemoryPlace, ...]
    signals: tuple[MemoryPlace, ...]
    commands: tuple[MemoryPlace, ...]
    flag: MemoryPlace
    telemetry: tuple[MemoryPlace, ...]


def memory_layout(controller: NativeController) -> MemoryLayout:
    """Find the places of a controller's numbers, from the offsets in its description."""
    real = controller.dtype
    word = np.dtype(f"u{controller.number_size}")
    parameter_offsets = [number.offset for number in controller.parameters]
    words = []
    for offset in range(0, controller.size, controller.number_size):
        if offset not in parameter_offsets:
            words.append(MemoryPlace(word, offset))
    return MemoryLayout(
        parameters=tuple(MemoryPlace(real, offset) for offset in parameter_offsets),
        words=tuple(words),
        signals=tuple(MemoryPlace(real, offset) for offset in controller.inputs),
        commands=tuple(MemoryPlace(real, offset) for offset in controller.commands),
        flag=MemoryPlace(np.dtype(np.uint32), controller.flag),
        telemetry=tuple(MemoryPlace(real, number.offset) for number in controller.telemetry),
    )


def words_after_init(controller: NativeController, layout: MemoryLayout) -> list[Scalar]:
    """The state that the library's ``init`` leaves, word by word.

    Args:
        controller: The controller.
        layout: Places of its numbers.
    """
    padding = np.zeros(controller.number_size, np.uint8)  # the last word may end after the exchange
    memory = np.append(initial_memory(controller), padding)
    words = []
    for word, start in layout.words:
        (value,) = memory[start : start + word.itemsize].view(word)
        words.append(value)
    return words


class NativeCalls:
    """The functions of one controller of a library, in the form in which lanes call them.

    Telemetry may cost more than the command, and most flights do not record it. If the library has a step without
    telemetry, a sample therefore makes two calls, and the compiler drops the one whose results are not used.

    Args:
        library: The library.
        controller: The controller.
    """

    def __init__(self, library: NativeLibrary, controller: NativeController) -> None:
        """Make the functions known to lanes, with the places of their operands and results."""
        self.library = library
        self.controller = controller
        layout = memory_layout(controller)
        self.initial_words = words_after_init(controller, layout)
        self.reset = self.foreign_function("reset", controller.reset, layout.parameters + layout.words, layout.words)
        operands = layout.parameters + layout.words + layout.signals
        outputs = (*layout.words, *layout.commands, layout.flag)
        self.step = self.foreign_function("step", controller.step, operands, outputs + layout.telemetry)
        self.step_without_telemetry: ForeignFunction | None = None
        quiet_step = controller.step_without_telemetry
        if quiet_step is not None:
            name = "step_without_telemetry"
            self.step_without_telemetry = self.foreign_function(name, quiet_step, operands, outputs)

    def foreign_function(
        self, name: str, address: int, operands: tuple[MemoryPlace, ...], results: tuple[MemoryPlace, ...]
    ) -> ForeignFunction:
        """Make one function of the library, whose code is at an address, known to lanes.

        Args:
            name: Name of the function, such as ``step``.
            address: Address of its code.
            operands: Places of the numbers that it reads.
            results: Places of the numbers that it writes.
        """
        symbol = provide_function(self.library, self.controller, name, address)
        size = self.controller.exchange_size + self.controller.number_size  # the last word may end after the exchange
        return ForeignFunction(symbol, size, operands, results)

    def parameter_values(self, gains: Params) -> list[Scalar]:
        """The values of the library's parameters, in its order."""
        return [getattr(gains, number.name) for number in self.controller.parameters]

    def call(self, function: ForeignFunction, *operands: Scalar) -> list[jax.Array]:
        """Call a function of the library for one draw, and return its results in the order of their places.

        Raises:
            ConfigError: The loop's precision lacks the type of the library's numbers.
        """
        bits = 8 * self.controller.number_size
        if bits > 8 * jnp.result_type(float).itemsize:
            raise ConfigError("loop.precision", f"must be {bits}, the precision of {self.label}")
        return call_foreign(function, *operands)

    def sample(self, *operands: Scalar) -> list[jax.Array]:
        """Compute one sample: return the words of the state, u, u_n, the flag, and then the telemetry.

        If the library has a step without telemetry, everything but the telemetry comes from that step.

        Args:
            operands: The parameters, the words of the state and the signals.

        Raises:
            ConfigError: The loop's precision lacks the type of the library's numbers.
        """
        results = self.call(self.step, *operands)
        if self.step_without_telemetry is not None:
            outputs = self.call(self.step_without_telemetry, *operands)
            results[: len(outputs)] = outputs  # the telemetry alone remains from the full step
        return results

    @property
    def label(self) -> str:
        """The controller's name and file, for messages."""
        return f"the controller {self.controller.name} in {self.library.file}"


@cache
def controller_of(library: NativeLibrary, name: str) -> Controller:
    """The model of a library's controller, by the controller's name; the library must have it.

    Args:
        library: The library.
        name: Name of the controller.
    """
    controller = next(candidate for candidate in library.controllers if candidate.name == name)
    calls = NativeCalls(library, controller)
    info = info_type(controller)

    def init(gains: Params, measurement: Measurement, reference: ReferencePoint) -> Words:
        """The state after ``init`` and ``reset`` with the draw's parameters."""
        return tuple(calls.call(calls.reset, *calls.parameter_values(gains), *calls.initial_words))

    def step(
        gains: Params, state: Words, measurement: Measurement, reference: ReferencePoint, dt: Scalar
    ) -> tuple[Words, Command, Info]:
        """One sample; raises ConfigError if T_s is not the sample time for which the C was written."""
        if isinstance(dt, float) and not np.isclose(dt, controller.sample_time, rtol=1e-9, atol=0.0):
            rule = f"must be {controller.sample_time:g} s, a constant of {calls.label}, got {dt:g} s"
            raise ConfigError("loop.sample_time", rule)
        signals = (measurement.y, measurement.y_dot, *reference, *measurement.signals[: len(controller.measured)])
        results = calls.sample(*calls.parameter_values(gains), *state, *signals)
        words = tuple(results[: len(state)])
        numbers = [result.astype(jnp.result_type(float)) for result in results[len(state) :]]
        robust, nominal, flag, *telemetry = numbers
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
    """Make the NamedTuple type of the gains: the library's parameters with its defaults, and l0 for the metrics.

    Args:
        controller: The description of the controller in the library.
        defaults: Default of each parameter by name.
    """
    quantities = {number.name: number.quantity for number in controller.parameters}
    return named_type("Gains", {"l0": L0} | quantities, {"l0": 1.0} | defaults)


def info_type(controller: NativeController) -> Any:
    """Make the NamedTuple type of the controller's report: its telemetry, and the flag of its step."""
    telemetry = {number.name: number.quantity for number in controller.telemetry}
    return named_type("Info", {**telemetry, "flag": FLAG}, {})


def loaded_controller(table: TomlTable) -> Controller:
    """The controller that a study's table names by file, digest and name; without a name, the library's only one.

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
    """Make the placeholder for native code in lists of kinds, where no file is loaded; no study gets it.

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
