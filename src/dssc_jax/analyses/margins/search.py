"""Find the critical values of many draws at once: bracketing on a grid, then bisection."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.defaults import BISECTIONS, POINTS
from dssc_jax.closed_loop.requirements import binding_requirement, ended_early, worst_slack
from dssc_jax.core.bisection import bisect
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study

CLOCK = "loop.sample_time"

SlackFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(indices of draws, a value for each) -> signed slacks, negative if the draw fails."""


class Censoring(IntEnum):
    """Where a critical value lies: before the first bound, inside, or beyond the second."""

    BEFORE = -1
    INSIDE = 0
    BEYOND = 1


@dataclass(frozen=True)
class Walk:
    """The walk from the safe end to the other end, evenly spaced in the number or its logarithm.

    Args:
        start: The safe end.
        end: The other end, larger or smaller than the start.
        log: Space the values evenly in the logarithm.
        points: Number of values in the bracketing grid, including both ends.
        parted: A length that must be a whole multiple of every value; values move to the nearest such divisor.
    """

    start: float
    end: float
    log: bool = False
    points: int = POINTS
    parted: float | None = None

    def at(self, share: np.ndarray) -> np.ndarray:
        """The value at a fraction of the walk in [0, 1]."""
        if self.log:
            value = np.exp((1.0 - share) * np.log(self.start) + share * np.log(self.end))
        else:
            value = (1.0 - share) * self.start + share * self.end
        value = np.clip(value, min(self.start, self.end), max(self.start, self.end))
        return value if self.parted is None else self.parted / np.round(self.parted / value)

    @property
    def grid(self) -> np.ndarray:
        """The values of the grid."""
        return self.at(np.linspace(0.0, 1.0, self.points))


class Critical(NamedTuple):
    """The critical value of each draw.

    Args:
        value: The critical value; NaN if censored. Shape (n,).
        censoring: A :class:`Censoring` code.
        non_monotone: Whether the draw passes again beyond a value at which it fails.
        slack: Signed slacks on the grid, shape (points, n).
        violated: Index of the requirement that the draw violates first along the walk, as :class:`FirstViolated` counts
            them; None if that is not known. Shape (n,).
    """

    value: np.ndarray
    censoring: np.ndarray
    non_monotone: np.ndarray
    slack: np.ndarray
    violated: np.ndarray | None = None


class FirstViolated:
    """The requirement that each draw violates first along a walk, for values that are tried in any order.

    ``requirement`` has shape (n,): the index of the requirement; the number of requirements for a draw that ended
    early; -1 without a failure.

    Args:
        draws: n.
        start: The walk's start.
    """

    def __init__(self, draws: int, start: float) -> None:
        self.start = start
        self.requirement = np.full(draws, -1)
        self.distance = np.full(draws, np.inf)

    def slack(self, draws: np.ndarray, values: np.ndarray, study: Study, results: Arrays) -> np.ndarray:
        """The signed slack of draws at values of the walk; records the failures nearest to the start."""
        requirements = study.requirements
        slack = worst_slack(requirements, results)
        distance = np.abs(values - self.start)
        violated = np.full(len(draws), len(requirements))
        if requirements:
            ended = ended_early(results["outcome"])
            violated = np.where(ended, violated, binding_requirement(requirements, results))
        nearer = (slack < 0.0) & (distance < self.distance[draws])
        self.requirement[draws[nearer]] = violated[nearer]
        self.distance[draws[nearer]] = distance[nearer]
        return slack


def search_critical(slack_at: SlackFunction, draws: int, walk: Walk, bisections: int = BISECTIONS) -> Critical:
    """Find the critical values of all draws at once.

    Args:
        slack_at: The signed slack of draws at values of the walk.
        draws: The number of draws.
        walk: The walk to search.
        bisections: Number of bisections of the grid cell that contains the first failure.

    Returns:
        Critical values at which the draw passes, with a failure at most a cell/2^bisections further along.
    """
    indices = np.arange(draws)
    slack = np.stack([slack_at(indices, np.full(draws, value)) for value in walk.grid])
    passes = slack >= 0.0
    first_failure = np.where(passes.all(axis=0), walk.points, np.argmin(passes, axis=0))
    censoring = np.full(draws, Censoring.INSIDE)
    censoring[first_failure == 0] = Censoring.BEFORE
    censoring[first_failure == walk.points] = Censoring.BEYOND
    value = np.full(draws, np.nan)
    crossing_draws = np.flatnonzero(censoring == Censoring.INSIDE)
    if crossing_draws.size:
        cells = walk.points - 1
        safe = (first_failure[crossing_draws] - 1) / cells
        failing = first_failure[crossing_draws] / cells
        safe, _ = bisect(lambda share: slack_at(crossing_draws, walk.at(share)) >= 0.0, safe, failing, bisections)
        value[crossing_draws] = walk.at(safe)
    passes_again = passes & (np.arange(walk.points)[:, None] > first_failure)
    return Critical(value, censoring, np.any(passes_again, axis=0), slack)
