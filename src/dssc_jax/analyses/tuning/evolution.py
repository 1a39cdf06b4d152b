"""Differential evolution, where derivatives say nothing."""

import numpy as np
from scipy.optimize import differential_evolution

from dssc_jax.analyses.tuning.problem import Point, Problem
from dssc_jax.analyses.tuning.progress import REACH, UNFIT, Report, Search
from dssc_jax.engine.batching import BLOCK
from dssc_jax.engine.evaluation import Evaluator

PENALTY = 20.0  # of a violation, relative to the objective's scale
UPDATE = 5  # generations between two looks at the validation draws
POPULATION = 8  # members a coordinate


def evolve(problem: Problem, first: tuple[Point, Point], report: Report) -> Search:
    """Differential evolution on the training draws, for objectives whose derivatives say nothing.

    A generation is one batch. It gets as many generations as a descent gets steps.

    Reference:
        R. Storn, K. Price, "Differential evolution", J. Global Optimization 11 (1997) 341-359.
    """
    plan, table = problem.plan, problem.plan.table
    size = len(plan.mirror.names)
    goal, scale = problem.goal_on(problem.train), abs(first[0].merit.objective) or 1.0
    lanes = len(problem.train) + len(problem.extra)
    evaluator = Evaluator(problem.plain.study, problem.plain.extents, min(BLOCK, POPULATION * size * lanes))
    found, done = Search(first[1]), 0
    found.look(problem, 0, *first)

    def cost(columns: np.ndarray) -> np.ndarray:
        z = np.atleast_2d(columns.T)
        results = problem.results(z, problem.train, evaluator)
        values = np.empty(len(z))
        for i in range(len(z)):
            own = {name: array[i * lanes : (i + 1) * lanes] for name, array in results.items()}
            merit = goal.merit(own, (), len(problem.extra))
            fit = not merit.ended and problem.allowed(z[i])
            values[i] = merit.objective / scale + PENALTY * merit.violation if fit else UNFIT
        return values

    def look(z: np.ndarray) -> None:
        found.look(problem, done, problem.seen(z, problem.train), problem.seen(z))

    def told(z: np.ndarray, convergence: float) -> bool:
        nonlocal done
        done += 1
        if done % UPDATE == 0:
            look(z)
        report(min(done, table.steps), table.steps, found.text())
        return False

    box = [(-REACH, REACH)] * size
    ended = differential_evolution(
        cost, box, x0=np.clip(first[0].z, -REACH, REACH), rng=plan.seed, popsize=POPULATION, maxiter=table.steps,
        polish=False, vectorized=True, updating="deferred", callback=told,
    )  # fmt: skip
    if done % UPDATE:
        look(ended.x)
    return found
