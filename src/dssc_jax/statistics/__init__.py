"""Statistics: intervals, tests and sample sizes with guaranteed confidence."""

from dssc_jax.statistics.likelihood import Likelihood, distance_of_mass, mass_within
from dssc_jax.statistics.multistage import Look, multistage_interval
from dssc_jax.statistics.order import quantile_interval, tolerance_limits, wilks_draws, wilks_order
from dssc_jax.statistics.paired import (
    FailureDifference,
    MetricDifference,
    compare_failures,
    compare_metrics,
    difference_interval,
    log_evidence_of_less,
    mcnemar,
)
from dssc_jax.statistics.planning import assured_draws, chernoff_draws, expected_draws, plan, worst_case_draws
from dssc_jax.statistics.proportions import (
    CONFIDENCE,
    DesignEffect,
    FixedCount,
    IntervalsAfterStop,
    Method,
    Replicated,
    clopper_pearson,
    describe_probability,
    design_effect,
    draws_as_narrow,
    lognormal_interval,
    replicate_interval,
    rounded_probability,
    unseen,
)
from dssc_jax.statistics.sequential import AcceptReject, StoppingRule, UntilWidth

__all__ = [
    "CONFIDENCE",
    "AcceptReject",
    "DesignEffect",
    "FailureDifference",
    "FixedCount",
    "IntervalsAfterStop",
    "Likelihood",
    "Look",
    "Method",
    "MetricDifference",
    "Replicated",
    "StoppingRule",
    "UntilWidth",
    "assured_draws",
    "chernoff_draws",
    "clopper_pearson",
    "compare_failures",
    "compare_metrics",
    "describe_probability",
    "design_effect",
    "difference_interval",
    "distance_of_mass",
    "draws_as_narrow",
    "expected_draws",
    "log_evidence_of_less",
    "lognormal_interval",
    "mass_within",
    "mcnemar",
    "multistage_interval",
    "plan",
    "quantile_interval",
    "replicate_interval",
    "rounded_probability",
    "tolerance_limits",
    "unseen",
    "wilks_draws",
    "wilks_order",
    "worst_case_draws",
]
