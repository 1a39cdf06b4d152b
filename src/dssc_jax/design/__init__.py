"""Design with Theorem 1 and Table 1 of the article: gains from bounds, and certificates for given gains."""

from dssc_jax.design.bounds import Bounds, Constants, derive
from dssc_jax.design.certificate import Certificate, certified, check
from dssc_jax.design.exact_rates import exact_rates, rate_warning
from dssc_jax.design.noise import Drift, noise_drift, noise_warning
from dssc_jax.design.practice import Modulation
from dssc_jax.design.small_gain import Guarantee, guarantee, small_gain
from dssc_jax.design.synthesis import Free, Recipe, design, synthesise
from dssc_jax.design.table1 import Inequality, InequalityState, Parameters

__all__ = [
    "Bounds",
    "Certificate",
    "Constants",
    "Drift",
    "Free",
    "Guarantee",
    "Inequality",
    "InequalityState",
    "Modulation",
    "Parameters",
    "Recipe",
    "certified",
    "check",
    "derive",
    "design",
    "exact_rates",
    "guarantee",
    "noise_drift",
    "noise_warning",
    "rate_warning",
    "small_gain",
    "synthesise",
]
