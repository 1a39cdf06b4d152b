"""Tuning a study: descent on training draws, choice on validation draws, verdict on fresh ones."""

import time

import numpy as np

from dssc_jax.analyses.falsification import falsify, require_hunt
from dssc_jax.analyses.tuning.gradients import Agreement, check_gradients
from dssc_jax.analyses.tuning.plan import EVOLUTION, Plan
from dssc_jax.analyses.tuning.problem import Problem
from dssc_jax.analyses.tuning.progress import Report, Search
from dssc_jax.analyses.tuning.result import Tuned
from dssc_jax.analyses.tuning.search import search
from dssc_jax.analyses.tuning.verdict import judge
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Arrays
from dssc_jax.study import Study

CHECKED = 16  # points of the gradient check before a descent
USEFUL = 0.5  # share of derivatives that must agree; below it evolution takes over
ROUNDS, BUDGET = 5, 1000  # of the counterexample loop: rounds at most, simulations of each falsification


def tune(
    study: Study, *, robust: bool = False, rounds: int = ROUNDS, budget: int = BUDGET, report: Report | None = None
) -> Tuned:
    """Choose the numbers that the study's ``[tune]`` names.

    Args:
        study: The study; its own sweep is left aside, and its own draws are kept for the verdict.
        robust: Also hunt the worst case of what was found, add it to what must be met, and tune again, until no
            failure is found.
        rounds: Times at most that this is done.
        budget: Simulations of each hunt.
        report: Told after each step.

    Raises:
        ConfigError: what is asked for is not admissible, or the start is not feasible.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/tune_case2.toml").override({"draws": 64, "tune.steps": 3, "tune.limits": {}})
        >>> one = study.override({"tune.parameters": {"controller.functions.kappa_m": [0.5, 20.0]}})
        >>> dj.tune(one.override({"tune.draws": 32})).verdict.reduction > 0.0
        True
    """
    began = time.perf_counter()
    plan = Plan.of(study)
    if robust:
        require_falsifiable(plan.study, rounds, budget)
    if plan.theorem is not None:
        require_certified(plan)
    said = report or (lambda done, total, text: None)
    problem, added, hunts = Problem(plan), {}, []
    found, gradients = solve(problem, said)
    certified = problem.certified
    while robust:
        worst = falsify(tuned_study(plan, found.best.z), budget=budget, seed=len(hunts))
        hunts.append({"slack": worst.slack, "simulations": worst.simulations, "witness": worst.witness})
        if worst.slack >= 0.0 or len(hunts) == rounds:
            break
        added = joined(added, worst.witness)
        problem = Problem(plan, added)
        found, gradients = solve(problem, said)
        certified += problem.certified
    mirror = plan.mirror
    numbers = [{n: float(v[0]) for n, v in mirror.numbers(z[None]).items()} for z in (mirror.origin, found.best.z)]
    verdict, costs = judge(plan, problem.goal, *numbers)
    facts = {
        "method": EVOLUTION if gradients is None or not useful(gradients) else plan.table.optimiser,
        "stopped": found.stopped,
        "feasible": found.best.merit.violation == 0.0,
        "violation": found.best.merit.violation,
        "shortened": found.shortened,
        "certified_points": certified if plan.theorem else None,
        "counterexamples": hunts,
        "seconds": time.perf_counter() - began,
    }
    values = {name: float(value) for name, value in mirror.tuned(found.best.z).items()}
    return Tuned(
        plan, tuned_study(plan, found.best.z), mirror.start, values, found.history, gradients, verdict, costs, facts
    )


def solve(problem: Problem, report: Report) -> tuple[Search, Agreement | None]:
    """One search, by descent where derivatives are asked for and useful.

    Raises:
        ConfigError: draws end early at the start, so that there is nothing to descend from.
    """
    first = problem.begin()
    for point, name in zip(first, ("training", "validation"), strict=True):
        if point.merit.ended:
            rule = f"the start is infeasible: {point.merit.ended} {name} draws end early, and nothing measures them"
            raise ConfigError(problem.plan.study.source, rule)
    gradients = None
    if problem.plan.table.optimiser != EVOLUTION:
        gradients = check_gradients(problem, CHECKED, problem.plan.seed)
    return search(problem, first, gradients is None or useful(gradients), report), gradients


def useful(gradients: Agreement) -> bool:
    """Whether there is something to descend on: derivatives that hold, and not only for the smallest of steps."""
    return min(gradients.useful, gradients.telling) >= USEFUL


def tuned_study(plan: Plan, z: np.ndarray) -> Study:
    """The study with the numbers of a point in it."""
    return plan.study.override({name: float(value[0]) for name, value in plan.mirror.numbers(z[None]).items()})


def joined(added: Arrays, witness: dict[str, float]) -> Arrays:
    """The counterexamples with one more."""
    return {name: np.append(added.get(name, []), value) for name, value in witness.items()}


def require_certified(plan: Plan) -> None:
    """Require that the start passes the strict check, with the slack that is asked for.

    Raises:
        ConfigError: it does not.
    """
    assert plan.theorem is not None
    numbers = {name: float(value[0]) for name, value in plan.mirror.numbers(plan.mirror.origin[None]).items()}
    if plan.table.slack is not None:
        missed = {name: float(value) for name, value in plan.theorem.excess(numbers, plan.table.slack).items()}
        worst = max(missed, key=missed.__getitem__)
        if missed[worst] > 0.0:
            rule = f"the start is infeasible: {worst} is below {plan.table.slack:g} by {missed[worst]:.3g} (relative)"
            raise ConfigError(plan.study.source, f"tune.slack: {rule}")
    if not plan.theorem.certificate(numbers).certified:
        place = "tune.free" if plan.table.certified else "tune.slack"
        raise ConfigError(plan.study.source, f"{place}: the start is infeasible: its design is not certified")


def require_falsifiable(study: Study, rounds: int, budget: int) -> None:
    """Require what a hunt for counterexamples needs.

    Raises:
        ConfigError: it is not there.
    """
    require_hunt(study, budget)
    if rounds < 1:
        raise ConfigError("rounds", f"must be >= 1, got {rounds}")
