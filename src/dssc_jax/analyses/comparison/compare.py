"""Compare controllers on the same draws and noise, singly and in pairs."""

import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, NamedTuple, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.comparison.rivals import Contestants, ControllerTable, with_controller
from dssc_jax.analyses.comparison.tuning import Tuning, best_gains, gain_ranges, untuned_reason, with_gains
from dssc_jax.analyses.defaults import TUNING_DRAWS
from dssc_jax.analyses.margins.joined import name_axis
from dssc_jax.closed_loop.metrics.requirements import violated
from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Outcome, ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.fields import MERGED
from dssc_jax.results.result import headline_measure
from dssc_jax.runs import run as running
from dssc_jax.statistics import CONFIDENCE, clopper_pearson, compare_failures, compare_metrics
from dssc_jax.statistics.order import upper_quantiles
from dssc_jax.study import Study, takes_file


@dataclass(frozen=True)
class MetricDifference:
    """The median of a metric's difference between two controllers, draw by draw."""

    difference: Annotated[float, Quantity("that of the metric", "median of the metric of a minus that of b")]
    interval: Annotated[tuple[float, float], Quantity("that of the metric", "interval of that median")]


@dataclass(frozen=True)
class ControllerPair:
    """Two controllers on the same draws: failure probability of a minus that of b."""

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
    """A controller's failures and its metrics."""

    controller: Annotated[ControllerTable, Quantity("", "table of the controller in a study file")]
    failures: Annotated[int, Quantity("1", "failed draws")]
    probability: Annotated[float, Quantity("1", "failure probability")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability (Clopper-Pearson)")]
    violations: Annotated[dict[str, int], Quantity("1", "draws that violate each requirement")]
    median: Annotated[dict[str, float], Quantity("that of the metric", "median of each metric")]


@dataclass(frozen=True)
class ContestAnswer:
    """Controllers on the same draws, singly and in pairs."""

    controllers: dict[str, ControllerAnswer]
    pairs: list[ControllerPair]


@dataclass(frozen=True)
class TunedContestAnswer:
    """Controllers with gains that were tuned on equal budgets."""

    budget: Annotated[str, Quantity("", "the budget of each controller")]
    contest: ContestAnswer = field(metadata={MERGED: True})


@dataclass(frozen=True)
class ComparisonAnswer:
    """Controllers with the study's gains or those that follow from it, and with tuned gains."""

    draws: Annotated[int, Quantity("1", "number of draws")]
    confidence: Annotated[float, Quantity("1", "confidence of each interval")]
    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    headline: Annotated[str, Quantity("", "the metric that is shown")]
    corresponding: ContestAnswer = field(metadata={MERGED: True})
    tuned: TunedContestAnswer | None
    untuned: Annotated[dict[str, str], Quantity("", "why none of a controller's gains could be tuned, by controller")]
    seconds: Annotated[float, Quantity("s", "computing time")]


class Contest(NamedTuple):
    """The results of several controllers on the same draws.

    Args:
        tables: The ``[controller]`` table of each controller.
        dataset: Along ``controller`` and ``draw`` it has ``failed``, ``outcome`` and every metric that all controllers
            have; along ``draw`` the uncertain numbers.
    """

    tables: dict[str, ControllerTable]
    dataset: xr.Dataset

    @classmethod
    def of(cls, study: Study, tables: dict[str, ControllerTable], progress: Callable[[], None]) -> "Contest":
        """Run the study with every controller.

        Args:
            study: The study without its sweep.
            tables: The ``[controller]`` table of each controller.
            progress: Called after each run.
        """
        parts: list[xr.Dataset] = []
        for name, table in tables.items():
            parts.append(running.run(with_controller(study, name, table)).dataset)
            progress()
        first = parts[0]
        uncertain = []
        common = []
        for name in first:
            if all("law" in part.get(name, part["outcome"]).attrs for part in parts):
                uncertain.append(name)
            elif all(name in part for part in parts):
                common.append(name)
        axis = controller_axis(tables)
        dataset = xr.concat([part[common] for part in parts], dim=axis, join="exact").assign(first[uncertain])
        failed = dataset["outcome"] != Outcome.OK
        dataset["failed"] = (failed.dims, failed.values, {"long_name": "the draw failed"})
        return cls(tables, dataset)

    def metrics(self, study: Study) -> list[str]:
        """Names of the study's metrics that all controllers have."""
        return [measure.name for measure in study.measures if measure.name in self.dataset]

    def pairs(self, study: Study, confidence: float = CONFIDENCE) -> list[ControllerPair]:
        """Compare every two controllers a and b draw by draw, by their failures and by each metric that both have."""
        pairs = []
        for a, b in itertools.combinations(self.tables, 2):
            first = self.dataset.sel(controller=a)
            second = self.dataset.sel(controller=b)
            failures = compare_failures(first["failed"].values, second["failed"].values, confidence)
            metrics = {}
            for name in self.metrics(study):
                paired = compare_metrics(first[name].values, second[name].values, confidence=confidence)
                metrics[name] = MetricDifference(paired.difference, paired.interval)
            pairs.append(ControllerPair(a, b, **failures._asdict(), metrics=metrics))
        return pairs

    def answer(self, study: Study, confidence: float = CONFIDENCE) -> ContestAnswer:
        """Failures, violations and median metrics of each controller, and the comparison of every pair."""
        controllers = {}
        for name, table in self.tables.items():
            data = self.dataset.sel(controller=name)
            failures = int(data["failed"].sum())
            draws = data.sizes["draw"]
            medians = {}
            for measure in study.measures:
                if measure.name in data:
                    values = data[measure.name].values
                    medians[measure.name] = upper_quantiles(values, [0.5], measure.metric.worst)[0]
            violations = {}
            for requirement in study.requirements:
                if requirement.name in data:
                    violations[requirement.label] = int(np.count_nonzero(violated(data[requirement.name].values)))
            low, high = clopper_pearson(failures, draws, confidence)
            controllers[name] = ControllerAnswer(
                controller=table,
                failures=failures,
                probability=failures / draws,
                interval=(low, high),
                violations=violations,
                median=medians,
            )
        return ContestAnswer(controllers, self.pairs(study, confidence))


class ContestPart(NamedTuple):
    """A contest without its data, which lie in the dataset of the comparison.

    Args:
        tables: The ``[controller]`` table of each controller.
        variables: Names of the contest's variables in that dataset.
    """

    tables: dict[str, ControllerTable]
    variables: tuple[str, ...]

    @classmethod
    def of(cls, contest: Contest) -> "ContestPart":
        """The part that belongs to a contest."""
        return cls(contest.tables, tuple(map(str, contest.dataset)))

    def contest(self, dataset: xr.Dataset) -> Contest:
        """The contest with its data.

        Args:
            dataset: The rows of the comparison's dataset that belong to these controllers, in their order.
        """
        labelled = dataset.assign_coords(controller=controller_axis(self.tables))
        return Contest(self.tables, labelled[list(self.variables)])


def controller_axis(names: Iterable[str]) -> xr.DataArray:
    """The coordinate ``controller`` of a dataset, from the controllers' names."""
    return name_axis("controller", names, "controller")


@dataclass(eq=False)
class Comparison(Analysis):
    """A comparison of controllers with corresponding gains, and with gains tuned on equal budgets.

    The dataset has every draw of every controller. Controllers with tuned gains are called NAME_tuned.

    Args:
        corresponding_part: Controllers with the gains that the study gives, or that follow from it.
        tuned_part: Controllers with the best gains found within the budget; None if nothing was tuned.
        budget: The budget of the tuning; None if nothing was tuned.
        seconds: Computing time [s].
        untuned: The reason why a controller could not be tuned, by the name of the controller.
    """

    kind = "compare"
    title = "Controllers compared"
    table = ("controller", "draw")

    corresponding_part: ContestPart
    tuned_part: ContestPart | None = None
    budget: Tuning | None = None
    seconds: float = 0.0
    untuned: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        study: Study,
        corresponding: Contest,
        tuned: Contest | None,
        budget: Tuning | None,
        seconds: float,
        untuned: Mapping[str, str],
    ) -> Self:
        """Create the comparison from its contests; arguments as of the class."""
        dataset = corresponding.dataset
        if tuned is not None:
            names = controller_axis(f"{name}_tuned" for name in tuned.tables)
            dataset = xr.concat(
                [dataset, tuned.dataset.assign_coords(controller=names)],
                dim="controller", data_vars="minimal", coords="minimal", compat="override", join="outer",
            )  # fmt: skip
        return cls(
            study=study,
            dataset=dataset,
            corresponding_part=ContestPart.of(corresponding),
            tuned_part=None if tuned is None else ContestPart.of(tuned),
            budget=None if tuned is None else budget,
            seconds=seconds,
            untuned=dict(untuned),
        )

    @cached_property
    def corresponding(self) -> Contest:
        """The contest with the gains that the study gives, or that follow from it."""
        count = len(self.corresponding_part.tables)
        return self.corresponding_part.contest(self.dataset.isel(controller=slice(count)))

    @cached_property
    def tuned(self) -> Contest | None:
        """The contest with tuned gains; None if nothing was tuned."""
        if self.tuned_part is None:
            return None
        count = len(self.corresponding_part.tables)
        return self.tuned_part.contest(self.dataset.isel(controller=slice(count, None)))

    @property
    def headline(self) -> str:
        """Number of failed draws of each controller, in one line."""
        failures = self.corresponding.dataset["failed"].sum("draw")
        counts = [f"{name} {int(failures.sel(controller=name))}" for name in self.corresponding.tables]
        return f"failures in {self.dataset.sizes['draw']:,} draws: {', '.join(counts)}"

    def figure(self) -> Figure:
        """Plot the controllers' failure probabilities, and their differences from the first one draw by draw."""
        return plotting.comparison(self)

    @property
    def answer(self) -> ComparisonAnswer:
        """The controllers with corresponding and with tuned gains, as ``summary.json`` has them."""
        tuned = None
        if self.tuned is not None and self.budget is not None:
            tuned = TunedContestAnswer(self.budget.text, self.tuned.answer(self.study))
        return ComparisonAnswer(
            draws=self.study.config.draws,
            confidence=CONFIDENCE,
            requirements=tuple(requirement.text for requirement in self.study.requirements),
            headline=headline_measure(self.study).name,
            corresponding=self.corresponding.answer(self.study),
            tuned=tuned,
            untuned=self.untuned,
            seconds=self.seconds,
        )


@takes_file
def compare(
    study: Study,
    controllers: Sequence[str],
    *,
    candidates: int = 0,
    tuning_draws: int = TUNING_DRAWS,
    progress: ProgressCallback | None = None,
) -> Comparison:
    """Compare controllers on common draws and common noise.

    Args:
        study: The study, or its file; its own sweep is ignored. Gains: see :func:`controller_table`.
        controllers: At least two names.
        candidates: Number of candidate gains to try for each controller; fresh draws decide. 0: no tuning.
        tuning_draws: Draws on which each candidate is tried.
        progress: Called with the runs and tunings done, and their total.

    Raises:
        ConfigError: A name is unknown or given twice, or a controller does not fit.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/mu_robustness.toml").override({"draws": 16, "loop.duration": 45.0})
        >>> comparison = dj.compare(study, ["dssc", "sta"])
        >>> [(pair["a"], pair["b"]) for pair in comparison.summary()["pairs"]]
        [('dssc', 'sta')]
    """
    began = time.perf_counter()
    require_independent(study, "a comparison")
    study, tables, studies = Contestants.of(study, controllers)
    steps = itertools.count(1)
    total = len(tables) * (3 if candidates else 1)

    def step() -> None:
        if progress:
            progress(next(steps), total)

    budget = Tuning.of(study, candidates, tuning_draws) if candidates else None
    if budget and len(study.loop.channels) > 1:
        raise ConfigError("candidates", "a plant of several channels is not tuned here; give the gains, and 0")
    extents = ranges_by_controller(studies) if budget else {}
    untuned = {name: untuned_reason(studies[name], name) for name, ranges in extents.items() if not ranges}
    corresponding = Contest.of(study, tables, step)
    contest = None
    if budget is not None and len(untuned) < len(tables):
        better = {}
        for name, rival in studies.items():
            with errors_under(f"compare.{name}"):
                better[name] = with_gains(tables[name], best_gains(rival, budget, extents[name]))
            step()
        contest = Contest.of(study, better, step)
    return Comparison.of(study, corresponding, contest, budget, time.perf_counter() - began, untuned)


def ranges_by_controller(studies: Mapping[str, Study]) -> dict[str, dict[str, tuple[float, float]]]:
    """The range of each number to tune, by controller; empty for a controller without a gain that can be tuned.

    Args:
        studies: The study with each controller.

    Raises:
        ConfigError: A range is not valid.
    """
    extents = {}
    for name, study in studies.items():
        requested = study.config.compare.get(name, {}).get("tune", {})
        with errors_under(f"compare.{name}"):
            extents[name] = gain_ranges(study, requested)
    return extents
