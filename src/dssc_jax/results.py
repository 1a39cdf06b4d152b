"""The result of a study: every draw's metrics and outcome, and what they say together."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax.metrics import METRICS, Measure
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

        Quantiles are those of the finite draws; ``finite`` tells how many there are.
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
            values = self.dataset[measure.name].values[index]
            values = values[~np.isnan(values)]
            if values.size:  # "lower" and "higher" never average a finite with an infinite value
                found = np.quantile(values, QUANTILES, method="inverted_cdf")
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
        """Write the results folder; see :func:`dssc_jax.store.save`.

        Raises:
            ConfigError: the folder holds something else.
        """
        from dssc_jax import store

        return store.save(self, Path(folder))


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


def outcome_codes(study: Study) -> dict[int, str]:
    """Every outcome code that the study's draws can have, with its meaning."""
    requirements = {Outcome.REQUIREMENT + i: f"failed_{r.measure.name}" for i, r in enumerate(study.requirements)}
    return {int(Outcome.OK): "ok", int(Outcome.NON_FINITE): "non_finite", **{int(k): v for k, v in requirements.items()}}


@dataclass(frozen=True)
class Variable:
    """One variable of a result: its dimensions, type and attributes."""

    dims: tuple[str, ...]
    dtype: str
    attributes: Mapping[str, Any]


def variables(study: Study) -> dict[str, Variable]:
    """Every variable of the study's dataset. ``outcome`` stands last: its presence marks a block as complete."""
    grid = (*study.axes, "draw")
    real = f"float{study.config.loop.precision}"
    found = {}
    for name, law in study.laws.items():
        quantity = study.quantities[name]
        about = {"units": quantity.unit, "long_name": quantity.meaning, "law": str(law)}
        found[name] = Variable(("draw",), "float64", about)
    for measure in study.measures:
        metric = METRICS[measure.kind]
        window = f", t >= {measure.window.after:g} s" if measure.window.after > 0 else ""
        found[measure.name] = Variable(grid, real, {"units": metric.unit, "long_name": metric.meaning + window})
    for requirement in study.requirements:
        about = {"units": requirement.measure.metric.unit, "long_name": f"signed margin of {requirement.text}"}
        found[requirement.name] = Variable(grid, real, about)
    about = {"units": "s", "long_name": "time of the first non-finite step (NaN: none)"}
    found["failed_at"] = Variable(grid, real, about)
    codes = outcome_codes(study)
    about = {"long_name": "outcome", "flag_values": list(codes), "flag_meanings": " ".join(codes.values())}
    found["outcome"] = Variable(grid, "int32", about)
    return found


def coordinates(study: Study) -> dict[str, Variable]:
    """The dataset's coordinates, one an axis, and the draw's index."""
    found = {}
    for name in study.axes:
        quantity = study.quantities[name]
        found[name] = Variable((name,), "float64", {"units": quantity.unit, "long_name": quantity.meaning})
    found["draw"] = Variable(("draw",), "int64", {"long_name": "draw index"})
    return found


def coordinate_values(study: Study) -> dict[str, np.ndarray]:
    """Values of :func:`coordinates`."""
    return {**{k: np.asarray(v) for k, v in study.axes.items()}, "draw": np.arange(study.config.draws)}
