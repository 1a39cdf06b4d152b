"""The controllers that a shared object exports, read from their description in the layout of ``dssc_jax_library.h``.

The *exchange* is the memory of a call. It contains the controller's structure, then the signals, commands, telemetry
and flag. *Places* are offsets in the exchange [bytes].
"""

import ctypes
import math
from dataclasses import dataclass, replace

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity

SYMBOL = "dssc_jax_controllers"
"""The one symbol that a library must export."""

VERSION = 4  # of the layout
MOST_CONTROLLERS = 64  # of a library
MOST_NUMBERS = 256  # of a table
MOST_BYTES = 1 << 16  # of the exchange
TINY = float(np.finfo(np.float32).tiny)
"""A positive lower limit that is not larger than this stands for "above 0"."""

SIGNALS = 5
"""Number of signals that every controller gets: y, y', y_m, y_m', y_m''."""
MEASUREMENT = 2
"""Number of these signals that are measured: y and y'."""
COMMANDS = 2  # u and u_n
RESERVED = ("kind", "file", "name", "sha256", "flag")
"""Names that no parameter or telemetry value may have: entries of a study's table, and the flag."""

CALL = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class NumberRow(ctypes.Structure):
    """C's structure ``dssc_jax_number``: the description of one number."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("unit", ctypes.c_char_p),
        ("meaning", ctypes.c_char_p),
        ("offset", ctypes.c_size_t),
        ("size", ctypes.c_size_t),
        ("low", ctypes.c_double),
        ("high", ctypes.c_double),
    )


class ControllerRow(ctypes.Structure):
    """C's structure ``dssc_jax_controller``: the description of one controller."""

    _fields_ = (
        ("version", ctypes.c_uint),
        ("name", ctypes.c_char_p),
        ("sample_time", ctypes.c_double),
        ("real", ctypes.c_size_t),
        ("controller", ctypes.c_size_t),
        ("exchange", ctypes.c_size_t),
        ("measurement", ctypes.c_size_t),
        ("signals", ctypes.c_size_t * SIGNALS),
        ("commands", ctypes.c_size_t * COMMANDS),
        ("total", ctypes.c_size_t),
        ("flag", ctypes.c_size_t),
        ("parameter_count", ctypes.c_size_t),
        ("parameters", ctypes.POINTER(NumberRow)),
        ("telemetry_count", ctypes.c_size_t),
        ("telemetry", ctypes.POINTER(NumberRow)),
        ("measured_count", ctypes.c_size_t),
        ("measured", ctypes.POINTER(NumberRow)),
        ("init", ctypes.c_void_p),
        ("reset", ctypes.c_void_p),
        ("step", ctypes.c_void_p),
        ("step_without_telemetry", ctypes.c_void_p),
    )


@dataclass(frozen=True)
class NativeNumber:
    """A parameter, a measured signal or a telemetry value of a controller in C.

    Args:
        name: Name in the description, which a study uses as well.
        quantity: Unit, meaning and range.
        offset: Place in the exchange [bytes].
    """

    name: str
    quantity: Quantity
    offset: int


@dataclass(frozen=True)
class NativeController:
    """A controller of a shared object, as ``dssc_jax_controller`` describes it.

    Args:
        name: Prefix of the names of the controller's functions.
        sample_time: Sample time for which the code is written [s].
        number_size: Size of a number [bytes], 4 or 8.
        size: Size of the controller's structure, with which the exchange begins [bytes].
        exchange_size: Size of the exchange [bytes].
        signals: Places of y, y', y_m, y_m', y_m''.
        commands: Places of u and u_n.
        total: Place of u_p = u + u_n, the command that flies.
        flag: Place of the flag that a step sets.
        parameters: The parameters.
        telemetry: The telemetry values.
        measured: The measured signals that the controller takes beside y and y', by their names in a study.
        init: Address of the function that sets the parameters to their defaults. This function and the following ones
            take one argument, the address of the exchange.
        reset: Address of the function that begins a flight.
        step: Address of the function that computes a sample.
        step_without_telemetry: Address of the function that computes a sample without telemetry; None: there is none.
    """

    name: str
    sample_time: float
    number_size: int
    size: int
    exchange_size: int
    signals: tuple[int, ...]
    commands: tuple[int, ...]
    total: int
    flag: int
    parameters: tuple[NativeNumber, ...]
    telemetry: tuple[NativeNumber, ...]
    measured: tuple[NativeNumber, ...]
    init: int
    reset: int
    step: int
    step_without_telemetry: int | None

    @property
    def dtype(self) -> np.dtype:
        """The dtype of the controller's numbers: float32 or float64."""
        return np.dtype(f"f{self.number_size}")

    @property
    def inputs(self) -> tuple[int, ...]:
        """Places of all signals that a step gets: y, y', y_m, y_m', y_m'', then the further measured signals."""
        return (*self.signals, *(number.offset for number in self.measured))


def described_controllers(library: ctypes.CDLL) -> tuple[NativeController, ...]:
    """The controllers that a loaded library exports.

    Raises:
        ConfigError: The library exports no controllers or too many, two have one name, or a description is not valid.
    """
    try:
        rows = (ctypes.POINTER(ControllerRow) * (MOST_CONTROLLERS + 1)).in_dll(library, SYMBOL)
    except ValueError:
        rule = f"exports no {SYMBOL}; build it with dssc-jax library from a source that ends in DSSC_JAX_LIBRARY_OF"
        raise ConfigError("", rule) from None
    controllers: list[NativeController] = []
    for row in rows:
        if not row:  # NULL ends the list
            break
        controllers.append(described_controller(row.contents))
    names = [controller.name for controller in controllers]
    if not names or len(set(names)) < len(names) or len(names) > MOST_CONTROLLERS:
        raise ConfigError("", f"must export between 1 and {MOST_CONTROLLERS} controllers of different names: {names}")
    return tuple(controllers)


def described_controller(row: ControllerRow) -> NativeController:
    """Return the controller that a row of C describes, after checks of the description.

    Raises:
        ConfigError: The description is not valid.
    """
    if row.version != VERSION:
        raise ConfigError("", f"has version {row.version} of its description, this is {VERSION}; build it again")
    name = text_of(row.name)
    if not (name.isidentifier() and name.isascii()):
        raise ConfigError("", f"has a controller with the name {name!r}, which is no identifier of C")
    controller = NativeController(
        name=name,
        sample_time=row.sample_time,
        number_size=row.real,
        size=row.controller,
        exchange_size=row.exchange,
        signals=tuple(row.signals),
        commands=tuple(row.commands),
        total=row.total,
        flag=row.flag,
        parameters=described_numbers(name, row.parameters, row.parameter_count),
        telemetry=described_numbers(name, row.telemetry, row.telemetry_count),
        measured=described_numbers(name, row.measured, row.measured_count),
        init=row.init or 0,
        reset=row.reset or 0,
        step=row.step or 0,
        step_without_telemetry=row.step_without_telemetry,
    )
    require_consistent(controller, row)
    require_measured(controller, row)
    return controller


def require_consistent(controller: NativeController, row: ControllerRow) -> None:
    """Require that the sizes, places and addresses of a description are possible.

    Args:
        controller: The controller that was read.
        row: Its description in C.

    Raises:
        ConfigError: A size, place or address is not possible.
    """
    rows = [*row.parameters[: row.parameter_count], *row.telemetry[: row.telemetry_count]]
    rows += row.measured[: row.measured_count]
    places = [*controller.inputs, *controller.commands, controller.total, controller.flag]
    places += [number.offset for number in (*controller.parameters, *controller.telemetry)]
    rules = {
        "the sample time must be positive": controller.sample_time > 0.0,
        "numbers must be float or double": controller.number_size in (4, 8),
        f"at most {MOST_BYTES} bytes": 0 < controller.size <= controller.exchange_size <= MOST_BYTES,
        "all numbers of its tables must have one type": all(part.size == controller.number_size for part in rows),
        "places must be whole words within the exchange": all(
            place % 4 == 0 and place <= controller.exchange_size - 4 for place in places
        ),
        "parameters lie in the controller": all(
            number.offset <= controller.size - controller.number_size for number in controller.parameters
        ),
        "a function is missing": all((controller.init, controller.reset, controller.step)),
    }
    for rule, holds in rules.items():
        if not holds:
            raise ConfigError("", f"describes its controller {controller.name} wrongly: {rule}")


def require_measured(controller: NativeController, row: ControllerRow) -> None:
    """Require that the measurement in C has only the members y, y' and the declared signals; others would stay 0.

    Args:
        controller: The controller that was read.
        row: Its description in C.

    Raises:
        ConfigError: The measurement has another number of members.
    """
    expected_count = MEASUREMENT + len(controller.measured)
    member_count = row.measurement / controller.number_size
    if member_count != expected_count:
        names = ", ".join(["y", "y_dot", *(number.name for number in controller.measured)])
        rule = (
            f"has a controller {controller.name} with {member_count:g} numbers in its measurement, and the study gives "
            f"{expected_count}: {names}; list others by DSSC_JAX_MEASURED and "
            "DSSC_JAX_CONTROLLER_OF_SIGNALS, or remove them"
        )
        raise ConfigError("", rule)


def described_numbers(controller: str, rows: "ctypes._Pointer[NumberRow]", count: int) -> tuple[NativeNumber, ...]:
    """Return the numbers in one table of a controller's description: parameters, telemetry, or measured signals.

    In the table, an infinite bound means that there is no bound. A lower bound of at most :data:`TINY` above 0 means
    that the number must be positive.

    Args:
        controller: Name of the controller, for messages.
        rows: The first row.
        count: Number of rows.

    Raises:
        ConfigError: There are too many rows; or a name is not an identifier, is reserved, or occurs twice.
    """
    if count > MOST_NUMBERS:
        raise ConfigError("", f"has more than {MOST_NUMBERS} numbers in a table of its controller {controller}")
    numbers: dict[str, NativeNumber] = {}
    described_rows = rows[:count] if count else []  # without rows the pointer may be NULL
    for row in described_rows:
        name = text_of(row.name)
        is_public = name.isidentifier() and name.isascii() and not name.startswith("_")
        if not is_public or name in RESERVED or name in numbers:
            raise ConfigError("", f"has a number {name!r} in its controller {controller}; choose another name")
        low = None if row.low == -math.inf else row.low
        high = None if row.high == math.inf else row.high
        quantity = Quantity(text_of(row.unit), text_of(row.meaning), at_least=low, at_most=high)
        if low is not None and 0.0 < low <= TINY:
            quantity = replace(quantity, at_least=None, above=0.0)
        numbers[name] = NativeNumber(name, quantity, row.offset)
    return tuple(numbers.values())


def text_of(content: bytes | None) -> str:
    """Return a string of C as text, empty for NULL; bytes that are not UTF-8 become replacement characters."""
    return (content or b"").decode("utf-8", "replace")
