"""Statements about probability laws that hold at the confidence they print."""

from dssc_jax.statistics.order import quantile_interval
from dssc_jax.statistics.paired import (
    FailureDifference,
    MetricDifference,
    compare_failures,
    compare_metrics,
    difference_interval,
    mcnemar,
)
from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson, describe_probability

__all__ = [
    "CONFIDENCE",
    "FailureDifference",
    "MetricDifference",
    "clopper_pearson",
    "compare_failures",
    "compare_metrics",
    "describe_probability",
    "difference_interval",
    "mcnemar",
    "quantile_interval",
]
