"""The search of ``falsify``: points spread evenly, projected gradients, then differential evolution."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from dssc_jax.analyses.defaults import LEAST_BUDGET
from dssc_jax.analyses.falsification.search_sets import SearchSet
from dssc_jax.closed_loop.requirements import (
    Requirement,
    binding_requirement,
    counted_places,
    ended_early,
    first_violation,
    with_typical_slacks,
    worst_slack,
)
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import BLOCK
from dssc_jax.engine.evaluation import Evaluator, GradientEvaluator, native_code, worst_slopes
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study

EXPLORED, CLIMBED = 0.25, 0.5  # shares of the budget; evolution gets what is left
STARTS, CLIMB = 8, 12  # largest number of climbs, and least number of steps of each
STRIDE, LONGER, SHORTER = 0.25, 1.5, 0.3  # first step of a climb, and its factors after success and failure
MEMBERS_PER_COORDINATE = 4  # members of the evolution, for each coordinate


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
    return max(8, min(MEMBERS_PER_COORDINATE * size, budget // 20))


def climbers(budget: int, size: int) -> int:
    """Number of climbs, such that each can make several steps."""
    return max(1, min(STARTS, int(CLIMBED * budget) // (CLIMB * (1 + size))))


class SimulatedPoints(NamedTuple):
    """Simulated points.

    Args:
        points: Coordinates, shape (n, laws).
        slacks: Slack of the worst requirement, relative to its scale, shape (n,).
        binding: Index of that requirement, shape (n,).
        distances: Slack of that requirement in its metric's unit, shape (n,).
        simulation_counts: Simulations spent until then, shape (n,).
        ended: Code of how the draw ended early; 0 if it ran to its end, shape (n,).
        failed_at: Time at which it ended early [s]; NaN if it ran to its end, shape (n,).
        first: Index of the requirement that it violated first, before it ended; -1 if none, shape (n,).
        violated_at: Time at which that was certain [s]; NaN if none, shape (n,).
        single_slacks: Slack of every requirement in its metric's unit, shape (n, requirements).
    """

    points: np.ndarray
    slacks: np.ndarray
    binding: np.ndarray
    distances: np.ndarray
    simulation_counts: np.ndarray
    ended: np.ndarray
    failed_at: np.ndarray
    first: np.ndarray
    violated_at: np.ndarray
    single_slacks: np.ndarray


@dataclass
class Hunt:
    """A search in progress.

    Args:
        programs: The study, compiled.
        region: Where to search.
        budget: Number of simulations.
        rng: Random generator of the search.
        progress: Called with the simulations spent.
        requirement: Label of the only requirement that counts; empty: all count.
        requirements: The study's, with the scales that the first points show.
        unspent: Why evolution leaves simulations, in words; empty if it does not, or has not begun.
    """

    programs: Programs
    region: SearchSet
    budget: int
    rng: np.random.Generator
    progress: ProgressCallback | None
    requirement: str = ""
    simulation_count: int = 0
    worst: float = np.inf
    batches: list[SimulatedPoints] = field(default_factory=list)
    requirements: tuple[Requirement, ...] = ()
    unspent: str = ""

    @property
    def stopped(self) -> str:
        """Why the search stopped before its budget was spent, in words; empty if it spent it."""
        if self.simulation_count >= self.budget:
            return ""
        if self.worst > -np.inf:
            return self.unspent
        points = self.batches[-1]
        place = int(np.argmin(points.slacks))
        if points.ended[place]:
            return "a draw ended early, and no draw is worse"
        label = self.requirements[int(points.binding[place])].label
        return f"a draw misses {label} by an infinite amount, and no draw is worse"

    @property
    def size(self) -> int:
        """Number of uncertain numbers."""
        return self.region.size

    def simulate(self, points: np.ndarray, evaluator: Evaluator, cost: int = 1) -> tuple[np.ndarray, Arrays]:
        """Slacks and results of points; ``cost`` is the number of simulations that one point costs."""
        results = evaluator(np.zeros(len(points), dtype=int), self.region.values(points))
        self.requirements = self.requirements or with_typical_slacks(self.programs.study.requirements, results)
        relevant_places = counted_places(self.requirements, self.requirement)
        requirements = [self.requirements[place] for place in relevant_places]
        slacks = worst_slack(requirements, results)
        binding = np.array(relevant_places)[binding_requirement(requirements, results)]
        all_slacks = np.array([results[requirement.name] for requirement in self.requirements])
        distances = np.take_along_axis(all_slacks, binding[None], 0)[0]
        simulation_counts = self.simulation_count + cost * np.arange(1, len(points) + 1)
        ended = np.where(ended_early(results["outcome"]), results["outcome"], 0)
        first, violated_at = first_violation(self.requirements, results)
        self.batches.append(
            SimulatedPoints(
                points=points,
                slacks=slacks,
                binding=binding,
                distances=distances,
                simulation_counts=simulation_counts,
                ended=ended,
                failed_at=results["failed_at"],
                first=first,
                violated_at=violated_at,
                single_slacks=all_slacks.T,
            )
        )
        self.simulation_count += cost * len(points)
        self.worst = min(self.worst, float(slacks.min()))
        if self.progress:
            self.progress(min(self.simulation_count, self.budget), self.budget)
        return slacks, results

    def explore(self) -> None:
        """Simulate points spread evenly over the set."""
        self.simulate(self.region.spread(spread(self.budget), self.rng), self.programs.plain)

    def ranked(self) -> tuple[np.ndarray, np.ndarray]:
        """All points so far with their slacks, worst first."""
        points, slacks, *_ = (np.concatenate(parts) for parts in zip(*self.batches, strict=True))
        order = np.argsort(slacks, kind="stable")
        return points[order], slacks[order]

    @property
    def relevant_requirements(self) -> list[Requirement]:
        """The requirements that the search considers."""
        return [self.requirements[place] for place in counted_places(self.requirements, self.requirement)]

    def single_slacks(self) -> np.ndarray:
        """Slack of each relevant requirement, relative to its scale, at all points so far; shape (n, requirements)."""
        places = counted_places(self.requirements, self.requirement)
        scales = np.array([requirement.scale for requirement in self.relevant_requirements])
        slacks = np.concatenate([batch.single_slacks[:, places] for batch in self.batches]) / scales
        return np.where(np.isnan(slacks), -np.inf, slacks)

    def starts(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Starting points of climbs, and the index of the relevant requirement whose slack each climb descends.

        The worst draw of all requirements is the worst among those of each. The requirement that binds at most points
        would otherwise hide another one, whose worst draws lie elsewhere. So they take turns, the most critical one
        first: a climb starts at its worst point that is far enough from the other starts, or at the worst that is left.
        """
        points = np.concatenate([batch.points for batch in self.batches])
        slacks = self.single_slacks()
        targets = np.resize(np.argsort(slacks.min(axis=0), kind="stable"), count)
        starts: list[int] = []
        for target in targets:
            unused = [index for index in np.argsort(slacks[:, target], kind="stable").tolist() if index not in starts]
            apart = (index for index in unused if self.is_apart(points[index], points[starts]))
            starts.append(next(apart, unused[0]))
        return points[starts], targets

    def is_apart(self, point: np.ndarray, other_starts: np.ndarray) -> bool:
        """Whether a point is far enough from each of the other starts, shape (n, laws)."""
        return all(self.region.separate(point, other) for other in other_starts)

    def climb(self) -> None:
        """Run projected gradient descents simultaneously, each of one slack and with its own step length.

        Native code has no derivatives, and neither has an early end; then evolution gets this share of the budget.
        """
        if native_code(self.programs.study) or not self.relevant_requirements:
            return
        cost, room, evaluator = 1 + self.size, int(CLIMBED * self.budget), self.programs.steep
        points, targets = self.starts(climbers(self.budget, self.size))
        if len(points) * cost > room:
            return
        _, results = self.simulate(points, evaluator, cost)
        best, slopes = self.descent(points, results, targets)
        stride = np.full(len(points), STRIDE)
        for _ in range(room // (cost * len(points)) - 1):
            trial = self.region.descended(points, slopes, stride)
            _, results = self.simulate(trial, evaluator, cost)
            slacks, trial_slopes = self.descent(trial, results, targets)
            better = slacks < best
            points = np.where(better[:, None], trial, points)
            slopes = np.where(better[:, None], trial_slopes, slopes)
            best, stride = np.minimum(best, slacks), stride * np.where(better, LONGER, SHORTER)
            if self.worst == -np.inf:
                return

    def descent(self, points: np.ndarray, results: Arrays, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The slack that each climb descends, shape (n,), and its derivatives by the coordinates, shape (n, laws)."""
        laws = list(self.programs.study.laws)
        slacks = np.array([worst_slack([requirement], results) for requirement in self.relevant_requirements])
        gradients = np.array([worst_slopes([requirement], results, laws) for requirement in self.relevant_requirements])
        climbs = np.arange(len(points))
        slopes = self.region.slopes(points, gradients[targets, climbs])
        return slacks[targets, climbs], np.where(np.isfinite(slopes), slopes, 0.0)

    def evolve(self) -> None:
        """Run differential evolution, starting from the worst points so far."""
        count = members(self.budget, self.size)
        first_generation: Any = self.ranked()[0][:count]
        remaining_budget = self.budget - self.simulation_count
        generations = remaining_budget // count - 1
        self.unspent = f"the {remaining_budget % count} simulations left are fewer than a generation of {count}"
        if generations < 1:
            self.unspent = f"the {remaining_budget} simulations left are fewer than two generations of {count}"
            return

        def cost(columns: np.ndarray) -> np.ndarray:
            slacks, _ = self.simulate(self.region.projected(np.atleast_2d(columns.T)), self.programs.plain)
            return np.clip(slacks, -1e100, 1e100)

        evolution = differential_evolution(
            cost, [self.region.limits] * self.size, init=first_generation, rng=self.rng, tol=0.0,
            maxiter=generations, polish=False, vectorized=True, updating="deferred",
            callback=lambda x, convergence: self.worst == -np.inf,
        )  # fmt: skip
        if evolution.nit < generations:
            self.unspent = f"all {count} draws of the last generation are equally bad"
