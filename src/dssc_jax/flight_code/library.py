"""The description of generated controllers, from which ``dssc-jax library`` builds a library."""

from collections.abc import Sequence

import numpy as np

from dssc_jax.core.quantities import Quantity, quantities_of
from dssc_jax.flight_code.controller import FlightCode, SampledController, takes_signals
from dssc_jax.flight_code.template_files import fill
from dssc_jax.lanes.c.names import c_string
from dssc_jax.lanes.c.operations import c_literal

DOUBLE = np.dtype(float)
NO_LIBRARY = """#ifdef DSSC_JAX_LIBRARY
#error "a library takes y and y_dot only, and this controller takes other measured signals, too"
#endif
"""


def description_text(code: FlightCode) -> str:
    """The end of the source, which only the build of a library compiles: a refusal, if a controller takes signals."""
    if takes_signals(code.study):
        return NO_LIBRARY
    return fill(
        "description.c",
        channels="\n".join(channel_text(code, controller) for controller in code.controllers),
        addresses=", ".join(f"&{controller.prefix}_description" for controller in code.controllers),
    )


def channel_text(code: FlightCode, controller: SampledController) -> str:
    """The tables and the description of one channel."""
    name = controller.prefix
    computed = Quantity("1", "computed from the study")
    rows: list[str] = []
    for parameter in controller.parameters:
        quantity = parameter.quantity or computed
        low, high = limits(quantity, controller.real)
        texts = f"{c_string(quantity.unit)}, {c_string(quantity.meaning)}"
        rows.append(f"DSSC_JAX_PARAMETER({name}, {parameter.name}, {texts}, {low}, {high})")
    known = quantities_of(code.study.loop.controller[controller.index].info)
    units = code.study.units[controller.index]
    reported: list[str] = []
    for info in controller.infos:
        quantity = known.get(info, Quantity("1", info))
        texts = f"{c_string(units.of(quantity.unit))}, {c_string(quantity.meaning)}"
        reported.append(f"DSSC_JAX_TELEMETRY({name}, {info}, {texts})")
    sample_time = c_literal(DOUBLE.type(code.study.loop.sample_time), DOUBLE)
    return fill(
        "description_channel.c",
        name=name,
        sample_time=sample_time,
        tables=[*table_lines(f"{name}_parameter_table", rows), *table_lines(f"{name}_telemetry_table", reported)],
        parameters=table_argument(f"{name}_parameter_table", rows),
        telemetry=table_argument(f"{name}_telemetry_table", reported),
    )


def table_lines(name: str, rows: Sequence[str]) -> list[str]:
    """The definition of a table; C has no empty ones."""
    return [f"static const dssc_jax_number {name}[] = {{", *(f"    {row}," for row in rows), "};"] if rows else []


def table_argument(name: str, rows: Sequence[str]) -> str:
    """A table and its length as arguments."""
    return f"{name}, DSSC_JAX_COUNT({name})" if rows else "NULL, 0"


def limits(quantity: Quantity, real: np.dtype) -> tuple[str, str]:
    """The least and the greatest admissible value in C's notation; for an excluded end its neighbour."""
    low = -np.inf if quantity.at_least is None else quantity.at_least
    high = np.inf if quantity.at_most is None else quantity.at_most
    if quantity.above is not None:
        low = np.nextafter(real.type(quantity.above), real.type(np.inf))
    if quantity.below is not None:
        high = np.nextafter(real.type(quantity.below), real.type(-np.inf))
    return c_literal(DOUBLE.type(low), DOUBLE), c_literal(DOUBLE.type(high), DOUBLE)
