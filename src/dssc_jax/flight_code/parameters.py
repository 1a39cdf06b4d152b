"""The numbers of a controller or of software on board that generated code lets its caller change in flight."""

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
    """A number of generated code that may be changed in flight.

    Args:
        key: Key in ``Study.params``: the number's name in the study, or its path if the study computes it.
        name: Name in C.
        quantity: Unit, meaning and range; None: the number's field declares none.
        value: The study's value, or the value at the medians of the laws.
        uncertain: Whether the number has a law in the study, or follows from a number that has one.
        less_than: Name in C of a parameter that must be larger than this one; None: there is none.
    """

    key: str
    name: str
    quantity: Quantity | None
    value: float
    uncertain: bool
    less_than: str | None = None


def loop_parameters(
    study: Study, selects: Callable[[str], bool], name: Callable[[str], str], units: ChannelUnits = UNNAMED_UNITS
) -> tuple[Parameter, ...]:
    """The selected numbers of a study's loop as parameters, in the order of their fields.

    Numbers that decide the shape of the program (choices, counts) stay constants.

    Args:
        study: The study.
        selects: ``(path) -> bool``: whether the number at a dotted path in the loop's parameters is selected.
        name: ``(key) -> name in C``, where the key is the number's name in the study, or its path if the study computes
            it.
        units: Units of y and u, for numbers that the study computes.
    """
    number_of_path = {}
    for number in study.numbers.values():
        number_of_path |= dict.fromkeys(number.paths, number)
    leaves, _ = tree_flatten_with_path(study.template)
    parameters: dict[str, Parameter] = {}
    keys: dict[str, str] = {}  # by path
    larger_paths: dict[str, str] = {}  # by key: path of the number below which the number must lie
    for path, leaf in leaves:
        dotted_path = keystr(path, simple=True, separator=".")
        if not selects(dotted_path) or not isinstance(leaf, float | UncertainValue):
            continue
        number = number_of_path.get(dotted_path)  # None: the study computes it
        if number is not None and not number.quantity.law:  # it decides the shape of the program
            continue
        key = dotted_path if number is None else number.name
        quantity = declared_quantity(study.template, dotted_path, units) if number is None else number.quantity
        uncertain = isinstance(leaf, UncertainValue)
        value = float(leaf.median) if isinstance(leaf, UncertainValue) else leaf
        parameters[key] = Parameter(key, name(key), quantity, value, uncertain)
        keys[dotted_path] = key
        if quantity is not None and quantity.less_than is not None:
            part, _, _ = dotted_path.rpartition(".")
            larger_paths[key] = f"{part}.{quantity.less_than}"
    c_names = member_names(parameter.name for parameter in parameters.values())
    name_of_key = dict(zip(parameters, c_names, strict=True))
    named = []
    for key, parameter in parameters.items():
        larger_key = keys.get(larger_paths.get(key, ""))
        larger = None if larger_key is None else name_of_key[larger_key]
        named.append(parameter._replace(name=name_of_key[key], less_than=larger))
    return tuple(named)


def declared_quantity(params: Any, path: str, units: ChannelUnits) -> Quantity | None:
    """The quantity that the field of a number declares, by the number's dotted path in ``params``.

    Args:
        params: The loop's parameters.
        path: The number's path: names of fields and positions in tuples, with dots between them.
        units: Units of y and u in the channel.

    Returns:
        The quantity in the units of a channel; None if the field declares none, as the field of a matrix.
    """
    quantity = None
    node = params
    for name in path.split("."):
        if name.isdecimal():  # a position in a tuple
            node = node[int(name)]
        else:
            quantity = quantities_of(type(node)).get(name)
            node = getattr(node, name)
    return None if quantity is None else replace(quantity, unit=units.of(quantity.unit))


def numbers_of_draws(study: Study, indices: np.ndarray, constants: Mapping[str, float]) -> dict[str, np.ndarray]:
    """The numbers that some draws have, by their keys in ``Study.params``; a column of shape (draws,) for each.

    Args:
        study: The study.
        indices: Indices of the draws, shape (draws,).
        constants: Numbers that all draws share; laws, and numbers that follow from laws, override them.
    """
    values = draw_values(study, indices)
    values |= {name: np.asarray(column) for name, column in study.derived(values).items()}
    return {name: np.full(len(indices), value) for name, value in constants.items()} | values


def parameter_comment(number: int, parameter: Parameter) -> str:
    """The comment on a parameter in C: its number, unit, meaning, range and the study's value.

    Args:
        number: Number of the parameter, from 1 on, which the check of the parameters returns.
        parameter: The parameter.
    """
    quantity = parameter.quantity
    median = ", median of its law" if parameter.uncertain else ""
    if quantity is None:
        return f"{number}: computed from the study; {parameter.value!r}{median}"
    interval = f", {quantity.interval}" if quantity.interval else ""
    if parameter.less_than is not None:
        interval += f", < {parameter.less_than}"
    return f"{number}: {quantity.unit}: {quantity.meaning}{interval}; {parameter.value!r}{median}"


def assignment_lines(structure: str, parameters: tuple[Parameter, ...], real: np.dtype) -> list[str]:
    """Statements in C that assign the study's values to the members of a structure.

    Args:
        structure: C's expression of the structure.
        parameters: The parameters, each of which is a member.
        real: The dtype of the members.
    """
    if not parameters:  # C has no empty structures
        return [f"{structure}.unused = 0;"]
    lines = []
    for parameter in parameters:
        literal = c_literal(real.type(parameter.value), real)
        lines.append(f"{structure}.{parameter.name} = {literal};")
    return lines


def check_lines(parameters: tuple[Parameter, ...], real: np.dtype) -> list[str]:
    """Statements in C that return the number, from 1 on, of the first parameter with an inadmissible value.

    Args:
        parameters: The parameters in the order of their numbers.
        real: The dtype of the parameters in C.
    """
    lines: list[str] = []
    for number, parameter in enumerate(parameters, start=1):
        conditions = " && ".join(parameter_conditions(parameter, real))
        lines += [f"if (!({conditions})) {{", f"    return {number}u;", "}"]
    return lines or ["(void)parameters;"]


def parameter_conditions(parameter: Parameter, real: np.dtype) -> list[str]:
    """Conditions in C that hold for exactly the admissible values of a parameter; NaN is not admissible.

    If one parameter must be less than another, the smaller one has this condition.
    """
    member = f"parameters->{parameter.name}"
    conditions = [f"is_finite({member})"]
    quantity = parameter.quantity
    if quantity is None:
        return conditions
    bounds = {">": quantity.above, ">=": quantity.at_least, "<": quantity.below, "<=": quantity.at_most}
    for sign, bound in bounds.items():
        if bound is not None:
            conditions.append(f"{member} {sign} {c_literal(real.type(bound), real)}")
    if parameter.less_than is not None:
        conditions.append(f"{member} < parameters->{parameter.less_than}")
    return conditions
