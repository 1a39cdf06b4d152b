"""Statements about probability laws that hold at the confidence they print."""

from dssc_jax.statistics.order import quantile_interval, tolerance_limits, wilks_draws, wilks_order
from dssc_jax.statistics.paired import (
    FailureDifference,
    MetricDifference,
    compare_failures,
    compare_metrics,
    difference_interval,
    mcnemar,
)
from dssc_jax.statistics.planning import chernoff_draws, clopper_pearson_draws, plan, worst_case_draws
from dssc_jax.statistics.proportions import (
    CONFIDENCE,
    DataDriven,
    FixedCount,
    Method,
    Replicated,
    clopper_pearson,
    describe_probability,
    replicate_interval,
)
from dssc_jax.statistics.sequential import AcceptReject, UntilWidth, looks

__all__ = [
    "CONFIDENCE",
    "AcceptReject",
    "DataDriven",
    "FailureDifference",
    "FixedCount",
    "Method",
    "MetricDifference",
    "Replicated",
    "UntilWidth",
    "chernoff_draws",
    "clopper_pearson",
    "clopper_pearson_draws",
    "compare_failures",
    "compare_metrics",
    "describe_probability",
    "difference_interval",
    "looks",
    "mcnemar",
    "plan",
    "quantile_interval",
    "replicate_interval",
    "tolerance_limits",
    "wilks_draws",
    "wilks_order",
    "worst_case_draws",
]
