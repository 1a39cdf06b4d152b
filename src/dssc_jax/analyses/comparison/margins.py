"""Margins of several controllers on the same draws: who goes how far, and who goes further."""

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dssc_jax.analyses.comparison.compare import require_names, with_controller
from dssc_jax.analyses.comparison.rivals import controller_table
from dssc_jax.analyses.margins import Margins, margin
from dssc_jax.analyses.margins.search import BISECTIONS, POINTS
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.results.analysis_folder import require_free
from dssc_jax.statistics import CONFIDENCE, compare_failures
from dssc_jax.study import Study


@dataclass(frozen=True)
class MarginContest:
    """Margins of controllers over one number, draw by draw on common draws.

    Args:
        margins: By controller.
        seconds: What it took.
    """

    margins: dict[str, Margins]
    seconds: float

    def pairs(self, confidence: float = CONFIDENCE) -> list[dict[str, Any]]:
        """Every pair a, b: on which share of all draws a goes further, less that on which b does.

        With the exact interval and test of paired draws. Draws on which both are censored alike are ties.
        """
        found = []
        for a, b in itertools.combinations(self.margins, 2):
            left, right = self.margins[a].reached, self.margins[b].reached
            told = compare_failures(left > right, right > left, confidence)
            further = {"a_further": told.only_a, "b_further": told.only_b, "draws": told.draws}
            statement = {"difference": told.difference, "interval": list(told.interval), "p_value": told.p_value}
            found.append({"a": a, "b": b, **further, **statement})
        return found

    def summary(self, confidence: float = CONFIDENCE) -> dict[str, Any]:
        """The contest in plain numbers, for JSON."""
        first = next(iter(self.margins.values())).summary()
        return {
            **{name: first[name] for name in ("study", "parameter", "unit", "draws", "bounds", "criterion")},
            "confidence": confidence,
            "controllers": {name: found.summary() for name, found in self.margins.items()},
            "pairs": self.pairs(confidence),
            "seconds": self.seconds,
        }

    def save(self, folder: str | Path) -> list[Path]:
        """Write each controller's margins into a folder of its own, which :func:`dssc_jax.load` reads.

        Raises:
            ConfigError: one of them holds something else.
        """
        for name in self.margins:
            require_free(Path(folder) / name, "margin")
        return [found.save(Path(folder) / name) for name, found in self.margins.items()]


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
    """Every draw's critical value of one number under each of several controllers, on the same draws and noise.

    Args:
        study: The study; its own sweep is left aside. Gains: see :func:`dssc_jax.analyses.comparison.controller_table`.
        controllers: At least two names.
        over: What is walked, see :func:`dssc_jax.margin`, as are the rest.
        bounds: The safe end, then the other.
        log: Walk evenly in the logarithm.
        points: Values of the bracketing grid.
        bisections: Halvings of the grid's cell.
        progress: Told of the lanes done.

    Raises:
        ConfigError: a name is unknown or given twice, a controller does not fit, or :func:`dssc_jax.margin` says so.
    """
    began = time.perf_counter()
    names = require_names(controllers)
    studies = {name: with_controller(study, name, controller_table(study, name)) for name in names}
    each = (points + bisections) * study.config.draws
    found: dict[str, Margins] = {}

    def advance(done: int, total: int) -> None:
        if progress:
            progress(len(found) * each + done, len(names) * each)

    for name, of in studies.items():
        found[name] = margin(
            of, over=over, bounds=bounds, log=log, points=points, bisections=bisections, progress=advance
        )
    return MarginContest(found, time.perf_counter() - began)
