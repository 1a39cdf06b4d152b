"""Searches without derivatives: differential evolution, and the Nelder-Mead simplex for proved numbers."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.optimize import differential_evolution, minimize

from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.problem import BOX_HALF_WIDTH, PENALTY, UNFIT, UPDATE, Point, Problem, Search
from dssc_jax.analyses.tuning.rules import PROVED_ERROR
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import BLOCK
from dssc_jax.engine.evaluation import Evaluator

POPULATION = 8  # members a coordinate


def evolve(problem: Problem, first: tuple[Point, Point], progress: ProgressCallback | None) -> Search:
    """Run differential evolution on the training draws, for objectives whose derivatives are not useful.

    A generation is one batch. The number of generations is the number of steps of a descent.

    Reference:
        R. Storn, K. Price, "Differential evolution", J. Global Optimization 11 (1997) 341-359.
    """
    plan = problem.plan
    table = plan.table
    size = len(plan.coordinates.names)
    goal = problem.goal_on(problem.train)
    scale = abs(first[0].merit.objective) or 1.0
    lanes = len(problem.train) + len(problem.extra)
    evaluator = Evaluator(problem.plain.study, problem.plain.extents, min(BLOCK, POPULATION * size * lanes))
    search = Search(first[1])
    generation = 0
    search.record(problem, 0, *first)

    def cost(columns: np.ndarray) -> np.ndarray:
        """Costs of one member, shape (size,), or of a generation, shape (size, members)."""
        z = np.atleast_2d(columns.T)
        results = problem.results(z, problem.train, evaluator)
        costs = np.full(len(z), UNFIT)
        for i in range(len(z)):
            lanes_of_member = slice(i * lanes, (i + 1) * lanes)
            part = {name: array[lanes_of_member] for name, array in results.items()}
            merit = goal.merit(part, (), len(problem.extra))
            if not merit.ended and problem.is_admissible(z[i]):
                costs[i] = merit.objective / scale + PENALTY * merit.violation
        return costs

    def record(z: np.ndarray) -> None:
        search.record(problem, generation, problem.evaluate(z, problem.train), problem.evaluate(z))

    def after_generation(z: np.ndarray, convergence: float) -> bool:
        nonlocal generation
        generation += 1
        if generation % UPDATE == 0:
            record(z)
        if progress:
            progress(min(generation, table.steps), table.steps)
        return False

    box = [(-BOX_HALF_WIDTH, BOX_HALF_WIDTH)] * size
    start = np.clip(first[0].z, -BOX_HALF_WIDTH, BOX_HALF_WIDTH)
    evolution = differential_evolution(
        cost, box, x0=start, rng=plan.seed, popsize=POPULATION, maxiter=table.steps,
        polish=False, vectorized=True, updating="deferred", callback=after_generation,
    )  # fmt: skip
    if generation % UPDATE:
        record(evolution.x)
    return search


EDGE = 0.5  # length of the first simplex's edges, in the search's coordinates
FINE_EDGE = 0.02  # the search ends with a simplex of at most this size, in the same coordinates
FINE_SCORE = 1e-3  # whose scores differ by at most this


@dataclass(frozen=True)
class Aimed:
    """The comparison of start and result by the proved number.

    Args:
        aim: What was optimised, as ``[tune] aim`` names it.
        start: Its value at the start.
        result: Its value at the result.
        over: The number along which the loop is proved, for ``proved_up_to``.
    """

    aim: Annotated[str, Quantity("", "what was optimised")]
    start: Annotated[float, Quantity("that of the number", "proved number at the start")]
    result: Annotated[float, Quantity("that of the number", "proved number of the result")]
    over: Annotated[str | None, Quantity("", "the number along which the loop is proved")]


def score_at(problem: Problem, z: np.ndarray) -> float:
    """Logarithm of the proved number, with a sign so that less is better; infinite if the point is not proved."""
    value = problem.plan.aim_at(problem.plan.numbers_at(z)).value
    if value is None:
        return math.inf
    return math.log(value) if problem.plan.table.aim == PROVED_ERROR else -math.log(value)


def optimise_proof(problem: Problem, first: tuple[Point, Point], progress: ProgressCallback | None) -> Search:
    """Optimise the proved number by the Nelder-Mead simplex, in the scaled logarithms of the tuned numbers.

    A point that is not proved is never accepted. Limits and requirements count on the draws, as in other searches: the
    training draws guide the simplex, and the best point on the validation draws is the result.

    Reference:
        J. A. Nelder, R. Mead, "A simplex method for function minimization", The Computer Journal 7 (1965) 308-313.
    """
    origin = first[0].z
    steps = problem.plan.table.steps
    search = Search(first[1])
    evaluation_count = 0
    lowest = math.inf

    def cost(z: np.ndarray) -> float:
        nonlocal evaluation_count, lowest
        train = first[0] if np.array_equal(z, origin) else problem.evaluate(z, problem.train)
        score = score_at(problem, z) if not train.merit.ended and problem.is_admissible(z) else math.inf
        total = score + PENALTY * train.merit.violation if math.isfinite(score) else UNFIT
        if total < lowest:
            lowest = total
            search.record(
                problem, evaluation_count, train, first[1] if evaluation_count == 0 else problem.evaluate(z), score
            )
        evaluation_count += 1
        if progress:
            progress(min(evaluation_count, steps), steps)
        return total

    simplex = origin + EDGE * np.vstack([np.zeros(len(origin)), np.eye(len(origin))])
    options = {"initial_simplex": simplex, "maxfev": steps, "xatol": FINE_EDGE, "fatol": FINE_SCORE}
    box = [(-BOX_HALF_WIDTH, BOX_HALF_WIDTH)] * len(origin)
    nelder_mead = minimize(cost, origin, method="Nelder-Mead", bounds=box, options=options)
    if nelder_mead.success:
        search.stopped = "the simplex has shrunk to a point"
    return search


def compare_proved(plan: Plan, start: dict[str, float], best: dict[str, float]) -> Aimed:
    """The proved number at the start and at the result.

    Raises:
        AssertionError: a point without a proof was accepted.
    """
    start_value = plan.aim_at(start).value
    result_value = plan.aim_at(best).value
    assert start_value is not None
    assert result_value is not None
    return Aimed(plan.table.aim, start_value, result_value, next(iter(plan.table.over), None))
