"""Compare the margins of several controllers on the same draws."""

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Self

from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.comparison.rivals import Contestants, ControllerTable, with_controller
from dssc_jax.analyses.defaults import BISECTIONS, POINTS
from dssc_jax.analyses.margins import Margins, join_margins, margin, margin_parts, split_margins
from dssc_jax.analyses.margins.joined import MarginPart, NamedMargins, medians_text
from dssc_jax.analyses.margins.result import PARAMETER_UNIT
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.core.toml import TomlTable
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import read_description
from dssc_jax.statistics import CONFIDENCE, compare_failures
from dssc_jax.study import Described, Study
from dssc_jax.study.code import code_names


@dataclass(frozen=True)
class MarginPair:
    """Two controllers a and b on the same draws: on how many draws each passes further along the walk."""

    a: Annotated[str, Quantity("", "one controller")]
    b: Annotated[str, Quantity("", "the other controller")]
    a_further: Annotated[int, Quantity("1", "draws on which a goes further")]
    b_further: Annotated[int, Quantity("1", "draws on which b goes further")]
    draws: Annotated[int, Quantity("1", "number of draws")]
    difference: Annotated[float, Quantity("1", "share on which a goes further, minus the share on which b does")]
    interval: Annotated[tuple[float, float], Quantity("1", "exact interval of the difference")]
    p_value: Annotated[float, Quantity("1", "exact test for paired draws")]


@dataclass(frozen=True)
class MarginContestAnswer:
    """The margins of several controllers over one number: each alone, and every two compared draw by draw."""

    parameter: Annotated[str, Quantity("", "the number that is varied")]
    unit: Annotated[str, Quantity("", "unit of the number")]
    draws: Annotated[int, Quantity("1", "number of draws")]
    bounds: Annotated[tuple[float, float], Quantity(PARAMETER_UNIT, "start and end of the walk")]
    criterion: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    confidence: Annotated[float, Quantity("1", "confidence of each interval")]
    controllers: dict[str, NamedMargins]
    pairs: list[MarginPair]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(eq=False)
class MarginContest(Analysis):
    """Margins of several controllers over one number, on common draws.

    The dataset is that of :class:`dssc_jax.analyses.margins.Margins`, with the additional dimension ``controller``.

    Args:
        parts: The settings and units of the margins that the dataset does not contain, by controller.
        tables: The ``[controller]`` table of each controller.
        seconds: Computing time [s].
    """

    kind = "margins"
    title = "Robustness margins of several controllers"
    table = ("controller", "draw")

    parts: dict[str, MarginPart]
    tables: dict[str, ControllerTable]
    seconds: float

    @classmethod
    def of(cls, study: Study, margins: dict[str, Margins], tables: dict[str, ControllerTable], seconds: float) -> Self:
        """Create the contest from the margins of its controllers.

        Args:
            study: The study without its sweep.
            margins: The margins by controller.
            tables: The ``[controller]`` table of each controller.
            seconds: Computing time [s].
        """
        dataset = join_margins(margins, "controller", "controller")
        contest = cls(study, dataset, margin_parts(margins), tables, seconds)
        contest.margins = margins  # fills the cached property, which would otherwise read them from the dataset
        return contest

    @classmethod
    def load(cls, folder: str | Path, trust_code: bool = False) -> Self:
        """Load a contest from a folder; see :meth:`Analysis.load`.

        Raises:
            ConfigError: The folder is damaged, or a stored controller names code that the stored study does not name.
        """
        description = read_description(Path(folder), cls.kind)
        require_no_foreign_code(description["source"], description["study"], description["settings"].get("tables"))
        return super().load(folder, trust_code)

    @cached_property
    def margins(self) -> dict[str, Margins]:
        """The margins by controller, read from the dataset."""
        return split_margins(self.dataset, "controller", self.parts, self.study_of)

    def study_of(self, controller: str) -> Study:
        """The study with one of the controllers; the study itself if the code it names is not loaded."""
        if isinstance(self.study, Described):
            return self.study
        return with_controller(self.study, controller, self.tables[controller])

    def pairs(self, confidence: float = CONFIDENCE) -> list[MarginPair]:
        """Compare every two controllers a and b: on how many draws each passes further along the walk than the other.

        The walk leads from the safe end of the number's range to the other end. A draw is a tie if both controllers
        fail at the start of the walk, or both pass to its end. Interval and test are exact for paired draws.

        Args:
            confidence: Confidence of each interval.
        """
        pairs = []
        for a, b in itertools.combinations(self.margins, 2):
            reach_of_a = self.margins[a].reached
            reach_of_b = self.margins[b].reached
            paired = compare_failures(reach_of_a > reach_of_b, reach_of_b > reach_of_a, confidence)
            pair = MarginPair(
                a=a,
                b=b,
                a_further=paired.only_a,
                b_further=paired.only_b,
                draws=paired.draws,
                difference=paired.difference,
                interval=paired.interval,
                p_value=paired.p_value,
            )
            pairs.append(pair)
        return pairs

    @property
    def headline(self) -> str:
        """The median critical value of each controller, in one line."""
        return f"median critical {self.answer.parameter}: {medians_text(self.margins)}"

    def figure(self) -> Figure:
        """Plot the margins of all controllers over the number."""
        return plotting.theory(self.margins)

    @property
    def answer(self) -> MarginContestAnswer:
        """The margins of all controllers and of every pair, as ``summary.json`` has them."""
        first = next(iter(self.margins.values())).answer
        controllers = {}
        for name, margins in self.margins.items():
            controllers[name] = NamedMargins(margins.study.name, margins.answer)
        return MarginContestAnswer(
            parameter=first.parameter,
            unit=first.unit,
            draws=first.draws,
            bounds=first.bounds,
            criterion=first.criterion,
            confidence=CONFIDENCE,
            controllers=controllers,
            pairs=self.pairs(),
            seconds=self.seconds,
        )


def require_no_foreign_code(source: str, study: TomlTable, tables: object) -> None:
    """Require that stored controllers name only code that their study names, too.

    The user trusts the code that the study names. An altered table of controllers must not add other code, so this
    check runs before anything is imported.

    Args:
        source: Name of the file, for the message.
        study: The stored study.
        tables: The stored tables of the controllers.

    Raises:
        ConfigError: A table names other code.
    """
    foreign = set(code_names({"tables": tables})) - set(code_names(study))
    if foreign:
        raise ConfigError(source, f"is damaged: its controllers name code that its study does not, {min(foreign)}")


def compare_margins(
    study: Study,
    controllers: Sequence[str],
    *,
    over: str,
    bounds: tuple[float, float],
    log: bool = False,
    points: int = POINTS,
    bisections: int = BISECTIONS,
    progress: ProgressCallback | None = None,
) -> MarginContest:
    """Find every draw's critical value of one number for several controllers, on the same draws and noise.

    Args:
        study: The study; its own sweep is ignored. Gains: see :func:`dssc_jax.analyses.comparison.controller_table`.
        controllers: At least two names.
        over: The number that is varied. For this and the other settings see :func:`dssc_jax.margin`.
        bounds: The safe end, then the other end.
        log: Space the values evenly in the logarithm.
        points: Number of values in the bracketing grid.
        bisections: Number of bisections of the grid cell.
        progress: Called with the lanes done.

    Raises:
        ConfigError: A name is unknown or given twice, a controller does not fit, or :func:`dssc_jax.margin` raises it.
    """
    began = time.perf_counter()
    study, tables, studies = Contestants.of(study, controllers)
    lanes = (points + bisections) * study.config.draws
    walk = {"over": over, "bounds": bounds, "log": log, "points": points, "bisections": bisections}
    margins: dict[str, Margins] = {}

    def advance(finished_lanes: int, _: int | None) -> None:
        """Report the lanes done for all controllers; the argument counts those of the present controller alone."""
        if progress:
            progress(len(margins) * lanes + finished_lanes, len(studies) * lanes)

    for name, rival in studies.items():
        margins[name] = margin(rival, **walk, progress=advance)
    return MarginContest.of(study, margins, tables, time.perf_counter() - began)
