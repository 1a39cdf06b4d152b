"""Optimise a proved number without derivatives: the residual of |e|, or how far along a number the loop is proved."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.optimize import minimize

from dssc_jax.analyses.tuning.plan import PROVED_ERROR, Plan
from dssc_jax.analyses.tuning.problem import Point, Problem
from dssc_jax.analyses.tuning.progress import PENALTY, REACH, UNFIT, Search
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback

EDGE = 0.5  # length of the first simplex's edges, in the mirror's coordinates
FINE_EDGE, FINE_SCORE = 0.02, 1e-3  # the search ends where the simplex, and its scores, are so close together


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


def prove_better(problem: Problem, first: tuple[Point, Point], progress: ProgressCallback | None) -> Search:
    """Optimise the proved number by the Nelder-Mead simplex, in the scaled logarithms of the tuned numbers.

    A point that is not proved is never accepted. Limits and requirements count on the draws, as in other searches: the
    training draws guide the simplex, and the best point on the validation draws is the result.

    Reference:
        J. A. Nelder, R. Mead, "A simplex method for function minimization", The Computer Journal 7 (1965) 308-313.
    """
    origin, steps = first[0].z, problem.plan.table.steps
    search, done, lowest = Search(first[1]), 0, math.inf

    def cost(z: np.ndarray) -> float:
        nonlocal done, lowest
        train = first[0] if np.array_equal(z, origin) else problem.seen(z, problem.train)
        score = score_at(problem, z) if not train.merit.ended and problem.allowed(z) else math.inf
        total = score + PENALTY * train.merit.violation if math.isfinite(score) else UNFIT
        if total < lowest:
            lowest = total
            search.look(problem, done, train, first[1] if done == 0 else problem.seen(z), score)
        done += 1
        if progress:
            progress(min(done, steps), steps)
        return total

    simplex = origin + EDGE * np.vstack([np.zeros(len(origin)), np.eye(len(origin))])
    options = {"initial_simplex": simplex, "maxfev": steps, "xatol": FINE_EDGE, "fatol": FINE_SCORE}
    ended = minimize(cost, origin, method="Nelder-Mead", bounds=[(-REACH, REACH)] * len(origin), options=options)
    if ended.success:
        search.stopped = "the simplex has shrunk to a point"
    return search


def compare_proved(plan: Plan, start: dict[str, float], best: dict[str, float]) -> Aimed:
    """The proved number at the start and at the result.

    Raises:
        AssertionError: a point without a proof was accepted.
    """
    first = plan.aim_at(start).value
    after = plan.aim_at(best).value
    assert first is not None
    assert after is not None
    return Aimed(plan.table.aim, first, after, next(iter(plan.table.over), None))


def require_proved(plan: Plan) -> None:
    """Require that the start is proved, as far as the settings need it.

    Raises:
        ConfigError: it is not.
    """
    numbers = plan.numbers_at(plan.mirror.origin)
    if plan.table.proved:
        proof = plan.proof_at(numbers)
        if not proof.complete:
            raise infeasible_start(plan, "tune.proved", "it is not proved", proof.summary()["failures"][0]["text"])
    if plan.optimises_proof:
        outcome = plan.aim_at(numbers)
        if outcome.value is None:
            place = "".join(f" at the safe end {name} = {low:g}" for name, (low, _) in plan.table.over.items())
            raise infeasible_start(plan, "tune.aim", f"it is not proved{place}", outcome.reason)


def infeasible_start(plan: Plan, place: str, missing: str, reason: str) -> ConfigError:
    """The error of a start that is not proved."""
    return ConfigError(plan.study.source, f"{place}: the start is infeasible: {missing}: {reason}")
