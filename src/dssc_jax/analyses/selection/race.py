"""A race of candidates on common draws: those that are surely not among the best are simulated no more.

Let the best be the K candidates with the smallest failure probabilities. A candidate leaves the race when the draws are
evidence that K others fail less often. One of the best leaves only if the evidence is wrong for one of the others, so
that K N pairs matter out of N^2, whatever the race looks like. The race ends when the draws are evidence that each of
the K that failed least often fails at most ``within`` more often than each of the others that are left. If no evidence
on the best is wrong, each chosen candidate then fails at most ``within`` more often than any that was not chosen:
either all of the best are chosen, or the evidence compares the chosen ones with one of the best that is not.

Where K candidates hardly ever fail, nothing fails less often by more than that: a candidate whose failure probability
is surely less than ``within`` may be chosen without a look at the others.

The evidence holds at all numbers of draws at once (:func:`dssc_jax.statistics.log_evidence_of_less`), so the race may
look as often as it likes. A third of the error is spent on those that leave, a third on the end, and a third on those
that hardly ever fail.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dssc_jax.core.bisection import bisect
from dssc_jax.statistics import CONFIDENCE, log_evidence_of_less

FIRST = 24
"""Draws of each candidate before the first look."""
GROWTH = 1.3
"""Ratio of the draws at a look to those at the look before."""
HOPEFUL = 0.25
"""A candidate whose share of failures is larger than this share of ``within`` is not tried as rarely failing."""
TRIED = 4
"""Candidates that are tried as rarely failing, as a multiple of those to find."""
HALVINGS = 20  # bisections of the proved difference

Failing = Callable[[np.ndarray, slice], np.ndarray]
"""(candidates, draws) -> whether each candidate fails on each draw, shape (candidates, draws)."""


@dataclass(frozen=True)
class RaceResult:
    """The result of a race of N candidates.

    Args:
        chosen: Indices of the chosen candidates, the best first.
        draws: Number of draws of each candidate, shape (N,).
        failures: Number of failed draws of each candidate, shape (N,).
        within: With the confidence, each chosen candidate fails at most this much more often than any not chosen.
        remaining: Number of candidates that were still in the race at its end.
        simulations: Number of simulations.
    """

    chosen: np.ndarray
    draws: np.ndarray
    failures: np.ndarray
    within: float
    remaining: int
    simulations: int


class Tally:
    """Draws and failures of each candidate so far, and the number of simulations.

    Args:
        failing: (candidates, draws) -> whether each candidate fails on each draw.
        count: Number of candidates.
    """

    def __init__(self, failing: Failing, count: int) -> None:
        self.failing = failing
        self.draws = np.zeros(count, int)
        self.failures = np.zeros(count, int)
        self.simulations = 0

    def simulate(self, candidates: np.ndarray, draws: slice) -> np.ndarray:
        """Simulate candidates on draws: whether each fails on each, shape (candidates, draws)."""
        failed = self.failing(candidates, draws)
        self.simulations += failed.size
        return failed

    def extend(self, candidates: np.ndarray, goal: int) -> None:
        """Simulate candidates on further draws, until each has ``goal`` draws; before, all have equally many."""
        failed = self.simulate(candidates, slice(int(self.draws[candidates[0]]), goal))
        self.failures[candidates] += np.count_nonzero(failed, axis=1)
        self.draws[candidates] = goal


def race(failing: Failing, count: int, keep: int, within: float, most: int) -> RaceResult:
    """Find the K candidates that fail least often; the module tells how.

    Args:
        failing: (candidates, draws) -> whether each candidate fails on each draw.
        count: Number N of candidates.
        keep: Number K of those to find, less than ``count``.
        within: Difference of failure probabilities that does not matter, in (0, 1).
        most: Largest number of simulations; the last look may pass it by one growth.
    """
    evidence_threshold = math.log(3.0 * keep * count / (1.0 - CONFIDENCE))
    tally = Tally(failing, count)
    running = np.arange(count)
    failed = np.zeros((count, 0), bool)
    goal = FIRST
    while True:
        new_outcomes = tally.simulate(running, slice(failed.shape[1], goal))
        failed = np.concatenate([failed, new_outcomes], axis=1)
        tally.draws[running] = goal
        tally.failures[running] = failed.sum(axis=1)
        sole_failures = sole_failure_counts(failed)
        worse_than = log_evidence_of_less(sole_failures, sole_failures.T, goal, 0.0) >= evidence_threshold
        is_racing = worse_than.sum(axis=0) < keep
        running = running[is_racing]
        failed = failed[is_racing]
        sole_failures = sole_failures[np.ix_(is_racing, is_racing)]
        order = np.argsort(tally.failures[running], kind="stable")
        best = order[:keep]
        rivals = order[keep:]
        counts_against = (sole_failures[np.ix_(best, rivals)], sole_failures[np.ix_(rivals, best)].T, goal)
        winners = running[best]
        proved_within = within
        if rivals.size and not np.all(log_evidence_of_less(*counts_against, within) >= evidence_threshold):
            safe_candidates = rarely_failing(tally, running[order], keep, within, evidence_threshold)
            if safe_candidates is not None:
                winners = safe_candidates
            elif tally.simulations >= most:
                proved_within = proved_difference(counts_against, evidence_threshold)
            else:
                goal = math.ceil(GROWTH * goal)
                continue
        return RaceResult(
            chosen=winners,
            draws=tally.draws,
            failures=tally.failures,
            within=proved_within,
            remaining=len(running),
            simulations=tally.simulations,
        )


def rarely_failing(
    tally: Tally, order: np.ndarray, keep: int, within: float, evidence_threshold: float
) -> np.ndarray | None:
    """Find candidates whose failure probability is proved to be below ``within``, by further draws.

    Args:
        tally: Draws and failures of all candidates; updated.
        order: The candidates of the race, the best first; all have the same draws.
        keep: Number of candidates to find.
        within: Upper limit of the failure probability.
        evidence_threshold: Logarithm of the evidence that counts as a proof.

    Returns:
        ``keep`` candidates, the best first; None if there are not so many.
    """
    most = math.ceil(2.0 * evidence_threshold / within)  # about twice the draws that a proof takes without a failure
    proved_candidates: list[int] = []
    for begin in range(0, TRIED * keep, keep):
        contenders = order[begin : begin + keep]
        while True:
            failures = tally.failures[contenders]
            draws = tally.draws[contenders]
            is_proved = log_evidence_of_less(failures, 0, draws, within) >= evidence_threshold
            proved_candidates += contenders[is_proved].tolist()
            contenders = contenders[~is_proved & (failures <= HOPEFUL * within * draws) & (draws < most)]
            if not contenders.size:
                break
            tally.extend(contenders, 2 * int(tally.draws[contenders[0]]))
        if len(proved_candidates) >= keep:
            best = np.argsort(tally.failures[proved_candidates] / tally.draws[proved_candidates], kind="stable")
            return np.array(proved_candidates)[best[:keep]]
    return None


def sole_failure_counts(failed: np.ndarray) -> np.ndarray:
    """For each pair (i, j) the number of draws on which i fails and j does not, shape (N, N).

    Args:
        failed: Whether each candidate fails on each draw, shape (N, draws).
    """
    failures = failed.astype(np.float32)  # exact up to 2^24 draws
    return failures @ (1.0 - failures.T)


def proved_difference(counts_against: tuple[np.ndarray, np.ndarray, int], evidence_threshold: float) -> float:
    """The smallest difference of failure probabilities that is excluded for every pair of a winner and a rival.

    Args:
        counts_against: Draws on which the winner of a pair alone fails, shape (winners, rivals); those on which the
            rival alone fails, of the same shape; the number of draws.
        evidence_threshold: Logarithm of the evidence that counts as a proof.
    """

    def is_excluded(difference: np.ndarray) -> bool:
        evidence = log_evidence_of_less(*counts_against, float(difference))
        return bool(np.all(evidence >= evidence_threshold))

    smallest, _ = bisect(is_excluded, 1.0, 0.0, HALVINGS)
    return float(smallest)
