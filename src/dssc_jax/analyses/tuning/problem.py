"""The tuning problem as a function of the search variables, and the record of a search for its solution."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.analyses.tuning.objective import Goal, Merit
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.rules import WIDTH
from dssc_jax.analyses.tuning.search_variables import SLACK
from dssc_jax.engine.batching import BLOCK
from dssc_jax.engine.evaluation import Evaluator, GradientEvaluator, native_code
from dssc_jax.engine.sampling import Arrays


class Point(NamedTuple):
    """A point evaluated on a batch: objective, excesses, and their gradients in the search's coordinates."""

    z: np.ndarray
    merit: Merit
    gradient: np.ndarray
    slopes: dict[str, np.ndarray]


class Slacks:
    """Excesses of Theorem 1's inequalities at a point, and their derivatives, if a slack is required."""

    def __init__(self, plan: Plan) -> None:
        theorem = plan.theorem
        slack = plan.table.slack
        assert theorem is not None
        assert slack is not None

        def excess(z: jax.Array) -> dict[str, jax.Array]:
            return theorem.excess(plan.coordinates.traced(z), slack)

        self._excess_and_slopes = jax.jit(lambda z: (excess(z), jax.jacfwd(excess)(z)))

    def at(self, z: np.ndarray) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Excesses, and their derivatives with respect to the coordinates."""
        with jax.enable_x64(True):
            traced_excess, traced_slopes = self._excess_and_slopes(jnp.asarray(z))
        excess = {name: float(value) for name, value in traced_excess.items()}
        slopes = {name: np.nan_to_num(np.asarray(slope)) for name, slope in traced_slopes.items()}
        return excess, slopes


@dataclass
class Problem:
    """The plan's objective on training and validation draws, by two programs: with derivatives, and without.

    The first ``draws`` draws are for training, the next ``validation`` for validation. Draws and their noise are the
    same at every point.

    Args:
        plan: The plan.
        counterexamples: Values of the laws' numbers, each of shape (n,).
        width: Width of the smoothed sign in the program with derivatives [m/s], if ``smoothing`` is set.
    """

    plan: Plan
    counterexamples: Arrays = field(default_factory=dict)
    width: float | None = field(default=None, init=False)
    certified: int = field(default=0, init=False)
    proved: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        trial = self.plan.trial()
        table = self.plan.table
        start = self.plan.numbers_at(self.plan.coordinates.origin)
        self.names = list(start)
        lanes = min(BLOCK, max(table.draws, table.validation) + len(self.extra))
        ends = {name: (value, value) for name, value in start.items()}
        self.plain = Evaluator(trial, ends, lanes)
        self.width = table.smoothing
        smooth = ends if self.width is None else ends | {WIDTH: (self.width, self.width)}
        reverse = table.derivatives == "reverse"
        self.evaluator = GradientEvaluator(self.plan.smoothed(), smooth, lanes, names=self.names, reverse=reverse)
        self.laws = self.evaluator.values_of_draws(slice(0, trial.config.draws))
        self.train = np.arange(table.draws)
        self.validation = np.arange(table.draws, trial.config.draws)
        self.slacks = None if table.slack is None else Slacks(self.plan)
        self.goal = Goal(table.objective, table.aggregate, table.level, {}, self.evaluator.swept.requirements)

    @property
    def extra(self) -> np.ndarray:
        """Draw indices of the counterexamples: all use the noise of draw 0, with which they were found."""
        return np.zeros(len(next(iter(self.counterexamples.values()), [])), dtype=int)

    @property
    def differentiable(self) -> bool:
        """Whether derivatives pass through the loop: none do through native code."""
        return not native_code(self.plain.swept)

    def begin(self) -> tuple[Point, Point]:
        """Evaluate the start on the training and the validation draws; limits may refer to its values."""
        origin = self.plan.coordinates.origin
        draws = np.concatenate([self.train, self.validation])
        results = self.results(origin[None], draws, self.plain)
        self.start_metrics = {name: results[name][: len(draws)] for name in self.plan.table.limits}
        plain = self.plan.optimises_proof or not self.differentiable
        train = self.evaluate(origin, self.train) if plain else self.at(origin, self.train)
        return train, self.evaluate(origin)

    def goal_on(self, draws: np.ndarray) -> Goal:
        """The goal on some of the draws: a limit relative to the start uses the start's value on the same draws."""
        limits = {}
        for name, bound in self.plan.table.limits.items():
            value = np.mean(self.start_metrics[name][draws]) if bound == "start" else bound
            limits[name] = float(value)
        return replace(self.goal, limits=limits)

    def results(self, z: np.ndarray, draws: np.ndarray, evaluator: Evaluator | None = None) -> Arrays:
        """Results of every draw, then of the counterexamples, at each point.

        Args:
            z: Points, shape (m, n).
            draws: Indices of the draws, shape (d,).
            evaluator: A program to use instead of the one with derivatives.

        Returns:
            Arrays of shape (m (d + counterexamples),), point by point.
        """
        indices = np.concatenate([draws, self.extra])
        lanes = {}
        for name, column in self.laws.items():
            values = np.concatenate([column[draws], self.counterexamples.get(name, [])])
            lanes[name] = np.tile(values, len(z))
        for name, column in self.plan.coordinates.numbers(z).items():
            lanes[name] = np.repeat(column, len(indices))
        return (evaluator or self.with_derivatives)(np.tile(indices, len(z)), lanes)

    def with_derivatives(self, indices: np.ndarray, lanes: Arrays) -> Arrays:
        """Results of the lanes with derivatives, at the present width of the sign."""
        return self.evaluator(indices, lanes | self._width(indices))

    def without_derivatives(self, indices: np.ndarray, lanes: Arrays) -> Arrays:
        """The same results, without the derivatives."""
        if self.width is None:
            return self.plain(indices, lanes)
        evaluator = Evaluator(self.plan.smoothed(), self.evaluator.extents, self.evaluator.lanes)
        return evaluator(indices, lanes | self._width(indices))

    def _width(self, indices: np.ndarray) -> Arrays:
        return {} if self.width is None else {WIDTH: np.full(len(indices), self.width)}

    def evaluate(self, z: np.ndarray, draws: np.ndarray | None = None) -> Point:
        """Evaluate a point with the exact sign and without derivatives, by default on the validation draws."""
        draws = self.validation if draws is None else draws
        merit = self.goal_on(draws).merit(self.results(z[None], draws, self.plain), (), len(self.extra))
        if not merit.ended and self.slacks is not None:
            merit = merit._replace(excess=merit.excess | self.slacks.at(z)[0])
        return Point(z, merit, gradient=np.full(len(z), np.nan), slopes={})

    def at(self, z: np.ndarray, draws: np.ndarray) -> Point:
        """Evaluate a point with derivatives on some of the draws."""
        merit = self.goal_on(draws).merit(self.results(z[None], draws), self.names, len(self.extra))
        if merit.ended:
            return Point(z, merit, gradient=np.full(len(z), np.nan), slopes={})
        number_slopes = {name: column[0] for name, column in self.plan.coordinates.slopes(z[None]).items()}

        def along(slopes: dict[str, float]) -> np.ndarray:
            return np.sum([slope * number_slopes[name] for name, slope in slopes.items()], axis=0)

        slopes = {name: along(row) for name, row in merit.slopes.items()}
        if self.slacks is not None:
            excess, excess_slopes = self.slacks.at(z)
            merit = merit._replace(excess=merit.excess | excess)
            slopes |= excess_slopes
        return Point(z, merit, along(merit.gradient), slopes)

    def is_admissible(self, z: np.ndarray) -> bool:
        """Whether the point passes the strict check of Theorem 1, and is proved, if either is required."""
        numbers = self.plan.numbers_at(z)
        if self.plan.theorem is not None:
            if not self.plan.theorem.certificate(numbers).certified:
                return False
            self.certified += 1
        if self.plan.table.proved:
            if not self.plan.proof_at(numbers).complete:
                return False
            self.proved += 1
        return True


HEADROOM = 0.01  # relative margin that a search keeps within limits
UNFIT = 1e6  # cost of a point that is not certified, or whose draws end early
BOX_HALF_WIDTH = 6.0  # |z| at the ends of a search's box: 0.25 % of the interval's logarithm is left out
FINAL_WIDTH = 1e-3  # width of the sign before it is 0, relative to the first
PENALTY = 20.0  # weight of an excess, for objective and excess relative to their scales; more than the multipliers' sum
UPDATE = 5  # steps or generations between two looks at the validation draws


@dataclass
class Search:
    """The result of a search.

    Args:
        best: The best point on the validation draws.
        history: A row for each evaluation on validation draws: step, objective and violation on training and validation
            draws, tuned numbers.
        stopped: The reason why it ended.
        shortened: Number of halvings of steps that led to points that are not allowed.
        lowest: Sort key of the best point.
    """

    best: Point
    history: list[dict[str, float | None]] = field(default_factory=list)
    stopped: str = "all steps done"
    shortened: int = 0
    lowest: tuple[float, float] = (float("inf"), float("inf"))

    def record(self, problem: Problem, step: int, train: Point, validation: Point, score: float | None = None) -> bool:
        """Record a point; return whether it is the best so far.

        Args:
            problem: The tuning problem.
            step: Step of the search.
            train: The point on the training draws.
            validation: The point on the validation draws.
            score: What is minimised in place of the objective on the validation draws; None: that objective.
        """
        row: dict[str, float | None] = {
            "step": step,
            "objective": train.merit.objective,
            "violation": train.merit.violation,
            "validation": validation.merit.objective,
            "validation_violation": validation.merit.violation,
        }
        if score is not None:
            row[problem.plan.table.aim] = problem.plan.aim_at(problem.plan.numbers_at(train.z)).value
        for name, value in problem.plan.coordinates.tuned(train.z).items():
            row[name] = float(value)
        self.history.append(row)
        key = rank(validation, score)
        better = key < self.lowest
        if better or step == 0:
            self.best = validation
            self.lowest = key
        return better


def headroom(limit: str) -> float:
    """The relative headroom kept within a limit; 0 for the theorem's, which do not depend on the draws."""
    return 0.0 if limit.startswith(SLACK) else HEADROOM


def rank(point: Point, score: float | None) -> tuple[float, float]:
    """Sort key: points within the limits first, then by the score, or by the objective."""
    return point.merit.violation, point.merit.objective if score is None else score
