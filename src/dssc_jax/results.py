"""The result of a study: every draw's metrics and outcome, and what they say together."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax import store
from dssc_jax.dataset import outcome_codes, variables
from dssc_jax.engine import Layout
from dssc_jax.metrics import Measure
from dssc_jax.statistics import CONFIDENCE, clopper_pearson
from dssc_jax.study import Study
from dssc_jax.types import Outcome

QUANTILES = (0.05, 0.5, 0.95)


@dataclass
class Result:
    """A finished study.

    Args:
        study: The study as run.
        dataset: One variable a metric, margin and drawn number, ``outcome`` and ``failed_at``; dimensions are the
            swept parameters and ``draw``.
        manifest: Study, versions, device, counts and times.
        path: The results folder, once there is one.
    """

    study: Study
    dataset: xr.Dataset
    manifest: dict[str, Any] = field(default_factory=dict)
    path: Path | None = None

    @property
    def failed(self) -> xr.DataArray:
        """Whether each draw failed, in any way; a non-finite draw is a failure."""
        return self.dataset["outcome"] != Outcome.OK

    def summary(self, confidence: float = CONFIDENCE) -> dict[str, Any]:
        """Failures, probability and exact interval of every sweep point, and quantiles of the metrics.

        A draw that ended early has no metric and counts as infinite; ``finite`` tells how many did not.
        """
        times = self.manifest.get("times", {})
        return {
            "study": self.study.name,
            "draws": self.study.config.draws,
            "confidence": confidence,
            "requirements": [requirement.text for requirement in self.study.requirements],
            "points": [self._point(index, confidence) for index in np.ndindex(*map(len, self.study.axes.values()))],
            "rate": times.get("rate"),
            "compile_seconds": times.get("compile_seconds"),
            "seconds": times.get("seconds"),
            "result": str(self.path) if self.path else None,
        }

    def _point(self, index: tuple[int, ...], confidence: float) -> dict[str, Any]:
        axes = self.study.axes
        point = {name: axes[name][i] for name, i in zip(axes, index, strict=True)}
        outcome = self.dataset["outcome"].values[index]
        draws, failures = int(outcome.size), int(np.count_nonzero(outcome != Outcome.OK))
        metrics = {}
        for measure in self.study.measures:
            found = upper_quantiles(self.dataset[measure.name].values[index], QUANTILES)
            metrics[measure.name] = {f"q{100 * q:g}": finite_or_none(v) for q, v in zip(QUANTILES, found, strict=True)}
        return {
            **point,
            "draws": draws,
            "failures": failures,
            "probability": failures / draws,
            "interval": clopper_pearson(failures, draws, confidence).tolist(),
            "certified": None,
            "finite": int(np.count_nonzero(outcome != Outcome.NON_FINITE)),
            "outcomes": {
                meaning: int(np.count_nonzero(outcome == code)) for code, meaning in outcome_codes(self.study).items()
            },
            "metrics": metrics,
        }

    def save(self, folder: str | Path) -> Path:
        """Write the results folder.

        Args:
            folder: Made when absent; one that holds the same study is written anew.

        Raises:
            ConfigError: the folder holds something else.
        """
        path = Path(folder)
        layout = Layout.of(self.study)
        with store.Store(path, self.study, self.manifest | {"layout": layout.to_dict(), "complete": False}) as target:
            for block in layout.blocks():
                drawn = {name: self.dataset[name].values[block[-1]] for name in self.study.laws}
                grid = {name: self.dataset[name].values[block] for name in variables(self.study) if name not in drawn}
                target.chunks.write(block, grid, drawn)
            target.complete({})
            self.path = path
            target.summarise(self.summary())
        return path


def load(folder: str | Path) -> Result:
    """Read a results folder.

    Args:
        folder: What ``run`` or ``sweep`` wrote, or :meth:`Result.save`.

    Raises:
        ConfigError: it is no results folder, it is damaged, or its run did not finish.
    """
    return Result(*store.read(Path(folder)), Path(folder))


def upper_quantiles(values: np.ndarray, levels: Sequence[float]) -> np.ndarray:
    """Quantiles along the last axis with draws without a value at infinity, shape (levels, ...).

    Order statistics only: a finite value is never averaged with an infinite one.
    """
    return np.quantile(np.where(np.isnan(values), np.inf, values), levels, axis=-1, method="inverted_cdf")


def headline(result: Result) -> Measure:
    """The metric that the study is about: the one it names, else that of its first requirement, else the error."""
    wanted = result.study.config.plot.metric
    by_name = {measure.name: measure for measure in result.study.measures}
    if wanted:
        return by_name[wanted]
    if result.study.requirements:
        return result.study.requirements[0].measure
    return by_name["error_rms"]


def finite_or_none(value: float) -> float | None:
    """JSON has no infinity."""
    return float(value) if np.isfinite(value) else None
