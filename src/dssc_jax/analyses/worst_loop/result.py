"""Worst case of the linearised loop: its dataset, answer, figure and folder."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.loop_margins.result import MARGIN_KINDS, MARGIN_UNIT
from dssc_jax.analyses.worst_loop.box import Box
from dssc_jax.analyses.worst_loop.joint import JointCase
from dssc_jax.analyses.worst_loop.search import MARGINS
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, unit_and_meaning
from dssc_jax.results.analysis import Analysis
from dssc_jax.study import Study
from dssc_jax.study.known_draws import study_of_draw

ALL_COMMANDS = "all commands"
"""Name of the margin of all commands at once, beside those of the break points."""
OPERATING_POINT = "whether the nearest unstable loop has an operating point within its limits"
BEYOND = (0.02, 0.01, 0.005, 0.002, 0.001)
"""Shares by which an unstable witness may lie farther from the middle of the box than the point found."""


class LoopCase(NamedTuple):
    """The worst case of one broken loop.

    Args:
        names: Dotted names of the numbers on which the loop depends.
        drawn: Worst value of each margin among the draws, shape (margins,).
        found: Worst value of each margin found in the box, shape (margins,).
        numbers: For each margin the numbers at which its worst value was found, by name.
        bounded: Values of the margins that hold on all of the box, shape (margins,); NaN if none was found.
        growth_found: Smallest growth of the box found that reaches an unstable loop; infinite if none was found.
        unstable: The numbers of that loop, by name.
        has_operating_point: Whether that loop has an operating point within its limits; one without counts as unstable.
        growth_bounded: Growth up to which the loop is proved to be stable.
        growable: Largest growth that was searched.
        cells: Number of cells that were computed.
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


@dataclass(frozen=True)
class WorstMargin:
    """The worst case of a margin."""

    unit: Annotated[str, Quantity("", "unit of the margin")]
    drawn: Annotated[float, Quantity(MARGIN_UNIT, "worst of all draws; None: infinite, or a loop is unstable")]
    found: Annotated[float, Quantity(MARGIN_UNIT, "worst found in the box; None: infinite, or a loop is unstable")]
    bounded: Annotated[float, Quantity(MARGIN_UNIT, "bound that holds on all of the box; None: none was found")]
    numbers: Annotated[dict[str, float], Quantity("that of the number", "the numbers that have the value found")]


@dataclass(frozen=True)
class LoopWorst:
    """The worst case of the loop broken at one place."""

    stable: Annotated[bool | None, Quantity("", "whether it is stable on all of the box; None: undecided")]
    growth_bounded: Annotated[float, Quantity("1", "growth of the box up to which the loop is stable")]
    growth_found: Annotated[float, Quantity("1", "growth that reaches an unstable loop; None: none was found")]
    growable: Annotated[float, Quantity("1", "largest growth that was searched")]
    unstable: Annotated[dict[str, float], Quantity("that of the number", "numbers of that loop; empty: none was found")]
    has_operating_point: Annotated[bool, Quantity("", "whether that loop has an operating point within its limits")]
    depends_on: Annotated[tuple[str, ...], Quantity("", "the numbers that change this loop")]
    cells: Annotated[int, Quantity("1", "parts of box and frequencies that were computed")]
    margins: dict[str, WorstMargin]


@dataclass(frozen=True)
class BoxSide:
    """The range of one uncertain number."""

    low: Annotated[float, Quantity("that of the number", "lower end")]
    high: Annotated[float, Quantity("that of the number", "upper end")]
    cut: Annotated[bool, Quantity("", "whether the law has no end there")]


@dataclass(frozen=True)
class MultiloopWorst:
    """The worst case of the disk margin of all commands at once."""

    drawn: Annotated[float, Quantity("1", "worst alpha of all draws; 0: a loop is unstable")]
    found: Annotated[float, Quantity("1", "worst alpha found in the box; 0: a loop is unstable")]
    bounded: Annotated[float, Quantity("1", "alpha that holds on all of the box; None: no bound was found")]
    numbers: Annotated[dict[str, float], Quantity("that of the number", "the numbers that have the value found")]
    frequency: Annotated[float, Quantity("rad/s", "frequency at which that loop oscillates")]
    factors: Annotated[dict[str, float], Quantity("1", "gain in each channel with which it does")]
    phases: Annotated[dict[str, float], Quantity("rad", "phase in each channel with which it does")]
    depends_on: Annotated[tuple[str, ...], Quantity("", "the numbers that change these loops")]
    cells: Annotated[int, Quantity("1", "parts of box and frequencies that were computed")]


@dataclass(frozen=True)
class WorstLoopAnswer:
    """Worst margins over the box of the laws, found and bounded, beside those of the draws."""

    draws: Annotated[int, Quantity("1", "number of draws")]
    sigma: Annotated[float, Quantity("1", "standard deviations at which laws without ends are cut")]
    taken: Annotated[str, Quantity("", "what is taken for parts of the loop without a derivative")]
    box: Annotated[dict[str, BoxSide], Quantity("", "by uncertain number")]
    loops: Annotated[dict[str, LoopWorst], Quantity("", "by break point")]
    multiloop: Annotated[
        dict[str, MultiloopWorst],
        Quantity("", "all commands perturbed at once; empty for a single command, or with stated break points"),
    ]
    points: Annotated[int, Quantity("1", "points of the box at which the loop was linearised")]
    most_points: Annotated[int, Quantity("1", "largest number of these points")]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(eq=False)
class WorstLoop(Analysis):
    """Worst case of the linearised loop over the box of the laws.

    The dataset has along ``loop`` (the break point) and ``margin``: ``drawn``, ``found`` and ``bounded``, and the
    ``perturbation`` (along ``number``) that has the value found. Where several commands have an effect,
    ``multiloop_drawn``, ``multiloop_found`` and ``multiloop_bounded`` are the disk margin of all of them at once,
    ``multiloop_perturbation`` (along ``number``) has the value found, and along ``channel`` the loop there oscillates
    with ``multiloop_gain`` and ``multiloop_phase``.

    Args:
        sigma: Standard deviations at which laws without ends are cut.
        taken: What is taken for parts of the loop that have no derivative, in words.
        points: Number of points of the box at which the loop was linearised.
        most_points: Largest number of these points.
        seconds: Computing time [s].
    """

    kind = "worst-loop"
    title = "Worst case of the linearised loop"
    table = ("loop", "margin")

    sigma: float
    taken: tuple[str, ...]
    points: int
    most_points: int
    seconds: float

    def numbers(self, loop: str, margin: str) -> dict[str, float]:
        """The numbers of the study that have the worst value found of a margin."""
        return numbers_present(self.dataset["perturbation"].sel(loop=loop, margin=margin))

    def witness(self, loop: str, margin: str) -> Study:
        """The study with the numbers of :meth:`numbers` in place of their laws."""
        return study_of_draw(self.study, self.numbers(loop, margin))

    def unstable(self, loop: str) -> dict[str, float]:
        """Numbers of the nearest unstable loop found; empty: none was found."""
        return numbers_present(self.dataset["unstable"].sel(loop=loop))

    def unstable_witness(self, loop: str) -> Study | None:
        """The study of an unstable loop: its numbers lie up to 2 % beyond those of :meth:`unstable`.

        Nearer numbers are taken if the study does not accept those, as where a root of a difference is undefined. None
        if no unstable loop was found.
        """
        if not self.unstable(loop):
            return None
        for share in BEYOND:
            try:
                return study_of_draw(self.study, self.numbers_beyond(loop, share))
            except ConfigError:
                continue
        return study_of_draw(self.study, self.unstable(loop))

    def numbers_beyond(self, loop: str, share: float) -> dict[str, float]:
        """Numbers that lie farther from the middle of the box than those of :meth:`unstable`, by a share."""
        numbers = {}
        for name, value in self.unstable(loop).items():
            side = self.dataset.sel(number=name)
            low = float(side["low"])
            high = float(side["high"])
            if bool(side["logarithmic"]):
                numbers[name] = value * np.exp(share * (np.log(value) - 0.5 * (np.log(low) + np.log(high))))
            else:
                numbers[name] = value + share * (value - 0.5 * (low + high))
        return numbers

    def witnesses(self) -> dict[str, Study]:
        """The studies of all worst cases, by loop and margin; ``LOOP-stability`` is unstable."""
        studies = {}
        for loop in self.loops:
            name = loop.replace(" ", "-")
            for margin in MARGINS:
                studies[f"{name}-{margin}"] = self.witness(loop, margin)
            unstable = self.unstable_witness(loop)
            if unstable is not None:
                studies[f"{name}-stability"] = unstable
        for name, worst in self.multiloop.items():
            studies[f"{name.replace(' ', '-')}-disk"] = study_of_draw(self.study, worst.numbers)
        return studies

    @property
    def loops(self) -> list[str]:
        """Names of the break points."""
        return list(map(str, self.dataset["loop"].values))

    @property
    def headline(self) -> str:
        """Whether the loop broken at the first place is stable on all of the box, and its disk margin, in one line."""
        loop = self.loops[0]
        worst = self.answer.loops[loop]
        disk = worst.margins["disk"]
        if worst.stable is False:
            verdict = "are unstable" if worst.has_operating_point else "have no operating point within their limits"
            return f"broken at {loop}: some loops of the box {verdict}, from {worst.growth_found:.3g} of its size on"
        if worst.stable is None:
            return f"broken at {loop}: no unstable loop was found in the box, and none is excluded"
        is_bounded = np.isfinite(disk.bounded)
        least = f"a disk margin of at least {disk.bounded:.3g}" if is_bounded else "no bound of its margins"
        text = (
            f"broken at {loop}: stable on all of the box, with {least} "
            f"(worst found {disk.found:.3g}, worst drawn {disk.drawn:.3g}), and up to {worst.growth_bounded:.3g} "
            "times its size"
        )
        for name, joint in self.multiloop.items():
            is_bounded = np.isfinite(joint.bounded)
            text += f"; {name}: " + (f"at least {joint.bounded:.3g}" if is_bounded else "no bound")
            text += f" (worst found {joint.found:.3g})"
        return text

    def figure(self) -> Figure:
        """Plot the worst drawn, the worst found and the bounded value of each margin, at every break point."""
        return plotting.worst_loop(self)

    def worst_of(self, loop: str) -> LoopWorst:
        """The worst case of the loop broken at one place, read from the dataset."""
        data = self.dataset.sel(loop=loop)
        margins = {}
        for name in MARGINS:
            values = data.sel(margin=name)
            margins[name] = WorstMargin(
                unit=MARGIN_KINDS[name].unit,
                drawn=float(values["drawn"]),
                found=float(values["found"]),
                bounded=float(values["bounded"]),
                numbers=self.numbers(loop, name),
            )
        growth_found = float(data["growth_found"])
        growth_bounded = float(data["growth_bounded"])
        stable = None
        if growth_bounded >= 1.0:
            stable = True
        elif growth_found <= 1.0:
            stable = False
        return LoopWorst(
            stable=stable,
            growth_bounded=growth_bounded,
            growth_found=growth_found,
            growable=float(data["growable"]),
            unstable=self.unstable(loop),
            has_operating_point=bool(data["has_operating_point"]),
            depends_on=tuple(map(str, self.dataset["number"].values[data["depends"].values])),
            cells=int(data["cells"]),
            margins=margins,
        )

    @property
    def multiloop(self) -> dict[str, MultiloopWorst]:
        """The worst case of all commands at once, under its name; empty if it was not computed."""
        if "multiloop_found" not in self.dataset:
            return {}
        data = self.dataset
        channels = list(map(str, data["channel"].values))
        numbers = numbers_present(data["multiloop_perturbation"])
        return {
            ALL_COMMANDS: MultiloopWorst(
                drawn=float(data["multiloop_drawn"]),
                found=float(data["multiloop_found"]),
                bounded=float(data["multiloop_bounded"]),
                numbers=numbers,
                frequency=float(data["multiloop_frequency"]),
                factors=dict(zip(channels, data["multiloop_gain"].values.tolist(), strict=True)),
                phases=dict(zip(channels, data["multiloop_phase"].values.tolist(), strict=True)),
                depends_on=tuple(numbers),
                cells=int(data["multiloop_cells"]),
            )
        }

    @property
    def answer(self) -> WorstLoopAnswer:
        """The worst case at every break point, as ``summary.json`` has it."""
        box = {}
        for name in self.dataset["number"].values:
            side = self.dataset.sel(number=name)
            box[str(name)] = BoxSide(float(side["low"]), float(side["high"]), bool(side["cut"]))
        return WorstLoopAnswer(
            draws=self.study.config.draws,
            sigma=self.sigma,
            taken="; ".join(self.taken) or "none; every part has a derivative",
            box=box,
            loops={loop: self.worst_of(loop) for loop in self.loops},
            multiloop=self.multiloop,
            points=self.points,
            most_points=self.most_points,
            seconds=self.seconds,
        )


def numbers_present(values: xr.DataArray) -> dict[str, float]:
    """The values along ``number`` that are not missing, by the number's name."""
    numbers = {}
    for name, value in zip(values["number"].values, values.values, strict=True):
        if not np.isnan(value):
            numbers[str(name)] = float(value)
    return numbers


def worst_dataset(box: Box, cases: Mapping[str, LoopCase]) -> xr.Dataset:
    """The dataset of :class:`WorstLoop` for single break points, from the worst case at each, by name."""
    names = [side.name for side in box.sides]
    of_margin = {"units": "that of the margin"}
    of_number = {"units": "that of the number"}

    def rows(numbers: Mapping[str, float]) -> list[float]:
        return [numbers.get(name, np.nan) for name in names]

    loop_cases = list(cases.values())
    table = ("loop", "margin")
    perturbations = np.array([[rows(numbers) for numbers in case.numbers] for case in loop_cases])
    unstable = np.array([rows(case.unstable) for case in loop_cases])
    depends = np.array([[name in case.names for name in names] for case in loop_cases])
    columns = {
        "perturbation": ((*table, "number"), perturbations, of_number | {"long_name": "numbers of the worst found"}),
        "unstable": (("loop", "number"), unstable, of_number | {"long_name": "numbers of the nearest unstable loop"}),
        "has_operating_point": (
            "loop",
            np.array([case.has_operating_point for case in loop_cases]),
            {"long_name": OPERATING_POINT},
        ),
        "depends": (("loop", "number"), depends, {"long_name": "whether the number changes the loop"}),
    }
    for name, meaning in {
        "drawn": "worst margin of all draws",
        "found": "worst margin found in the box",
        "bounded": "margin that holds on all of the box",
    }.items():
        values = np.stack([getattr(case, name) for case in loop_cases])
        columns[name] = (table, values, of_margin | {"long_name": meaning})
    for name, meaning in {
        "growth_found": "growth of the box that reaches an unstable loop",
        "growth_bounded": "growth of the box up to which the loop is stable",
        "growable": "largest growth that was searched",
        "cells": "cells computed",
    }.items():
        values = np.array([getattr(case, name) for case in loop_cases])
        columns[name] = ("loop", values, unit_and_meaning("1", meaning))
    for name, meaning in {
        "low": "lower end",
        "high": "upper end",
        "cut": "whether the law has no end there",
        "logarithmic": "whether the box grows in the logarithm",
    }.items():
        values = np.array([getattr(side, name) for side in box.sides])
        columns[name] = ("number", values, of_number | {"long_name": meaning})
    coords = {
        "loop": ("loop", np.array(list(cases)), {"long_name": "where the loop is broken"}),
        "margin": ("margin", np.array(MARGINS), {"long_name": "margin"}),
        "number": ("number", np.array(names), {"long_name": "uncertain number"}),
    }
    return xr.Dataset(columns, coords=coords)


def multiloop_dataset(box: Box, case: JointCase | None) -> xr.Dataset:
    """The variables of a :class:`WorstLoop` for all commands at once; an empty dataset if there is no such case."""
    if case is None:
        return xr.Dataset()
    numbers = [case.numbers.get(side.name, np.nan) for side in box.sides]
    columns = {
        "drawn": ((), case.drawn, "1", "worst disk margin of all commands at once, of all draws"),
        "found": ((), case.found, "1", "worst disk margin of all commands at once found in the box"),
        "bounded": ((), case.bounded, "1", "disk margin of all commands at once that holds on all of the box"),
        "frequency": ((), case.frequency, "rad/s", "frequency at which the worst loop found oscillates"),
        "gain": ("channel", np.abs(case.factors), "1", "gain of each command with which it does"),
        "phase": ("channel", np.angle(case.factors), "rad", "phase of each command with which it does"),
        "perturbation": ("number", numbers, "that of the number", "numbers of the worst found"),
        "cells": ((), case.cells, "1", "cells computed"),
    }
    variables = {}
    for name, (dims, values, unit, meaning) in columns.items():
        variables[f"multiloop_{name}"] = (dims, np.asarray(values), unit_and_meaning(unit, meaning))
    return xr.Dataset(variables, coords={"channel": list(case.channels)})
