"""The subject of a report: an analysis, or a result with its point shown in detail and its worst draws."""

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import xarray as xr

from dssc_jax.analyses.defaults import WORST_DRAWS
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import Result, headline_measure
from dssc_jax.results.summary import JsonObject, Summary, SummaryRow
from dssc_jax.runs.trajectory import agreement_of, recorder
from dssc_jax.study import Described


@dataclass(frozen=True)
class AnalysisSubject:
    """An analysis as the subject of a report."""

    result: Analysis

    @cached_property
    def summary(self) -> JsonObject:
        """The analysis in plain numbers."""
        return self.result.summary()


@dataclass(frozen=True)
class Subject:
    """A result as the subject of a report, with the data that several sections need.

    Args:
        result: The result.
        worst: Number of worst draws that are simulated again.
    """

    result: Result
    worst: int = WORST_DRAWS

    @cached_property
    def summary(self) -> Summary:
        """Failures, intervals and quantiles of all points."""
        return self.result.summary()

    @cached_property
    def index(self) -> dict[str, int]:
        """Indices, by axis, of the point shown in detail, whose failure probability is nearest to one half."""
        axes = list(self.result.study.axes)
        share = self.result.failed.mean("draw").transpose(*axes).values
        index = np.unravel_index(np.argmin(np.abs(share - 0.5)), share.shape)
        return dict(zip(axes, map(int, index), strict=True))

    @property
    def point(self) -> dict[str, float]:
        """Values of the swept parameters at the point shown in detail."""
        return {name: self.result.study.axes[name][i] for name, i in self.index.items()}

    @cached_property
    def point_result(self) -> Result:
        """The result at the point shown in detail."""
        return self.result.at(self.index)

    @cached_property
    def point_summary(self) -> SummaryRow:
        """The summary of the point shown in detail."""
        shape = tuple(len(values) for values in self.result.study.axes.values())
        position = np.ravel_multi_index(tuple(self.index.values()), shape) if shape else 0  # a run has one point
        return self.summary["points"][position]

    @property
    def point_phrase(self) -> str:
        """The values at the point shown in detail, as the end of a phrase; empty for a run."""
        values = " and ".join(f"{name} = {value:.4g}" for name, value in self.point.items())
        return f" at {values}, the point where nearest to half of the draws fail" if values else ""

    @cached_property
    def trajectories(self) -> list[xr.Dataset]:
        """Trajectories of the worst draws at the point shown in detail; none for a study whose code is not loaded.

        The attributes ``agreement`` and ``deviation`` of a trajectory tell how well it agrees with the stored draw.
        """
        if not self.worst or isinstance(self.result.study, Described):
            return []
        study = self.result.study
        record = recorder(study)
        flights = []
        for draw in worst_draws(self.point_result, self.worst):
            run = record(draw, self.point)
            agreement = agreement_of(self.result, run)
            run.attrs |= {"deviation": float(agreement.deviation[0]), "agreement": agreement.verdict}
            flights.append(run)
        return flights


AnySubject: TypeAlias = Subject | AnalysisSubject
"""The subject of a report of any kind."""


def worst_draws(result: Result, count: int) -> list[int]:
    """Indices of the worst draws at one point, the worst first.

    Draws are sorted by their smallest slack, relative to the scale of its requirement. Without requirements they are
    sorted by the headline metric. Among draws with equal values, those that ended earlier come first.

    Args:
        result: A run, or one point of a sweep.
        count: Number of draws.
    """
    requirements = result.study.requirements
    if requirements:
        slack = np.min([result.dataset[rule.name].values / rule.scale for rule in requirements], axis=0)
    else:
        value = result.dataset[headline_measure(result.study).name].values
        slack = -np.where(np.isnan(value), np.inf, value)
    failed_at = result.dataset["failed_at"].values
    end = np.where(np.isnan(failed_at), np.inf, failed_at)  # NaN: the draw ran to its end
    order = np.lexsort((end, slack))  # by the last key first: slack, then end
    return [int(draw) for draw in order[:count]]
