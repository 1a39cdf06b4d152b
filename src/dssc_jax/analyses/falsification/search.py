"""The search of ``falsify``: points spread evenly, projected gradients, then differential evolution."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from dssc_jax.analyses.defaults import LEAST_BUDGET
from dssc_jax.analyses.falsification.search_sets import SearchSet
from dssc_jax.closed_loop.metrics.requirements import (
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

EXPLORED = 0.25  # share of the budget for points that are spread evenly
CLIMBED = 0.5  # share of the budget for gradient descents; evolution gets the remainder
STARTS = 8  # largest number of descents
CLIMB = 12  # least number of steps of each descent
STRIDE = 0.25  # first step of a descent, relative to the size of the set
LONGER = 1.5  # factor of a step after success
SHORTER = 0.3  # factor of a step after failure
MEMBERS_PER_COORDINATE = 4  # members of the evolution, for each coordinate
LEAST_MEMBERS = 8  # members of the evolution in any case
GENERATION_COST = 20  # a generation takes at most one part in so many of the budget
LARGEST_COST = 1e100  # largest size of a cost in the evolution, in place of infinity
RAN_TO_END = 0  # value of a draw that did not end early, in place of an outcome code


class SearchPrograms(NamedTuple):
    """The compiled programs of a study, shared by all searches with one budget; each compiles on first use.

    Args:
        study: The study without a sweep.
        plain: Simulates draws.
        with_gradients: Simulates draws, with the derivatives of the metrics by each uncertain number.
    """

    study: Study
    plain: Evaluator
    with_gradients: Evaluator

    @classmethod
    def of(cls, study: Study, budget: int) -> "SearchPrograms":
        """Create the programs of a study without a sweep, in batches as large as a search needs.

        Args:
            study: The study.
            budget: Number of simulations of the search.
        """
        size = len(study.laws)
        lanes = max(exploration_size(budget), population_size(budget, size))
        with_gradients = GradientEvaluator(study, {}, climb_count(budget, size), names=list(study.laws))
        return cls(study, Evaluator(study, {}, min(BLOCK, lanes)), with_gradients)


def exploration_size(budget: int) -> int:
    """Number of evenly spread points with which a search begins: the largest power of two within their budget share.

    Args:
        budget: Number of simulations.
    """
    share = max(EXPLORED * budget, LEAST_BUDGET // 2)
    return 1 << int(np.log2(share))


def population_size(budget: int, size: int) -> int:
    """Number of members of a generation of the differential evolution; several generations fit the budget.

    Args:
        budget: Number of simulations.
        size: Number of uncertain numbers.
    """
    return max(LEAST_MEMBERS, min(MEMBERS_PER_COORDINATE * size, budget // GENERATION_COST))


def climb_count(budget: int, size: int) -> int:
    """Number of gradient descents that run together; each can make several steps within the descents' budget share.

    Args:
        budget: Number of simulations.
        size: Number of uncertain numbers; a simulation with derivatives costs 1 + size.
    """
    return max(1, min(STARTS, int(CLIMBED * budget) // (CLIMB * (1 + size))))


class SimulatedPoints(NamedTuple):
    """Simulated draws as points of a search, with their results.

    Args:
        points: Coordinates, shape (n, laws).
        slacks: Slack of the worst requirement, relative to the scale of that requirement, shape (n,).
        binding: Index of the worst requirement among all requirements of the study, shape (n,).
        distances_to_bound: Slack of the worst requirement in its metric's unit, shape (n,).
        simulation_counts: Simulations spent by the search up to and including each point, shape (n,).
        ended: Outcome code of a draw that ended early; 0 if it ran to its end, shape (n,).
        failed_at: Time at which the draw ended early [s]; NaN if it ran to its end, shape (n,).
        first_violated: Index of the requirement that is violated first, before the draw ends; -1: none, shape (n,).
        violated_at: Time at which that violation is certain [s]; NaN if there is none, shape (n,).
        single_slacks: Slack of every requirement in its metric's unit, shape (n, requirements).
    """

    points: np.ndarray
    slacks: np.ndarray
    binding: np.ndarray
    distances_to_bound: np.ndarray
    simulation_counts: np.ndarray
    ended: np.ndarray
    failed_at: np.ndarray
    first_violated: np.ndarray
    violated_at: np.ndarray
    single_slacks: np.ndarray


def join_batches(batches: Sequence[SimulatedPoints]) -> SimulatedPoints:
    """All simulated points of a search, in the order in which they were simulated."""
    return SimulatedPoints(*(np.concatenate(columns) for columns in zip(*batches, strict=True)))


@dataclass
class WorstDrawSearch:
    """A search for the worst draw: :meth:`explore`, then :meth:`climb`, then :meth:`evolve`.

    Args:
        programs: The compiled study.
        region: The set of draws to search.
        budget: Number of simulations.
        rng: Random generator of the search.
        progress: Called with the simulations spent.
        requirement: Label of the only requirement that counts; empty: all count.
        simulation_count: Number of simulations spent.
        worst: Smallest slack so far.
        batches: The simulated points so far.
        requirements: The study's requirements, with the scales that the first points show.
        unspent: Why the evolution leaves simulations unspent, in words; empty before the evolution begins.
    """

    programs: SearchPrograms
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
        """Why the search stopped before it had spent its budget, in words; empty if the budget is spent."""
        if self.simulation_count >= self.budget:
            return ""
        if self.worst > -np.inf:
            return self.unspent
        last_batch = self.batches[-1]
        worst = int(np.argmin(last_batch.slacks))
        if last_batch.ended[worst] != RAN_TO_END:
            return "a draw ended early, and no draw is worse"
        label = self.requirements[int(last_batch.binding[worst])].label
        return f"a draw misses {label} by an infinite amount, and no draw is worse"

    @property
    def size(self) -> int:
        """Number of uncertain numbers."""
        return self.region.size

    def simulate(self, points: np.ndarray, evaluator: Evaluator, cost: int = 1) -> tuple[np.ndarray, Arrays]:
        """Simulate points with the in-loop noise of draw 0, and record their results.

        The first call also fixes the scales by which slacks are divided.

        Args:
            points: Coordinates, shape (n, laws).
            evaluator: The program that simulates, with or without derivatives.
            cost: Number of simulations that one point costs.

        Returns:
            The slack of the worst requirement, shape (n,), and the results.
        """
        draw_0 = np.zeros(len(points), dtype=int)  # all points share the in-loop noise of draw 0
        results = evaluator(draw_0, self.region.values(points))
        if not self.requirements:
            self.requirements = with_typical_slacks(self.programs.study.requirements, results)
        places = np.array(counted_places(self.requirements, self.requirement))
        slacks = worst_slack(self.relevant_requirements, results)
        binding = places[binding_requirement(self.relevant_requirements, results)]
        single_slacks = np.array([results[requirement.name] for requirement in self.requirements])
        first_violated, violated_at = first_violation(self.requirements, results)
        self.batches.append(
            SimulatedPoints(
                points=points,
                slacks=slacks,
                binding=binding,
                distances_to_bound=np.take_along_axis(single_slacks, binding[None], 0)[0],
                simulation_counts=self.simulation_count + cost * np.arange(1, len(points) + 1),
                ended=np.where(ended_early(results["outcome"]), results["outcome"], RAN_TO_END),
                failed_at=results["failed_at"],
                first_violated=first_violated,
                violated_at=violated_at,
                single_slacks=single_slacks.T,
            )
        )
        self.simulation_count += cost * len(points)
        self.worst = min(self.worst, float(slacks.min()))
        if self.progress:
            self.progress(min(self.simulation_count, self.budget), self.budget)
        return slacks, results

    def explore(self) -> None:
        """Simulate points that are spread evenly over the set."""
        points = self.region.even_points(exploration_size(self.budget), self.rng)
        self.simulate(points, self.programs.plain)

    def worst_points(self, count: int) -> np.ndarray:
        """The points with the smallest slacks so far, the worst first, shape (count, laws)."""
        simulated = join_batches(self.batches)
        worst_first = np.argsort(simulated.slacks, kind="stable")
        return simulated.points[worst_first[:count]]

    @property
    def relevant_requirements(self) -> list[Requirement]:
        """The requirements that count in this search."""
        return [self.requirements[place] for place in counted_places(self.requirements, self.requirement)]

    def single_slacks(self) -> np.ndarray:
        """Slack of each requirement that counts, relative to its scale, at all points so far; shape (n, requirements).

        A missing slack is minus infinity.
        """
        places = counted_places(self.requirements, self.requirement)
        scales = np.array([requirement.scale for requirement in self.relevant_requirements])
        slacks = join_batches(self.batches).single_slacks[:, places] / scales
        return np.where(np.isnan(slacks), -np.inf, slacks)

    def starts(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Choose the starting points of gradient descents, each of which lowers the slack of one requirement.

        The requirements that count take turns, the one with the smallest slack first. If all descents followed the
        requirement that is worst at most points, they would miss the worst draws of the others. A descent starts at the
        worst point of its requirement that is far enough from the other starts. If no point is, the descent starts at
        the worst point that is not a start yet.

        Args:
            count: Number of descents.

        Returns:
            The points, shape (count, laws), and for each descent the index of its requirement among
            :attr:`relevant_requirements`, shape (count,).
        """
        points = join_batches(self.batches).points
        slacks = self.single_slacks()
        most_critical_first = np.argsort(slacks.min(axis=0), kind="stable")
        targets = np.resize(most_critical_first, count)  # repeated in turn
        starts: list[int] = []
        for target in targets:
            worst_first = np.argsort(slacks[:, target], kind="stable").tolist()
            unused = [index for index in worst_first if index not in starts]
            distant = (index for index in unused if self.is_apart(points[index], points[starts]))
            starts.append(next(distant, unused[0]))
        return points[starts], targets

    def is_apart(self, point: np.ndarray, starts: np.ndarray) -> bool:
        """Whether a point is far enough from all starting points, shape (n, laws)."""
        return all(self.region.are_apart(point, start) for start in starts)

    def climb(self) -> None:
        """Run several projected gradient descents together, each with one requirement's slack and its own step length.

        A simulation with derivatives by d uncertain numbers costs as much as 1 + d plain simulations. Without
        derivatives (native code), without a requirement, or with too small a budget nothing is done here, and the
        differential evolution gets this share of the budget. The descents stop as soon as a slack is minus infinity.
        """
        if native_code(self.programs.study) or not self.relevant_requirements:
            return
        cost = 1 + self.size
        share = int(CLIMBED * self.budget)
        evaluator = self.programs.with_gradients
        points, targets = self.starts(climb_count(self.budget, self.size))
        if len(points) * cost > share:
            return
        _, results = self.simulate(points, evaluator, cost)
        best, slopes = self.slacks_and_slopes(points, results, targets)
        stride = np.full(len(points), STRIDE)
        steps = share // (cost * len(points)) - 1
        for _ in range(steps):
            trial = self.region.descend(points, slopes, stride)
            _, results = self.simulate(trial, evaluator, cost)
            slacks, trial_slopes = self.slacks_and_slopes(trial, results, targets)
            is_better = slacks < best
            points = np.where(is_better[:, None], trial, points)
            slopes = np.where(is_better[:, None], trial_slopes, slopes)
            best = np.minimum(best, slacks)
            stride = stride * np.where(is_better, LONGER, SHORTER)
            if self.worst == -np.inf:
                return

    def slacks_and_slopes(
        self, points: np.ndarray, results: Arrays, targets: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The slack that each descent lowers, shape (n,), and its derivatives by the coordinates, shape (n, laws).

        A derivative that is not finite is replaced by 0.

        Args:
            points: The point of each descent, shape (n, laws).
            results: The results there, with derivatives by the uncertain numbers.
            targets: Index of each descent's requirement among :attr:`relevant_requirements`, shape (n,).
        """
        laws = list(self.programs.study.laws)
        all_slacks = np.array([worst_slack([required], results) for required in self.relevant_requirements])
        all_gradients = np.array([worst_slopes([required], results, laws) for required in self.relevant_requirements])
        descents = np.arange(len(points))
        slopes = self.region.slopes(points, all_gradients[targets, descents])
        return all_slacks[targets, descents], np.where(np.isfinite(slopes), slopes, 0.0)

    def evolve(self) -> None:
        """Run differential evolution, starting from the worst points so far."""
        count = population_size(self.budget, self.size)
        first_generation: Any = self.worst_points(count)
        remaining_budget = self.budget - self.simulation_count
        generations = remaining_budget // count - 1  # SciPy simulates the first generation again
        self.unspent = f"the {remaining_budget % count} simulations left are fewer than a generation of {count}"
        if generations < 1:
            self.unspent = f"the {remaining_budget} simulations left are fewer than two generations of {count}"
            return

        def cost(columns: np.ndarray) -> np.ndarray:
            """The slack of each member of a generation, shape (n,), from coordinates of shape (laws, n)."""
            slacks, _ = self.simulate(self.region.project(np.atleast_2d(columns.T)), self.programs.plain)
            return np.clip(slacks, -LARGEST_COST, LARGEST_COST)

        def is_over(point: np.ndarray, convergence: float) -> bool:
            """Whether the evolution can end, because nothing is worse than a slack of minus infinity.

            SciPy passes both arguments, which are not used.
            """
            return self.worst == -np.inf

        evolution = differential_evolution(
            cost, [self.region.limits] * self.size, init=first_generation, rng=self.rng, tol=0.0,
            maxiter=generations, polish=False, vectorized=True, updating="deferred", callback=is_over,
        )  # fmt: skip
        if evolution.nit < generations:
            self.unspent = f"all {count} draws of the last generation are equally bad"
