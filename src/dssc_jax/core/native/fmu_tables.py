"""The table of an FMU in a study: the file, and the variables that are connected to signals."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.native.allowed import loaded_native
from dssc_jax.core.native.fmu import OUTPUT, FmuVariable, NativeFmu
from dssc_jax.core.native.named_types import named_type
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Params, Scalar
from dssc_jax.core.toml import TomlTable

KIND = "fmu"
"""The kind's name in a study's tables, for plants and for controllers."""

PARAMETERS = "parameters"

FILE_KEYS = {
    "file": "FMU for co-simulation, FMI 2.0 or 3.0, relative to the study's folder",
    "sha256": "digest of the file, which must match; read from the file if absent",
}
OUTPUTS_KEY = "table of further outputs to report: the FMU's variable for each name in the study"
WITHOUT_DERIVATIVE = (
    "is an FMU, which has no derivative here; what samples draws (run, margin, compare, falsify) needs none"
)


class Connection(NamedTuple):
    """A signal of the loop that is connected to a variable of an FMU.

    Args:
        signal: Name of the signal in the study.
        variable: The variable.
    """

    signal: str
    variable: FmuVariable


def fmu_of(table: TomlTable) -> NativeFmu:
    """Return the loaded FMU that a table names by file and digest.

    Raises:
        ConfigError: The FMU is not loaded, or the file is a shared object.
    """
    fmu = loaded_native(table, "an FMU")
    if not isinstance(fmu, NativeFmu):
        raise ConfigError("file", f"'{table.get('file')}' is a shared object; set kind = \"library\"")
    return fmu


def connection(fmu: NativeFmu, table: TomlTable, key: str, causality: str) -> Connection:
    """Return the connection of one signal that a study must connect.

    Args:
        fmu: The FMU.
        table: The study's table of the FMU.
        key: Name of the signal, whose entry in the table names the variable.
        causality: Causality that the variable must have.

    Raises:
        ConfigError: The entry is missing, or names no such variable.
    """
    if key not in table:
        candidates = fmu.names_with(causality)
        rule = f"is required: an {causality} of '{fmu.file}'; it has {', '.join(sorted(candidates)) or 'none'}"
        raise ConfigError(key, rule)
    return Connection(key, fmu.variable(table[key], key, causality))


def connections(fmu: NativeFmu, table: TomlTable, key: str, causality: str) -> tuple[Connection, ...]:
    """Return the connections of an inner table, whose keys are signals and whose values are names of variables.

    Args:
        fmu: The FMU.
        table: The study's table of the FMU.
        key: Name of the inner table; it may be absent.
        causality: Causality that the variables must have.

    Raises:
        ConfigError: The entry is no table, or names a variable that does not exist or has another causality.
    """
    names = table.get(key, {})
    if not isinstance(names, Mapping):
        raise ConfigError(key, f"must be a table of variables by name, got {names!r}")
    connected = []
    with errors_under(key):
        for signal, variable_name in names.items():
            connected.append(Connection(str(signal), fmu.variable(variable_name, str(signal), causality)))
    return tuple(connected)


def require_distinct(connected: Iterable[Connection]) -> None:
    """Require that no variable is set by two signals.

    Raises:
        ConfigError: A variable is connected twice.
    """
    signals: dict[str, str] = {}
    for signal, variable in connected:
        if variable.name in signals:
            raise ConfigError(signal, f"'{variable.name}' is already connected to {signals[variable.name]}")
        signals[variable.name] = signal


def reported_outputs(fmu: NativeFmu, table: TomlTable) -> tuple[Connection, ...]:
    """Return the further outputs of an FMU that a study reports, sorted by name.

    Raises:
        ConfigError: The entry ``outputs`` is no table, or names a variable that is no output of the FMU.
    """
    return tuple(sorted(connections(fmu, table, "outputs", OUTPUT)))


def named_signals(connected: Iterable[Connection]) -> tuple[NamedSignal, ...]:
    """Return the connected signals, with the units and meanings of their variables."""
    return tuple(NamedSignal.of(signal, variable.quantity) for signal, variable in connected)


def value_references(connected: Iterable[Connection]) -> tuple[int, ...]:
    """Return the value references of the connected variables: the numbers by which the FMU identifies them."""
    return tuple(variable.reference for _, variable in connected)


def parameter_connections(fmu: NativeFmu, table: TomlTable, connected: Iterable[Connection]) -> tuple[Connection, ...]:
    """Return the connections of the variables that a study sets once, before t = 0, in its table ``parameters``.

    Args:
        fmu: The FMU.
        table: The study's table of the FMU.
        connected: The connections of variables that are set in each step, which cannot be parameters as well.

    Raises:
        ConfigError: A variable does not exist, cannot be set, or is set in each step.
    """
    values = table.get(PARAMETERS, {})
    if not isinstance(values, Mapping):
        raise ConfigError(PARAMETERS, f"must be a table of numbers by name, got {values!r}")
    signal_of_variable = {variable.name: signal for signal, variable in connected}
    selected = []
    with errors_under(PARAMETERS):
        for name in values:
            variable = fmu.parameter(str(name), str(name))
            if variable.name in signal_of_variable:
                signal = signal_of_variable[variable.name]
                raise ConfigError(str(name), f"'{variable.name}' is connected to {signal} already")
            selected.append(Connection(str(name), variable))
    return tuple(selected)


def params_type(parameters: tuple[Connection, ...], name: str, quantity: Quantity, default: float | None) -> Any:
    """Return the NamedTuple type of the parameters of a plant or controller that is an FMU.

    Args:
        parameters: The FMU's parameters that the study sets. They become the field ``parameters``, itself a NamedTuple;
            empty: there is no such field.
        name: Name of the one further number of the type.
        quantity: Unit and meaning of this number.
        default: Default of this number; None: it may be absent.
    """
    if not parameters:
        return named_type("Params", {name: quantity}, {name: default})
    inner = named_type("Parameters", {signal: variable.quantity for signal, variable in parameters}, {})
    combined_type = named_type("Params", {PARAMETERS: quantity, name: quantity}, {PARAMETERS: None, name: default})
    combined_type.__annotations__[PARAMETERS] = inner  # in place of the quantity, which only made the field
    return combined_type


def values_of(params: Params) -> tuple[Scalar, ...]:
    """Return the values of the FMU's parameters that a study sets, in the order of its table; () if it sets none."""
    return tuple(getattr(params, PARAMETERS, ()))
