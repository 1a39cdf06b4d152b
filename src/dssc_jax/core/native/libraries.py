"""Shared objects with controllers in C: loading, and trial flights that detect code which cannot be analysed."""

import ctypes
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.description import CALL, NativeController, described_controllers
from dssc_jax.lanes import foreign

TRIED_SAMPLES = 64  # of a trial flight
LARGEST_SIGNAL = 1000.0  # largest signal of a trial flight
SAME_SUM = 1e-5  # largest relative difference of u_p from u + u_n
WITHOUT_EFFECT = (
    "changes no command of a trial flight: the code does not read it, keeps it outside of its structure, or the flight "
    "does not reach what it limits"
)


@dataclass(frozen=True)
class NativeLibrary:
    """A loaded shared object.

    Args:
        file: Path of the file from which the shared object was read.
        sha256: SHA-256 digest of the file's content, in hexadecimal.
        controllers: The controllers that the shared object exports.
    """

    file: str
    sha256: str
    controllers: tuple[NativeController, ...]


def loaded_library(path: Path, content: bytes, digest: str) -> NativeLibrary:
    """Load a shared object from a private copy of its content, and check its controllers by trial flights.

    Args:
        path: The file, for messages.
        content: The file's content.
        digest: SHA-256 digest of the content.

    Raises:
        ConfigError: The file cannot be loaded or describes no controller; or a controller keeps numbers outside of its
            structure, is not reset, changes its parameters, has a u_p other than u + u_n, or gives other commands
            without telemetry.
    """
    with TemporaryDirectory(prefix="dssc-jax-library-") as folder:
        copy = Path(folder) / f"{digest}.so"
        files.write_bytes(copy, content, durable=False)
        try:
            library = ctypes.CDLL(str(copy))
        except OSError as error:
            reason = str(error).replace(str(copy), path.name)
            raise ConfigError("file", f"'{path}' cannot be loaded: {reason}") from None
    try:
        controllers = described_controllers(library)
        for controller in controllers:
            require_reentrant(controller)
            require_reset(controller)
            require_parameters_kept(controller)
            require_sum(controller)
            require_same_without_telemetry(controller)
    except ConfigError as error:
        raise ConfigError("file", f"'{path}' {error.rule}") from None
    return NativeLibrary(str(path.resolve()), digest, controllers)


def symbol_of(library: NativeLibrary, controller: NativeController, function: str) -> str:
    """Return the name by which compiled lanes call a function of a controller.

    The name contains the digest of the library's content, so that compiled lanes call no other library's function.
    """
    return f"dssc_jax_{library.sha256}_{controller.name}_{function}"


def provide_function(library: NativeLibrary, controller: NativeController, function: str, address: int) -> str:
    """Register a function of a library, so that lanes can call it; return its symbol.

    Args:
        library: The library.
        controller: The controller to which the function belongs.
        function: Name of the function within the symbol.
        address: Address of the function.
    """
    symbol = symbol_of(library, controller, function)
    if symbol not in foreign.ADDRESSES:
        foreign.provide(symbol, address)
    return symbol


def initial_memory(controller: NativeController) -> np.ndarray:
    """Return a controller's exchange after ``init``, an array of bytes, shape (exchange_size,)."""
    memory = np.zeros(controller.exchange_size, np.uint8)
    CALL(controller.init)(memory.ctypes.data)
    return memory


def default_values(controller: NativeController) -> dict[str, float]:
    """Return the default of each parameter, as ``init`` sets it, by the parameter's name."""
    memory = initial_memory(controller)
    real = controller.dtype
    values: dict[str, float] = {}
    for number in controller.parameters:
        content = memory[number.offset : number.offset + controller.number_size]
        values[number.name] = float(content.view(real).item())
    return values


def require_reentrant(controller: NativeController) -> None:
    """Require that a controller keeps no numbers outside of its structure.

    Two trial flights must give the same bits whether they run one after the other or in turn, sample by sample. The
    first flight must give the same bits again when it is repeated.

    Raises:
        ConfigError: A flight gives other bits.
    """
    first = flown_commands(controller, [0])
    second = flown_commands(controller, [1])
    alternating = flown_commands(controller, [0, 1])
    repeated_first = flown_commands(controller, [0])
    if alternating != first + second or repeated_first != first:
        rule = (
            "keeps numbers outside of its structure (static or global variables, a random generator, a clock), which "
            "would mix thousands of flights; move them into its state"
        )
        raise ConfigError("", f"has a controller {controller.name} that {rule}")


def require_reset(controller: NativeController) -> None:
    """Require that ``reset`` sets the whole state: a trial flight repeated after it gives the same bits.

    Raises:
        ConfigError: The repeated flight gives other bits.
    """
    memory = initial_memory(controller)
    first = flown_with(controller, {0: memory})
    second = flown_with(controller, {0: memory})  # in the memory that the first flight has left
    if first != second:
        rule = (
            "gives other commands when a trial flight is repeated after reset, so that the second flight of this code "
            "differs from the first, which is the one analysed; let reset set the whole state"
        )
        raise ConfigError("", f"has a controller {controller.name} that {rule}")


def moved_values(controller: NativeController) -> dict[str, float]:
    """Return a value of each parameter, by name, that is admissible and differs from the parameter's default.

    Three values are tried. A parameter for which none of them is admissible is left out.
    """
    values = {}
    defaults = default_values(controller)
    for number in controller.parameters:
        default = defaults[number.name]
        for value in (1.5 * default + 0.5, 0.5 * default - 0.5, 0.5 * default):
            if value != default and number.quantity.violated_by(value, value) is None:
                values[number.name] = value
                break
    return values


def memory_with(controller: NativeController, values: dict[str, float]) -> np.ndarray:
    """Return a controller's exchange after ``init``, with the values of some parameters replaced.

    Args:
        controller: The controller.
        values: New values of these parameters by name.

    Returns:
        An array of bytes, shape (exchange_size,).
    """
    memory = initial_memory(controller)
    real = controller.dtype
    for number in controller.parameters:
        if number.name in values:
            content = np.array([values[number.name]], real).view(np.uint8)
            memory[number.offset : number.offset + controller.number_size] = content
    return memory


def require_parameters_kept(controller: NativeController) -> None:
    """Require that neither ``reset`` nor ``step`` changes a parameter, because the analysis would not see the change.

    Raises:
        ConfigError: A trial flight changes a parameter.
    """
    memory = memory_with(controller, moved_values(controller))
    before = memory.copy()
    flown_with(controller, {0: memory})
    for number in controller.parameters:
        place = slice(number.offset, number.offset + controller.number_size)
        if not np.array_equal(before[place], memory[place]):
            rule = (
                f"changes its parameter {number.name} in reset or step, so that it would fly other numbers than those "
                "analysed; let init alone set parameters"
            )
            raise ConfigError("", f"has a controller {controller.name} that {rule}")


def parameters_without_effect(controller: NativeController) -> tuple[str, ...]:
    """Return the names of the parameters whose change alters no command of a trial flight."""
    default_commands = flown_commands(controller, [0])
    names = []
    for name, value in moved_values(controller).items():
        commands = flown_with(controller, {0: memory_with(controller, {name: value})})
        if commands == default_commands:
            names.append(name)
    return tuple(names)


def flown_commands(controller: NativeController, flights: list[int]) -> list[bytes]:
    """Return the bits of all commands of trial flights with default parameters, one entry for each flight.

    Args:
        controller: The controller.
        flights: Numbers of the flights; the signals of a flight depend on its number.
    """
    return flown_with(controller, {flight: initial_memory(controller) for flight in flights})


def flown_with(
    controller: NativeController, memories: dict[int, np.ndarray], address: int | None = None
) -> list[bytes]:
    """Reset some trial flights and fly them in turn, sample by sample.

    The signals oscillate, and grow from 1/``LARGEST_SIGNAL`` to ``LARGEST_SIGNAL``, so that the commands reach limits
    as well.

    Args:
        controller: The controller.
        memories: Exchange of each flight by the flight's number, arrays of bytes, which the flights change.
        address: Address of the function that computes a sample; None: the step with telemetry.

    Returns:
        The bits of all commands of each flight.
    """
    reset = CALL(controller.reset)
    step = CALL(address or controller.step)
    for memory in memories.values():
        reset(memory.ctypes.data)
    commands = {flight: bytearray() for flight in memories}
    real = controller.dtype
    for k in range(TRIED_SAMPLES):
        for flight, memory in memories.items():
            angles = np.arange(1.0, 1.0 + len(controller.inputs)) * (0.1 * k + flight + 1.0)
            size = LARGEST_SIGNAL ** (2.0 * k / TRIED_SAMPLES - 1.0)
            signals = (size * np.cos(angles)).astype(real)
            for place, signal in zip(controller.inputs, signals, strict=True):
                memory[place : place + real.itemsize] = np.frombuffer(signal.tobytes(), np.uint8)
            step(memory.ctypes.data)
            for place in (*controller.commands, controller.total):
                commands[flight] += memory[place : place + real.itemsize].tobytes()
    return [bytes(bits) for bits in commands.values()]


def require_sum(controller: NativeController) -> None:
    """Require that the command u_p that flies is the sum u + u_n that is analysed, in every sample of a trial flight.

    Raises:
        ConfigError: u_p differs from the sum.
    """
    robust, nominal, total = trial_commands(controller).T
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.abs(robust) + np.abs(nominal)
        different = np.abs(robust + nominal - total) > SAME_SUM * size
    if different.any():
        k = int(np.argmax(different))
        rule = (
            f"has a controller {controller.name} whose u_p is not u + u_n: in a trial flight it gives u = "
            f"{robust[k]:g}, u_n = {nominal[k]:g} and u_p = {total[k]:g}. The analysis takes their sum, and u_p flies; "
            "give all three, and limit u, u_n or both so that their sum is within the limits"
        )
        raise ConfigError("", rule)


def require_same_without_telemetry(controller: NativeController) -> None:
    """Require that a trial flight has the same commands with and without telemetry.

    Raises:
        ConfigError: The commands differ.
    """
    quiet_step = controller.step_without_telemetry
    if quiet_step is None:
        return
    quiet_commands = flown_with(controller, {0: initial_memory(controller)}, quiet_step)
    if quiet_commands != flown_commands(controller, [0]):
        rule = (
            "gives other commands where it gets NULL for its telemetry; let telemetry change nothing, or define no "
            "DSSC_JAX_OPTIONAL_TELEMETRY"
        )
        raise ConfigError("", f"has a controller {controller.name} that {rule}")


def trial_commands(controller: NativeController) -> np.ndarray:
    """Return u, u_n and u_p of every sample of a trial flight with default parameters, shape (samples, 3)."""
    (bits,) = flown_commands(controller, [0])
    return np.frombuffer(bits, controller.dtype).reshape(TRIED_SAMPLES, -1).astype(float)


def samples_not_finite(controller: NativeController) -> int:
    """Count the samples of a trial flight with default parameters in which a command is not finite."""
    is_finite = np.isfinite(trial_commands(controller)).all(axis=1)
    return int(np.count_nonzero(~is_finite))
