"""Choose the search: descent, sequential quadratic programming, or evolution."""

from dssc_jax.analyses.tuning.descent import descend
from dssc_jax.analyses.tuning.evolution import evolve
from dssc_jax.analyses.tuning.plan import EVOLUTION, PROGRAMMING
from dssc_jax.analyses.tuning.problem import Point, Problem
from dssc_jax.analyses.tuning.programming import program
from dssc_jax.analyses.tuning.progress import Search
from dssc_jax.core.signals import ProgressCallback

METHODS = {PROGRAMMING: program, EVOLUTION: evolve}
"""Searches other than those of optax."""


def search(problem: Problem, first: tuple[Point, Point], useful: bool, progress: ProgressCallback | None) -> Search:
    """Run the search that the study names, or evolution if derivatives are not useful."""
    optimiser = problem.plan.table.optimiser if useful else EVOLUTION
    return METHODS.get(optimiser, descend)(problem, first, progress)
