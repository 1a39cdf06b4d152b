"""Outputs and disturbance inputs of a linear plant that a study names, by rows of C and D and by input columns."""

from collections.abc import Mapping
from typing import Annotated, NamedTuple

from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.named import NamedSignal, Text, by_names, report_type
from dssc_jax.core.numerics import dot
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Info, PlantInput, Scalar
from dssc_jax.core.units import parse_unit

ROW = Quantity("SI", "entry of the output's row of C")
THROUGH = Quantity("SI", "feedthrough of the command")
INPUT_THROUGH = Quantity("SI", "feedthrough of the disturbance at this input")
COLUMN = Quantity("SI", "entry of the input's column")


class OutputRow(NamedTuple):
    """A named output: c x + d u_p + the sum of feedthroughs (``inputs``) times the disturbances at these inputs."""

    c: Annotated[tuple[Scalar, ...], ROW]
    d: Annotated[Scalar, THROUGH] = 0.0
    inputs: Annotated[dict[str, Scalar] | None, INPUT_THROUGH] = None
    unit: Text = Text("")
    meaning: Text = Text("")


class InputColumn(NamedTuple):
    """A named disturbance input, which adds its column times the disturbance to x'."""

    column: Annotated[tuple[Scalar, ...], COLUMN]
    unit: Text = Text("")
    meaning: Text = Text("")


Outputs = dict[str, OutputRow] | None
Inputs = dict[str, InputColumn] | None


def named_signals(items: Mapping[str, OutputRow] | Mapping[str, InputColumn] | None) -> tuple[NamedSignal, ...]:
    """The named outputs or inputs as signals with unit and meaning, sorted by name."""
    return tuple(NamedSignal(name, str(item.unit), str(item.meaning)) for name, item in by_names(items))


def output_report(outputs: Outputs, inputs: Inputs, x: tuple[Scalar, ...], drive: PlantInput, is_matched: bool) -> Info:
    """The values of the named outputs, as a report of the plant; () if there are none.

    Args:
        outputs: The named outputs.
        inputs: The named inputs.
        x: State of the plant.
        drive: The plant's input.
        is_matched: Whether the disturbance acts as the command does, so that it passes through ``d``, too.
    """
    if not outputs:
        return ()
    input_names = [name for name, _ in by_names(inputs)]
    disturbances = dict(zip(input_names, drive.inputs, strict=False))  # drive.inputs may be (): no disturbances
    command = drive.command + drive.disturbance if is_matched else drive.command
    names = []
    values = []
    for output_name, row in by_names(outputs):
        value = dot((*row.c, row.d), (*x, command))
        for name, feedthrough in by_names(row.inputs):
            value = value + feedthrough * disturbances.get(name, 0.0)
        names.append(output_name)
        values.append(value)
    report = report_type(tuple(names))
    return report(*values)


def require_named(outputs: Outputs, inputs: Inputs, order: int) -> None:
    """Check the sizes, names and units of named outputs and inputs of a plant with ``order`` states.

    Args:
        outputs: The named outputs; None: there are none.
        inputs: The named inputs; None: there are none.
        order: Number of states.

    Raises:
        ConfigError: A row or column has another length, an output names no input, or a unit is no unit.
    """
    input_names = list(inputs or {})
    for name, column in by_names(inputs):
        with errors_under(f"inputs.{name}"):
            require_length("column", column.column, order)
            require_unit(column.unit)
    for name, row in by_names(outputs):
        with errors_under(f"outputs.{name}"):
            require_length("c", row.c, order)
            require_unit(row.unit)
            for input_name, _ in by_names(row.inputs):
                if input_name not in input_names:
                    rule = f"is no input of the plant; {nearest(input_name, input_names)}"
                    raise ConfigError(f"inputs.{input_name}", rule)


def require_length(place: str, numbers: tuple[Scalar, ...], order: int) -> None:
    """Require a row or column with one number for each state.

    Args:
        place: Name of the field, for the message.
        numbers: The row or column.
        order: Number of states.

    Raises:
        ConfigError: There are more or fewer numbers.
    """
    if len(numbers) != order:
        raise ConfigError(place, f"must have {order} numbers, one for each state, got {len(numbers)}")


def require_unit(unit: str) -> None:
    """Require that a unit is empty, or a product of powers of symbols.

    Raises:
        ConfigError: The text is no such unit.
    """
    try:
        parse_unit(unit or "1")
    except ValueError as error:
        raise ConfigError("unit", str(error)) from None
