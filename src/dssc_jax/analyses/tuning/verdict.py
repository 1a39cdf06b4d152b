"""Evaluate tuned numbers on fresh draws: start and result on the study's own draws, which the tuning did not use."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.stats import bootstrap

from dssc_jax.analyses.tuning.objective import Goal, weights
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.batching import Arrays
from dssc_jax.engine.evaluation import Evaluator
from dssc_jax.statistics import CONFIDENCE, clopper_pearson, compare_failures, compare_metrics, quantile_interval

RESAMPLES = 2000
Pair = tuple[float, float]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Verdict:
    """Start and result on the same fresh draws.

    Args:
        draws: Number of draws; they are the study's own.
        objective: The aggregate of the costs at the start and of the result; infinite if a draw ended early.
        reduction: 1 - result/start.
        reduction_interval: Its bootstrap interval over the draws; NaN if a draw ended early.
        quantile: Exact order-statistic intervals of the cost's quantile at the aggregate's level, start and result.
        difference: Median and exact interval of the draw-by-draw difference of the cost, result minus start.
        limits: Bound of each limit, and the means at the start and of the result.
        failures: Failed draws at the start and of the result.
        intervals: Exact (Clopper-Pearson) intervals of both failure probabilities.
        failure_difference: Exact interval of their paired difference, result minus start, and McNemar's p-value.
    """

    draws: Annotated[int, Quantity("1", "number of fresh draws")]
    objective: Annotated[Pair, Quantity("1", "aggregate of the costs at the start and of the result")]
    reduction: Annotated[float, Quantity("1", "1 - result/start")]
    reduction_interval: Annotated[Pair, Quantity("1", "its bootstrap interval over the draws")]
    quantile: Annotated[tuple[Pair, Pair], Quantity("1", "interval of the cost's quantile, start and result")]
    difference: Annotated[Triple, Quantity("1", "median and interval of the cost's difference, result minus start")]
    limits: Annotated[
        dict[str, Triple], Quantity("that of the metric", "bound, and the means at the start and of the result")
    ]
    failures: Annotated[tuple[int, int], Quantity("1", "failed draws at the start and of the result")]
    intervals: Annotated[tuple[Pair, Pair], Quantity("1", "intervals of both failure probabilities")]
    failure_difference: Annotated[Triple, Quantity("1", "interval of their paired difference, and McNemar's p-value")]

    @property
    def within(self) -> bool:
        """Whether every limit holds on these draws."""
        return all(results <= bound for bound, _, results in self.limits.values())


def judge_tuning(
    plan: Plan, goal: Goal, start: Mapping[str, float], best: Mapping[str, float]
) -> tuple[Verdict, Arrays]:
    """Compare the result with the start.

    Args:
        plan: The plan; the study's own draws decide.
        goal: Costs, aggregate and level.
        start: The loop's numbers at the start.
        best: Those of the result.

    Returns:
        The verdict, and the costs of every draw at the start and of the result.
    """
    study = plan.study
    evaluator = Evaluator(study, {name: (start[name], start[name]) for name in start}, min(study.config.draws, 4096))
    indices = np.arange(study.config.draws)
    laws = evaluator.drawn(slice(0, len(indices)))

    def simulated(numbers: Mapping[str, float]) -> Arrays:
        return evaluator(indices, laws | {name: np.full(len(indices), value) for name, value in numbers.items()})

    start_results = simulated(start)
    results = simulated(best)
    costs = {"start": goal.cost(start_results), "tuned": goal.cost(results)}
    return compare_objectives(plan, goal, start_results, results), costs


def compare_objectives(plan: Plan, goal: Goal, start_results: Arrays, results: Arrays) -> Verdict:
    """Create the verdict from the results at the start and at the end."""
    costs = goal.cost(start_results), goal.cost(results)
    objective = goal.value(costs[0]), goal.value(costs[1])
    level = goal.level if goal.aggregate == "cvar" else 0.5
    paired = compare_metrics(costs[1], costs[0])
    failed = [np.asarray(results["outcome"] != Outcome.OK) for results in (start_results, results)]
    failures = compare_failures(failed[1], failed[0])
    limits = {}
    for name, bound in plan.table.limits.items():
        means = float(np.mean(start_results[name])), float(np.mean(results[name]))
        limits[name] = (means[0] if bound == "start" else float(bound), *means)
    counts = tuple(int(np.count_nonzero(part)) for part in failed)
    ends = [tuple(clopper_pearson(count, failures.draws).tolist()) for count in counts]
    return Verdict(
        draws=failures.draws,
        objective=objective,
        reduction=1.0 - objective[1] / objective[0],
        reduction_interval=reduction_interval(goal, *costs),
        quantile=(quantile_interval(costs[0], level), quantile_interval(costs[1], level)),
        difference=(paired.difference, *paired.interval),
        limits=limits,
        failures=(counts[0], counts[1]),
        intervals=(ends[0], ends[1]),
        failure_difference=(*failures.interval, failures.p_value),
    )


def reduction_interval(goal: Goal, start: np.ndarray, tuned: np.ndarray) -> tuple[float, float]:
    """Percentile bootstrap of 1 - result/start over the draws, with pairs kept together."""
    if not (np.isfinite(start).all() and np.isfinite(tuned).all()):
        return float("nan"), float("nan")

    def reduction(first: np.ndarray, second: np.ndarray) -> float:
        a, b = (float(weights(costs, goal.aggregate, goal.level) @ costs) for costs in (first, second))
        return 1.0 - b / a

    interval = bootstrap(
        (start, tuned), reduction, paired=True, vectorized=False, n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE, method="percentile", rng=0,
    ).confidence_interval  # fmt: skip
    return float(interval.low), float(interval.high)
