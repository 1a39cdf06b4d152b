"""Combine the draws' metrics into one objective with limits; compare start and result by it on fresh draws."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from scipy.special import softmax
from scipy.stats import bootstrap

from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.closed_loop.metrics.requirements import Requirement, ended_early, violated
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.evaluation import Derivative, Evaluator
from dssc_jax.engine.sampling import Arrays
from dssc_jax.statistics import CONFIDENCE, clopper_pearson, compare_failures, compare_metrics, quantile_interval

ENDLESS = 10.0  # relative excess of a draw that misses a bound by an infinite amount, such as one that never settles
SHARPNESS = 0.1  # temperature of the soft worst case, in standard deviations of the draws' costs
REQUIREMENTS = "requirements"
COUNTEREXAMPLES = "counterexamples"


class Merit(NamedTuple):
    """The objective and the excesses over the limits on some draws.

    If a draw has no objective, ``objective`` is infinite and the dictionaries are empty.

    Args:
        objective: The aggregate of the draws' costs.
        gradient: Derivatives of the objective by the loop's numbers; empty if they were not computed.
        excess: Relative excess over each limit, by name of the limit; not positive if the limit holds. The names
            ``requirements`` and ``counterexamples`` stand for the mean excess over requirements.
        slopes: Derivatives of each excess by the loop's numbers.
        ended: Number of draws without an objective, such as those that ended early.
    """

    objective: float
    gradient: dict[str, float]
    excess: dict[str, float]
    slopes: dict[str, dict[str, float]]
    ended: int

    @property
    def violation(self) -> float:
        """The largest excess; 0 if all limits hold, infinite if some draw has no objective."""
        if self.ended:
            return float("inf")
        return max([0.0, *self.excess.values()])


def draw_weights(costs: np.ndarray, aggregate: str, level: float) -> np.ndarray:
    """The weight of each draw in the aggregate of the costs, shape (n,); the weights add up to 1.

    The same weights serve for the gradient of the aggregate, as a weighted sum of the draws' gradients. For ``worst``
    this neglects that the weights depend on the costs.

    Args:
        costs: Cost of each draw, shape (n,).
        aggregate: ``mean``; ``cvar``, the mean over the worst share 1 - level of the draws, the last of which may count
            in part; or ``worst``, a softmax whose temperature is a tenth of the costs' standard deviation.
        level: Level of ``cvar``, in [0, 1).

    Reference:
        R. T. Rockafellar, S. Uryasev, Journal of Risk 2 (2000) 21-41.
    """
    count = len(costs)
    if aggregate == "mean":
        return np.full(count, 1.0 / count)
    if aggregate == "worst":
        rounding = np.finfo(float).eps * float(np.max(np.abs(costs)))
        temperature = max(SHARPNESS * float(np.std(costs)), rounding)
        if temperature <= np.finfo(float).tiny:
            temperature = 1.0  # all costs are 0
        return softmax(costs / temperature)
    worst_count = (1.0 - level) * count  # a fraction of a draw counts in part
    rank = np.empty(count)  # 0: the worst draw
    rank[np.argsort(-costs, kind="stable")] = np.arange(count)
    return np.clip(worst_count - rank, 0.0, 1.0) / worst_count


@dataclass(frozen=True)
class Goal:
    """The objective of a tuning, and its limits.

    Args:
        costs: Weight of each metric in the cost of a draw.
        aggregate: Name of the aggregate of the costs, see :func:`draw_weights`.
        level: Level of the aggregate ``cvar``.
        limits: For each limited metric, the largest admissible mean over the draws.
        requirements: Requirements that every draw must meet.
    """

    costs: Mapping[str, float]
    aggregate: str
    level: float
    limits: Mapping[str, float]
    requirements: Sequence[Requirement]

    def cost(self, results: Arrays) -> np.ndarray:
        """The cost of each draw, shape (n,): the weighted sum of its metrics; NaN if one of them is missing."""
        total = np.zeros(len(results["outcome"]))
        for name, weight in self.costs.items():
            total = total + weight * results[name]
        return total

    def value(self, costs: np.ndarray) -> float:
        """The aggregate of the draws' costs; infinite if some draw has no finite cost."""
        if not np.isfinite(costs).all():
            return float("inf")
        return float(draw_weights(costs, self.aggregate, self.level) @ costs)

    def excess(self, results: Arrays) -> np.ndarray:
        """How far each draw misses its worst requirement, relative to the bound, shape (n,); 0 if all are met."""
        return np.maximum(np.max(self._relative_excess(results), axis=0), 0.0)

    def _relative_excess(self, results: Arrays) -> np.ndarray:
        """How far each draw misses each requirement, relative to the bound, shape (requirements, draws).

        The value is negative where the requirement is met. A metric that is missing, or infinitely bad, misses its
        bound by :data:`ENDLESS`, so that no value is NaN or inf.
        """
        relative_excess = np.array([-results[r.name] / r.scale for r in self.requirements])
        return np.where(np.isnan(relative_excess) | (relative_excess == np.inf), ENDLESS, relative_excess)

    def lacks_value(self, results: Arrays) -> np.ndarray:
        """Whether each draw lacks a cost or a limited metric, shape (n,), because it ended early or has no margin."""
        is_lacking = ended_early(results["outcome"]) | np.isnan(self.cost(results))
        for name in self.limits:
            is_lacking = is_lacking | np.isnan(results[name])
        return is_lacking

    def merit(self, results: Arrays, numbers: Sequence[str], counterexample_count: int = 0) -> Merit:
        """Compute objective and excesses from results of draws and counterexamples, with derivatives by some numbers.

        Args:
            results: Results of the draws, then of the counterexamples, by name.
            numbers: The loop's numbers by which the results have derivatives; empty: no derivatives.
            counterexample_count: Number of counterexamples; they have no cost, and must meet the requirements.
        """
        count = len(results["outcome"]) - counterexample_count
        ended = int(np.count_nonzero(self.lacks_value(results)))
        if ended:
            return Merit(objective=float("inf"), gradient={}, excess={}, slopes={}, ended=ended)
        draw_results = {name: array[:count] for name, array in results.items()}
        costs = self.cost(draw_results)
        weights = draw_weights(costs, self.aggregate, self.level)
        excess = {}
        slopes = {}
        for name, bound in self.limits.items():
            scale = bound or 1.0  # an excess over 0 is absolute
            excess[name] = float((np.mean(draw_results[name]) - bound) / scale)
            by_number = {}
            for number in numbers:
                by_number[number] = float(np.mean(draw_results[Derivative(name, number)]) / scale)
            slopes[name] = by_number
        if self.requirements:
            excess[REQUIREMENTS], slopes[REQUIREMENTS] = self._mean_excess(draw_results, numbers)
            if counterexample_count:
                counterexamples = {name: array[count:] for name, array in results.items()}
                excess[COUNTEREXAMPLES], slopes[COUNTEREXAMPLES] = self._mean_excess(counterexamples, numbers)
        gradient = {number: float(weights @ self._slope(draw_results, number)) for number in numbers}
        return Merit(objective=float(weights @ costs), gradient=gradient, excess=excess, slopes=slopes, ended=0)

    def _slope(self, results: Arrays, number: str) -> np.ndarray:
        """Derivative of the cost of each draw by one of the loop's numbers, shape (n,)."""
        total = np.zeros(len(results["outcome"]))
        for name, weight in self.costs.items():
            total = total + weight * results[Derivative(name, number)]
        return total

    def _mean_excess(self, results: Arrays, numbers: Sequence[str]) -> tuple[float, dict[str, float]]:
        """Mean over the draws of how far each misses its worst requirement, and derivatives of this mean.

        A draw that meets all requirements, or whose derivative is not finite, has the derivative 0.
        """
        relative_excess = self._relative_excess(results)
        worst = np.argmax(relative_excess, axis=0)  # index of a requirement for each draw
        is_violated = np.max(relative_excess, axis=0) > 0.0
        slopes = {}
        for number in numbers:
            rows = np.array([-results[Derivative(r.name, number)] / r.scale for r in self.requirements])
            slope_of_worst = np.take_along_axis(rows, worst[None], 0)[0]
            counted = np.where(is_violated & np.isfinite(slope_of_worst), slope_of_worst, 0.0)
            slopes[number] = float(np.mean(counted))
        return float(np.mean(self.excess(results))), slopes


@dataclass(frozen=True)
class MissedBound:
    """A requirement or a limit that a point misses, in words; the excess is infinite if the metric is infinite."""

    text: Annotated[str, Quantity("", "the bound")]
    draws: Annotated[int | None, Quantity("1", "draws that miss it; None of a bound of the mean")]
    excess: Annotated[float, Quantity("that of the metric", "by how much the worst draw, or the mean, misses it")]
    unit: Annotated[str, Quantity("", "unit of the excess")]


def missed_bounds(goal: Goal, results: Arrays, units: Mapping[str, str]) -> tuple[MissedBound, ...]:
    """List the requirements that some draws miss, then the limits that the mean over the draws misses.

    If draws end early, the first entry says so; these draws are left out of the other entries.

    Args:
        goal: Requirements and limits.
        results: Results of the draws.
        units: Unit of each limited metric.
    """
    ended = ended_early(results["outcome"])
    rows = []
    if ended.any():
        rows.append(MissedBound("runs to its end", int(np.count_nonzero(ended)), math.inf, unit=""))
    for requirement in goal.requirements:
        slacks = results[requirement.name][~ended]
        is_missed = violated(slacks)
        if is_missed.any():
            rows.append(missed_requirement(requirement, slacks[is_missed]))
    for name, bound in goal.limits.items():
        excess = float(np.mean(results[name][~ended])) - bound if not ended.all() else math.nan
        if excess > 0.0:
            rows.append(MissedBound(text=f"mean {name} <= {bound:.5g}", draws=None, excess=excess, unit=units[name]))
    return tuple(rows)


def missed_requirement(requirement: Requirement, slacks: np.ndarray) -> MissedBound:
    """Say by how much the worst of some draws misses a requirement, in the unit in which the requirement is shown.

    Args:
        requirement: The requirement.
        slacks: Slack of each draw that misses it; NaN without a metric.
    """
    distance = -float(np.min(np.where(np.isnan(slacks), -np.inf, slacks)))
    worst_value = requirement.bound - distance
    if requirement.maximum is not None:
        worst_value = requirement.bound + distance
    shown_value, unit = requirement.shown(worst_value)
    shown_bound, _ = requirement.shown(requirement.bound)
    return MissedBound(text=requirement.short_text, draws=len(slacks), excess=abs(shown_value - shown_bound), unit=unit)


RESAMPLES = 2000  # resamples of the bootstrap
JUDGED_LANES = 4096  # most draws of the verdict that are simulated at once
Pair = tuple[float, float]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Verdict:
    """Comparison of the result of a tuning with its start, on the same fresh draws. Pairs are (start, result).

    If a draw ended early, ``objective`` is infinite and ``reduction_interval`` is NaN. ``quantile`` has exact
    order-statistic intervals of the cost's quantile at the level of ``cvar``, or of the median for other aggregates.
    ``intervals`` are exact, too (Clopper-Pearson). Differences are result minus start, draw by draw.
    """

    draws: Annotated[int, Quantity("1", "number of fresh draws")]
    objective: Annotated[Pair, Quantity("1", "aggregate of the costs at the start and of the result")]
    reduction: Annotated[float, Quantity("1", "1 - result/start")]
    reduction_interval: Annotated[Pair, Quantity("1", "bootstrap interval of the reduction over the draws")]
    quantile: Annotated[tuple[Pair, Pair], Quantity("1", "interval of the cost's quantile, start and result")]
    difference: Annotated[Triple, Quantity("1", "median and interval of the cost's difference, result minus start")]
    limits: Annotated[
        dict[str, Triple], Quantity("that of the metric", "bound, and the means at the start and of the result")
    ]
    failures: Annotated[tuple[int, int], Quantity("1", "failed draws at the start and of the result")]
    requirements: Annotated[
        dict[str, tuple[int, int]], Quantity("1", "draws that violate each requirement, at the start and of the result")
    ]
    intervals: Annotated[tuple[Pair, Pair], Quantity("1", "intervals of both failure probabilities")]
    failure_difference: Annotated[Triple, Quantity("1", "interval of their paired difference, and McNemar's p-value")]

    @property
    def within(self) -> bool:
        """Whether the result keeps every limit on these draws."""
        return all(result_mean <= bound for bound, _, result_mean in self.limits.values())


def judge_tuning(
    plan: Plan, goal: Goal, start: Mapping[str, float], best: Mapping[str, float]
) -> tuple[Verdict, Arrays]:
    """Simulate start and result on the study's own draws, and compare them.

    Args:
        plan: The plan.
        goal: Costs, aggregate and level.
        start: The loop's numbers at the start.
        best: The loop's numbers in the result.

    Returns:
        The verdict, and the cost of every draw for ``start`` and ``tuned``, shape (draws,) each.
    """
    study = plan.study
    draws = study.config.draws
    extents = {name: (value, value) for name, value in start.items()}
    evaluator = Evaluator(study, extents, min(draws, JUDGED_LANES))
    laws = evaluator.values_of_draws(slice(0, draws))

    def simulate(numbers: Mapping[str, float]) -> Arrays:
        """Simulate all draws with the given numbers of the loop, and return the results by name."""
        columns = {name: np.full(draws, value) for name, value in numbers.items()}
        return evaluator(np.arange(draws), laws | columns)

    start_results = simulate(start)
    results = simulate(best)
    verdict = compare_results(plan, goal, start_results, results)
    return verdict, {"start": goal.cost(start_results), "tuned": goal.cost(results)}


def compare_results(plan: Plan, goal: Goal, start_results: Arrays, results: Arrays) -> Verdict:
    """Compare the results of the same draws at the start and in the result of a tuning.

    Args:
        plan: The plan.
        goal: Costs, aggregate and level.
        start_results: Results of all draws at the start.
        results: Results of all draws in the result.
    """
    start_costs = goal.cost(start_results)
    costs = goal.cost(results)
    start_objective = goal.value(start_costs)
    objective = goal.value(costs)
    level = goal.level if goal.aggregate == "cvar" else 0.5  # level of the quantile whose intervals are given
    cost_difference = compare_metrics(costs, start_costs)
    start_failed = np.asarray(start_results["outcome"] != Outcome.OK)
    failed = np.asarray(results["outcome"] != Outcome.OK)
    failures = compare_failures(failed, start_failed)
    limits = {}
    for name, bound in plan.table.limits.items():
        start_mean = float(np.mean(start_results[name]))
        limit = start_mean if bound == "start" else float(bound)
        limits[name] = (limit, start_mean, float(np.mean(results[name])))
    by_requirement = {}
    for requirement in goal.requirements:
        start_violations = int(np.count_nonzero(violated(start_results[requirement.name])))
        violations = int(np.count_nonzero(violated(results[requirement.name])))
        by_requirement[requirement.short_text] = (start_violations, violations)
    start_count = int(np.count_nonzero(start_failed))
    count = int(np.count_nonzero(failed))
    return Verdict(
        draws=failures.draws,
        objective=(start_objective, objective),
        reduction=1.0 - objective / start_objective,
        reduction_interval=reduction_interval(goal, start_costs, costs),
        quantile=(quantile_interval(start_costs, level), quantile_interval(costs, level)),
        difference=(cost_difference.difference, *cost_difference.interval),
        limits=limits,
        failures=(start_count, count),
        requirements=by_requirement,
        intervals=(failure_interval(start_count, failures.draws), failure_interval(count, failures.draws)),
        failure_difference=(*failures.interval, failures.p_value),
    )


def failure_interval(failures: int, draws: int) -> Pair:
    """Exact (Clopper-Pearson) interval of a failure probability, from the number of failures among the draws."""
    low, high = clopper_pearson(failures, draws).tolist()
    return low, high


def reduction_interval(goal: Goal, start: np.ndarray, tuned: np.ndarray) -> Pair:
    """Percentile bootstrap interval of 1 - result/start over paired draws; NaN if a draw has no cost.

    Args:
        goal: Aggregate and level.
        start: Cost of each draw at the start, shape (n,).
        tuned: Cost of each draw in the result, shape (n,).
    """
    if not (np.isfinite(start).all() and np.isfinite(tuned).all()):
        return float("nan"), float("nan")

    def reduction(start_costs: np.ndarray, tuned_costs: np.ndarray) -> float:
        """The reduction 1 - result/start of the aggregate, for costs of resampled draws."""
        return 1.0 - goal.value(tuned_costs) / goal.value(start_costs)

    interval = bootstrap(
        (start, tuned), reduction, paired=True, vectorized=False, n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE, method="percentile", rng=0,
    ).confidence_interval  # fmt: skip
    return float(interval.low), float(interval.high)
