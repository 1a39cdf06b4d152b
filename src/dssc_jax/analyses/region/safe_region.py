"""The region of two numbers in which enough of all plants meet the requirements, found by following its boundary.

The two numbers lie on a lattice that is fixed in advance, and all its points share the same independent draws. At each
point the number of failed draws has a binomial law, so that an exact interval says whether at least 95 % of all plants
pass. The intervals hold for all points of the lattice together (Bonferroni), and hence for the points that the search
chooses to simulate, in whatever way. Between the points nothing is claimed.

The search simulates a coarse lattice and halves its cells where the verdicts at the corners differ. A side whose ends
differ belongs to two cells; both are halved, so that the boundary is followed until it closes or leaves the lattice.
"""

import time
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.conditions import criterion_of
from dssc_jax.analyses.defaults import HALVINGS
from dssc_jax.analyses.region.lattice import PASSING, TABLE, Lattice, PairVerdict, RegionAxis, thresholds
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.design.certification import mark
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.results.analysis import Analysis
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.statistics.order import first_integer
from dssc_jax.study import Study, takes_file

COARSE = 8
"""Cells of the coarse lattice in each direction."""
MOST_HALVINGS = 8
MOST_RANGES = 9  # lines of the lattice whose safe ranges are listed


@dataclass(frozen=True)
class SafeRange:
    """The ranges in which the second number is safe, at a value of the first."""

    first: Annotated[float, Quantity("that of the first number", "value of the first number")]
    second: Annotated[list[tuple[float, float]], Quantity("that of the second number", "ends of each safe range")]


@dataclass(frozen=True)
class RegionAnswer:
    """The answer for a region: where pairs of the two numbers meet the requirements, and what is claimed."""

    names: Annotated[tuple[str, str], Quantity("", "the two numbers")]
    units: Annotated[tuple[str, str], Quantity("", "their units")]
    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    draws: Annotated[int, Quantity("1", "number of draws at each point")]
    passing: Annotated[float, Quantity("1", "share of all plants that has to meet the requirements")]
    confidence: Annotated[float, Quantity("1", "confidence for all points together")]
    interval_method: Annotated[str, Quantity("", "method of the intervals")]
    failures_allowed: Annotated[int, Quantity("1", "most failed draws of a point that meets")]
    failures_refuting: Annotated[int, Quantity("1", "fewest failed draws of a point that fails")]
    lattice: Annotated[tuple[int, ...], Quantity("1", "values of each number")]
    simulated_points: Annotated[int, Quantity("1", "points that were simulated")]
    simulations: Annotated[int, Quantity("1", "number of simulations")]
    meets: Annotated[int, Quantity("1", "points that meet")]
    undecided: Annotated[int, Quantity("1", "points that are undecided")]
    fails: Annotated[int, Quantity("1", "points that fail")]
    safe_ranges: list[SafeRange]
    certified: Annotated[int, Quantity("1", "points that Theorem 1 certifies")]
    certificate: Annotated[str, Quantity("", "what Theorem 1 says")]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(eq=False)
class SafeRegion(Analysis):
    """The region of two numbers in which at least 95 % of all plants meet the requirements.

    The dataset has along ``first`` and ``second``, the values of the two numbers: ``verdict`` (a :class:`PairVerdict`),
    ``failures`` (-1 where nothing was simulated) and ``certified`` (whether Theorem 1 certifies the point).

    Args:
        names: Dotted names of the two numbers.
        log: Whether the lattice of each number is even in the logarithm.
        simulations: Number of simulations.
        certificate: What Theorem 1 says, in words.
        seconds: Computing time [s].
    """

    kind = "region"
    title = "Safe region of two numbers"
    table = TABLE

    names: tuple[str, str]
    log: tuple[bool, bool]
    simulations: int
    certificate: str
    seconds: float

    def points(self, verdict: PairVerdict) -> int:
        """Count the lattice points that have a given verdict."""
        return int(np.count_nonzero(self.dataset["verdict"].values == verdict))

    def safe_ranges(self) -> list[SafeRange]:
        """Ranges of the second number in which all simulated pairs meet, for some values of the first number.

        Values of the first number without such a range are left out. If more than :data:`MOST_RANGES` remain, so many
        of them are chosen, spread evenly.
        """
        first_values = self.dataset[self.table[0]].values
        second_values = self.dataset[self.table[1]].values
        lines = []
        for value, verdicts in zip(first_values, self.dataset["verdict"].values, strict=True):
            ends = meeting_ends(verdicts)
            if ends:
                ranges = [(float(second_values[low]), float(second_values[high])) for low, high in ends]
                lines.append(SafeRange(float(value), ranges))
        count = min(len(lines), MOST_RANGES)
        chosen = np.unique(np.linspace(0, len(lines) - 1, count).round().astype(int))
        return [lines[k] for k in chosen]

    @property
    def simulated_points(self) -> int:
        """Number of lattice points that were simulated."""
        return self.dataset["verdict"].size - self.points(PairVerdict.NOT_SIMULATED)

    @property
    def headline(self) -> str:
        """At how many of the simulated pairs enough of all plants meet the requirements, in one line."""
        return (
            f"at {self.points(PairVerdict.MEETS)} of {self.simulated_points} simulated pairs of "
            f"{' and '.join(self.names)} at least {100 * PASSING:g} % of all plants meet the requirements"
        )

    def figure(self) -> Figure:
        """Plot the verdict of every simulated pair, and what Theorem 1 certifies."""
        return plotting.region(self)

    @property
    def answer(self) -> RegionAnswer:
        """The number of points with each verdict, and the safe ranges, as ``summary.json`` has them."""
        draws = self.study.config.draws
        decisive_failures = thresholds(draws, self.dataset["verdict"].size)
        first_axis, second_axis = self.table
        return RegionAnswer(
            names=self.names,
            units=(self.dataset[first_axis].attrs["units"], self.dataset[second_axis].attrs["units"]),
            requirements=criterion_of(self.study),
            draws=draws,
            passing=PASSING,
            confidence=CONFIDENCE,
            interval_method="Clopper-Pearson, simultaneous over all points of the lattice (Bonferroni)",
            failures_allowed=decisive_failures.most_failures_to_meet,
            failures_refuting=decisive_failures.least_failures_to_refute,
            lattice=self.dataset["verdict"].shape,
            simulated_points=self.simulated_points,
            simulations=self.simulations,
            meets=self.points(PairVerdict.MEETS),
            undecided=self.points(PairVerdict.UNDECIDED),
            fails=self.points(PairVerdict.FAILS),
            safe_ranges=self.safe_ranges(),
            certified=int(self.dataset["certified"].sum()),
            certificate=self.certificate,
            seconds=self.seconds,
        )


def meeting_ends(verdicts: np.ndarray) -> list[tuple[int, int]]:
    """Find the first and last index of each run of neighbouring simulated pairs that meet, along a lattice line.

    Args:
        verdicts: A :class:`PairVerdict` for each point of the line, shape (count,).

    Returns:
        The pairs (first, last). The list is empty if no pair meets, or if the first or the last run may extend to where
        the line is not simulated, so that its end is unknown.
    """
    places = np.flatnonzero(verdicts != PairVerdict.NOT_SIMULATED)
    meets = verdicts[places] == PairVerdict.MEETS
    if not meets.any():
        return []
    may_begin_earlier = meets[0] and places[0] > 0
    may_end_later = meets[-1] and places[-1] < len(verdicts) - 1
    if may_begin_earlier or may_end_later:
        return []
    begins, ends = flag_runs(meets)  # an end is the position after the run
    first_places = places[begins].tolist()
    final_places = places[ends - 1].tolist()
    return list(zip(first_places, final_places, strict=True))


@takes_file
def region(
    study: Study,
    *,
    over: tuple[RegionAxis, RegionAxis],
    halvings: int = HALVINGS,
    progress: ProgressCallback | None = None,
) -> SafeRegion:
    """Find where at least 95 % of all plants meet the requirements, over two numbers, with 95 % confidence.

    Args:
        study: The study, or its file; its own sweep is ignored. The two numbers replace their laws. Draws are
            independent, and common to all points.
        over: The two numbers and their ranges.
        halvings: How often the cells of the coarse lattice of 8 x 8 cells are halved. A part of the region that fits
            into a coarse cell may be missed.
        progress: Called with the simulations done.

    Raises:
        ConfigError: A number or range is not admissible, draws are not independent, or too few to decide anything.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/motor.toml").override({"draws": 300, "loop.sample_time": 0.01})
        >>> gain = dj.RegionAxis("controller.k_p", 20.0, 400.0, True)
        >>> lag = dj.RegionAxis("unmodelled.mu", 0.005, 0.1, True)
        >>> dj.region(study, over=(gain, lag), halvings=0).summary()["simulated_points"]
        81
    """
    began = time.perf_counter()
    require_independent(study, "a binomial interval")
    study = study.without_sweep()
    count = lattice_size(study, over, halvings)
    lattice = Lattice(study, over, count, progress)
    lattice.follow_boundary(2**halvings)
    certified, text = certify_points(study, lattice)
    return SafeRegion(
        study=study,
        dataset=lattice.dataset(certified),
        names=(over[0].name, over[1].name),
        log=(over[0].log, over[1].log),
        simulations=lattice.simulations,
        certificate=text,
        seconds=time.perf_counter() - began,
    )


def lattice_size(study: Study, over: tuple[RegionAxis, RegionAxis], halvings: int) -> int:
    """Count the values of each number on the finest lattice, if all settings are admissible.

    Args:
        study: The study, for its number of draws.
        over: The two numbers and their ranges.
        halvings: How often the cells of the coarse lattice are halved.

    Raises:
        ConfigError: A range or the number of halvings is not admissible, the numbers are the same, or there are too
            few draws to decide any point.
    """
    for axis in over:
        is_range = np.isfinite(axis.low) and np.isfinite(axis.high) and axis.low < axis.high
        if not is_range or (axis.log and axis.low <= 0.0):
            rule = "needs finite LO < HI"
            if axis.log:
                rule += ", above 0 for a logarithmic lattice"
            raise ConfigError(axis.name, f"{rule}, got {axis.low:g} and {axis.high:g}")
    if over[0].name == over[1].name or not 0 <= halvings <= MOST_HALVINGS:
        raise ConfigError("region", f"needs two different numbers and 0 to {MOST_HALVINGS} halvings, got {halvings}")
    count = COARSE * 2**halvings + 1
    draws = study.config.draws

    def can_meet(number: int) -> bool:
        """Whether a point would meet if none of this number of draws failed there."""
        return thresholds(number, count**2).most_failures_to_meet >= 0

    if not can_meet(draws):
        least_draws = first_integer(can_meet, draws)
        raise ConfigError("draws", f"must be at least {least_draws} to decide a point of {count**2}, got {draws}")
    return count


def certify_points(study: Study, lattice: Lattice) -> tuple[np.ndarray, str]:
    """Check Theorem 1 at every point of a lattice, for all draws at once.

    Args:
        study: The study without a sweep.
        lattice: The lattice, for its axes.

    Returns:
        Whether the theorem certifies each point, shape (count, count), and in words what the theorem covers, or why it
        does not apply.
    """
    over = lattice.over
    sweep = {axis.name: values.tolist() for axis, values in zip(over, lattice.axes, strict=True)}
    swept = study.override({"sweep": sweep})
    certified, reason = mark(swept)
    if certified is None:
        return np.zeros(lattice.failures.shape, bool), f"Theorem 1 does not apply: {reason}"
    swept_names = list(swept.axes)  # in the order of the study
    in_lattice_order = certified.transpose([swept_names.index(axis.name) for axis in over])
    return in_lattice_order, "Theorem 1 covers the loop without lag and sampling, for all plants of the laws"
