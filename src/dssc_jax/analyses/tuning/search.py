"""The way to better numbers: by descent, by sequential quadratic programming, or by evolution."""

from dssc_jax.analyses.tuning.descent import descend
from dssc_jax.analyses.tuning.evolution import evolve
from dssc_jax.analyses.tuning.plan import EVOLUTION, PROGRAMMING
from dssc_jax.analyses.tuning.problem import Point, Problem
from dssc_jax.analyses.tuning.programming import program
from dssc_jax.analyses.tuning.progress import Report, Search

METHODS = {PROGRAMMING: program, EVOLUTION: evolve}
"""Those that are not of optax."""


def search(problem: Problem, first: tuple[Point, Point], useful: bool, report: Report) -> Search:
    """What the study asks for; evolution where derivatives are not useful."""
    asked = problem.plan.table.optimiser if useful else EVOLUTION
    return METHODS.get(asked, descend)(problem, first, report)
