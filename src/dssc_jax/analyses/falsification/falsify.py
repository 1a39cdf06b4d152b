"""Search for the worst draw: within the laws' support, within k sigma, or within a given probability.

The search uses standardised coordinates (:mod:`dssc_jax.analyses.falsification.search_sets`): the quantile levels of
the laws, or their standard normal scores. Every draw comes with its likelihood, from the same scores. Knots of a
disturbance or a wind that is a ``spline`` are treated like other numbers, so signals need no special treatment. All
points have the in-loop noise of draw 0, which the likelihood leaves out.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.defaults import BUDGET
from dssc_jax.analyses.falsification.answer import (
    FalsifiedAnswer,
    PointAnswer,
    likelihood_answer,
    value_text,
)
from dssc_jax.analyses.falsification.conditions import require_falsifiable, require_label, without_other_margins
from dssc_jax.analyses.falsification.search import (
    RAN_TO_END,
    SearchPrograms,
    SimulatedPoints,
    WorstDrawSearch,
    join_batches,
)
from dssc_jax.analyses.falsification.search_sets import ScoreBall, SearchSet, search_set
from dssc_jax.closed_loop.metrics.requirements import Requirement, counted_places
from dssc_jax.core.quantities import unit_and_meaning
from dssc_jax.core.signals import Outcome, ProgressCallback
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.schema import ENDINGS
from dssc_jax.statistics import Likelihood, mass_within
from dssc_jax.study import Study, takes_file
from dssc_jax.study.known_draws import study_of_draw

DESIGN = ("sampling", "replicates", "correlation")  # settings of a study for all of its draws together
NO_UNIT = ""  # of values whose unit depends on the metric
NOTHING_VIOLATED = -1  # in place of the index of the requirement that is violated first


@dataclass(eq=False)
class Falsified(Analysis):
    """The worst draw that a search found, among all draws that it simulated.

    The dataset has along ``point``, one simulated draw each:

    * the uncertain numbers, and the slack of every requirement in its metric's unit, by their names;
    * ``slack``, the slack of the worst requirement relative to its bound, negative if the draw fails; for a bound of 0
      relative to the median slack of the first points;
    * ``binding``, the index of the worst requirement, and ``distance_to_bound``, its slack in the metric's unit;
    * ``ended``, the outcome code of a draw that ended early, else 0, and ``failed_at``, the time of this end [s];
    * ``first``, the index of the requirement that is violated first, else -1, and ``violated_at``, the time of that
      violation [s];
    * ``distance``, ``log_density`` and ``mass``, the likelihood (:class:`dssc_jax.statistics.Likelihood`);
    * ``simulations``, the number of simulations spent so far. A simulation with derivatives by d numbers counts as
      1 + d simulations.

    Args:
        within: Distance from the median draw within which the search stayed, in sigma; None for the whole support.
        seconds: Computing time [s].
        stopped: Why the search stopped before its budget was spent, in words; empty if it spent it.
        requirement: Label of the only requirement that counts; empty: all count.
    """

    kind = "falsify"
    title = "The worst draw"
    table = ("point",)

    within: float | None
    seconds: float
    stopped: str = ""
    requirement: str = ""

    @classmethod
    def of(
        cls,
        region: SearchSet,
        batches: Sequence[SimulatedPoints],
        seconds: float,
        stopped: str = "",
        requirement: str = "",
    ) -> Self:
        """Create the analysis from the simulated points.

        Args:
            region: The set that was searched.
            batches: The simulated points in the order of the search.
            seconds: Computing time [s].
            stopped: Why the search stopped before its budget was spent; empty if it spent it.
            requirement: Label of the only requirement that counts; empty: all count.
        """
        simulated = join_batches(batches)
        study = region.study
        distances = region.distances(simulated.points)
        bound_meaning = "slack of the worst requirement in its metric's unit"
        columns = {  # values, unit, meaning
            "slack": (simulated.slacks, "1", "signed slack"),
            "binding": (simulated.binding, "1", "index of the worst requirement"),
            "distance_to_bound": (simulated.distances_to_bound, NO_UNIT, bound_meaning),
            "simulations": (simulated.simulation_counts, "1", "simulations spent until then"),
            "ended": (simulated.ended, "1", "outcome code of a draw that ended early, else 0"),
            "failed_at": (simulated.failed_at, "s", "time at which it ended early (NaN: it did not)"),
            "first": (simulated.first_violated, "1", "index of the requirement that it violated first, else -1"),
            "violated_at": (simulated.violated_at, "s", "time at which that was certain (NaN: none was violated)"),
            "distance": (distances, "1", "distance from the median draw in standard normal scores"),
            "log_density": (-0.5 * distances**2, "1", "logarithm of the scores' density relative to the mode"),
            "mass": (mass_within(distances, region.size), "1", "probability of a draw at most this far"),
        }
        for required, column in zip(study.requirements, simulated.single_slacks.T, strict=True):
            columns[required.name] = (column, NO_UNIT, f"slack of {required.text} in its metric's unit")
        for name, column in region.values(simulated.points).items():
            columns[name] = (column, study.quantities[name].unit, study.quantities[name].meaning)
        variables = {}
        for name, (column, unit, meaning) in columns.items():
            variables[name] = ("point", column, unit_and_meaning(unit, meaning))
        return cls(
            study=study,
            dataset=xr.Dataset(variables, attrs={"title": study.name}),
            within=region.radius if isinstance(region, ScoreBall) else None,
            seconds=seconds,
            stopped=stopped,
            requirement=requirement,
        )

    @property
    def worst(self) -> int:
        """Index of the simulated point with the smallest slack."""
        return int(np.argmin(self.dataset["slack"].values))

    @property
    def witness(self) -> dict[str, float]:
        """Value of each uncertain number at the worst point, by dotted name."""
        return self.numbers_at(self.worst)

    @property
    def likelihood(self) -> Likelihood:
        """Likelihood of the draw at the worst point."""
        return self.likelihood_at(self.worst)

    @property
    def nearest_failure(self) -> int | None:
        """Index of the likeliest simulated failure: the one nearest to the median draw in standard normal scores.

        None if no simulated point failed. The true nearest failure (the design point) is no farther than this one.
        """
        failed = self.dataset["slack"].values < 0.0
        if not failed.any():
            return None
        distances = np.where(failed, self.dataset["distance"].values, np.inf)
        return int(np.argmin(distances))

    def numbers_at(self, point: int) -> dict[str, float]:
        """Return the value of each uncertain number at a simulated point, by dotted name."""
        return {name: float(self.dataset[name][point]) for name in self.study.laws}

    def likelihood_at(self, point: int) -> Likelihood:
        """Likelihood of the draw at a simulated point, given by its index."""
        return Likelihood(float(self.dataset["distance"][point]), len(self.study.laws))

    @property
    def slack(self) -> float:
        """Relative slack of the worst requirement at the worst point; negative: its draw fails."""
        return float(self.dataset["slack"][self.worst])

    def binding_requirement_at(self, point: int) -> Requirement | None:
        """Return the worst requirement of a point; None if its draw ends early, which violates all requirements."""
        if self.dataset["ended"].values[point] != RAN_TO_END:
            return None
        return self.study.requirements[int(self.dataset["binding"][point])]

    def binding_at(self, point: int) -> str | None:
        """Describe the worst requirement of a point in words; None if its draw ends early, so that none stands out."""
        requirement = self.binding_requirement_at(point)
        return None if requirement is None else requirement.short_text

    def value_at(self, point: int) -> str | None:
        """Format the metric that the worst requirement of a point bounds, with its unit; None: the draw ends early."""
        requirement = self.binding_requirement_at(point)
        if requirement is None:
            return None
        return value_text(requirement, float(self.dataset["distance_to_bound"][point]))

    @property
    def worst_value_texts(self) -> dict[str, str]:
        """The worst value of each required metric, with its unit, over the points whose simulations were completed."""
        ran_to_end = self.dataset["ended"].values == RAN_TO_END
        texts = {}
        for requirement in self.study.requirements:
            slacks = self.dataset[requirement.name].values[ran_to_end]
            if np.any(~np.isnan(slacks)):
                texts[requirement.short_text] = value_text(requirement, float(np.nanmin(slacks)))
        return texts

    def ending_at(self, point: int) -> str | None:
        """How the draw of a point ends early, in words; None if it runs to its end."""
        code = int(self.dataset["ended"].values[point])
        return None if code == RAN_TO_END else ENDINGS[Outcome(code)]

    def course_at(self, point: int) -> str:
        """When and how the draw of a point fails, in words; empty if it runs to its end and meets all requirements."""
        ending = self.ending_at(point)
        first_violated = self.first_at(point)
        violation = ""
        if first_violated is not None:
            violated_at = float(self.dataset["violated_at"].values[point])
            violation = f"violates {first_violated} at {violated_at:.4g} s"
        if ending is None:
            return f"it first {violation}" if violation else ""
        ended_at = float(self.dataset["failed_at"].values[point])
        if violation:
            return f"it {ending} at {ended_at:.4g} s; before that it {violation}"
        return f"it {ending} at {ended_at:.4g} s, before it violates any requirement"

    def first_at(self, point: int) -> str | None:
        """The requirement that a point violates first, before its draw ends, in words; None if it violates none."""
        index = int(self.dataset["first"].values[point])
        return None if index == NOTHING_VIOLATED else self.study.requirements[index].short_text

    @property
    def simulations(self) -> int:
        """Number of simulations spent."""
        return int(self.dataset["simulations"][-1])

    @property
    def first_failure(self) -> int | None:
        """The number of simulations until the first failure was found; None if there was none."""
        failed = np.flatnonzero(self.dataset["slack"].values < 0.0)
        if not failed.size:
            return None
        return int(self.dataset["simulations"][failed[0]])

    @property
    def witness_study(self) -> Study:
        """The study whose only draw is the worst one: numbers replace the laws, and no table designs other draws."""
        table = {name: value for name, value in self.study.table.items() if name not in DESIGN}
        study_of_one_draw = Study.from_table({**table, "draws": 1}, self.study.source)
        return study_of_draw(study_of_one_draw, self.witness)

    @property
    def headline(self) -> str:
        """One line that says whether the worst draw fails, how far it is from the median draw, and how it behaves."""
        value = self.value_at(self.worst)
        course = self.ending_at(self.worst)
        if value is not None:
            course = f"has {value} where {self.binding_at(self.worst)} is required"
        verdict = "fails" if self.slack < 0.0 else "passes"
        region = "" if self.within is None else f" within {self.within:.4g} sigma"
        place = f"at {self.likelihood.distance:.3g} sigma"
        return f"the worst of {self.simulations:,} simulations{region} {verdict} {place}: it {course}"

    def figure(self) -> Figure:
        """Plot the slacks along the search, and where the worst draw lies within its laws."""
        return plotting.falsification(self)

    @property
    def answer(self) -> FalsifiedAnswer:
        """The worst draw and the likeliest failure, as ``summary.json`` has them."""
        nearest = self.nearest_failure
        within = None
        if self.within is not None:
            within = likelihood_answer(Likelihood(self.within, len(self.study.laws)))
        required = self.study.requirements
        counted = [required[place] for place in counted_places(required, self.requirement)]
        return FalsifiedAnswer(
            within=within,
            requirements=tuple(requirement.text for requirement in counted),
            failed=self.slack < 0.0,
            worst=self.point_answer(self.worst),
            units={name: self.study.quantities[name].unit for name in self.study.laws},
            nearest_failure=None if nearest is None else self.point_answer(nearest),
            worst_seen=self.worst_value_texts,
            simulations=self.simulations,
            stopped=self.stopped,
            first_failure=self.first_failure,
            seconds=self.seconds,
        )

    def point_answer(self, point: int) -> PointAnswer:
        """The answer for one simulated point, given by its index: its draw's slack, failure, numbers and likelihood."""
        ending = self.ending_at(point)
        first = self.first_at(point)
        return PointAnswer(
            slack=float(self.dataset["slack"][point]),
            worst_requirement=self.binding_at(point),
            worst_value=self.value_at(point),
            ending=ending,
            ended_at=None if ending is None else float(self.dataset["failed_at"].values[point]),
            first_violated=first,
            violated_at=None if first is None else float(self.dataset["violated_at"].values[point]),
            witness=self.numbers_at(point),
            likelihood=likelihood_answer(self.likelihood_at(point)),
        )


@takes_file
def falsify(
    study: Study,
    *,
    budget: int = BUDGET,
    seed: int = 0,
    within_sigma: float | None = None,
    within_mass: float | None = None,
    requirement: str = "",
    progress: ProgressCallback | None = None,
) -> Falsified:
    """Find the worst draw of a study, by the worst requirement's signed slack.

    By default the search covers the support of the laws. With ``within_sigma`` = k the search stays in the ball
    |z| <= k, where z are the independent standard normal scores of the laws and of their Gaussian copula. For d numbers
    the ball has the probability P(chi^2_d <= k^2), and no smaller region of the scores has the same probability. With
    ``within_mass`` this probability is given instead of k.

    A quarter of the budget is spread over the set. Half of the budget follows projected gradients from the worst of
    these points, unless a controller is native code, which has no derivatives. The rest goes to differential evolution,
    which starts from the worst of all points. A draw that ends early counts as worst.

    Args:
        study: The study, or its file; its own sweep is ignored. Unbounded laws are cut off at their 1e-6 quantiles.
        budget: Number of simulations.
        seed: Seed of the search.
        within_sigma: Distance k from the median draw within which to search, in (0, 8].
        within_mass: Probability of the draws among which to search, in (0, 1); instead of ``within_sigma``.
        requirement: Label of the only requirement that counts, as in results; empty: the worst of all counts. If the
            label is not that of a margin, required margins are not computed.
        progress: Called with the simulations spent.

    Raises:
        ConfigError: Nothing is uncertain, nothing is required, the requirement is unknown, the budget or the set is
            out of range, or both ``within_sigma`` and ``within_mass`` are given.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/mu_robustness.toml").override({"sweep": {}, "loop.duration": 45.0})
        >>> dj.falsify(study, budget=64).slack < 0.0
        True

    Reference:
        A. M. Hasofer, N. C. Lind, J. Engineering Mechanics Division 100 (1974) 111-121, on this distance.
    """
    study = study.without_sweep()
    require_falsifiable(study, budget)
    require_label(study, requirement)
    study = without_other_margins(study, requirement)
    region = search_set(study, within_sigma, within_mass)
    return search_worst_draw(SearchPrograms.of(study, budget), budget, seed, progress, region, requirement)


def search_worst_draw(
    programs: SearchPrograms,
    budget: int,
    seed: int,
    progress: ProgressCallback | None = None,
    region: SearchSet | None = None,
    requirement: str = "",
) -> Falsified:
    """Search for the worst draw with programs that are compiled already; :func:`falsify` compiles them.

    Args:
        programs: The compiled study.
        budget: Number of simulations.
        seed: Seed of the search.
        progress: Called with the simulations spent.
        region: The draws among which to search; None: the whole support of the laws.
        requirement: Label of the only requirement that counts; empty: all count.
    """
    began = time.perf_counter()
    region = region or search_set(programs.study)
    search = WorstDrawSearch(
        programs=programs,
        region=region,
        budget=budget,
        rng=np.random.default_rng(seed),
        progress=progress,
        requirement=requirement,
    )
    search.explore()
    for improve in (search.climb, search.evolve):
        if search.worst > -np.inf:  # nothing is worse than an infinite miss
            improve()
    return Falsified.of(region, search.batches, time.perf_counter() - began, search.stopped, requirement)
