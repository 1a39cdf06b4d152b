"""The subject of a report: a result, its point shown in detail, and its worst draws."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import xarray as xr

from dssc_jax.analyses.defaults import WORST_DRAWS
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import Result, headline
from dssc_jax.results.summary import JsonObject, Summary, SummaryRow
from dssc_jax.runs.trajectory import agreement_of, recorder
from dssc_jax.study import Described, Study


class Studied(Protocol):
    """A result or an analysis; both have a study."""

    @property
    def study(self) -> Study:
        """The study."""
        ...


class StudySubject(Protocol):
    """The subject of a report of any kind."""

    @property
    def result(self) -> Studied:
        """The result, or the analysis."""
        ...


@dataclass(frozen=True)
class AnalysisSubject:
    """An analysis with the data that several sections need.

    Args:
        result: The analysis.
    """

    result: Analysis

    @cached_property
    def summary(self) -> JsonObject:
        """The analysis in plain numbers."""
        return self.result.summary()


@dataclass(frozen=True)
class Subject:
    """A result with the data that several sections need.

    Args:
        result: The result.
        worst: Number of its worst draws that are simulated again.
    """

    result: Result
    worst: int = WORST_DRAWS

    @cached_property
    def summary(self) -> Summary:
        """Every point's failures, interval and quantiles."""
        return self.result.summary()

    @cached_property
    def index(self) -> dict[str, int]:
        """The point shown in detail: for a sweep, the one with the failure probability nearest to one half."""
        axes = list(self.result.study.axes)
        share = self.result.failed.mean("draw").transpose(*axes).values
        half = np.unravel_index(np.argmin(np.abs(share - 0.5)), share.shape)
        return dict(zip(axes, map(int, half), strict=True))

    @property
    def point(self) -> dict[str, float]:
        """The swept parameters' values at the point shown in detail."""
        return {name: self.result.study.axes[name][i] for name, i in self.index.items()}

    @cached_property
    def point_result(self) -> Result:
        """The result at the point shown in detail."""
        return self.result.at(self.index)

    @cached_property
    def point_summary(self) -> SummaryRow:
        """The summary of the point shown in detail."""
        shape = tuple(len(values) for values in self.result.study.axes.values())
        return self.summary["points"][np.ravel_multi_index(tuple(self.index.values()), shape) if shape else 0]

    @property
    def point_phrase(self) -> str:
        """The values at the point shown in detail, as the end of a phrase; empty for a run."""
        at = " and ".join(f"{name} = {value:.4g}" for name, value in self.point.items())
        return f" at {at}, the point where nearest to half of the draws fail" if at else ""

    @cached_property
    def trajectories(self) -> list[xr.Dataset]:
        """The worst draws of the point shown in detail, simulated again.

        The attributes ``agreement`` and ``deviation`` compare them with the stored ones.
        Empty for a study whose code is not loaded.
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


def worst_draws(result: Result, count: int) -> list[int]:
    """Draws of one point, sorted by the smallest slack relative to its bound; early ends are sorted by their time.

    Without requirements, they are sorted by the largest value of the headline metric.
    """
    required = result.study.requirements
    if required:
        slack = np.min([result.dataset[r.name].values / r.scale for r in required], axis=0)
    else:
        value = result.dataset[headline(result).name].values
        slack = -np.where(np.isnan(value), np.inf, value)
    ended = result.dataset["failed_at"].values
    order = np.lexsort((np.where(np.isnan(ended), np.inf, ended), slack))
    return [int(draw) for draw in order[:count]]
