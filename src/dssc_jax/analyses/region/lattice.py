"""A lattice over two numbers, with the failed draws at each point and the search along its boundary."""

from collections.abc import Iterable
from enum import IntEnum
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.core.quantities import unit_and_meaning
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import BLOCK
from dssc_jax.engine.evaluation import Evaluator
from dssc_jax.statistics import CONFIDENCE, clopper_pearson
from dssc_jax.study import Study

PASSING = 0.95  # share of all plants that has to meet the requirements
TABLE = ("first", "second")
"""Dimensions of the dataset: the two numbers."""


class PairVerdict(IntEnum):
    """Whether enough of all plants meet the requirements at a pair of values, with confidence for all pairs at once."""

    NOT_SIMULATED = -1
    MEETS = 0
    UNDECIDED = 1
    FAILS = 2


class CellSide(NamedTuple):
    """A side of a cell of the lattice: from the point (i, j) to the point (i + di, j + dj)."""

    i: int
    j: int
    di: int
    dj: int

    @property
    def start(self) -> tuple[int, int]:
        """The point at which the side begins."""
        return self.i, self.j

    @property
    def end(self) -> tuple[int, int]:
        """The point at which the side ends."""
        return self.i + self.di, self.j + self.dj

    @property
    def opposite(self) -> tuple["CellSide", "CellSide"]:
        """For each of the two cells that share this side, the side of the cell opposite to it.

        A cell may lie outside the lattice; its opposite side then does, too.
        """
        before = CellSide(self.i - self.dj, self.j - self.di, self.di, self.dj)
        after = CellSide(self.i + self.dj, self.j + self.di, self.di, self.dj)
        return before, after


class RegionAxis(NamedTuple):
    """One of the two numbers over which a region is searched, and its range.

    Args:
        name: Dotted name of the number.
        low: Lower end of the range.
        high: Upper end of the range.
        log: Whether the lattice is even in the logarithm of the number.
    """

    name: str
    low: float
    high: float
    log: bool = False

    def values(self, count: int) -> np.ndarray:
        """Return ``count`` evenly spaced values of the number from the lower to the upper end, shape (count,)."""
        if self.log:
            return np.geomspace(self.low, self.high, count)
        return np.linspace(self.low, self.high, count)


class Thresholds(NamedTuple):
    """Numbers of failed draws that decide a point of the lattice.

    Args:
        most_failures_to_meet: Largest number of failed draws with which a point meets the requirements; -1 if even 0
            failures do not prove it.
        least_failures_to_refute: Smallest number of failed draws with which a point fails; the number of draws + 1 if
            even all draws failing does not prove it.
    """

    most_failures_to_meet: int
    least_failures_to_refute: int


def thresholds(draws: int, points: int) -> Thresholds:
    """Compute the numbers of failed draws that decide a point, with confidence for all points of the lattice together.

    Args:
        draws: Number of draws at each point.
        points: Number of points of the lattice.
    """
    intervals = clopper_pearson(np.arange(draws + 1), draws, 1.0 - (1.0 - CONFIDENCE) / points)
    meeting_failures = np.flatnonzero(intervals[:, 1] <= 1.0 - PASSING)
    refuting_failures = np.flatnonzero(intervals[:, 0] > 1.0 - PASSING)
    return Thresholds(
        most_failures_to_meet=int(meeting_failures.max(initial=-1)),
        least_failures_to_refute=int(refuting_failures.min(initial=draws + 1)),
    )


class Lattice:
    """The points of a lattice over two numbers, with the failed draws at each point that was simulated.

    A point is a pair of indices (i, j) of the values of the first and the second number. ``failures``, shape
    (count, count), is the number of failed draws at each point, and -1 at a point that was not simulated.

    Args:
        study: The study without a sweep.
        over: The two numbers and their ranges.
        count: Number of values of each number.
        progress: Called with the simulations done.
    """

    def __init__(
        self, study: Study, over: tuple[RegionAxis, RegionAxis], count: int, progress: ProgressCallback | None
    ) -> None:
        """Lay out the lattice, and compile the study; nothing is simulated yet."""
        self.study = study
        self.over = over
        self.progress = progress
        self.axes = [axis.values(count) for axis in over]
        self.failures = np.full((count, count), -1)
        self.thresholds = thresholds(study.config.draws, count**2)
        extents = {axis.name: (axis.low, axis.high) for axis in over}
        self.evaluator = Evaluator(study, extents, BLOCK)
        self.drawn = self.evaluator.values_of_draws(slice(0, study.config.draws))

    def verdicts(self) -> np.ndarray:
        """Return the :class:`PairVerdict` at each point, shape (count, count)."""
        verdicts = np.where(
            self.failures <= self.thresholds.most_failures_to_meet, PairVerdict.MEETS, PairVerdict.UNDECIDED
        )
        verdicts = np.where(self.failures >= self.thresholds.least_failures_to_refute, PairVerdict.FAILS, verdicts)
        return np.where(self.failures < 0, PairVerdict.NOT_SIMULATED, verdicts)

    @property
    def simulations(self) -> int:
        """Number of simulations done."""
        return int(np.count_nonzero(self.failures >= 0)) * self.study.config.draws

    def simulate(self, points: Iterable[tuple[int, int]]) -> None:
        """Simulate all draws at each of the points (i, j); points that are simulated already are left out."""
        new_points = sorted({point for point in points if self.failures[point] < 0})
        if not new_points:
            return
        draws = self.study.config.draws
        first_places, second_places = np.array(new_points).T
        values = {name: np.tile(column, len(new_points)) for name, column in self.drawn.items()}
        values[self.over[0].name] = np.repeat(self.axes[0][first_places], draws)
        values[self.over[1].name] = np.repeat(self.axes[1][second_places], draws)
        indices = np.tile(np.arange(draws), len(new_points))
        failed = self.evaluator.fails(indices, values).reshape(len(new_points), draws)
        self.failures[first_places, second_places] = np.count_nonzero(failed, axis=1)
        if self.progress:
            self.progress(self.simulations, None)  # how many will follow is not known

    def follow_boundary(self, stride: int) -> None:
        """Simulate the coarse lattice, then its boundary at ever finer strides down to 1.

        Args:
            stride: Distance of neighbouring points of the coarse lattice, in points of the finest lattice.
        """
        count = len(self.failures)
        coarse = range(0, count, stride)
        self.simulate(product(coarse, coarse))
        while stride > 1:
            half = stride // 2
            for i, j in self.mixed_cells(stride):  # simulate the corners of the four cells of half the side
                self.simulate(product((i, i + half, i + stride), (j, j + half, j + stride)))
            stride = half
            self.close_boundary(stride)

    def mixed_cells(self, stride: int) -> list[tuple[int, int]]:
        """The cells that the boundary crosses, each given by its corner (i, j) with the smallest indices.

        All four corners of such a cell are simulated, and their verdicts are not all the same.

        Args:
            stride: Length of a cell's side, in points of the finest lattice.
        """
        verdicts = self.verdicts()
        end = len(self.failures) - 1
        cells = []
        for i in range(0, end, stride):
            for j in range(0, end, stride):
                corners = verdicts[i : i + stride + 1 : stride, j : j + stride + 1 : stride]
                if PairVerdict.NOT_SIMULATED < corners.min() < corners.max():
                    cells.append((i, j))
        return cells

    def close_boundary(self, stride: int) -> None:
        """Simulate the cells on both sides of the boundary, until it closes or leaves the lattice.

        Args:
            stride: Length of a cell's side, in points of the finest lattice.
        """
        while True:
            points: set[tuple[int, int]] = set()
            for side in self.boundary_sides(stride):
                points |= self.corners_beside(side)
            if not any(self.failures[point] < 0 for point in points):
                return
            self.simulate(points)

    def boundary_sides(self, stride: int) -> list[CellSide]:
        """Find the sides of cells that the boundary crosses: both ends are simulated and have different verdicts.

        Args:
            stride: Length of a cell's side, in points of the finest lattice.
        """
        verdicts = self.verdicts()
        last = len(self.failures) - 1
        is_simulated = verdicts != PairVerdict.NOT_SIMULATED
        crossed_sides = []
        for i, j in np.argwhere(is_simulated).tolist():
            if i % stride or j % stride:
                continue  # a point of finer cells only
            for side in (CellSide(i, j, stride, 0), CellSide(i, j, 0, stride)):
                is_complete = max(side.end) <= last and is_simulated[side.end]
                if is_complete and verdicts[side.end] != verdicts[side.start]:
                    crossed_sides.append(side)
        return crossed_sides

    def corners_beside(self, side: CellSide) -> set[tuple[int, int]]:
        """The corners beyond the ends of a side, of the cells that have this side.

        Two cells have the side in common; at the edge of the lattice only one cell has it.
        """
        last = len(self.failures) - 1
        corners: set[tuple[int, int]] = set()
        for opposite in side.opposite:
            if min(opposite.start) >= 0 and max(opposite.start) <= last:
                corners |= {opposite.start, opposite.end}
        return corners

    def dataset(self, certified: np.ndarray) -> xr.Dataset:
        """Make the dataset of :class:`~dssc_jax.analyses.region.safe_region.SafeRegion`.

        Args:
            certified: Whether Theorem 1 certifies each point, shape (count, count).
        """
        flags = {
            "flag_values": [verdict.value for verdict in PairVerdict],
            "flag_meanings": " ".join(verdict.name.lower() for verdict in PairVerdict),
        }
        columns = {
            "verdict": (TABLE, self.verdicts(), {"long_name": "whether 95 % of all plants pass", **flags}),
            "failures": (TABLE, self.failures, {"long_name": "failed draws, -1: not simulated"}),
            "certified": (TABLE, certified, {"long_name": "whether Theorem 1 certifies the point"}),
        }
        coords = {}
        for dimension, axis, values in zip(TABLE, self.over, self.axes, strict=True):
            quantity = self.study.quantities[axis.name]
            coords[dimension] = (dimension, values, unit_and_meaning(quantity.unit, quantity.meaning))
        return xr.Dataset(columns, coords=coords, attrs={"title": self.study.name})
