"""Search for the worst draw: within the laws' support, within k sigma, or within a given probability.

The search uses standardised coordinates (:mod:`dssc_jax.analyses.search_sets`): the quantile levels of the laws, or
their standard normal scores. Every draw comes with its likelihood, from the same scores. Knots of a disturbance or a
wind that is a ``spline`` are treated like other numbers, so signals need no special treatment. In-loop noise is that of
draw 0, and the likelihood leaves it out.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy.optimize import differential_evolution

from dssc_jax import plotting
from dssc_jax.analyses.defaults import BUDGET, LEAST_BUDGET, MOST_BUDGET
from dssc_jax.analyses.search_sets import ScoreBall, SearchSet, search_set
from dssc_jax.closed_loop.requirements import binding_requirement, worst_slack
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import BLOCK, Arrays
from dssc_jax.engine.evaluation import Derivative, Evaluator, GradientEvaluator
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.statistics import Likelihood, mass_within
from dssc_jax.study import Study

EXPLORED, CLIMBED = 0.25, 0.5  # shares of the budget; evolution gets what is left
STARTS, CLIMB = 8, 12  # largest number of climbs, and least number of steps of each
STRIDE, LONGER, SHORTER = 0.25, 1.5, 0.3  # first step of a climb, and its factors after success and failure
DESIGN = ("sampling", "replicates", "correlation")  # settings of a study for all its draws together
MEMBERS_EACH = 4  # of the evolution, for each coordinate


@dataclass(eq=False)
class Falsified(Analysis):
    """The worst draw found.

    The dataset has every simulated point, along ``point``: its numbers; its ``slack``, that of the worst requirement
    relative to its bound, negative if the draw fails; ``binding``, the index of that requirement; ``simulations``, the
    number spent so far; and its likelihood, as ``distance``, ``log_density`` and ``mass``
    (:class:`dssc_jax.statistics.Likelihood`). A simulation with derivatives counts once, and once more for each
    derivative.

    Args:
        within: Distance from the median draw within which the search stayed, in sigma; None for the whole support.
        seconds: Computing time.
    """

    kind = "falsify"
    title = "The worst draw"
    table = ("point",)

    within: float | None
    seconds: float

    @classmethod
    def of(cls, region: SearchSet, seen: Sequence["Seen"], seconds: float) -> Self:
        """Collect the simulated points in the order of the search."""
        points, slacks, binding, spent = (np.concatenate(parts) for parts in zip(*seen, strict=True))
        study, distances = region.study, region.distances(points)
        columns = {
            "slack": (slacks, "1", "signed slack"),
            "binding": (binding, "1", "index of the worst requirement"),
            "simulations": (spent, "1", "simulations spent until then"),
            "distance": (distances, "1", "distance from the median draw in standard normal scores"),
            "log_density": (-0.5 * distances**2, "1", "logarithm of the scores' density relative to the mode"),
            "mass": (mass_within(distances, region.size), "1", "probability of a draw at most this far"),
        }
        for name, column in region.values(points).items():
            columns[name] = (column, study.quantities[name].unit, study.quantities[name].meaning)
        described = {
            name: ("point", column, {"units": unit, "long_name": meaning})
            for name, (column, unit, meaning) in columns.items()
        }
        within = region.radius if isinstance(region, ScoreBall) else None
        return cls(study, xr.Dataset(described, attrs={"title": study.name}), within, seconds)

    @property
    def worst(self) -> int:
        """Index of the worst point."""
        return int(np.argmin(self.dataset["slack"].values))

    @property
    def witness(self) -> dict[str, float]:
        """Value of each uncertain number at the worst point."""
        return self.numbers_at(self.worst)

    @property
    def likelihood(self) -> Likelihood:
        """How likely the worst point is."""
        return self.likelihood_at(self.worst)

    @property
    def nearest_failure(self) -> int | None:
        """Index of the likeliest failure among the simulated points; None if there is none.

        Its distance is an upper bound of that of the likeliest failure of all, known as the design point.
        """
        failed = self.dataset["slack"].values < 0.0
        distances = np.where(failed, self.dataset["distance"].values, np.inf)
        return int(np.argmin(distances)) if failed.any() else None

    def numbers_at(self, point: int) -> dict[str, float]:
        """Value of each uncertain number at a point."""
        return {name: float(self.dataset[name][point]) for name in self.study.laws}

    def likelihood_at(self, point: int) -> Likelihood:
        """How likely a point is."""
        return Likelihood(float(self.dataset["distance"][point]), len(self.study.laws))

    @property
    def slack(self) -> float:
        """Slack of the worst point."""
        return float(self.dataset["slack"][self.worst])

    def binding_at(self, point: int) -> str | None:
        """The worst requirement of a point; None if its draw ends early, which violates all."""
        if self.dataset["slack"].values[point] == -np.inf:
            return None
        return self.study.requirements[int(self.dataset["binding"][point])].text

    @property
    def simulations(self) -> int:
        """Number of simulations spent."""
        return int(self.dataset["simulations"][-1])

    @property
    def first_failure(self) -> int | None:
        """The number of simulations until the first failure was found; None if there was none."""
        failed = np.flatnonzero(self.dataset["slack"].values < 0.0)
        return int(self.dataset["simulations"][failed[0]]) if failed.size else None

    @property
    def witness_study(self) -> Study:
        """The study of the witness alone, as draw 0: numbers replace the laws, and no design of draws is left."""
        table = {name: value for name, value in self.study.table.items() if name not in DESIGN}
        return Study.from_table({**table, "draws": 1}, self.study.source).override(self.witness)

    @property
    def headline(self) -> str:
        """The answer in one line."""
        of = f" in {self.binding_at(self.worst)}" if len(self.study.requirements) > 1 else ""
        ending = "ends early" if self.slack == -np.inf else f"has a slack of {self.slack:.4g} of its bound{of}"
        verdict = "fails" if self.slack < 0.0 else "passes"
        region = "" if self.within is None else f" within {self.within:.4g} sigma"
        place = f"at {self.likelihood.distance:.3g} sigma"
        return f"the worst of {self.simulations:,} simulations{region} {verdict} {place}: it {ending}"

    def figure(self) -> Figure:
        """Plot the answer."""
        return plotting.falsification(self)

    def content(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        nearest = self.nearest_failure
        return {
            "within": None if self.within is None else Likelihood(self.within, len(self.study.laws)).summary(),
            "requirements": [requirement.text for requirement in self.study.requirements],
            "failed": self.slack < 0.0,
            "slack": self.slack,
            "worst_requirement": self.binding_at(self.worst),
            "witness": self.witness,
            "likelihood": self.likelihood.summary(),
            "nearest_failure": None if nearest is None else self.about(nearest),
            "simulations": self.simulations,
            "first_failure": self.first_failure,
            "seconds": self.seconds,
        }

    def about(self, point: int) -> dict[str, Any]:
        """Slack, numbers and likelihood of a point, for JSON."""
        return {
            "slack": float(self.dataset["slack"][point]),
            "worst_requirement": self.binding_at(point),
            "witness": self.numbers_at(point),
            "likelihood": self.likelihood_at(point).summary(),
        }

    def settings(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        return {"within": self.within, "seconds": self.seconds}

    @classmethod
    def restored(cls, stored: Stored) -> Self:
        """See :class:`Analysis`."""
        return cls(stored.study, stored.dataset, **stored.settings)


def falsify(
    study: Study,
    *,
    budget: int = BUDGET,
    seed: int = 0,
    within_sigma: float | None = None,
    within_mass: float | None = None,
    progress: ProgressCallback | None = None,
) -> Falsified:
    """Find the worst draw of a study, by the worst requirement's signed slack.

    By default the search covers the support of the laws. With ``within_sigma`` = k it stays where |z| <= k, z being the
    independent standard normal scores of the laws and of their Gaussian copula: the smallest region of the scores with
    its probability P(chi^2_d <= k^2) for d numbers; with ``within_mass`` that probability is given instead of k.

    A quarter of the budget is spread over the set, and half of it climbs from the worst points along projected
    gradients. The rest is differential evolution among the worst of all points. A draw that ends early counts as worst.

    Args:
        study: The study; its own sweep is ignored. Unbounded laws are cut off at their 1e-6 quantiles.
        budget: Number of simulations.
        seed: Seed of the search.
        within_sigma: Distance k from the median draw within which to search, in (0, 8].
        within_mass: Probability of the draws among which to search, in (0, 1); instead of ``within_sigma``.
        progress: Called with the simulations spent.

    Raises:
        ConfigError: nothing is uncertain, nothing is required, the budget or the set is out of range, or both
            ``within_sigma`` and ``within_mass`` are given.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/mu_robustness.toml").override({"sweep": {}, "loop.duration": 45.0})
        >>> dj.falsify(study, budget=64).slack < 0.0
        True

    Reference:
        A. M. Hasofer, N. C. Lind, J. Engineering Mechanics Division 100 (1974) 111-121: distances in
        standard normal space.
    """
    study = study.without_sweep()
    require_hunt(study, budget)
    region = search_set(study, within_sigma, within_mass)
    return hunt(Programs.of(study, budget), budget, seed, progress, region)


def require_hunt(study: Study, budget: int) -> None:
    """Require uncertain numbers, requirements and an admissible budget.

    Raises:
        ConfigError: one of these is missing.
    """
    if not study.without_sweep().laws:
        raise ConfigError(study.source, "no number is uncertain, so all draws are equal; give laws")
    if not study.requirements:
        raise ConfigError(study.source, "nothing is required, so nothing can fail; give a [[requirement]]")
    if not LEAST_BUDGET <= budget <= MOST_BUDGET:
        raise ConfigError("budget", f"must be in {LEAST_BUDGET} .. {MOST_BUDGET}, got {budget}")


class Programs(NamedTuple):
    """The compiled study with and without derivatives, shared by searches of one budget; each compiles on first use."""

    study: Study
    plain: Evaluator
    steep: Evaluator

    @classmethod
    def of(cls, study: Study, budget: int) -> "Programs":
        """The programs of a study without a sweep."""
        lanes = max(spread(budget), members(budget, len(study.laws)))
        climbs = climbers(budget, len(study.laws))
        steep = GradientEvaluator(study, {}, climbs, names=list(study.laws))
        return cls(study, Evaluator(study, {}, min(BLOCK, lanes)), steep)


def spread(budget: int) -> int:
    """Number of points spread over the support: a power of two."""
    return 1 << int(np.log2(max(EXPLORED * budget, LEAST_BUDGET // 2)))


def members(budget: int, size: int) -> int:
    """Number of members of the evolution, such that several generations fit the budget."""
    return max(8, min(MEMBERS_EACH * size, budget // 20))


def climbers(budget: int, size: int) -> int:
    """Number of climbs, such that each can make several steps."""
    return max(1, min(STARTS, int(CLIMBED * budget) // (CLIMB * (1 + size))))


def hunt(
    programs: Programs,
    budget: int,
    seed: int,
    progress: ProgressCallback | None = None,
    region: SearchSet | None = None,
) -> Falsified:
    """Run one search, by default over the whole support; see :func:`falsify`."""
    began = time.perf_counter()
    region = region or search_set(programs.study)
    search = Hunt(programs, region, budget, np.random.default_rng(seed), progress)
    search.explore()
    for stage in (search.climb, search.evolve):
        if search.worst > -np.inf:
            stage()
    return Falsified.of(region, search.seen, time.perf_counter() - began)


class Seen(NamedTuple):
    """Simulated points.

    Args:
        points: Coordinates, shape (n, laws).
        slacks: That of the worst requirement, relative to its bound, shape (n,).
        binding: Index of that requirement, shape (n,).
        spent: Simulations spent until then, shape (n,).
    """

    points: np.ndarray
    slacks: np.ndarray
    binding: np.ndarray
    spent: np.ndarray


@dataclass
class Hunt:
    """A search in progress.

    Args:
        programs: The study, compiled.
        region: Where to search.
        budget: Number of simulations.
        rng: Random generator of the search.
        progress: Called with the simulations spent.
    """

    programs: Programs
    region: SearchSet
    budget: int
    rng: np.random.Generator
    progress: ProgressCallback | None
    spent: int = 0
    worst: float = np.inf
    seen: list[Seen] = field(default_factory=list)

    @property
    def size(self) -> int:
        """Number of uncertain numbers."""
        return self.region.size

    def simulate(self, points: np.ndarray, evaluator: Evaluator, each: int = 1) -> tuple[np.ndarray, Arrays]:
        """Slacks and results of points; ``each`` is the number of simulations that one point costs."""
        results = evaluator(np.zeros(len(points), dtype=int), self.region.values(points))
        requirements = evaluator.swept.requirements
        slacks, spent = worst_slack(requirements, results), self.spent + each * np.arange(1, len(points) + 1)
        self.seen.append(Seen(points, slacks, binding_requirement(requirements, results), spent))
        self.spent += each * len(points)
        self.worst = min(self.worst, float(slacks.min()))
        if self.progress:
            self.progress(min(self.spent, self.budget), self.budget)
        return slacks, results

    def explore(self) -> None:
        """Simulate points spread evenly over the set."""
        self.simulate(self.region.spread(spread(self.budget), self.rng), self.programs.plain)

    def ranked(self) -> tuple[np.ndarray, np.ndarray]:
        """All points so far with their slacks, worst first."""
        points, slacks, *_ = (np.concatenate(parts) for parts in zip(*self.seen, strict=True))
        order = np.argsort(slacks, kind="stable")
        return points[order], slacks[order]

    def starts(self, count: int) -> np.ndarray:
        """Starting points: the worst points that are far enough apart, then the worst of the rest."""
        points, _ = self.ranked()
        chosen: list[int] = []
        for index, point in enumerate(points):
            if len(chosen) == count:
                break
            if all(self.region.apart(point, points[other]) for other in chosen):
                chosen.append(index)
        rest = [index for index in range(len(points)) if index not in chosen]
        return points[[*chosen, *rest][:count]]

    def climb(self) -> None:
        """Run projected gradient descents of the slack simultaneously, each with its own step length."""
        each, room, evaluator = 1 + self.size, int(CLIMBED * self.budget), self.programs.steep
        points = self.starts(climbers(self.budget, self.size))
        if len(points) * each > room:
            return
        best, results = self.simulate(points, evaluator, each)
        slopes, stride = self.slopes(points, results), np.full(len(points), STRIDE)
        for _ in range(room // (each * len(points)) - 1):
            trial = self.region.descended(points, slopes, stride)
            slacks, results = self.simulate(trial, evaluator, each)
            better = slacks < best
            points = np.where(better[:, None], trial, points)
            slopes = np.where(better[:, None], self.slopes(trial, results), slopes)
            best, stride = np.minimum(best, slacks), stride * np.where(better, LONGER, SHORTER)
            if self.worst == -np.inf:
                return

    def slopes(self, points: np.ndarray, results: Arrays) -> np.ndarray:
        """Derivatives of the worst slack with respect to the coordinates, shape (n, laws); 0 if there is none."""
        requirements = self.programs.study.requirements
        binding = binding_requirement(requirements, results)
        columns = []
        for name in self.programs.study.laws:
            rows = [results[Derivative(r.name, name)] / r.scale for r in requirements]
            columns.append(np.take_along_axis(np.array(rows), binding[None], 0)[0])
        slopes = self.region.slopes(points, np.stack(columns, axis=1))
        return np.where(np.isfinite(slopes), slopes, 0.0)

    def evolve(self) -> None:
        """Run differential evolution, starting from the worst points so far."""
        count = members(self.budget, self.size)
        first: Any = self.ranked()[0][:count]
        generations = (self.budget - self.spent) // count - 1
        if generations < 1:
            return

        def cost(columns: np.ndarray) -> np.ndarray:
            slacks, _ = self.simulate(self.region.projected(np.atleast_2d(columns.T)), self.programs.plain)
            return np.clip(slacks, -1e100, 1e100)

        differential_evolution(
            cost, [self.region.limits] * self.size, init=first, rng=self.rng, tol=0.0,
            maxiter=generations, polish=False, vectorized=True, updating="deferred",
            callback=lambda x, convergence: self.worst == -np.inf,
        )  # fmt: skip
