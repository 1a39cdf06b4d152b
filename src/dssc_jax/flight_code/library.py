"""The description of generated controllers in C, which ``dssc-jax library`` compiles into a shared object."""

from collections.abc import Sequence

import numpy as np

from dssc_jax.core.quantities import Quantity, quantities_of
from dssc_jax.flight_code.controller import OF_CHANNEL, FlightCode, SampledController
from dssc_jax.flight_code.parameters import Parameter
from dssc_jax.flight_code.template_files import fill
from dssc_jax.lanes.c.names import c_string
from dssc_jax.lanes.c.operations import c_literal
from dssc_jax.lanes.passes.liveness import read_inputs

DOUBLE = np.dtype(float)


def description_text(code: FlightCode) -> str:
    """The descriptions of all controllers, with which the source ends; only the build of a library compiles them."""
    return fill(
        "description.c",
        channels="\n".join(channel_text(code, controller) for controller in code.controllers),
        addresses=", ".join(f"&{controller.prefix}_description" for controller in code.controllers),
    )


def channel_text(code: FlightCode, controller: SampledController) -> str:
    """The tables and the description of one channel's controller in C."""
    name = controller.prefix
    tables = {
        "parameter": parameter_rows(controller),
        "telemetry": telemetry_rows(code, controller),
        "measured": measured_rows(controller),
    }
    definitions = []
    table_arguments = {}
    for kind, rows in tables.items():
        table = f"{name}_{kind}_table"
        definitions += table_lines(table, rows)
        table_arguments[kind] = table_argument(table, rows)
    return fill(
        "description_channel.c",
        name=name,
        sample_time=c_literal(DOUBLE.type(code.study.loop.sample_time), DOUBLE),
        tables=definitions,
        parameters=table_arguments["parameter"],
        telemetry=table_arguments["telemetry"],
        measured=table_arguments["measured"],
    )


def parameter_rows(controller: SampledController) -> list[str]:
    """The rows in C of the table of parameters: unit, meaning, least and greatest value of each.

    A parameter without a quantity is a number that the study computes; it has no unit and no limits.
    """
    computed_quantity = Quantity("", "computed from the study")
    rows = []
    for parameter in read_parameters(controller):
        quantity = parameter.quantity or computed_quantity
        low, high = c_limits(quantity, controller.real)
        texts = f"{c_string(quantity.unit)}, {c_string(quantity.meaning)}"
        rows.append(f"DSSC_JAX_PARAMETER({controller.prefix}, {parameter.name}, {texts}, {low}, {high})")
    return rows


def telemetry_rows(code: FlightCode, controller: SampledController) -> list[str]:
    """The rows in C of the table of telemetry: unit and meaning of each number.

    A number that the controller does not declare gets the unit 1, and its name in place of a meaning.
    """
    info_quantities = quantities_of(code.study.loop.controller[controller.index].info)
    units = code.study.units[controller.index]
    rows = []
    for info in controller.infos:
        quantity = info_quantities.get(info, Quantity("1", info))
        texts = f"{c_string(units.of(quantity.unit))}, {c_string(quantity.meaning)}"
        rows.append(f"DSSC_JAX_TELEMETRY({controller.prefix}, {info}, {texts})")
    return rows


def measured_rows(controller: SampledController) -> list[str]:
    """The rows in C of the table of measured signals beside y and y': name in the study, unit and meaning of each."""
    rows = []
    for signal in controller.measured_signals[len(OF_CHANNEL) :]:
        texts = f"{c_string(signal.signal)}, {c_string(signal.unit)}, {c_string(signal.meaning)}"
        rows.append(f"DSSC_JAX_MEASURED({controller.prefix}, {signal.name}, {texts})")
    return rows


def read_parameters(controller: SampledController) -> list[Parameter]:
    """The parameters that start or step reads; others, such as those of metrics, are no parameters of a library.

    The order of the parameters stays.
    """
    read_positions = read_inputs(controller.start.program) | read_inputs(controller.step.program)
    return [parameter for position, parameter in enumerate(controller.parameters) if position in read_positions]


def table_lines(name: str, rows: Sequence[str]) -> list[str]:
    """The definition of a table in C; none without rows, because C has no empty tables.

    Args:
        name: Name of the table in C.
        rows: The rows in C.
    """
    if not rows:
        return []
    return [f"static const dssc_jax_number {name}[] = {{", *(f"    {row}," for row in rows), "};"]


def table_argument(name: str, rows: Sequence[str]) -> str:
    """The arguments in C for a table: the table and its length; NULL and 0 for a table without rows."""
    return f"{name}, DSSC_JAX_COUNT({name})" if rows else "NULL, 0"


def c_limits(quantity: Quantity, real: np.dtype) -> tuple[str, str]:
    """The least and the greatest admissible value of a quantity in C; an excluded bound is moved to the next number.

    Args:
        quantity: The quantity.
        real: The dtype of the controller's numbers, in which an excluded bound has its next number.
    """
    low = -np.inf if quantity.at_least is None else quantity.at_least
    high = np.inf if quantity.at_most is None else quantity.at_most
    if quantity.above is not None:
        low = np.nextafter(real.type(quantity.above), real.type(np.inf))
    if quantity.below is not None:
        high = np.nextafter(real.type(quantity.below), real.type(-np.inf))
    return c_literal(DOUBLE.type(low), DOUBLE), c_literal(DOUBLE.type(high), DOUBLE)
