"""Choose the search: descent, sequential quadratic programming, evolution, or a simplex for proved numbers."""

from dssc_jax.analyses.tuning.descent import descend
from dssc_jax.analyses.tuning.evolution import evolve
from dssc_jax.analyses.tuning.plan import EVOLUTION, PROGRAMMING, SIMPLEX, Plan
from dssc_jax.analyses.tuning.problem import Point, Problem
from dssc_jax.analyses.tuning.programming import program
from dssc_jax.analyses.tuning.progress import Search
from dssc_jax.analyses.tuning.proving import prove_better
from dssc_jax.core.signals import ProgressCallback

METHODS = {PROGRAMMING: program, EVOLUTION: evolve, SIMPLEX: prove_better}
"""Searches other than those of optax."""


def search(problem: Problem, first: tuple[Point, Point], useful: bool, progress: ProgressCallback | None) -> Search:
    """Run the search that the study names, or evolution if derivatives are not useful."""
    return METHODS.get(method_of(problem.plan, useful), descend)(problem, first, progress)


def method_of(plan: Plan, useful: bool) -> str:
    """The name of the search.

    Args:
        plan: The plan.
        useful: Whether derivatives can be used for descent.
    """
    if plan.optimises_proof:
        return SIMPLEX
    return plan.table.optimiser if useful else EVOLUTION
