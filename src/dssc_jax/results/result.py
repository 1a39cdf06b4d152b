"""The result of a run or a sweep: metrics and outcome of all draws, and their summary."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from dssc_jax.closed_loop.metrics.requirements import violated
from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.batching import Layout
from dssc_jax.proofs.claims import not_proved_text
from dssc_jax.results import store
from dssc_jax.results.manifest import Manifest
from dssc_jax.results.proofs import SweepProofs, read_proofs
from dssc_jax.results.schema import variables
from dssc_jax.results.scored_draws import ScoredDraws
from dssc_jax.results.stated_errors import STATED, StatedAmounts, StatedError, confidence_of
from dssc_jax.results.summary import Summary, SummaryRow, json_lines, jsonable, point_rows
from dssc_jax.results.theorem import theorem_mark
from dssc_jax.statistics import (
    CONFIDENCE,
    DesignEffect,
    FixedCount,
    IntervalsAfterStop,
    Look,
    Method,
    Replicated,
    design_effect,
)
from dssc_jax.study import Study

if TYPE_CHECKING:
    from dssc_jax.design.certification import Mark

ERROR_METRICS = ("error_rms", "position_error_rms")
"""Metrics of the error: for a plant with one channel, and for a vehicle."""
ASSUMPTIONS = "without lag and sampling and with a rho that keeps sliding"
"""Assumptions of a certificate by Theorem 1."""

DESIGN_NAMES = {"sobol": "scrambled Sobol", "lhs": "Latin hypercube"}


@dataclass
class Result:
    """The result of a finished run or sweep of a study.

    Args:
        study: The study as run.
        dataset: One variable for each metric, slack and drawn number, and ``outcome`` and ``failed_at``; dimensions are
            the swept parameters and ``draw``.
        manifest: Study, versions, device, counts and times.
        path: The results folder, if the result has been saved.
        point_proofs: Proofs of the points of the sweep; None: there are none.
    """

    study: Study
    dataset: xr.Dataset
    manifest: Manifest = field(default_factory=dict)
    path: Path | None = None
    point_proofs: SweepProofs | None = None

    @classmethod
    def of(cls, study: Study, dataset: xr.Dataset, manifest: Manifest, path: Path | None = None) -> "Result":
        """Make the result of a study, with the proofs in the results folder, if there are any.

        Args:
            study: The study as run.
            dataset: The dataset, as the class describes it.
            manifest: Study, versions, device, counts and times.
            path: The results folder; None: the result has not been saved.
        """
        result = cls(study, dataset, manifest, path)
        proofs = read_proofs(path, study) if path is not None else None
        return result if proofs is None else result.with_proofs(proofs)

    def with_proofs(self, proofs: SweepProofs) -> "Result":
        """Add proofs of the points, with the coordinates ``proved`` and ``proved_error`` of the dataset."""
        claim = proofs.claim
        proved_attributes = {
            "long_name": f"proved for {claim.covered}, with lag and sampling",
            "covered": claim.covered,
        }
        error_attributes = {
            "long_name": f"proved upper bound of {claim.error} once settled",
            "units": self.study.units[0].output,
            "bounded": claim.error,
        }
        axes = tuple(self.study.axes)
        coordinates = {
            "proved": (axes, proofs.proved, proved_attributes),
            "proved_error": (axes, proofs.error, error_attributes),
        }
        return replace(self, dataset=self.dataset.assign_coords(coordinates), point_proofs=proofs)

    def with_theorem(self) -> "Result":
        """Add the coordinate ``certified`` to the dataset, if Theorem 1 applies to the loop.

        The coordinate is true at each point at which the theorem holds for the loop without unmodelled dynamics,
        sensors and sampling, and with a rho that keeps sliding.
        """
        if "certified" in self.dataset or self._mark is None or self._mark.certified is None:
            return self
        attributes = {"long_name": "certified by Theorem 1, without lag and sampling"}
        dataset = self.dataset.assign_coords(certified=(tuple(self.study.axes), self._mark.certified, attributes))
        return replace(self, dataset=dataset)

    @cached_property
    def _mark(self) -> "Mark | None":
        """Theorem 1's verdict on each point, computed once; None if no controller has the functions of Table 1."""
        return theorem_mark(self.study)

    @property
    def certificate(self) -> str:
        """The number of proved points and the result of Theorem 1, in one line."""
        return "; ".join(filter(None, (self.proofs, self.theorem)))

    @property
    def proofs(self) -> str:
        """The number of points that are proved with lag and sampling, in words; empty if no proof was tried."""
        if "proved" not in self.dataset:
            return ""
        proved = self.dataset["proved"].values
        text = f"{np.count_nonzero(proved)} of {proved.size} points are proved, with lag and sampling"
        return "; ".join(filter(None, (text, not_proved_text(self.study))))

    @property
    def integration(self) -> str:
        """The error of integration between the samples, in words; empty if it was not checked."""
        entry = self.manifest.get("integration") or {}
        return entry.get("warning") or entry.get("text", "")

    @property
    def theorem(self) -> str:
        """The result of Theorem 1 for the loop, in one line; empty if no controller has the functions of Table 1."""
        dataset = self.with_theorem().dataset
        if "certified" not in dataset:
            return f"Theorem 1 does not apply: {self._mark.reason}" if self._mark else ""
        certified = dataset["certified"].values
        if not certified.ndim:
            return f"certified by Theorem 1, {ASSUMPTIONS}" if certified else "not certified by Theorem 1"
        return f"Theorem 1 certifies {np.count_nonzero(certified)} of {certified.size} points, {ASSUMPTIONS}"

    @property
    def failed(self) -> xr.DataArray:
        """Whether each draw failed: it violates a requirement or ended early."""
        return self.dataset["outcome"] != Outcome.OK

    def at(self, index: Mapping[str, int]) -> "Result":
        """Select one value of some swept parameters; the other ones remain dimensions of the dataset.

        Args:
            index: Index of the selected value, by the name of the parameter.
        """
        return Result(self.study, self.with_theorem().dataset.isel(index), self.manifest)

    @property
    def method(self) -> Method:
        """The method of the intervals, which follows from the stopping rule, or else from the design of the draws."""
        stopping = self.manifest.get("stopping")
        if not stopping:
            return interval_method(self.study)
        looks = tuple(Look(look["draws"], look["lower"], look["upper"]) for look in stopping["looks"])
        return IntervalsAfterStop(looks, possible_stops=stopping["stops"])

    def summary(self, confidence: float = CONFIDENCE) -> Summary:
        """Failures with intervals of each point of the sweep and each requirement, and quantiles of the metrics.

        ``failures`` of a point counts the draws that fail in any way; ``failures`` of a requirement counts all draws
        that violate the requirement. A draw that ended early violates every requirement. ``ended_early`` counts these
        draws; ``alone`` and ``overlaps`` count only the others. In the quantiles of a metric, a draw without a value
        counts as the worst value: -inf if large values are good, inf otherwise. An infinite quantile is None.
        Intervals of quantiles are order statistics, which hold for independent draws only.

        Args:
            confidence: Confidence of each single interval.
        """
        return self._content(list(self.points(confidence)), confidence)

    def points(self, confidence: float = CONFIDENCE) -> Iterator[SummaryRow]:
        """The points of :meth:`summary` one by one, so that few points of a large sweep are in memory at a time."""
        amounts = self.stated
        for row in point_rows(self.study, self.with_theorem().dataset, self.method, confidence):
            yield row | {STATED: jsonable(self.stated_errors(amounts, confidence))} if amounts else row

    @property
    def has_equal_draws(self) -> bool:
        """Whether all draws are the same because nothing in the study is random; an interval then has no meaning.

        The draws count as the same if no number has a law, all draws have equal outcomes and metrics, or none of a
        metric, and at least one metric is not a whole number. Counts may agree by chance, but noise, turbulence or a
        random disturbance would change such a metric.
        """
        if self.study.laws or self.study.config.draws < 2:
            return False
        metrics = [self.dataset[measure.name].transpose(..., "draw").values for measure in self.study.measures]
        outcomes = self.dataset["outcome"].transpose(..., "draw").values
        for values in (outcomes, *metrics):
            first_draw = values[..., :1]
            is_undefined_in_both = np.isnan(values) & np.isnan(first_draw)
            if np.any((values != first_draw) & ~is_undefined_in_both):
                return False
        return any(np.any(np.isfinite(values) & (values != np.rint(values))) for values in metrics)

    @property
    def design_effect(self) -> DesignEffect | None:
        """Gain of the design over independent draws; None for independent draws, for a sweep, or if all draws agree."""
        if self.method.independent or self.study.axes:
            return None
        return design_effect(self.failed.values, self.study.config.replicates)

    @property
    def design_reason(self) -> str:
        """Reason for the automatic choice of the draws' design; empty if the study names the design."""
        entry = self.manifest.get("design")
        return f"{entry['reason']}; the choice took {entry['pilot']} simulations" if entry else ""

    @property
    def stated(self) -> StatedAmounts | None:
        """Amounts by which the laws may be wrong, as stated for the run; None if no amounts were stated."""
        entry = self.manifest.get(STATED)
        return None if entry is None else StatedAmounts.of(entry)

    def stated_errors(self, amounts: StatedAmounts, confidence: float = CONFIDENCE) -> list[StatedError]:
        """Intervals of the failure probability if the laws are wrong by stated amounts, one for each amount.

        Args:
            amounts: Amounts by which the laws may be wrong.
            confidence: Confidence of each single interval.

        Raises:
            ConfigError: The result has a sweep, its draws are not independent, or no law can be changed.
        """
        amounts.require(self.study)
        low, high = self.method.failure_interval(self.failed.values, confidence).tolist()
        draws = ScoredDraws.of(self.study, self.failed.values)
        return amounts.errors(draws, (low, high), confidence_of(self.method, confidence))

    def lines(self) -> Iterator[str]:
        """The :meth:`summary` as JSON, line by line, as in ``summary.json``."""
        return json_lines(self._content(self.points(), CONFIDENCE))

    def _content(self, points: Iterable[SummaryRow], confidence: float) -> Summary:
        """The content of the summary for the given points.

        Args:
            points: Summaries of the points, which may be made one by one.
            confidence: Confidence of each single interval.
        """
        times = self.manifest.get("times", {})
        return {
            "study": self.study.name,
            "draws": self.study.config.draws,
            "confidence": confidence,
            "certificate": self.certificate,
            "interval_method": self.method.name,
            "equal_draws": self.has_equal_draws,
            "design": self._design_summary(),
            "stopping": self.manifest.get("stopping"),
            "integration": self.manifest.get("integration"),
            "requirements": [requirement.text for requirement in self.study.requirements],
            "points": points,
            "rate": times.get("rate"),
            "compile_seconds": times.get("compile_seconds"),
            "seconds": times.get("seconds"),
            "result": str(self.path) if self.path else None,
        }

    def _design_summary(self) -> JsonObject | None:
        """Reason and effect of the design, for the summary; None if there is neither a reason nor an effect."""
        effect = self.design_effect
        if effect is None and not self.design_reason:
            return None
        return {"reason": self.design_reason, "effect": effect and effect._asdict()}

    def save(self, folder: str | Path) -> Path:
        """Write the results folder.

        Args:
            folder: Created if absent; overwritten if it contains the same study.

        Raises:
            ConfigError: The folder contains something else.
        """
        path = Path(folder)
        layout = Layout.of(self.study)
        manifest = self.manifest | {"layout": layout.to_dict(), "complete": False}
        with store.Store(path, self.study, manifest) as target:
            for block in layout.blocks():
                draws = block[-1]
                law_values = {name: self.dataset[name].values[draws] for name in self.study.laws}
                names = [name for name in variables(self.study) if name not in law_values]
                results = {name: self.dataset[name].values[block] for name in names}
                target.chunks.write(block, results, law_values)
            target.complete({})
            self.path = path
            target.summarise(self.lines())
        return path


def interval_method(study: Study) -> Method:
    """The method of intervals for a fixed number of draws, which follows from the study's design of the draws."""
    config = study.config
    if config.independent:
        return FixedCount()
    return Replicated(config.replicates, DESIGN_NAMES[config.sampling])


def load_result(folder: str | Path, trust_code: bool = False) -> Result:
    """Load a results folder.

    Args:
        folder: A folder written by ``run``, ``sweep`` or :meth:`Result.save`.
        trust_code: Whether to import the models that the study names as ``module:object``, which are only needed to
            simulate a draw again.

    Raises:
        ConfigError: The folder is not a results folder, it is damaged, or its run did not finish.
    """
    study, dataset, manifest = store.read_run(Path(folder), trust_code)
    return Result.of(study, dataset, manifest, Path(folder))


def headline_measure(study: Study) -> Measure:
    """The metric that reports of a study show first.

    The choice is the metric that ``[plot]`` names, else the metric of the first requirement, else the error, else the
    first metric.
    """
    by_name = {measure.name: measure for measure in study.measures}
    if study.config.plot.metric:
        return by_name[study.config.plot.metric]
    if study.requirements:
        return study.requirements[0].measure
    for name in ERROR_METRICS:
        if name in by_name:
            return by_name[name]
    return study.measures[0]


def most_violated(result: Result) -> Measure:
    """The metric that ``[plot]`` names, else the metric of the requirement that most draws violate.

    If the study has no requirements, the result is the headline metric.
    """
    requirements = result.study.requirements
    if result.study.config.plot.metric or not requirements:
        return headline_measure(result.study)
    counts = []
    for requirement in requirements:
        slacks = result.dataset[requirement.name].values
        counts.append(int(np.count_nonzero(violated(slacks))))
    return requirements[int(np.argmax(counts))].measure


def measure_named(result: Result, metric: str | None) -> Measure:
    """The metric of a result by its name; the headline metric if the name is None.

    Raises:
        ConfigError: The result has no such metric.
    """
    if metric is None:
        return headline_measure(result.study)
    by_name = {measure.name: measure for measure in result.study.measures}
    if metric not in by_name:
        raise ConfigError("metric", f"'{metric}' is none of the result's; {nearest(metric, by_name)}")
    return by_name[metric]
