"""Worst case of the linearised loop: its answer, its witnesses and its figure."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.loop_margins.result import MARGIN_KINDS, MARGIN_UNIT
from dssc_jax.analyses.worst_loop.search import MARGINS
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.results.analysis import Analysis
from dssc_jax.study import Study
from dssc_jax.study.known_draws import study_of_draw

ALL_COMMANDS = "all commands"
"""Name of the margin of all commands at once, beside those of the break points."""
BEYOND = (0.02, 0.01, 0.005, 0.002, 0.001)
"""Shares by which an unstable witness may lie farther from the middle of the box than the point found."""


@dataclass(frozen=True)
class WorstMargin:
    """The worst case of a margin at one break point: among the draws, found in the box, and bounded for all of it."""

    unit: Annotated[str, Quantity("", "unit of the margin")]
    drawn: Annotated[float, Quantity(MARGIN_UNIT, "worst of all draws; None: infinite, or a loop is unstable")]
    found: Annotated[float, Quantity(MARGIN_UNIT, "worst found in the box; None: infinite, or a loop is unstable")]
    bounded: Annotated[float, Quantity(MARGIN_UNIT, "bound that holds on all of the box; None: none was found")]
    numbers: Annotated[dict[str, float], Quantity("that of the number", "the numbers that have the value found")]


@dataclass(frozen=True)
class LoopWorst:
    """The worst case of the loop broken at one place: whether it is stable on the box, and its margins by name."""

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
    """The range of one uncertain number: a side of the box."""

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

    The dataset has along ``loop`` (the break point) and ``margin`` the values ``drawn``, ``found`` and ``bounded``.
    Along ``number``, too, it has ``perturbation``, the uncertain numbers at which ``found`` was found. Where several
    commands have an effect, ``multiloop_drawn``, ``multiloop_found`` and ``multiloop_bounded`` are the disk margin of
    all commands at once, and ``multiloop_perturbation`` (along ``number``) are the numbers at which it was found. The
    loop with these numbers oscillates if the commands have the factors ``multiloop_gain`` and ``multiloop_phase``
    (along ``channel``).

    Args:
        sigma: Standard deviations at which laws without ends are cut.
        taken: The smooth substitutes that were taken for parts of the loop without a derivative, in words.
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
        """The numbers of the study with which a margin has the worst value found, by dotted name.

        Args:
            loop: Name of the break point.
            margin: Name of the margin.
        """
        return numbers_present(self.dataset["perturbation"].sel(loop=loop, margin=margin))

    def witness(self, loop: str, margin: str) -> Study:
        """The study of the worst loop found: the numbers of :meth:`numbers` replace their laws.

        Args:
            loop: Name of the break point.
            margin: Name of the margin.
        """
        return study_of_draw(self.study, self.numbers(loop, margin))

    def unstable(self, loop: str) -> dict[str, float]:
        """Numbers of the unstable loop found nearest to the middle of the box, by dotted name; empty: none was found.

        Args:
            loop: Name of the break point.
        """
        return numbers_present(self.dataset["unstable"].sel(loop=loop))

    def unstable_witness(self, loop: str) -> Study | None:
        """The study of an unstable loop, with numbers up to 2 % beyond those of :meth:`unstable`; None: none was found.

        If the study does not accept numbers so far out, for instance because the root of a difference is undefined
        there, numbers nearer to those of :meth:`unstable` are taken.

        Args:
            loop: Name of the break point.
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
        """Numbers that lie farther from the middle of the box than those of :meth:`unstable`.

        Args:
            loop: Name of the break point.
            share: Additional distance from the middle, relative to the distance of the numbers of :meth:`unstable`.
        """
        numbers = {}
        for name, value in self.unstable(loop).items():
            side = self.dataset.sel(number=name)
            low = float(side["low"])
            high = float(side["high"])
            if bool(side["logarithmic"]):
                middle = 0.5 * (np.log(low) + np.log(high))
                numbers[name] = value * np.exp(share * (np.log(value) - middle))
            else:
                middle = 0.5 * (low + high)
                numbers[name] = value + share * (value - middle)
        return numbers

    def witnesses(self) -> dict[str, Study]:
        """The studies of all worst cases, by a name ``LOOP-MARGIN``, or ``LOOP-stability`` for an unstable loop."""
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
        """One line on the loop broken at the first place: whether it is stable on all the box, and its disk margin."""
        loop = self.loops[0]
        worst = self.answer.loops[loop]
        disk = worst.margins["disk"]
        if worst.stable is False:
            verdict = "are unstable" if worst.has_operating_point else "have no operating point within their limits"
            return f"broken at {loop}: some loops of the box {verdict}, from {worst.growth_found:.3g} of its size on"
        if worst.stable is None:
            return f"broken at {loop}: no unstable loop was found in the box, and none is excluded"
        bound = "no bound of its margins"
        if np.isfinite(disk.bounded):
            bound = f"a disk margin of at least {disk.bounded:.3g}"
        text = (
            f"broken at {loop}: stable on all of the box, with {bound} "
            f"(worst found {disk.found:.3g}, worst drawn {disk.drawn:.3g}), and up to {worst.growth_bounded:.3g} "
            "times its size"
        )
        for name, joint in self.multiloop.items():
            bound = f"at least {joint.bounded:.3g}" if np.isfinite(joint.bounded) else "no bound"
            text += f"; {name}: {bound} (worst found {joint.found:.3g})"
        return text

    def figure(self) -> Figure:
        """Plot for every break point and margin the worst value of the draws, the worst value found, and the bound."""
        return plotting.worst_loop(self)

    def worst_of(self, loop: str) -> LoopWorst:
        """The worst case of the loop broken at one place, read from the dataset.

        Args:
            loop: Name of the break point.
        """
        data = self.dataset.sel(loop=loop)
        growth_found = float(data["growth_found"])
        growth_bounded = float(data["growth_bounded"])
        stable = None  # undecided
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
            margins={name: self.worst_margin(loop, name) for name in MARGINS},
        )

    def worst_margin(self, loop: str, margin: str) -> WorstMargin:
        """The worst case of one margin of the loop broken at one place, read from the dataset.

        Args:
            loop: Name of the break point.
            margin: Name of the margin.
        """
        values = self.dataset.sel(loop=loop, margin=margin)
        return WorstMargin(
            unit=MARGIN_KINDS[margin].unit,
            drawn=float(values["drawn"]),
            found=float(values["found"]),
            bounded=float(values["bounded"]),
            numbers=self.numbers(loop, margin),
        )

    @property
    def multiloop(self) -> dict[str, MultiloopWorst]:
        """The worst case of all commands at once, under the name :data:`ALL_COMMANDS`; empty if it was not computed."""
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
    """The values along the dimension ``number`` that are not NaN, by the number's dotted name."""
    numbers = {}
    for name, value in zip(values["number"].values, values.values, strict=True):
        if not np.isnan(value):
            numbers[str(name)] = float(value)
    return numbers
