"""Find the critical values of many draws at once: bracketing on a grid, then bisection."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.defaults import BISECTIONS, POINTS
from dssc_jax.closed_loop.metrics.requirements import binding_requirement, ended_early, worst_slack
from dssc_jax.core.bisection import bisect
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study

CLOCK = "loop.sample_time"
"""Dotted name of the sample time, which is fixed before a loop is traced."""
ROUNDING = 1e-9  # relative error within which a quotient of times is a whole number

WalkSlack = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(indices of draws, a value of the walk for each) -> signed slacks, negative if the draw fails."""


class Censoring(IntEnum):
    """Where the critical value of a draw lies: before the start of the walk, within the walk, or beyond its end."""

    BEFORE = -1
    INSIDE = 0
    BEYOND = 1


@dataclass(frozen=True)
class Walk:
    """The walk of a number from the safe end to the other end, even in the number or its logarithm.

    Args:
        start: The safe end.
        end: The other end, larger or smaller than the start.
        log: Whether the values are even in the logarithm.
        points: Number of values in the bracketing grid, including both ends.
        parted: The duration of the flight [s] if the number is the sample time, else None. Values of a sample time are
            moved to values within the walk that divide the duration into whole samples.
    """

    start: float
    end: float
    log: bool = False
    points: int = POINTS
    parted: float | None = None

    def at(self, share: np.ndarray) -> np.ndarray:
        """Return the values of the walk at shares of the way, any shape: share 0 is the start, share 1 the end."""
        if self.log:
            value = np.exp((1.0 - share) * np.log(self.start) + share * np.log(self.end))
        else:
            value = (1.0 - share) * self.start + share * self.end
        low = min(self.start, self.end)
        high = max(self.start, self.end)
        value = np.clip(value, low, high)
        if self.parted is None:
            return value
        # numbers of samples: the largest sample time has the fewest
        fewest = np.ceil(self.parted / high * (1.0 - ROUNDING))
        most = max(np.floor(self.parted / low * (1.0 + ROUNDING)), 1.0)
        return self.parted / np.clip(np.round(self.parted / value), fewest, most)

    @property
    def grid(self) -> np.ndarray:
        """The values of the bracketing grid, shape (points,)."""
        return self.at(np.linspace(0.0, 1.0, self.points))


class CriticalValues(NamedTuple):
    """The critical values of n draws, as a search along a walk found them.

    Args:
        value: The last passing value before the first failure; NaN if censored. Shape (n,).
        censoring: A :class:`Censoring` code. Shape (n,).
        non_monotone: Whether the draw passes again beyond a value at which it fails. Shape (n,).
        slack: Signed slacks on the grid, negative where the draw fails, shape (points, n).
        first_violated: Index of the requirement that the draw violates first along the walk, as
            :class:`FirstViolated` counts them, shape (n,); None if that is not known.
    """

    value: np.ndarray
    censoring: np.ndarray
    non_monotone: np.ndarray
    slack: np.ndarray
    first_violated: np.ndarray | None = None


class CriticalDraws(NamedTuple):
    """Critical values of n draws, with the draws' uncertain values.

    Args:
        critical: The critical values.
        uncertain_values: Value of each uncertain number in each draw, shape (n,) each.
    """

    critical: CriticalValues
    uncertain_values: Arrays


class FirstViolated:
    """Record of the requirement that each of n draws violates at its failure nearest to the start of a walk.

    A search may try the values of the walk in any order, so a failure nearer to the start replaces a recorded one.
    ``requirement``, shape (n,), has the index of the violated requirement; the number of requirements for a draw that
    ended early; -1 for a draw without a failure so far. ``distance``, shape (n,), is the distance of the recorded
    failure from the start, in the unit of the walk; infinite without a failure.

    Args:
        draws: Number n of draws.
        start: The value at which the walk starts.
    """

    def __init__(self, draws: int, start: float) -> None:
        """Begin without a failure of any draw."""
        self.start = start
        self.requirement = np.full(draws, -1)
        self.distance = np.full(draws, np.inf)

    def record(self, draws: np.ndarray, values: np.ndarray, study: Study, results: Arrays) -> np.ndarray:
        """Record what some simulated draws violate, and return their signed slacks, shape (m,).

        Args:
            draws: Indices of the draws, shape (m,).
            values: The value of the walk at which each draw was simulated, shape (m,).
            study: The study, for its requirements.
            results: Results of these simulations by name, shape (m,) each.
        """
        requirements = study.requirements
        slack = worst_slack(requirements, results)
        distance = np.abs(values - self.start)
        violated = np.full(len(draws), len(requirements))  # without requirements, a failure is an early end
        if requirements:
            ended = ended_early(results["outcome"])
            violated = np.where(ended, violated, binding_requirement(requirements, results))
        nearer = (slack < 0.0) & (distance < self.distance[draws])
        self.requirement[draws[nearer]] = violated[nearer]
        self.distance[draws[nearer]] = distance[nearer]
        return slack


def join_critical(blocks: Sequence[CriticalValues]) -> CriticalValues:
    """Join the critical values of blocks of draws, in the order of the blocks.

    Either all blocks know ``first_violated``, or none does.
    """
    first_violated = [block.first_violated for block in blocks if block.first_violated is not None]
    return CriticalValues(
        value=np.concatenate([block.value for block in blocks]),
        censoring=np.concatenate([block.censoring for block in blocks]),
        non_monotone=np.concatenate([block.non_monotone for block in blocks]),
        slack=np.concatenate([block.slack for block in blocks], axis=1),  # of shape (points, draws)
        first_violated=np.concatenate(first_violated) if first_violated else None,
    )


def search_critical(slack_at: WalkSlack, draws: int, walk: Walk, bisections: int = BISECTIONS) -> CriticalValues:
    """Find the critical values of all draws at once: the last passing value before the first failure.

    Args:
        slack_at: (indices of draws, a value of the walk for each) -> signed slacks, negative where the draw fails.
        draws: Number of draws.
        walk: The walk to search.
        bisections: Number of bisections of the grid cell that contains the first failure.

    Returns:
        The critical values. A draw passes at its critical value, and fails at most one cell/2^bisections further along
        the walk. ``first_violated`` is None.
    """
    indices = np.arange(draws)
    slack = np.stack([slack_at(indices, np.full(draws, value)) for value in walk.grid])
    passes = slack >= 0.0
    first_failure = np.where(passes.all(axis=0), walk.points, np.argmin(passes, axis=0))  # index on the grid
    censoring = np.full(draws, Censoring.INSIDE)
    censoring[first_failure == 0] = Censoring.BEFORE
    censoring[first_failure == walk.points] = Censoring.BEYOND
    value = np.full(draws, np.nan)
    crossing_draws = np.flatnonzero(censoring == Censoring.INSIDE)

    def crossing_draws_pass(share: np.ndarray) -> np.ndarray:
        """Whether each draw whose first failure is within the walk passes at a share of the walk, shape (draws,)."""
        return slack_at(crossing_draws, walk.at(share)) >= 0.0

    if crossing_draws.size:
        cells = walk.points - 1
        safe = (first_failure[crossing_draws] - 1) / cells
        failing = first_failure[crossing_draws] / cells
        safe, _ = bisect(crossing_draws_pass, safe, failing, bisections)
        value[crossing_draws] = walk.at(safe)
    passes_again = passes & (np.arange(walk.points)[:, None] > first_failure)
    return CriticalValues(value, censoring, non_monotone=np.any(passes_again, axis=0), slack=slack)
