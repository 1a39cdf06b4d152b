"""Compare the margins of several controllers on the same draws."""

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.comparison.compare import require_names, with_controller
from dssc_jax.analyses.comparison.rivals import ControllerTable, controller_table, with_own_controllers
from dssc_jax.analyses.defaults import BISECTIONS, POINTS
from dssc_jax.analyses.margins import Margins, join_margins, margin, margin_settings, part_margins
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.statistics import CONFIDENCE, compare_failures
from dssc_jax.study import Described, Study
from dssc_jax.study.code import code_names


@dataclass(eq=False)
class MarginContest(Analysis):
    """Margins of several controllers over one number, on common draws.

    The dataset is that of :class:`dssc_jax.analyses.margins.Margins`, with the additional dimension ``controller``.

    Args:
        margins: Margins by controller.
        tables: The ``[controller]`` table of each controller.
        seconds: Computing time.
    """

    kind = "margins"
    title = "Robustness margins of several controllers"
    table = ("controller", "draw")

    margins: dict[str, Margins]
    tables: dict[str, ControllerTable]
    seconds: float

    @classmethod
    def of(cls, study: Study, margins: dict[str, Margins], tables: dict[str, ControllerTable], seconds: float) -> Self:
        """Combine the margins of the controllers."""
        return cls(study, join_margins(margins, "controller", "controller"), margins, tables, seconds)

    def pairs(self, confidence: float = CONFIDENCE) -> list[dict[str, Any]]:
        """For every pair a, b: the share of draws on which a goes further, minus the share on which b does.

        Includes the exact interval and test for paired draws. Draws on which both are censored alike are ties.
        """
        pairs = []
        for a, b in itertools.combinations(self.margins, 2):
            left, right = self.margins[a].reached, self.margins[b].reached
            paired = compare_failures(left > right, right > left, confidence)
            further = {"a_further": paired.only_a, "b_further": paired.only_b, "draws": paired.draws}
            statement = {"difference": paired.difference, "interval": list(paired.interval), "p_value": paired.p_value}
            pairs.append({"a": a, "b": b, **further, **statement})
        return pairs

    @property
    def headline(self) -> str:
        """The answer in one line."""
        medians = ((name, margins.median) for name, margins in self.margins.items())
        values = (f"{name} {'before the start' if value is None else f'{value:.4g}'}" for name, value in medians)
        return f"median critical {next(iter(self.margins.values())).parameter}: {', '.join(values)}"

    def figure(self) -> Figure:
        """Plot the answer."""
        return plotting.theory(self.margins)

    def content(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        first = next(iter(self.margins.values())).summary()
        return {
            **{name: first[name] for name in ("parameter", "unit", "draws", "bounds", "criterion")},
            "confidence": CONFIDENCE,
            "controllers": {name: margins.summary() for name, margins in self.margins.items()},
            "pairs": self.pairs(),
            "seconds": self.seconds,
        }

    def settings(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        return {"margins": margin_settings(self.margins), "tables": self.tables, "seconds": self.seconds}

    @classmethod
    def restored(cls, stored: Stored) -> Self:
        """See :class:`Analysis`."""
        study, dataset, settings = stored
        tables = settings["tables"]

        require_named(study, tables)

        def study_of(name: str) -> Study:
            return study if isinstance(study, Described) else with_controller(study, name, tables[name])

        margins = part_margins(dataset, "controller", settings["margins"], study_of)
        return cls.of(study, margins, tables, settings["seconds"])


def require_named(study: Study, tables: dict[str, ControllerTable]) -> None:
    """Require that stored controllers refer to no code that the stored study does not name.

    Raises:
        ConfigError: one does; such a file was altered.
    """
    foreign = set(code_names(tables)) - set(code_names(study.table))
    if foreign:
        raise ConfigError(
            study.source, f"is damaged: its controllers name code that its study does not, {min(foreign)}"
        )


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
        ConfigError: a name is unknown or given twice, a controller does not fit, or :func:`dssc_jax.margin` raises it.
    """
    began = time.perf_counter()
    names = require_names(controllers)
    study = with_own_controllers(study.without_sweep(), names)
    tables = {name: controller_table(study, name) for name in names}
    studies = {name: with_controller(study, name, table) for name, table in tables.items()}
    each = (points + bisections) * study.config.draws
    walk = {"over": over, "bounds": bounds, "log": log, "points": points, "bisections": bisections}
    margins: dict[str, Margins] = {}

    def advance(done: int, total: int | None) -> None:
        del total
        if progress:
            progress(len(margins) * each + done, len(names) * each)

    for name, own in studies.items():
        margins[name] = margin(own, **walk, progress=advance)
    return MarginContest.of(study, margins, tables, time.perf_counter() - began)
