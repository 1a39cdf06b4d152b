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


class EvaluatedPoint(NamedTuple):
    """A point of the search, evaluated on some of the draws.

    Args:
        z: The search's coordinates, shape (n,).
        merit: Objective and excesses over the limits.
        gradient: Derivatives of the objective by the coordinates, shape (n,); NaN if they were not computed.
        slopes: Derivatives of each excess by the coordinates, shape (n,) each; empty if they were not computed.
    """

    z: np.ndarray
    merit: Merit
    gradient: np.ndarray
    slopes: dict[str, np.ndarray]


class StartPoints(NamedTuple):
    """The start of a search, evaluated on the training and on the validation draws."""

    train: EvaluatedPoint
    validation: EvaluatedPoint

    @property
    def scale(self) -> float:
        """Absolute value of the start's objective, by which a search divides all objectives; 1 in place of 0."""
        return abs(self.train.merit.objective) or 1.0


class TheoremSlacks:
    """By how much each inequality of Theorem 1 misses a required slack, as a function of the search's coordinates.

    The function is compiled, with its derivatives.

    Args:
        plan: A plan that requires a slack.
    """

    def __init__(self, plan: Plan) -> None:
        """Compile the excesses and their derivatives."""
        theorem = plan.theorem
        slack = plan.table.slack
        assert theorem is not None
        assert slack is not None

        def excess(z: jax.Array) -> dict[str, jax.Array]:
            """The excess of each inequality at traced coordinates of shape (n,)."""
            return theorem.excess(plan.coordinates.traced(z), slack)

        def excess_and_slopes(z: jax.Array) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
            """The excess of each inequality, and its derivatives by the coordinates."""
            return excess(z), jax.jacfwd(excess)(z)

        self._excess_and_slopes = jax.jit(excess_and_slopes)

    def at(self, z: np.ndarray) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """The excess of each inequality at coordinates of shape (n,), and its derivatives by these, shape (n,) each.

        A derivative that is NaN, as at the end of a range, is replaced by 0.
        """
        with jax.enable_x64(True):
            traced_excess, traced_slopes = self._excess_and_slopes(jnp.asarray(z))
        excess = {name: float(value) for name, value in traced_excess.items()}
        slopes = {name: np.nan_to_num(np.asarray(slope)) for name, slope in traced_slopes.items()}
        return excess, slopes


@dataclass
class Problem:
    """Objective and limits of a tuning as functions of the search's coordinates, by two compiled programs.

    One program has derivatives, the other has none. The first ``draws`` draws of ``[tune]`` are for training, the next
    ``validation`` for validation. Draws and their noise are the same at every point.

    Args:
        plan: The plan.
        counterexamples: Draws that have to meet the requirements: value of each uncertain number, shape (n,) each.
        width: Width of the smoothed sign in the program with derivatives [m/s]; None if it is not smoothed.
        certified: Number of points so far that Theorem 1 certified.
        proved: Number of points so far that were proved.
    """

    plan: Plan
    counterexamples: Arrays = field(default_factory=dict)
    width: float | None = field(default=None, init=False)
    certified: int = field(default=0, init=False)
    proved: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        """Prepare the programs with and without derivatives, split the draws, and read the goal."""
        trial = self.plan.trial()
        table = self.plan.table
        start = self.plan.numbers_at(self.plan.coordinates.origin)
        self.names = list(start)
        lanes = min(BLOCK, max(table.draws, table.validation) + len(self.counterexample_draws))
        extents = {name: (value, value) for name, value in start.items()}
        self.plain = Evaluator(trial, extents, lanes)
        self.width = table.smoothing
        if self.width is not None:
            extents = extents | {WIDTH: (self.width, self.width)}
        is_reverse = table.derivatives == "reverse"
        self.evaluator = GradientEvaluator(self.plan.smoothed(), extents, lanes, names=self.names, reverse=is_reverse)
        self.laws = self.evaluator.values_of_draws(slice(0, trial.config.draws))
        self.train = np.arange(table.draws)
        self.validation = np.arange(table.draws, trial.config.draws)
        self.slacks = None if table.slack is None else TheoremSlacks(self.plan)
        self.goal = Goal(
            costs=table.objective,
            aggregate=table.aggregate,
            level=table.level,
            limits={},  # goal_on sets the limits for the draws in use
            requirements=self.evaluator.swept.requirements,
        )

    @property
    def counterexample_draws(self) -> np.ndarray:
        """Draw index of each counterexample, shape (counterexamples,).

        All indices are 0, since the counterexamples were found with the in-loop noise of draw 0.
        """
        if not self.counterexamples:
            return np.zeros(0, dtype=int)
        first_column = next(iter(self.counterexamples.values()))
        return np.zeros(len(first_column), dtype=int)

    @property
    def differentiable(self) -> bool:
        """Whether the loop has derivatives: native code has none."""
        return not native_code(self.plain.swept)

    def begin(self) -> StartPoints:
        """Evaluate the start on the training and on the validation draws.

        The limited metrics of the start are stored, as bounds for limits that are ``start``.
        """
        origin = self.plan.coordinates.origin
        draws = np.concatenate([self.train, self.validation])
        results = self.results(origin[None], draws, self.plain)
        self.start_metrics = {name: results[name][: len(draws)] for name in self.plan.table.limits}
        needs_derivatives = self.differentiable and not self.plan.optimises_proof
        train = self.differentiate(origin, self.train) if needs_derivatives else self.evaluate(origin, self.train)
        return StartPoints(train, self.evaluate(origin))

    def goal_on(self, draws: np.ndarray) -> Goal:
        """The goal for some of the draws; a limit that is ``start`` becomes the start's mean on the same draws.

        Args:
            draws: Indices of the draws.
        """
        limits = {}
        for name, bound in self.plan.table.limits.items():
            value = np.mean(self.start_metrics[name][draws]) if bound == "start" else bound
            limits[name] = float(value)
        return replace(self.goal, limits=limits)

    def results(self, z: np.ndarray, draws: np.ndarray, evaluator: Evaluator | None = None) -> Arrays:
        """Simulate draws and then the counterexamples at each of several points.

        Args:
            z: Coordinates of the points, shape (m, n).
            draws: Indices of the draws, shape (d,).
            evaluator: A program to use; None: the one with derivatives.

        Returns:
            Arrays of shape (m (d + counterexamples),), point by point.
        """
        indices = np.concatenate([draws, self.counterexample_draws])
        lanes = {}
        for name, column in self.laws.items():
            values = np.concatenate([column[draws], self.counterexamples.get(name, [])])
            lanes[name] = np.tile(values, len(z))
        for name, column in self.plan.coordinates.numbers(z).items():
            lanes[name] = np.repeat(column, len(indices))
        simulate = self.with_derivatives if evaluator is None else evaluator
        return simulate(np.tile(indices, len(z)), lanes)

    def with_derivatives(self, indices: np.ndarray, lanes: Arrays) -> Arrays:
        """Simulate lanes with derivatives, at the present width of the sign.

        Args:
            indices: Draw index of each lane, shape (lanes,).
            lanes: Numbers of each lane by name, shape (lanes,) each.
        """
        return self.evaluator(indices, lanes | self._width(indices))

    def without_derivatives(self, indices: np.ndarray, lanes: Arrays) -> Arrays:
        """Simulate lanes at the present width of the sign, without derivatives.

        For the arguments see :meth:`with_derivatives`.
        """
        if self.width is None:
            return self.plain(indices, lanes)
        evaluator = Evaluator(self.plan.smoothed(), self.evaluator.extents, self.evaluator.lanes)
        return evaluator(indices, lanes | self._width(indices))

    def _width(self, indices: np.ndarray) -> Arrays:
        """The present width of the smoothed sign for each lane, shape (lanes,), by name; empty without smoothing."""
        return {} if self.width is None else {WIDTH: np.full(len(indices), self.width)}

    def evaluate(self, z: np.ndarray, draws: np.ndarray | None = None) -> EvaluatedPoint:
        """Evaluate a point with the exact sign and without derivatives.

        Args:
            z: Coordinates of the point, shape (n,).
            draws: Indices of the draws; None: the validation draws.
        """
        draws = self.validation if draws is None else draws
        results = self.results(z[None], draws, self.plain)
        merit = self.goal_on(draws).merit(results, (), len(self.counterexample_draws))  # (): no derivatives
        if self.slacks is not None and not merit.ended:
            slack_excess, _ = self.slacks.at(z)
            merit = merit._replace(excess=merit.excess | slack_excess)
        return EvaluatedPoint(z, merit, gradient=np.full(len(z), np.nan), slopes={})

    def differentiate(self, z: np.ndarray, draws: np.ndarray) -> EvaluatedPoint:
        """Evaluate a point with derivatives, at the present width of the sign, on some of the draws.

        Args:
            z: Coordinates of the point, shape (n,).
            draws: Indices of the draws.
        """
        merit = self.goal_on(draws).merit(self.results(z[None], draws), self.names, len(self.counterexample_draws))
        if merit.ended:
            return EvaluatedPoint(z, merit, gradient=np.full(len(z), np.nan), slopes={})
        number_slopes = {name: column[0] for name, column in self.plan.coordinates.slopes(z[None]).items()}

        def by_coordinates(by_number: dict[str, float]) -> np.ndarray:
            """Convert derivatives by the loop's numbers to derivatives by the coordinates, shape (n,): chain rule."""
            return np.sum([slope * number_slopes[name] for name, slope in by_number.items()], axis=0)

        slopes = {name: by_coordinates(by_number) for name, by_number in merit.slopes.items()}
        if self.slacks is not None:
            excess, excess_slopes = self.slacks.at(z)
            merit = merit._replace(excess=merit.excess | excess)
            slopes |= excess_slopes
        return EvaluatedPoint(z, merit, by_coordinates(merit.gradient), slopes)

    def is_admissible(self, z: np.ndarray) -> bool:
        """Whether a point of shape (n,) has what the plan requires of a certificate of Theorem 1 and of a proof.

        Certified and proved points are counted.
        """
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


HEADROOM = 0.01  # relative distance from each limit that a search keeps
UNFIT = 1e6  # cost of a point that is not admissible, or whose draws end early
BOX_HALF_WIDTH = 6.0  # largest |z| of a search: 0.25 % of an interval's logarithm is left out at each end
FINAL_WIDTH = 1e-3  # ratio of the last width of the sign above 0 to the first one
PENALTY = 20.0  # weight of a relative excess beside the relative objective; more than the sum of the multipliers
UPDATE = 5  # steps or generations between two evaluations on the validation draws


@dataclass
class SearchRecord:
    """The record of a search: its history on the validation draws, and its best point.

    Args:
        best: The best point on the validation draws.
        history: A row for each evaluation on validation draws: step, objective and violation on training and validation
            draws, tuned numbers.
        stopped: The reason why the search ended.
        shortened: Number of halvings of steps that led to points that are not allowed.
        best_rank: Rank of the best point; smaller is better.
    """

    best: EvaluatedPoint
    history: list[dict[str, float | None]] = field(default_factory=list)
    stopped: str = "all steps done"
    shortened: int = 0
    best_rank: tuple[float, float] = (float("inf"), float("inf"))

    def record(
        self, problem: Problem, step: int, train: EvaluatedPoint, validation: EvaluatedPoint, score: float | None = None
    ) -> bool:
        """Record a point that was evaluated on the validation draws; return whether it is the best so far.

        Args:
            problem: The tuning problem.
            step: Number of the step of the search.
            train: The point on the training draws.
            validation: The point on the validation draws.
            score: Value that is minimised in place of the objective on the validation draws; None: that objective.
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
        new_rank = rank(validation, score)
        is_best = new_rank < self.best_rank
        if is_best or step == 0:
            self.best = validation
            self.best_rank = new_rank
        return is_best


def headroom(limit: str) -> float:
    """The relative distance that a search keeps from a limit.

    It is 0 for the inequalities of Theorem 1, which do not depend on draws.
    """
    return 0.0 if limit.startswith(SLACK) else HEADROOM


def rank(point: EvaluatedPoint, score: float | None) -> tuple[float, float]:
    """Rank of a point, a pair (violation, score); the point with the smallest pair is the best.

    Args:
        point: The point, evaluated on the validation draws.
        score: Its score; None: its objective.
    """
    if score is None:
        score = point.merit.objective
    return point.merit.violation, score
