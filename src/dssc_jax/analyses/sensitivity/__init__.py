"""Which uncertain numbers matter: Sobol indices, Shapley effects of correlated numbers, and Morris screening."""

from dssc_jax.analyses.sensitivity.analysis import SENSITIVITY_METHODS, sensitivity
from dssc_jax.analyses.sensitivity.result import Sensitivity

__all__ = ["SENSITIVITY_METHODS", "Sensitivity", "sensitivity"]
