"""Searches without derivatives: differential evolution, and the Nelder-Mead simplex for proved numbers."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.optimize import differential_evolution, minimize

from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.problem import (
    BOX_HALF_WIDTH,
    PENALTY,
    UNFIT,
    UPDATE,
    Problem,
    SearchRecord,
    StartPoints,
)
from dssc_jax.analyses.tuning.rules import PROVED_ERROR
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import BLOCK
from dssc_jax.engine.evaluation import Evaluator

POPULATION = 8  # members of a generation for each coordinate


def evolve(problem: Problem, first: StartPoints, progress: ProgressCallback | None) -> SearchRecord:
    """Search by differential evolution on the training draws, for objectives whose derivatives are not useful.

    Each generation is simulated in one batch. The number of generations is the number of steps in ``[tune]``.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        first: The start, evaluated on the training and on the validation draws.
        progress: Called after each generation.

    Reference:
        R. Storn, K. Price, "Differential evolution", J. Global Optimization 11 (1997) 341-359.
    """
    plan = problem.plan
    table = plan.table
    size = len(plan.coordinates.names)
    most_lanes = min(BLOCK, POPULATION * size * lanes_per_point(problem))
    evaluator = Evaluator(problem.plain.study, problem.plain.extents, most_lanes)
    search = SearchRecord(first.validation)
    generation = 0
    search.record(problem, generation, *first)

    def costs_of(columns: np.ndarray) -> np.ndarray:
        """Cost of each member of a generation, shape (members,), from the members' coordinates.

        SciPy passes the shape (size, members), or (size,) for a single member.
        """
        return costs_at(problem, np.atleast_2d(columns.T), first.scale, evaluator)

    def record(z: np.ndarray) -> None:
        """Record the best member so far, evaluated on the training and on the validation draws."""
        search.record(problem, generation, problem.evaluate(z, problem.train), problem.evaluate(z))

    def after_generation(z: np.ndarray, convergence: float) -> bool:
        """Count a generation, and record the best member after every :data:`UPDATE` generations.

        SciPy passes ``convergence``, which is not used. The return value False lets the evolution continue.
        """
        nonlocal generation
        generation += 1
        if generation % UPDATE == 0:
            record(z)
        if progress:
            progress(min(generation, table.steps), table.steps)
        return False

    box = [(-BOX_HALF_WIDTH, BOX_HALF_WIDTH)] * size
    start = np.clip(first.train.z, -BOX_HALF_WIDTH, BOX_HALF_WIDTH)
    evolution = differential_evolution(
        costs_of, box, x0=start, rng=plan.seed, popsize=POPULATION, maxiter=table.steps,
        polish=False, vectorized=True, updating="deferred", callback=after_generation,
    )  # fmt: skip
    if generation % UPDATE:  # the last generations are not recorded yet
        record(evolution.x)
    return search


def lanes_per_point(problem: Problem) -> int:
    """Number of lanes that a point of the search takes: one for each training draw and each counterexample."""
    return len(problem.train) + len(problem.counterexample_draws)


def costs_at(problem: Problem, z: np.ndarray, scale: float, evaluator: Evaluator) -> np.ndarray:
    """Cost of each of several points on the training draws, shape (points,): relative objective plus penalty.

    A point that is not admissible, or whose draws end early, has the cost :data:`UNFIT`.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        z: Coordinates of the points, shape (points, n).
        scale: Size of the start's objective, by which objectives are divided.
        evaluator: The program, without derivatives.
    """
    goal = problem.goal_on(problem.train)
    results = problem.results(z, problem.train, evaluator)
    lanes_of_point = lanes_per_point(problem)
    costs = np.full(len(z), UNFIT)
    for row, point in enumerate(z):
        lanes = slice(row * lanes_of_point, (row + 1) * lanes_of_point)
        results_of_point = {name: array[lanes] for name, array in results.items()}
        merit = goal.merit(results_of_point, (), len(problem.counterexample_draws))  # (): no derivatives
        if not merit.ended and problem.is_admissible(point):
            costs[row] = merit.objective / scale + PENALTY * merit.violation
    return costs


EDGE = 0.5  # length of the edges of the first simplex, in the search's coordinates
FINE_EDGE = 0.02  # largest size of the last simplex, in the same coordinates
FINE_SCORE = 1e-3  # largest difference of scores in the last simplex


@dataclass(frozen=True)
class ProvedComparison:
    """The proved number that was optimised, at the start and in the result.

    ``over`` is a name if the optimised number was the last value of another number at which the loop is proved; None if
    it was a proved error.
    """

    aim: Annotated[str, Quantity("", "what was optimised")]
    start: Annotated[float, Quantity("that of the number", "proved number at the start")]
    result: Annotated[float, Quantity("that of the number", "proved number of the result")]
    over: Annotated[str | None, Quantity("", "the number along which the loop is proved")]


def score_at(problem: Problem, z: np.ndarray) -> float:
    """Score of a point by its proved number; the simplex minimises the score. Infinite without a proof.

    If a proved error is optimised, the score is its logarithm. If the last value at which the loop is proved is
    optimised, the score is minus its logarithm, since a large value is good.
    """
    value = problem.plan.aim_at(problem.plan.numbers_at(z)).value
    if value is None:
        return math.inf
    return math.log(value) if problem.plan.table.aim == PROVED_ERROR else -math.log(value)


def optimise_proof(problem: Problem, first: StartPoints, progress: ProgressCallback | None) -> SearchRecord:
    """Optimise the proved number by the Nelder-Mead simplex, in the scaled logarithms of the tuned numbers.

    A point without a proof is never accepted. Limits and requirements are evaluated on draws, as in other searches: the
    training draws guide the simplex, and the result is the best point on the validation draws.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        first: The start, evaluated on the training and on the validation draws.
        progress: Called after each evaluation.

    Reference:
        J. A. Nelder, R. Mead, "A simplex method for function minimization", The Computer Journal 7 (1965) 308-313.
    """
    origin = first.train.z
    steps = problem.plan.table.steps
    search = SearchRecord(first.validation)
    evaluation_count = 0
    lowest = math.inf

    def cost(z: np.ndarray) -> float:
        """The score of a point plus the penalty of its violation; a point that is the best so far is recorded."""
        nonlocal evaluation_count, lowest
        train = first.train if np.array_equal(z, origin) else problem.evaluate(z, problem.train)
        score = math.inf
        if not train.merit.ended and problem.is_admissible(z):
            score = score_at(problem, z)
        total = UNFIT
        if math.isfinite(score):
            total = score + PENALTY * train.merit.violation
        if total < lowest:
            lowest = total
            validation = first.validation if evaluation_count == 0 else problem.evaluate(z)  # 0: the start
            search.record(problem, evaluation_count, train, validation, score)
        evaluation_count += 1
        if progress:
            progress(min(evaluation_count, steps), steps)
        return total

    corners = np.vstack([np.zeros(len(origin)), np.eye(len(origin))])  # the start, and a step along each coordinate
    simplex = origin + EDGE * corners
    options = {"initial_simplex": simplex, "maxfev": steps, "xatol": FINE_EDGE, "fatol": FINE_SCORE}
    box = [(-BOX_HALF_WIDTH, BOX_HALF_WIDTH)] * len(origin)
    nelder_mead = minimize(cost, origin, method="Nelder-Mead", bounds=box, options=options)
    if nelder_mead.success:
        search.stopped = "the simplex has shrunk to a point"
    return search


def compare_proved(plan: Plan, start: dict[str, float], best: dict[str, float]) -> ProvedComparison:
    """Compare the proved number of the result with that of the start.

    Args:
        plan: The plan.
        start: The loop's numbers at the start.
        best: The loop's numbers in the result.

    Raises:
        AssertionError: A point without a proof was accepted.
    """
    start_value = plan.aim_at(start).value
    result_value = plan.aim_at(best).value
    assert start_value is not None
    assert result_value is not None
    over = next(iter(plan.table.over), None)  # the table has one number at most
    return ProvedComparison(plan.table.aim, start_value, result_value, over)
