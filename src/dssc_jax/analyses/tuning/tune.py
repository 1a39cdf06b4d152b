"""Tune a study: search on training draws, choice on validation draws, verdict on fresh ones."""

import json
import time

import numpy as np

from dssc_jax.analyses.defaults import BUDGET, ROUNDS
from dssc_jax.analyses.falsification.conditions import require_falsifiable
from dssc_jax.analyses.falsification.falsify import falsify
from dssc_jax.analyses.tuning.derivative_free import compare_proved, evolve, optimise_proof
from dssc_jax.analyses.tuning.descent import descend, quadratic_programming
from dssc_jax.analyses.tuning.gradients import GradientAgreement, check_gradients
from dssc_jax.analyses.tuning.objective import MissedBound, judge_tuning, missed_bounds
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.problem import Point, Problem, Search
from dssc_jax.analyses.tuning.result import Counterexample, SearchFacts, Tuned, dataset_of
from dssc_jax.analyses.tuning.rules import EVOLUTION, PROGRAMMING, SIMPLEX
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study, takes_file

CHECKED = 16  # points of the gradient check before a descent
USEFUL = 0.5  # share of derivatives that must agree; below it evolution takes over
METHODS = {PROGRAMMING: quadratic_programming, EVOLUTION: evolve, SIMPLEX: optimise_proof}
"""Searches other than those of optax."""


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
        robust: Also search for the worst case of the result, add it to the requirements, and tune again, until no
            failure is found.
        rounds: Largest number of repetitions.
        budget: Simulations of each search for the worst case.
        progress: Called with the steps done.

    Raises:
        ConfigError: the settings are not admissible, or the start is not feasible.

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
    problem = Problem(plan)
    outcome, gradients = solve(problem, progress)
    certified = problem.certified
    proved = problem.proved
    counterexamples: Arrays = {}
    hunts: list[Counterexample] = []
    while robust:
        tuned = plan.study.override(plan.numbers_at(outcome.best.z))
        worst = falsify(tuned, budget=budget, seed=len(hunts))
        hunts.append(Counterexample(worst.point_answer(worst.worst), worst.simulations))
        if worst.slack >= 0.0 or len(hunts) == rounds:
            break
        counterexamples = with_witness(counterexamples, worst.witness)
        problem = Problem(plan, counterexamples)
        outcome, gradients = solve(problem, progress)
        certified += problem.certified
        proved += problem.proved
    start = plan.numbers_at(plan.coordinates.origin)
    numbers = plan.numbers_at(outcome.best.z)
    verdict, costs = judge_tuning(plan, problem.goal, start, numbers)
    proof = plan.proof_of_result(numbers)
    facts = SearchFacts(
        method=method_of(plan, gradients is not None and useful(gradients)),
        stopped=outcome.stopped,
        feasible=outcome.best.merit.violation == 0.0,
        violation=float(outcome.best.merit.violation),
        missed=() if outcome.best.merit.violation == 0.0 else still_missed(problem, outcome.best),
        shortened=outcome.shortened,
        certified_points=certified if plan.theorem else None,
        proved_points=proved if plan.table.proved else None,
        proof=None if proof is None else proof.statement(),
        aimed=compare_proved(plan, start, numbers) if plan.optimises_proof else None,
        counterexamples=tuple(hunts),
        seconds=time.perf_counter() - began,
    )
    result_values = plan.coordinates.tuned(outcome.best.z)  # NumPy; the loop has JAX's digits
    values = {name: float(numbers.get(name, value)) for name, value in result_values.items()}
    dataset = dataset_of(plan.study, outcome.history, costs)
    certificate = None if proof is None else verified(proof.certificate())
    start_values = dict(plan.coordinates.start)
    tuned = Tuned(
        study=plan.study,
        dataset=dataset,
        start=start_values,
        values=values,
        numbers=numbers,
        gradients=gradients,
        verdict=verdict,
        facts=facts,
    )
    tuned.certificate = certificate
    return tuned


def solve(problem: Problem, progress: ProgressCallback | None) -> tuple[Search, GradientAgreement | None]:
    """Run one search, by descent if derivatives are requested and useful.

    Raises:
        ConfigError: draws end early at the start, so that there is no objective to descend on.
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
    differentiable = problem.differentiable and (gradients is None or useful(gradients))
    return search(problem, first, differentiable, progress), gradients


def still_missed(problem: Problem, point: Point) -> tuple[MissedBound, ...]:
    """What a point misses on the validation draws."""
    goal = problem.goal_on(problem.validation)
    results = problem.results(point.z[None], problem.validation, problem.plain)
    draw_results = {name: column[: len(problem.validation)] for name, column in results.items()}
    units = {measure.name: measure.unit for measure in problem.plan.study.measures}
    return missed_bounds(goal, draw_results, units)


def search(
    problem: Problem, first: tuple[Point, Point], differentiable: bool, progress: ProgressCallback | None
) -> Search:
    """Run the search that the study names, or evolution if derivatives are not useful."""
    return METHODS.get(method_of(problem.plan, differentiable), descend)(problem, first, progress)


def method_of(plan: Plan, differentiable: bool) -> str:
    """The name of the search.

    Args:
        plan: The plan.
        differentiable: Whether derivatives can be used for descent.
    """
    if plan.optimises_proof:
        return SIMPLEX
    return plan.table.optimiser if differentiable else EVOLUTION


def useful(gradients: GradientAgreement) -> bool:
    """Whether derivatives can be used for descent: they are correct, and not only for the smallest of steps."""
    return min(gradients.useful, gradients.predictive) >= USEFUL


def verified(certificate: JsonObject) -> JsonObject:
    """A certificate as its file will hold it, verified once more from that alone.

    Raises:
        RuntimeError: the verifier refuses it.
    """
    from dssc_jax.proofs.prove import check_certificate

    content = json.loads(json.dumps(certificate))
    verdict = check_certificate(content)
    if not verdict.proved:
        raise RuntimeError(f"the result's certificate is refused: {verdict.reason}")
    return content


def with_witness(counterexamples: Arrays, witness: dict[str, float]) -> Arrays:
    """Add one counterexample to the others."""
    return {name: np.append(counterexamples.get(name, []), value) for name, value in witness.items()}


def require_certified(plan: Plan) -> None:
    """Require that the start passes the strict check, with the required slack.

    Raises:
        ConfigError: it does not pass.
    """
    assert plan.theorem is not None
    numbers = plan.numbers_at(plan.coordinates.origin)
    if plan.table.slack is not None:
        excesses = {name: float(value) for name, value in plan.theorem.excess(numbers, plan.table.slack).items()}
        worst = max(excesses, key=excesses.__getitem__)
        if excesses[worst] > 0.0:
            rule = f"the start is infeasible: {worst} is below {plan.table.slack:g} by {excesses[worst]:.3g} (relative)"
            raise ConfigError(plan.study.source, f"tune.slack: {rule}")
    if not plan.theorem.certificate(numbers).certified:
        place = "tune.free" if plan.table.certified else "tune.slack"
        raise ConfigError(plan.study.source, f"{place}: the start is infeasible: its design is not certified")


def require_proved(plan: Plan) -> None:
    """Require that the start is proved, as far as the settings need it.

    Raises:
        ConfigError: it is not.
    """
    numbers = plan.numbers_at(plan.coordinates.origin)
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
