"""Controllers compared on common draws and common noise: with gains that correspond, and tuned on equal budgets."""

from dssc_jax.comparison.compare import Comparison, Contest, compare, with_controller
from dssc_jax.comparison.margins import MarginContest, compare_margins
from dssc_jax.comparison.rivals import controller_table
from dssc_jax.comparison.tuning import Tuning, tuned

__all__ = [
    "Comparison",
    "Contest",
    "MarginContest",
    "Tuning",
    "compare",
    "compare_margins",
    "controller_table",
    "tuned",
    "with_controller",
]
