"""The dataset of the worst case of the linearised loop, from the worst case at each break point."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.analyses.worst_loop.box import Box
from dssc_jax.analyses.worst_loop.joint import JointCase
from dssc_jax.analyses.worst_loop.search import MARGINS
from dssc_jax.core.quantities import unit_and_meaning

OF_MARGIN = "that of the margin"
OF_NUMBER = "that of the number"
MARGIN_VALUES = {
    "drawn": "worst margin of all draws",
    "found": "worst margin found in the box",
    "bounded": "margin that holds on all of the box",
}
"""The fields of a :class:`LoopCase` with a value for each margin, with their meanings."""
LOOP_VALUES = {
    "growth_found": "growth of the box that reaches an unstable loop",
    "growth_bounded": "growth of the box up to which the loop is stable",
    "growable": "largest growth that was searched",
    "cells": "cells computed",
}
"""The fields of a :class:`LoopCase` with a single number, with their meanings."""
SIDE_VALUES = {
    "low": "lower end",
    "high": "upper end",
    "cut": "whether the law has no end there",
    "logarithmic": "whether the box grows in the logarithm",
}
"""The fields of a side of the box, with their meanings."""
OPERATING_POINT = "whether the nearest unstable loop has an operating point within its limits"

Variable = tuple[str | tuple[str, ...], np.ndarray, dict[str, str]]
"""A variable of a dataset: its dimensions, values and attributes."""


class LoopCase(NamedTuple):
    """The worst case of one broken loop.

    Args:
        names: Dotted names of the numbers on which the loop depends.
        drawn: Worst value of each margin among the draws, shape (margins,).
        found: Worst value of each margin found in the box, shape (margins,).
        numbers: For each margin the numbers at which its worst value was found, by name.
        bounded: Values of the margins that hold on all of the box, shape (margins,); NaN if none was found.
        growth_found: Smallest factor found by which the box has to grow to reach an unstable loop; infinite if no
            unstable loop was found.
        unstable: The numbers of this unstable loop, by name; NaN if none was found.
        has_operating_point: Whether this unstable loop has an operating point within its limits. A loop without one
            counts as unstable.
        growth_bounded: Factor of growth up to which the bounds show that the loop is stable.
        growable: Largest factor of growth that was searched.
        cells: Number of cells for which bounds were computed.
    """

    names: tuple[str, ...]
    drawn: np.ndarray
    found: np.ndarray
    numbers: list[dict[str, float]]
    bounded: np.ndarray
    growth_found: float
    unstable: dict[str, float]
    has_operating_point: bool
    growth_bounded: float
    growable: float
    cells: int


def worst_dataset(box: Box, cases: Mapping[str, LoopCase]) -> xr.Dataset:
    """The dataset of a :class:`~dssc_jax.analyses.worst_loop.result.WorstLoop`, for the loops with one break point.

    Args:
        box: The box of the uncertain numbers.
        cases: The worst case of the loop broken at each point, by the point's name.
    """
    loop_cases = list(cases.values())
    variables = perturbation_variables(box, loop_cases)
    has_operating_point = np.array([case.has_operating_point for case in loop_cases])
    variables["has_operating_point"] = ("loop", has_operating_point, {"long_name": OPERATING_POINT})
    number_names = np.array([side.name for side in box.sides])
    depends = np.stack([np.isin(number_names, case.names) for case in loop_cases])
    variables["depends"] = (("loop", "number"), depends, {"long_name": "whether the number changes the loop"})
    for name, meaning in MARGIN_VALUES.items():
        values = np.stack([getattr(case, name) for case in loop_cases])
        variables[name] = (("loop", "margin"), values, {"units": OF_MARGIN, "long_name": meaning})
    for name, meaning in LOOP_VALUES.items():
        values = np.array([getattr(case, name) for case in loop_cases])
        variables[name] = ("loop", values, unit_and_meaning("1", meaning))
    for name, meaning in SIDE_VALUES.items():
        values = np.array([getattr(side, name) for side in box.sides])
        variables[name] = ("number", values, {"units": OF_NUMBER, "long_name": meaning})
    coords = {
        "loop": ("loop", np.array(list(cases)), {"long_name": "where the loop is broken"}),
        "margin": ("margin", np.array(MARGINS), {"long_name": "margin"}),
        "number": ("number", number_names, {"long_name": "uncertain number"}),
    }
    return xr.Dataset(variables, coords=coords)


def perturbation_variables(box: Box, loop_cases: list[LoopCase]) -> dict[str, Variable]:
    """The uncertain numbers of the worst loops found: for each margin, and for the nearest unstable loop.

    Args:
        box: The box of the uncertain numbers.
        loop_cases: The worst case at each break point.

    Returns:
        The variables ``perturbation``, shape (loops, margins, numbers), and ``unstable``, shape (loops, numbers).
    """
    perturbations = []
    for case in loop_cases:
        perturbations.append([along_sides(box, numbers) for numbers in case.numbers])  # a row for each margin
    unstable = [along_sides(box, case.unstable) for case in loop_cases]
    worst_attributes = {"units": OF_NUMBER, "long_name": "numbers of the worst found"}
    unstable_attributes = {"units": OF_NUMBER, "long_name": "numbers of the nearest unstable loop"}
    return {
        "perturbation": (("loop", "margin", "number"), np.array(perturbations), worst_attributes),
        "unstable": (("loop", "number"), np.array(unstable), unstable_attributes),
    }


def along_sides(box: Box, numbers: Mapping[str, float]) -> list[float]:
    """The value of each uncertain number in the order of the box's sides; NaN for a number that is not given."""
    return [numbers.get(side.name, np.nan) for side in box.sides]


def multiloop_dataset(box: Box, case: JointCase | None) -> xr.Dataset:
    """The worst case for all commands at once as variables of a dataset, which is empty without such a case.

    Args:
        box: The box of the uncertain numbers.
        case: The worst case; None if it was not computed.
    """
    if case is None:
        return xr.Dataset()
    scalar = ()  # no dimension
    columns = {  # dimensions, values, unit, meaning
        "drawn": (scalar, case.drawn, "1", "worst disk margin of all commands at once, of all draws"),
        "found": (scalar, case.found, "1", "worst disk margin of all commands at once found in the box"),
        "bounded": (scalar, case.bounded, "1", "disk margin of all commands at once that holds on all of the box"),
        "frequency": (scalar, case.frequency, "rad/s", "frequency at which the worst loop found oscillates"),
        "gain": ("channel", np.abs(case.factors), "1", "gain of each command with which it does"),
        "phase": ("channel", np.angle(case.factors), "rad", "phase of each command with which it does"),
        "perturbation": ("number", along_sides(box, case.numbers), OF_NUMBER, "numbers of the worst found"),
        "cells": (scalar, case.cells, "1", "cells computed"),
    }
    variables = {}
    for name, (dims, values, unit, meaning) in columns.items():
        variables[f"multiloop_{name}"] = (dims, np.asarray(values), unit_and_meaning(unit, meaning))
    return xr.Dataset(variables, coords={"channel": list(case.channels)})
