"""The record of a search: evaluations on the validation draws, and the best point among them."""

from dataclasses import dataclass, field
from typing import Any

from dssc_jax.analyses.tuning.certified import SLACK
from dssc_jax.analyses.tuning.problem import Point, Problem

HEADROOM = 0.01  # relative margin that a search keeps within limits
UNFIT = 1e6  # cost of a point that is not certified, or whose draws end early
REACH = 6.0  # |z| at the ends of a search's box: 0.25 % of the interval's logarithm is left out
FINEST = 1e-3  # width of the sign before it is 0, relative to the first
PENALTY = 20.0  # of an excess, for objective and excess relative to their scales; more than the multipliers' sum
UPDATE = 5  # steps or generations between two looks at the validation draws


@dataclass
class Search:
    """The result of a search.

    Args:
        best: The best point on the validation draws.
        history: A row for each evaluation on validation draws: step, objective and violation on training and validation
            draws, tuned numbers.
        stopped: The reason why it ended.
        shortened: Number of halvings of steps that led to points that are not allowed.
        lowest: Sort key of the best point.
    """

    best: Point
    history: list[dict[str, Any]] = field(default_factory=list)
    stopped: str = "all steps done"
    shortened: int = 0
    lowest: tuple[float, float] = (float("inf"), float("inf"))

    def look(self, problem: Problem, step: int, train: Point, validation: Point, score: float | None = None) -> bool:
        """Record a point; return whether it is the best so far.

        Args:
            problem: The tuning problem.
            step: Step of the search.
            train: The point on the training draws.
            validation: The point on the validation draws.
            score: What is minimised in place of the objective on the validation draws; None: that objective.
        """
        row = {"step": step, "objective": train.merit.objective, "violation": train.merit.violation}
        row |= {"validation": validation.merit.objective, "validation_violation": validation.merit.violation}
        if score is not None:
            row[problem.plan.table.aim] = problem.plan.aim_at(problem.plan.numbers_at(train.z)).value
        tuned = problem.plan.mirror.tuned(train.z)
        self.history.append(row | {name: float(value) for name, value in tuned.items()})
        placed = rank(validation, score)
        better = placed < self.lowest
        if better or step == 0:
            self.best, self.lowest = validation, placed
        return better


def headroom(limit: str) -> float:
    """The relative headroom kept within a limit; 0 for the theorem's, which do not depend on the draws."""
    return 0.0 if limit.startswith(SLACK) else HEADROOM


def rank(point: Point, score: float | None) -> tuple[float, float]:
    """Sort key: points within the limits first, then by the score, or by the objective."""
    return point.merit.violation, point.merit.objective if score is None else score
