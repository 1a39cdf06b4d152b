"""Find the critical values of many draws at once: bracketing on a grid, then bisection."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.defaults import BISECTIONS, POINTS
from dssc_jax.closed_loop.requirements import binding_requirement, ended_early, worst_slack
from dssc_jax.engine.batching import Arrays
from dssc_jax.study import Study

CLOCK = "loop.sample_time"

SlackOf = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(indices of some of the draws, a value for each) -> signed slacks, negative if the draw fails."""


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
    """The critical value found for each draw.

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
    """The requirement that each draw violates first along a walk, from the values that a search tries in any order.

    ``which`` has shape (n,): the index of the requirement; their number for a draw that ended early; -1 without a
    failure.

    Args:
        draws: n.
        start: The walk's start.
    """

    def __init__(self, draws: int, start: float) -> None:
        self.which, self._at, self._start = np.full(draws, -1), np.full(draws, np.inf), start

    def slack(self, draws: np.ndarray, values: np.ndarray, at: Study, results: Arrays) -> np.ndarray:
        """The signed slack of some draws at some values, of which it takes note."""
        slack, distance = worst_slack(at.requirements, results), np.abs(values - self._start)
        violated = np.full(len(draws), len(at.requirements))
        if at.requirements:
            early = ended_early(results["outcome"])
            violated = np.where(early, violated, binding_requirement(at.requirements, results))
        first = (slack < 0.0) & (distance < self._at[draws])
        self.which[draws[first]], self._at[draws[first]] = violated[first], distance[first]
        return slack


def search_critical(slack_of: SlackOf, draws: int, walk: Walk, bisections: int = BISECTIONS) -> Critical:
    """Find the critical values of all draws at once.

    Args:
        slack_of: The signed slack of chosen draws at chosen values.
        draws: The number of draws.
        walk: The walk to search.
        bisections: Number of bisections of the grid cell that contains the first failure.

    Returns:
        Critical values at which the draw passes, with a failure at most a cell/2^bisections further along.
    """
    everyone = np.arange(draws)
    slack = np.stack([slack_of(everyone, np.full(draws, value)) for value in walk.grid])
    passed = slack >= 0.0
    first = np.where(passed.all(axis=0), walk.points, np.argmin(passed, axis=0))
    censoring = np.where(first == 0, Censoring.BEFORE, np.where(first == walk.points, Censoring.BEYOND, 0))
    inside = np.flatnonzero(censoring == Censoring.INSIDE)
    cells = walk.points - 1
    good, bad = (first[inside] - 1) / cells, first[inside] / cells
    for _ in range(bisections if inside.size else 0):
        middle = 0.5 * (good + bad)
        ok = slack_of(inside, walk.at(middle)) >= 0.0
        good, bad = np.where(ok, middle, good), np.where(ok, bad, middle)
    value = np.full(draws, np.nan)
    value[inside] = walk.at(good)
    again = passed & (np.arange(walk.points)[:, None] > first)
    return Critical(value, censoring, np.any(again, axis=0), slack)
