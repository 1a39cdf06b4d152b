"""The results of several controllers on the same draws and noise, singly and in pairs."""

import itertools
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.analyses.comparison.rivals import ControllerTable, with_controller
from dssc_jax.analyses.margins.joined import name_axis
from dssc_jax.closed_loop.metrics.requirements import violated
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Outcome
from dssc_jax.runs import run as running
from dssc_jax.statistics import CONFIDENCE, clopper_pearson, compare_failures, compare_metrics
from dssc_jax.statistics.order import upper_quantiles
from dssc_jax.study import Study


@dataclass(frozen=True)
class MetricDifference:
    """The median of the difference of a metric, a minus b, over draws that two controllers a and b both flew."""

    difference: Annotated[float, Quantity("that of the metric", "median of the metric of a minus that of b")]
    interval: Annotated[tuple[float, float], Quantity("that of the metric", "interval of that median")]


@dataclass(frozen=True)
class ControllerPair:
    """Comparison of two controllers a and b on the same draws: how much more often a fails than b."""

    a: Annotated[str, Quantity("", "one controller")]
    b: Annotated[str, Quantity("", "the other controller")]
    draws: Annotated[int, Quantity("1", "number of draws")]
    only_a: Annotated[int, Quantity("1", "draws on which only a fails")]
    only_b: Annotated[int, Quantity("1", "draws on which only b fails")]
    difference: Annotated[float, Quantity("1", "failure probability of a minus that of b")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the difference, for paired draws")]
    p_value: Annotated[float, Quantity("1", "exact test of McNemar")]
    metrics: dict[str, MetricDifference]


@dataclass(frozen=True)
class ControllerAnswer:
    """A controller's failures and the medians of its metrics over all draws."""

    controller: Annotated[ControllerTable, Quantity("", "table of the controller in a study file")]
    failures: Annotated[int, Quantity("1", "failed draws")]
    probability: Annotated[float, Quantity("1", "failure probability")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability (Clopper-Pearson)")]
    violations: Annotated[dict[str, int], Quantity("1", "draws that violate each requirement")]
    median: Annotated[dict[str, float], Quantity("that of the metric", "median of each metric")]


@dataclass(frozen=True)
class ContestAnswer:
    """Controllers on the same draws: each alone, and every two of them compared draw by draw."""

    controllers: dict[str, ControllerAnswer]
    pairs: list[ControllerPair]


class Contest(NamedTuple):
    """The results of several controllers on the same draws.

    Args:
        tables: The ``[controller]`` table of each controller.
        dataset: Along ``controller`` and ``draw`` it has ``failed``, ``outcome`` and every metric that all controllers
            have; along ``draw`` the uncertain numbers that all of them have.
    """

    tables: dict[str, ControllerTable]
    dataset: xr.Dataset

    @classmethod
    def of(cls, study: Study, tables: dict[str, ControllerTable], progress: Callable[[], None]) -> "Contest":
        """Run the study with every controller, and join the results.

        Args:
            study: The study without its sweep.
            tables: The ``[controller]`` table of each controller.
            progress: Called after each run.
        """
        runs: list[xr.Dataset] = []
        for name, table in tables.items():
            runs.append(running.run(with_controller(study, name, table)).dataset)
            progress()
        uncertain, common = common_variables(runs)
        metrics = xr.concat([run[common] for run in runs], dim=controller_axis(tables), join="exact")
        dataset = metrics.assign(runs[0][uncertain])
        failed = dataset["outcome"] != Outcome.OK
        dataset["failed"] = (failed.dims, failed.values, {"long_name": "the draw failed"})
        return cls(tables, dataset)

    def metrics(self, study: Study) -> list[str]:
        """Names of the study's metrics that all controllers have."""
        return [measure.name for measure in study.measures if measure.name in self.dataset]

    def pairs(self, study: Study, confidence: float = CONFIDENCE) -> list[ControllerPair]:
        """Compare every two controllers a and b draw by draw, by their failures and by each metric that both have.

        Args:
            study: The study, which names the metrics.
            confidence: Confidence of each interval.
        """
        pairs = []
        for a, b in itertools.combinations(self.tables, 2):
            data_of_a = self.dataset.sel(controller=a)
            data_of_b = self.dataset.sel(controller=b)
            failures = compare_failures(data_of_a["failed"].values, data_of_b["failed"].values, confidence)
            metrics = {}
            for name in self.metrics(study):
                paired = compare_metrics(data_of_a[name].values, data_of_b[name].values, confidence=confidence)
                metrics[name] = MetricDifference(paired.difference, paired.interval)
            pairs.append(ControllerPair(a, b, **failures._asdict(), metrics=metrics))
        return pairs

    def answer(self, study: Study, confidence: float = CONFIDENCE) -> ContestAnswer:
        """Failures, violations and median metrics of each controller, and the comparison of every pair.

        Args:
            study: The study, which names the metrics and requirements.
            confidence: Confidence of each interval.
        """
        controllers = {name: self.controller_answer(name, study, confidence) for name in self.tables}
        return ContestAnswer(controllers, self.pairs(study, confidence))

    def controller_answer(self, name: str, study: Study, confidence: float) -> ControllerAnswer:
        """Failures, violations and median metrics of one controller.

        Args:
            name: Name of the controller in the comparison.
            study: The study, which names the metrics and requirements.
            confidence: Confidence of the interval of the failure probability.
        """
        data = self.dataset.sel(controller=name)
        failures = int(data["failed"].sum())
        draws = data.sizes["draw"]
        medians = {}
        for measure in study.measures:
            if measure.name in data:
                (median,) = upper_quantiles(data[measure.name].values, [0.5], measure.metric.worst)
                medians[measure.name] = median
        violations = {}
        for requirement in study.requirements:
            if requirement.name in data:
                violations[requirement.label] = int(np.count_nonzero(violated(data[requirement.name].values)))
        low, high = clopper_pearson(failures, draws, confidence)
        return ControllerAnswer(
            controller=self.tables[name],
            failures=failures,
            probability=failures / draws,
            interval=(low, high),
            violations=violations,
            median=medians,
        )


def common_variables(runs: Sequence[xr.Dataset]) -> tuple[list[Hashable], list[Hashable]]:
    """Find the variables that the results of all controllers have, and split their names into two lists.

    The first list names the uncertain numbers, the second list all other variables, such as metrics.

    Args:
        runs: The dataset of each controller's run; an uncertain number has its ``law`` as an attribute.
    """
    uncertain = []
    certain = []
    for name in runs[0]:
        if not all(name in run for run in runs):
            continue
        if all("law" in run[name].attrs for run in runs):
            uncertain.append(name)
        else:
            certain.append(name)
    return uncertain, certain


class ContestPart(NamedTuple):
    """What the dataset of a comparison does not say of one of its contests; stored beside that dataset.

    Args:
        tables: The ``[controller]`` table of each controller.
        variables: Names of the contest's variables in the dataset of the comparison.
    """

    tables: dict[str, ControllerTable]
    variables: tuple[str, ...]

    @classmethod
    def of(cls, contest: Contest) -> "ContestPart":
        """Keep the tables of a contest and the names of its variables, without its data."""
        return cls(contest.tables, tuple(map(str, contest.dataset)))

    def contest(self, dataset: xr.Dataset) -> Contest:
        """Restore the contest with its data.

        Args:
            dataset: The rows of the comparison's dataset that belong to these controllers, in the order of ``tables``.
        """
        labelled = dataset.assign_coords(controller=controller_axis(self.tables))
        return Contest(self.tables, labelled[list(self.variables)])


def controller_axis(names: Iterable[str]) -> xr.DataArray:
    """The coordinate ``controller`` of a dataset, from the controllers' names."""
    return name_axis(dimension="controller", names=names, meaning="controller")
