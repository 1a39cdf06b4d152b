"""Compare controllers on the same draws and noise, singly and in pairs."""

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Self

import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.comparison.contest import Contest, ContestAnswer, ContestPart, controller_axis
from dssc_jax.analyses.comparison.rivals import Contestants
from dssc_jax.analyses.comparison.tuning import Tuning, best_gains, gain_ranges, untuned_reason, with_gains
from dssc_jax.analyses.defaults import TUNING_DRAWS
from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.fields import MERGED
from dssc_jax.results.result import headline_measure
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.study import Study, takes_file


@dataclass(frozen=True)
class TunedContestAnswer:
    """The contest of controllers whose gains were tuned on equal budgets, with the budget in words.

    In JSON the fields of ``contest`` are merged into this object, next to ``budget``.
    """

    budget: Annotated[str, Quantity("", "the budget of each controller")]
    contest: ContestAnswer = field(metadata={MERGED: True})


@dataclass(frozen=True)
class ComparisonAnswer:
    """The answer of a comparison: the contest with given or derived gains, and the contest with tuned gains.

    The gains of ``corresponding`` are those that the study states for a controller, or else derives for it. ``tuned``
    is None if nothing was tuned. In JSON the fields of ``corresponding`` are merged into this object.
    """

    draws: Annotated[int, Quantity("1", "number of draws")]
    confidence: Annotated[float, Quantity("1", "confidence of each interval")]
    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    headline: Annotated[str, Quantity("", "the metric that is shown")]
    corresponding: ContestAnswer = field(metadata={MERGED: True})
    tuned: TunedContestAnswer | None
    untuned: Annotated[dict[str, str], Quantity("", "why none of a controller's gains could be tuned, by controller")]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(eq=False)
class Comparison(Analysis):
    """A comparison of controllers with corresponding gains, and with gains tuned on equal budgets.

    Corresponding gains are those that the study states for a controller, or else gains derived from the study's DSSC.
    The dataset has every draw of every controller. Controllers with tuned gains are called NAME_tuned.

    Args:
        corresponding_part: Controllers with corresponding gains.
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
        """Create the comparison from its contests.

        Args:
            study: The study without its sweep.
            corresponding: The contest with corresponding gains.
            tuned: The contest with tuned gains; None if nothing was tuned.
            budget: The budget of the tuning.
            seconds: Computing time [s].
            untuned: The reason why a controller could not be tuned, by the name of the controller.
        """
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
        """The contest with corresponding gains: stated by the study, or derived from its DSSC."""
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
        """Plot each controller's failure probability, and its difference from the first controller's, draw by draw."""
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
        study: The study, or its file; its own sweep is ignored. :func:`controller_table` tells where gains come from.
        controllers: At least two names.
        candidates: Number of sets of gains to try for each controller; fresh draws compare the tuned controllers. 0: no
            tuning.
        tuning_draws: Number of draws on which each set of gains is tried.
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
    step_numbers = itertools.count(1)
    steps_of_controller = 3 if candidates else 1  # a run, a tuning, and a run with the tuned gains; or a run alone
    total = len(tables) * steps_of_controller

    def report_step() -> None:
        """Report that one more run or tuning is done."""
        if progress:
            progress(next(step_numbers), total)

    budget = Tuning.of(study, candidates, tuning_draws) if candidates else None
    if budget and len(study.loop.channels) > 1:
        raise ConfigError("candidates", "a plant of several channels is not tuned here; give the gains, and 0")
    extents = ranges_by_controller(studies) if budget else {}
    untuned = {name: untuned_reason(studies[name], name) for name, ranges in extents.items() if not ranges}
    corresponding = Contest.of(study, tables, report_step)
    tuned = None
    if budget is not None and len(untuned) < len(tables):
        tuned_tables = {}
        for name, rival in studies.items():
            with errors_under(f"compare.{name}"):
                tuned_tables[name] = with_gains(tables[name], best_gains(rival, budget, extents[name]))
            report_step()
        tuned = Contest.of(study, tuned_tables, report_step)
    return Comparison.of(study, corresponding, tuned, budget, time.perf_counter() - began, untuned)


def ranges_by_controller(studies: Mapping[str, Study]) -> dict[str, dict[str, tuple[float, float]]]:
    """The range of each gain to tune, by controller and dotted name; empty for a controller with no tunable gain.

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
