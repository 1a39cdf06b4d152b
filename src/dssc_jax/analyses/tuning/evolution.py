"""Differential evolution, used if derivatives are not useful."""

import numpy as np
from scipy.optimize import differential_evolution

from dssc_jax.analyses.tuning.problem import Point, Problem
from dssc_jax.analyses.tuning.progress import PENALTY, REACH, UNFIT, UPDATE, Search
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
    plan, table = problem.plan, problem.plan.table
    size = len(plan.mirror.names)
    goal, scale = problem.goal_on(problem.train), abs(first[0].merit.objective) or 1.0
    lanes = len(problem.train) + len(problem.extra)
    evaluator = Evaluator(problem.plain.study, problem.plain.extents, min(BLOCK, POPULATION * size * lanes))
    search, done = Search(first[1]), 0
    search.look(problem, 0, *first)

    def cost(columns: np.ndarray) -> np.ndarray:
        z = np.atleast_2d(columns.T)
        results = problem.results(z, problem.train, evaluator)
        values = np.empty(len(z))
        for i in range(len(z)):
            part = {name: array[i * lanes : (i + 1) * lanes] for name, array in results.items()}
            merit = goal.merit(part, (), len(problem.extra))
            fit = not merit.ended and problem.allowed(z[i])
            values[i] = merit.objective / scale + PENALTY * merit.violation if fit else UNFIT
        return values

    def look(z: np.ndarray) -> None:
        search.look(problem, done, problem.seen(z, problem.train), problem.seen(z))

    def after_generation(z: np.ndarray, convergence: float) -> bool:
        nonlocal done
        done += 1
        if done % UPDATE == 0:
            look(z)
        if progress:
            progress(min(done, table.steps), table.steps)
        return False

    box = [(-REACH, REACH)] * size
    ended = differential_evolution(
        cost, box, x0=np.clip(first[0].z, -REACH, REACH), rng=plan.seed, popsize=POPULATION, maxiter=table.steps,
        polish=False, vectorized=True, updating="deferred", callback=after_generation,
    )  # fmt: skip
    if done % UPDATE:
        look(ended.x)
    return search
