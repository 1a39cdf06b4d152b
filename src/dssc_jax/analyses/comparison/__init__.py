"""Comparison of controllers on common draws and noise, with corresponding gains or gains tuned on equal budgets."""

from dssc_jax.analyses.comparison.compare import Comparison, compare
from dssc_jax.analyses.comparison.margins import MarginContest, compare_margins
from dssc_jax.analyses.comparison.rivals import controller_table, switching_kinds, with_controller, with_own_controllers

__all__ = [
    "Comparison",
    "MarginContest",
    "compare",
    "compare_margins",
    "controller_table",
    "switching_kinds",
    "with_controller",
    "with_own_controllers",
]
