"""Combine the draws' metrics and derivatives into one objective, its gradient, and the excesses over limits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from dssc_jax.closed_loop.requirements import Requirement, ended_early
from dssc_jax.engine.batching import Arrays
from dssc_jax.engine.evaluation import Derivative

SHARPNESS = 0.1  # temperature of the soft worst case, in standard deviations of the draws' costs
REQUIREMENTS, COUNTEREXAMPLES = "requirements", "counterexamples"


class Merit(NamedTuple):
    """The evaluation of a point on a batch.

    Args:
        objective: The aggregate of the draws' costs.
        gradient: Its derivatives with respect to the loop's numbers.
        excess: Relative excess over each limit; not positive if within.
        slopes: Derivatives of each excess.
        ended: Number of draws that ended early, for which no number is defined.
    """

    objective: float
    gradient: dict[str, float]
    excess: dict[str, float]
    slopes: dict[str, dict[str, float]]
    ended: int

    @property
    def violation(self) -> float:
        """The largest excess; 0 if all limits hold, infinite if draws ended early."""
        if self.ended:
            return float("inf")
        return max([0.0, *self.excess.values()])


def weights(costs: np.ndarray, aggregate: str, level: float) -> np.ndarray:
    """The weight of each draw in the aggregate of the costs; weights add up to 1 and also apply to the gradient.

    Args:
        costs: One for each draw, shape (n,).
        aggregate: ``mean``; ``cvar``, the mean of the worst share 1 - level, whose last draw may count in part;
            ``worst``, a softmax with a temperature of a tenth of the costs' standard deviation.
        level: Level of the CVaR.

    Reference:
        R. T. Rockafellar, S. Uryasev, Journal of Risk 2 (2000) 21-41.
    """
    count = len(costs)
    if aggregate == "mean":
        return np.full(count, 1.0 / count)
    if aggregate == "worst":
        spread = max(SHARPNESS * float(np.std(costs)), np.finfo(float).eps * float(np.max(np.abs(costs))))
        return softmax(costs / (spread if spread > np.finfo(float).tiny else 1.0))
    room = (1.0 - level) * count
    ranks = np.empty(count)
    ranks[np.argsort(-costs, kind="stable")] = np.arange(count)
    return np.clip(room - ranks, 0.0, 1.0) / room


@dataclass(frozen=True)
class Goal:
    """The objective to minimise, and the constraints.

    Args:
        costs: Weight of each metric in a draw's cost.
        aggregate: See :func:`weights`.
        level: See :func:`weights`.
        limits: Bound of each metric's mean over the draws.
        requirements: Requirements that every draw must meet.
    """

    costs: Mapping[str, float]
    aggregate: str
    level: float
    limits: Mapping[str, float]
    requirements: Sequence[Requirement]

    def cost(self, results: Arrays) -> np.ndarray:
        """Each draw's cost; NaN if it ended early."""
        total = np.zeros(len(results["outcome"]))
        for name, weight in self.costs.items():
            total = total + weight * results[name]
        return total

    def value(self, costs: np.ndarray) -> float:
        """The aggregate of the draws' costs; infinite if one has none."""
        if not np.isfinite(costs).all():
            return float("inf")
        return float(weights(costs, self.aggregate, self.level) @ costs)

    def excess(self, results: Arrays) -> np.ndarray:
        """How far each draw misses its worst requirement, relative to the bound; 0 if it meets all."""
        missed = [-results[r.name] / r.scale for r in self.requirements]
        return np.maximum(np.max(missed, axis=0), 0.0)

    def merit(self, results: Arrays, numbers: Sequence[str], added: int = 0) -> Merit:
        """Evaluate a batch, with derivatives if the results contain them.

        Args:
            results: Results of the draws, then of ``added`` counterexamples.
            numbers: The loop's numbers with respect to which there are derivatives.
            added: Number of counterexamples at the end: they have no cost, and must meet the requirements.
        """
        count = len(results["outcome"]) - added
        ended = int(np.count_nonzero(ended_early(results["outcome"])))
        if ended:
            return Merit(float("inf"), {}, {}, {}, ended)
        drawn = {name: array[:count] for name, array in results.items()}
        costs = self.cost(drawn)
        share = weights(costs, self.aggregate, self.level)
        excess, slopes = {}, {}
        for name, bound in self.limits.items():
            scale = bound or 1.0
            excess[name] = float((np.mean(drawn[name]) - bound) / scale)
            slopes[name] = {of: float(np.mean(drawn[Derivative(name, of)]) / scale) for of in numbers}
        if self.requirements:
            excess[REQUIREMENTS], slopes[REQUIREMENTS] = self._missed(drawn, numbers)
            if added:
                counterexamples = {name: array[count:] for name, array in results.items()}
                excess[COUNTEREXAMPLES], slopes[COUNTEREXAMPLES] = self._missed(counterexamples, numbers)
        gradient = {of: float(share @ self._slope(drawn, of)) for of in numbers}
        return Merit(float(share @ costs), gradient, excess, slopes, 0)

    def _slope(self, results: Arrays, of: str) -> np.ndarray:
        total = np.zeros(len(results["outcome"]))
        for name, weight in self.costs.items():
            total = total + weight * results[Derivative(name, of)]
        return total

    def _missed(self, results: Arrays, numbers: Sequence[str]) -> tuple[float, dict[str, float]]:
        """Mean over the draws of how far the worst requirement is missed, and its derivatives."""
        missed = np.array([-results[r.name] / r.scale for r in self.requirements])
        worst = np.argmax(missed, axis=0)
        counts = np.max(missed, axis=0) > 0.0
        slopes = {}
        for of in numbers:
            rows = np.array([-results[Derivative(r.name, of)] / r.scale for r in self.requirements])
            slopes[of] = float(np.mean(np.where(counts, np.take_along_axis(rows, worst[None], 0)[0], 0.0)))
        return float(np.mean(self.excess(results))), slopes
