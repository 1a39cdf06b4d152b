"""Comparison of controllers on common draws and noise, with corresponding gains or gains tuned on equal budgets."""

from dssc_jax.analyses.comparison.compare import Comparison, Contest, compare
from dssc_jax.analyses.comparison.margins import MarginContest, compare_margins
from dssc_jax.analyses.comparison.rivals import controller_table, switching_kinds, with_controller, with_own_controllers
from dssc_jax.analyses.comparison.tuning import Tuning, best_gains

__all__ = [
    "Comparison",
    "Contest",
    "MarginContest",
    "Tuning",
    "best_gains",
    "compare",
    "compare_margins",
    "controller_table",
    "switching_kinds",
    "with_controller",
    "with_own_controllers",
]
