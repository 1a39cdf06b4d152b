"""Tune a study: search on training draws, choice on validation draws, verdict on fresh ones."""

import json
import time
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.defaults import BUDGET, ROUNDS
from dssc_jax.analyses.falsification.conditions import require_falsifiable
from dssc_jax.analyses.falsification.falsify import falsify
from dssc_jax.analyses.tuning.derivative_free import compare_proved, evolve, optimise_proof
from dssc_jax.analyses.tuning.descent import descend, quadratic_programming
from dssc_jax.analyses.tuning.gradients import GradientAgreement, check_gradients
from dssc_jax.analyses.tuning.objective import MissedBound, judge_tuning, missed_bounds
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.problem import EvaluatedPoint, Problem, SearchRecord, StartPoints
from dssc_jax.analyses.tuning.result import Counterexample, SearchFacts, Tuned, tuning_dataset
from dssc_jax.analyses.tuning.rules import EVOLUTION, PROGRAMMING, SIMPLEX
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study, takes_file

CHECKED = 16  # points of the gradient check before a descent
USEFUL = 0.5  # share of derivatives that must agree; below it evolution takes over
METHODS = {PROGRAMMING: quadratic_programming, EVOLUTION: evolve, SIMPLEX: optimise_proof}
"""The searches by name, other than those of optax, which :func:`descend` runs."""


@takes_file
def tune(
    study: Study,
    *,
    robust: bool = False,
    rounds: int = ROUNDS,
    budget: int = BUDGET,
    progress: ProgressCallback | None = None,
) -> Tuned:
    """Tune the numbers that the study's ``[tune]`` names.

    Args:
        study: The study, or its file; its own sweep is ignored, and its own draws are kept for the verdict.
        robust: Also search for the worst draw of the result. If it fails, require that this draw pass, too, and tune
            again, until no failing draw is found.
        rounds: Largest number of searches for the worst draw.
        budget: Number of simulations of each search for the worst draw.
        progress: Called with the steps done.

    Raises:
        ConfigError: The settings are not admissible, or the start is not feasible.

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
        require_falsifiable(plan.study, budget)
        if rounds < 1:
            raise ConfigError("rounds", f"must be >= 1, got {rounds}")
    if plan.theorem is not None:
        require_certified(plan)
    require_proved(plan)
    solution = solve_rounds(plan, rounds if robust else 0, budget, progress)  # 0: not robust
    best = solution.record.best
    is_feasible = best.merit.violation == 0.0
    start = plan.numbers_at(plan.coordinates.origin)
    numbers = plan.numbers_at(best.z)
    verdict, costs = judge_tuning(plan, solution.problem.goal, start, numbers)
    proof = plan.proof_of_result(numbers)
    certificate = None if proof is None else verify_certificate(proof.certificate())
    facts = SearchFacts(
        method=search_method(plan, solution.gradients is not None and are_useful(solution.gradients)),
        stopped=solution.record.stopped,
        feasible=is_feasible,
        violation=float(best.merit.violation),
        missed=() if is_feasible else missed_on_validation(solution.problem, best),
        shortened=solution.record.shortened,
        certified_points=solution.certified if plan.theorem else None,
        proved_points=solution.proved if plan.table.proved else None,
        proof=None if proof is None else proof.statement(),
        aimed=compare_proved(plan, start, numbers) if plan.optimises_proof else None,
        counterexamples=solution.counterexamples,
        seconds=time.perf_counter() - began,
    )
    values = plan.coordinates.tuned(best.z)  # by NumPy; numbers of the loop, by JAX, may differ in the last digit
    tuned = Tuned(
        study=plan.study,
        dataset=tuning_dataset(plan.study, solution.record.history, costs),
        start=dict(plan.coordinates.start),
        values={name: float(numbers.get(name, value)) for name, value in values.items()},
        numbers=numbers,
        gradients=solution.gradients,
        verdict=verdict,
        facts=facts,
    )
    tuned.certificate = certificate
    return tuned


class Solution(NamedTuple):
    """The solution of a tuning, after all its rounds.

    Args:
        problem: The problem of the last round, with all counterexamples found before it.
        record: The search of the last round.
        gradients: The comparison of derivatives with differences in the last round; None if there was none.
        counterexamples: The worst draw found after each round of a robust tuning.
        certified: Number of points that Theorem 1 certified, in all rounds.
        proved: Number of points that were proved, in all rounds.
    """

    problem: Problem
    record: SearchRecord
    gradients: GradientAgreement | None
    counterexamples: tuple[Counterexample, ...]
    certified: int
    proved: int


def solve_rounds(plan: Plan, rounds: int, budget: int, progress: ProgressCallback | None) -> Solution:
    """Alternate between a search for the best point and a search for the worst draw of this point.

    If the worst draw fails, the next search for the best point requires that it pass, too. The rounds end when the
    worst draw found does not fail, or after ``rounds`` searches for it.

    Args:
        plan: The plan.
        rounds: Largest number of searches for the worst draw; 0: the tuning is not robust.
        budget: Simulations of each search for the worst draw.
        progress: Called with the steps done.
    """
    problem = Problem(plan)
    record, gradients = solve(problem, progress)
    certified = problem.certified
    proved = problem.proved
    required: Arrays = {}  # the values of each uncertain number in the worst draws
    found: list[Counterexample] = []
    while len(found) < rounds:
        tuned = plan.study.override(plan.numbers_at(record.best.z))
        worst = falsify(tuned, budget=budget, seed=len(found))
        found.append(Counterexample(worst.point_answer(worst.worst), worst.simulations))
        if worst.slack >= 0.0 or len(found) == rounds:
            break
        required = {name: np.append(required.get(name, []), value) for name, value in worst.witness.items()}
        problem = Problem(plan, counterexamples=required)
        record, gradients = solve(problem, progress)
        certified += problem.certified
        proved += problem.proved
    return Solution(problem, record, gradients, tuple(found), certified, proved)


def solve(problem: Problem, progress: ProgressCallback | None) -> tuple[SearchRecord, GradientAgreement | None]:
    """Run one search; it uses gradients if the study names such a method and a check finds the derivatives useful.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        progress: Called with the steps done.

    Returns:
        The search, and the comparison of derivatives with differences; None if the method needs no derivatives.

    Raises:
        ConfigError: Draws end early at the start, so that the start has no objective.
    """
    first = problem.begin()
    for point, name in zip(first, ("training", "validation"), strict=True):
        if point.merit.ended:
            rule = f"the start is infeasible: {point.merit.ended} {name} draws end early, and nothing measures them"
            raise ConfigError(problem.plan.study.source, rule)
    gradients = None
    by_descent = problem.plan.table.optimiser != EVOLUTION and not problem.plan.optimises_proof
    if by_descent and problem.differentiable:
        gradients = check_gradients(problem, CHECKED, problem.plan.seed)
    differentiable = problem.differentiable and (gradients is None or are_useful(gradients))
    return run_search(problem, first, differentiable, progress), gradients


def missed_on_validation(problem: Problem, point: EvaluatedPoint) -> tuple[MissedBound, ...]:
    """The requirements and limits that a point misses on the validation draws; counterexamples are left out."""
    goal = problem.goal_on(problem.validation)
    results = problem.results(point.z[None], problem.validation, problem.plain)
    draw_results = {name: column[: len(problem.validation)] for name, column in results.items()}
    units = {measure.name: measure.unit for measure in problem.plan.study.measures}
    return missed_bounds(goal, draw_results, units)


def run_search(
    problem: Problem,
    first: StartPoints,
    differentiable: bool,
    progress: ProgressCallback | None,
) -> SearchRecord:
    """Run the search that the study names, or differential evolution if derivatives cannot be used.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        first: The start, evaluated on the training and on the validation draws.
        differentiable: Whether derivatives can be used.
        progress: Called with the steps done.
    """
    search = METHODS.get(search_method(problem.plan, differentiable), descend)
    return search(problem, first, progress)


def search_method(plan: Plan, differentiable: bool) -> str:
    """The name of the search method.

    A proved number is optimised by the simplex. Otherwise the method is the optimiser of ``[tune]`` if derivatives can
    be used, and differential evolution if not.

    Args:
        plan: The plan.
        differentiable: Whether derivatives can be used.
    """
    if plan.optimises_proof:
        return SIMPLEX
    return plan.table.optimiser if differentiable else EVOLUTION


def are_useful(gradients: GradientAgreement) -> bool:
    """Whether derivatives can be used for descent.

    A share of at least :data:`USEFUL` has to agree with differences, and such a share to predict a longer step.
    """
    return min(gradients.useful, gradients.predictive) >= USEFUL


def verify_certificate(certificate: JsonObject) -> JsonObject:
    """Verify a certificate, and return its content as the file will have it.

    The content is converted to JSON and back before the check, which is independent of the search that found the
    certificate.

    Raises:
        RuntimeError: The verifier refuses the certificate.
    """
    from dssc_jax.proofs.prove import check_certificate

    content = json.loads(json.dumps(certificate))
    verdict = check_certificate(content)
    if not verdict.proved:
        raise RuntimeError(f"the result's certificate is refused: {verdict.reason}")
    return content


def require_certified(plan: Plan) -> None:
    """Require that Theorem 1 certifies the start, with the slack that ``[tune]`` requires, if it requires one.

    Raises:
        ConfigError: The start is not certified, or has less slack.
    """
    assert plan.theorem is not None
    numbers = plan.numbers_at(plan.coordinates.origin)
    if plan.table.slack is not None:
        excesses = {name: float(value) for name, value in plan.theorem.excess(numbers, plan.table.slack).items()}
        worst, excess = max(excesses.items(), key=itemgetter(1))
        if excess > 0.0:
            rule = f"the start is infeasible: {worst} is below {plan.table.slack:g} by {excess:.3g} (relative)"
            raise ConfigError(plan.study.source, f"tune.slack: {rule}")
    if not plan.theorem.certificate(numbers).certified:
        place = "tune.free" if plan.table.certified else "tune.slack"
        raise ConfigError(plan.study.source, f"{place}: the start is infeasible: its design is not certified")


def require_proved(plan: Plan) -> None:
    """Require a proof of the start, if the settings require proofs or optimise a proved number.

    Raises:
        ConfigError: The start is not proved.
    """
    numbers = plan.numbers_at(plan.coordinates.origin)
    if plan.table.proved:
        proof = plan.proof_at(numbers)
        if not proof.complete:
            raise infeasible_start(plan, "tune.proved", "it is not proved", proof.summary()["failures"][0]["text"])
    if plan.optimises_proof:
        outcome = plan.aim_at(numbers)
        if outcome.value is None:
            missing = "it is not proved"
            for name, (safe_end, _) in plan.table.over.items():  # one number at most
                missing += f" at the safe end {name} = {safe_end:g}"
            raise infeasible_start(plan, "tune.aim", missing, outcome.reason)


def infeasible_start(plan: Plan, place: str, missing: str, reason: str) -> ConfigError:
    """The error for a start that has no proof.

    Args:
        plan: The plan.
        place: The setting that needs the proof.
        missing: What is missing, as a clause of the message, such as "it is not proved".
        reason: Why there is no proof.
    """
    return ConfigError(plan.study.source, f"{place}: the start is infeasible: {missing}: {reason}")
