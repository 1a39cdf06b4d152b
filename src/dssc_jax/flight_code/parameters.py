"""The numbers of generated code that may be changed in flight: of a controller, of software on board."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jax.tree_util import keystr, tree_flatten_with_path

from dssc_jax.core.quantities import Quantity, quantities_of
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits
from dssc_jax.engine.sampling import draw as draw_values
from dssc_jax.lanes.c.names import member_names
from dssc_jax.lanes.c.operations import c_literal
from dssc_jax.study import Study
from dssc_jax.study.laws import UncertainValue


class Parameter(NamedTuple):
    """A number of the code that may be changed in flight."""

    key: str  # its key in Study.params: its name in the study, or its path if the study computes it
    name: str  # its name in C
    quantity: Quantity | None  # unit, meaning and range; None if its field declares none
    value: float  # the study's value, or that at the medians of laws
    uncertain: bool  # whether it has a law in the study, or follows from one


def loop_parameters(
    study: Study, belongs: Callable[[str], bool], name: Callable[[str], str], units: ChannelUnits = UNNAMED_UNITS
) -> tuple[Parameter, ...]:
    """Numbers of the study's loop, in the order of their fields.

    Numbers that decide the shape of the program (choices, counts) stay constants.

    Args:
        study: The study.
        belongs: Whether a number at a dotted path in the loop's parameters is one.
        name: Its name in C, from its name in the study, or its path if the study computes it.
        units: Units of y and u, for numbers that the study computes.
    """
    names = {path: name_in_study for name_in_study, number in study.numbers.items() for path in number.paths}
    leaves, _ = tree_flatten_with_path(study.template)
    parameters: dict[str, Parameter] = {}
    for path, leaf in leaves:
        dotted_path = keystr(path, simple=True, separator=".")
        if not belongs(dotted_path) or not isinstance(leaf, float | UncertainValue):
            continue
        number = study.numbers.get(names.get(dotted_path, ""))
        if number is not None and not number.quantity.law:
            continue
        key = dotted_path if number is None else number.name
        quantity = declared_quantity(study.template, dotted_path, units) if number is None else number.quantity
        uncertain = isinstance(leaf, UncertainValue)
        value = float(leaf.median) if isinstance(leaf, UncertainValue) else leaf
        parameters[key] = Parameter(key, name(key), quantity, value, uncertain)
    c_names = member_names(parameter.name for parameter in parameters.values())
    return tuple(parameter._replace(name=name) for parameter, name in zip(parameters.values(), c_names, strict=True))


def declared_quantity(params: Any, path: str, units: ChannelUnits) -> Quantity | None:
    """The quantity that a field of parameters declares, for a number at a dotted path; None: none, as in a matrix."""
    quantity = None
    node = params
    for step in path.split("."):
        if step.isdecimal():
            node = node[int(step)]
        else:
            quantity = quantities_of(type(node)).get(step)
            node = getattr(node, step)
    return None if quantity is None else replace(quantity, unit=units.of(quantity.unit))


def numbers_of_draws(study: Study, indices: np.ndarray, constants: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Laws of draws, what follows from them, and constants, by their keys in ``Study.params``; one value a draw."""
    values = draw_values(study, indices)
    values |= {name: np.asarray(column) for name, column in study.derived(values).items()}
    return {name: np.full(len(indices), value) for name, value in constants.items()} | values


def parameter_comment(number: int, parameter: Parameter) -> str:
    """Number, unit, meaning, range and the study's value of a parameter."""
    quantity = parameter.quantity
    median = ", median of its law" if parameter.uncertain else ""
    if quantity is None:
        return f"{number}: computed from the study; {parameter.value!r}{median}"
    interval = f", {quantity.interval}" if quantity.interval else ""
    return f"{number}: {quantity.unit}: {quantity.meaning}{interval}; {parameter.value!r}{median}"


def assignments(structure: str, parameters: tuple[Parameter, ...], real: np.dtype) -> list[str]:
    """Statements that give a structure in C the study's values."""
    literals = {parameter.name: c_literal(real.type(parameter.value), real) for parameter in parameters}
    return [f"{structure}.{name} = {literal};" for name, literal in (literals or {"unused": "0"}).items()]


def checks(parameters: tuple[Parameter, ...], real: np.dtype) -> list[str]:
    """Statements that return the number of the first inadmissible one of changed parameters."""
    lines: list[str] = []
    for number, parameter in enumerate(parameters, start=1):
        conditions = " && ".join(parameter_conditions(parameter, real))
        lines += [f"if (!({conditions})) {{", f"    return {number}u;", "}"]
    return lines or ["(void)parameters;"]


def parameter_conditions(parameter: Parameter, real: np.dtype) -> list[str]:
    """Conditions that an admissible parameter satisfies, and NaN does not."""
    member = f"parameters->{parameter.name}"
    conditions = [f"is_finite({member})"]
    quantity = parameter.quantity
    if quantity is None:
        return conditions
    bounds = {">": quantity.above, ">=": quantity.at_least, "<": quantity.below, "<=": quantity.at_most}
    for sign, bound in bounds.items():
        if bound is not None:
            conditions.append(f"{member} {sign} {c_literal(real.type(bound), real)}")
    return conditions
