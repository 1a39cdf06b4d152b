"""The schema of a result: variables with dimensions, types, units and meanings, following the CF conventions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax.closed_loop.metrics.requirements import violated
from dssc_jax.core.quantities import unit_and_meaning
from dssc_jax.core.signals import Outcome
from dssc_jax.study import Study

ENDINGS = {
    Outcome.OK: "meets all that is required",
    Outcome.NON_FINITE: "does not stay finite",
    Outcome.SINGULAR_ATTITUDE: "reaches a singular attitude",
    Outcome.INTO_GROUND: "flies into the ground",
}
"""Meaning of each outcome other than a violated requirement."""
OUTCOME = "how the draw ended; of violated requirements the first in the study's order"
NOT_COMPUTED = -1
"""Outcome of a lane that has not been computed."""


def outcome_codes(study: Study) -> dict[int, str]:
    """Names of the outcome codes that draws of a study can have, by code.

    The code of a draw names only the first violated requirement, in the study's order; the slacks show all violated
    ones.
    """
    codes = {int(Outcome.OK): "ok", int(Outcome.NON_FINITE): "non_finite"}
    is_vehicle = len(study.loop.channels) > 1
    if is_vehicle:
        codes[int(Outcome.SINGULAR_ATTITUDE)] = "singular_attitude"
    if study.table["plant"].get("ground") is not None:  # also in a study whose code is not loaded
        codes[int(Outcome.INTO_GROUND)] = "into_ground"
    for number, requirement in enumerate(study.requirements):
        codes[int(Outcome.REQUIREMENT) + number] = f"first_violated_{requirement.label}"
    return codes


def verdict(study: Study, outcome: int, slacks: Mapping[str, Any]) -> str:
    """Describe how a draw ended: its early end, or all requirements that it violates.

    Args:
        study: The study.
        outcome: Outcome code of the draw.
        slacks: Slack of each requirement, by :attr:`Requirement.name`.
    """
    if outcome < Outcome.REQUIREMENT:
        return ENDINGS[Outcome(outcome)]
    violated_texts = (requirement.text for requirement in study.requirements if violated(slacks[requirement.name]))
    return f"violates {' and '.join(violated_texts)}"


@dataclass(frozen=True)
class Variable:
    """How a result stores a variable.

    Args:
        dims: Names of the variable's dimensions.
        dtype: NumPy's name of the variable's type.
        attributes: Unit, meaning and further attributes, following the CF conventions.
    """

    dims: tuple[str, ...]
    dtype: str
    attributes: Mapping[str, Any]


def variables(study: Study) -> dict[str, Variable]:
    """All variables of a study's dataset by name, the drawn numbers first; ``outcome`` is the last.

    Drawn numbers have only the dimension ``draw``. All other variables have the swept parameters and ``draw``.
    """
    grid = (*study.axes, "draw")
    real = f"float{study.config.loop.precision}"
    variable_of = {}
    for name, law in study.laws.items():
        quantity = study.quantities[name]
        attributes = {"units": quantity.unit, "long_name": quantity.meaning, "law": str(law)}
        variable_of[name] = Variable(("draw",), "float64", attributes)
    for measure in study.measures:
        attributes = unit_and_meaning(measure.unit, measure.meaning + measure.window_text)
        variable_of[measure.name] = Variable(grid, real, attributes)
    for requirement in study.requirements:
        attributes = unit_and_meaning(requirement.measure.unit, f"signed slack of {requirement.text}")
        variable_of[requirement.name] = Variable(grid, real, attributes)
    for requirement in study.requirements:
        meaning = f"time from which on a violation of {requirement.text} was certain (NaN: it is met)"
        variable_of[requirement.violation_name] = Variable(grid, real, unit_and_meaning("s", meaning))
    attributes = unit_and_meaning("s", "time of the first non-finite step (NaN: none)")
    variable_of["failed_at"] = Variable(grid, real, attributes)
    if study.loop.settled:
        attributes = unit_and_meaning("s", "time from which on it had settled, and was not simulated (NaN: none)")
        variable_of["settled_at"] = Variable(grid, real, attributes)
    codes = outcome_codes(study)
    attributes = {"long_name": OUTCOME, "flag_values": list(codes), "flag_meanings": " ".join(codes.values())}
    variable_of["outcome"] = Variable(grid, "int32", attributes)
    return variable_of


def units_of(study: Study) -> dict[str, str]:
    """Unit of each variable and coordinate of a result, by name; those without a unit are left out."""
    units = {}
    for name, variable in (variables(study) | coordinates(study)).items():
        if "units" in variable.attributes:
            units[name] = variable.attributes["units"]
    return units


def name_with_unit(name: str, unit: str) -> str:
    """A name followed by its unit in brackets; the name alone if the unit is ``1`` or empty."""
    return name if unit in ("", "1") else f"{name} [{unit}]"


def coordinates(study: Study) -> dict[str, Variable]:
    """The coordinates of a study's dataset by name: each swept parameter, and the index of the draw."""
    variable_of = {}
    for name in study.axes:
        quantity = study.quantities[name]
        variable_of[name] = Variable((name,), "float64", unit_and_meaning(quantity.unit, quantity.meaning))
    variable_of["draw"] = Variable(("draw",), "int64", {"long_name": "draw index"})
    return variable_of


def coordinate_values(study: Study) -> dict[str, np.ndarray]:
    """Values of the :func:`coordinates` of a study's dataset, by name."""
    values = {name: np.asarray(axis) for name, axis in study.axes.items()}
    values["draw"] = np.arange(study.config.draws)
    return values


def dataset_attributes(study: Study) -> dict[str, str]:
    """Attributes of a study's dataset itself, following the CF conventions."""
    attributes = {"Conventions": "CF-1.11", "title": study.name, "source": "dssc_jax"}
    if study.config.description:
        attributes["comment"] = study.config.description
    return attributes


def empty_dataset(study: Study) -> xr.Dataset:
    """An empty dataset with all variables of a study's result: numbers are NaN, and outcomes :data:`NOT_COMPUTED`."""
    coords = coordinate_values(study)
    sizes = {name: len(values) for name, values in coords.items()}
    blank = {}
    for name, variable in variables(study).items():
        shape = [sizes[dim] for dim in variable.dims]
        fill = np.nan if variable.dtype.startswith("float") else NOT_COMPUTED
        blank[name] = (variable.dims, np.full(shape, fill, variable.dtype), dict(variable.attributes))
    coords_with_attributes = {}
    for name, variable in coordinates(study).items():
        coords_with_attributes[name] = ((name,), coords[name], dict(variable.attributes))
    return xr.Dataset(blank, coords=coords_with_attributes, attrs=dataset_attributes(study))


def copy_block(
    dataset: xr.Dataset,
    block: tuple[slice, ...],
    results: Mapping[str, np.ndarray],
    law_values: Mapping[str, np.ndarray],
) -> None:
    """Copy a block of lanes into a dataset of :func:`empty_dataset`.

    Args:
        dataset: The dataset.
        block: Place of the block in the grid of points and draws.
        results: Metrics, slacks and outcomes of the block, by name.
        law_values: Drawn numbers of the block's draws, by name.
    """
    for name, array in results.items():
        dataset[name].values[block] = array
    for name, column in law_values.items():
        dataset[name].values[block[-1]] = column
