"""The result of a study: every draw's metrics and outcome, and what they say together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax import certification, store
from dssc_jax.dataset import outcome_codes, variables
from dssc_jax.engine import Layout
from dssc_jax.errors import ConfigError, meant
from dssc_jax.metrics import Measure
from dssc_jax.statistics import CONFIDENCE, DataDriven, FixedCount, Method, Replicated
from dssc_jax.statistics.order import at_rank, quantile_ranks, ranked
from dssc_jax.study import Study
from dssc_jax.types import Outcome

QUANTILES = (0.05, 0.5, 0.95)
ERRORS = ("error_rms", "position_error_rms")  # of a plant of one channel, and of a vehicle
GIVEN = "with a rho that keeps sliding"
"""What a certificate presumes beside the loop that it names."""

DESIGNS = {"sobol": "scrambled Sobol", "lhs": "Latin hypercube"}


@dataclass
class Result:
    """A finished study.

    Args:
        study: The study as run.
        dataset: One variable a metric, margin and drawn number, ``outcome`` and ``failed_at``; dimensions are the
            swept parameters and ``draw``.
        manifest: Study, versions, device, counts and times.
        path: The results folder, once there is one.
        silence: Why the dataset has no coordinate ``certified``, which tells for each point of the sweep whether
            Theorem 1 holds for the loop without unmodelled dynamics, sensors and sampling, and with a rho that keeps
            sliding; empty where it has one.
    """

    study: Study
    dataset: xr.Dataset
    manifest: dict[str, Any] = field(default_factory=dict)
    path: Path | None = None
    silence: str = field(init=False)

    def __post_init__(self) -> None:
        certified, self.silence = certification.mark(self.study)
        if certified is not None and "certified" not in self.dataset:
            about = {"long_name": "certified by Theorem 1"}
            self.dataset = self.dataset.assign_coords(certified=(tuple(self.study.axes), certified, about))

    @property
    def certificate(self) -> str:
        """What Theorem 1 says of the loop, in a line."""
        if "certified" not in self.dataset:
            return f"not certified: {self.silence}"
        found = self.dataset["certified"].values
        if not found.ndim:
            return f"certified by Theorem 1, {GIVEN}" if found else "not certified by Theorem 1"
        return f"Theorem 1 certifies {np.count_nonzero(found)} of {found.size} points, {GIVEN}"

    @property
    def failed(self) -> xr.DataArray:
        """Whether each draw failed, in any way; a non-finite draw is a failure."""
        return self.dataset["outcome"] != Outcome.OK

    def at(self, index: Mapping[str, int]) -> "Result":
        """The result at given indices of swept parameters; the others stay axes of the dataset."""
        return Result(self.study, self.dataset.isel(index), self.manifest)

    @property
    def method(self) -> Method:
        """How intervals follow from these draws: by their design, and by what ended them."""
        config, stopping = self.study.config, self.manifest.get("stopping")
        if stopping:
            return DataDriven(stopping["look"])
        return FixedCount() if config.sampling == "random" else Replicated(config.replicates, DESIGNS[config.sampling])

    def summary(self, confidence: float = CONFIDENCE) -> dict[str, Any]:
        """Failures, probability and interval of every sweep point, and quantiles of the metrics.

        A draw that ended early has no metric and counts as infinite; ``finite`` tells how many did not. Intervals of
        quantiles are order statistics, hence for independent draws only.
        """
        times = self.manifest.get("times", {})
        quantiles = {measure.name: self._quantiles(measure.name, confidence) for measure in self.study.measures}
        points = np.ndindex(*map(len, self.study.axes.values()))
        return {
            "study": self.study.name,
            "draws": self.study.config.draws,
            "confidence": confidence,
            "certificate": self.certificate,
            "interval_method": self.method.name,
            "stopping": self.manifest.get("stopping"),
            "requirements": [requirement.text for requirement in self.study.requirements],
            "points": [self._point(index, confidence, quantiles) for index in points],
            "rate": times.get("rate"),
            "compile_seconds": times.get("compile_seconds"),
            "seconds": times.get("seconds"),
            "result": str(self.path) if self.path else None,
        }

    def _point(
        self, index: tuple[int, ...], confidence: float, quantiles: Mapping[str, Mapping[str, np.ndarray]]
    ) -> dict[str, Any]:
        axes = self.study.axes
        point = {name: axes[name][i] for name, i in zip(axes, index, strict=True)}
        outcome = self.dataset["outcome"].values[index]
        draws, failed = int(outcome.size), outcome != Outcome.OK
        failures = int(np.count_nonzero(failed))
        metrics = {
            metric: {name: np.asarray(values[index]).tolist() for name, values in found.items()}
            for metric, found in quantiles.items()
        }
        return {
            **point,
            "draws": draws,
            "failures": failures,
            "probability": failures / draws,
            "interval": self.method.interval(failed, confidence).tolist(),
            "certified": self._certified(index),
            "finite": int(np.count_nonzero(outcome != Outcome.NON_FINITE)),
            "outcomes": {
                meaning: int(np.count_nonzero(outcome == code)) for code, meaning in outcome_codes(self.study).items()
            },
            "metrics": metrics,
        }

    def _certified(self, index: tuple[int, ...]) -> bool | None:
        if "certified" not in self.dataset:
            return None
        return bool(self.dataset["certified"].transpose(*self.study.axes).values[index])

    def _quantiles(self, metric: str, confidence: float) -> dict[str, np.ndarray]:
        """A metric's quantiles at every point, None where infinite, and their intervals: a last axis of two ends."""
        ordered, method = ranked(self.dataset[metric].values), self.method
        found: dict[str, np.ndarray] = {}
        for level, values in zip(QUANTILES, upper_quantiles(ordered, QUANTILES), strict=True):
            found[f"q{100 * level:g}"] = values
            if not isinstance(method, Replicated):
                ranks = quantile_ranks(ordered.shape[-1], level, method.level(confidence))
                found[f"q{100 * level:g}_interval"] = np.stack([at_rank(ordered, rank) for rank in ranks], axis=-1)
        return {name: nullable(values) for name, values in found.items()}

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
    """The metric that a result's study is about."""
    return headline_measure(result.study)


def headline_measure(study: Study) -> Measure:
    """The metric that a study is about: the one it names, else that of its first requirement, else the error.

    A study that measures no error is about the first metric that it has.
    """
    wanted = study.config.plot.metric
    by_name = {measure.name: measure for measure in study.measures}
    if wanted:
        return by_name[wanted]
    if study.requirements:
        return study.requirements[0].measure
    return next((by_name[name] for name in ERRORS if name in by_name), study.measures[0])


def measured(result: Result, metric: str | None) -> Measure:
    """The measure of that name; None: the headline.

    Raises:
        ConfigError: the result has no such metric.
    """
    if metric is None:
        return headline(result)
    by_name = {measure.name: measure for measure in result.study.measures}
    if metric not in by_name:
        raise ConfigError("metric", f"'{metric}' is none of the result's; {meant(metric, by_name)}")
    return by_name[metric]


def nullable(values: np.ndarray) -> np.ndarray:
    """Numbers for JSON, which has no infinity: objects, None where a value is not finite."""
    found = np.array(values, dtype=object)
    found[~np.isfinite(values)] = None
    return found
