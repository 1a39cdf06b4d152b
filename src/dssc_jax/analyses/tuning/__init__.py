"""Gradient-based tuning: a loop's numbers are chosen on draws, within intervals or under the theorem's certificate."""

from dssc_jax.analyses.tuning.result import Tuned
from dssc_jax.analyses.tuning.tune import tune

__all__ = ["Tuned", "tune"]
