"""A race of N candidates on common draws: a candidate that is surely not among the best K is simulated no more.

Let the best be the K candidates with the smallest failure probabilities. A candidate leaves the race when the draws are
evidence that K others fail less often. One of the best leaves only if the evidence is wrong for one of the others, so
that K N pairs matter out of N^2, whatever the race looks like. The race ends when the draws are evidence that each of
the K that failed least often fails at most ``within`` more often than each of the others that are left. If no evidence
on the best is wrong, each chosen candidate then fails at most ``within`` more often than any that was not chosen:
either all of the best are chosen, or the evidence compares the chosen candidates with one of the best that is not.

If K candidates hardly ever fail, a comparison with the others is not needed: nothing fails less often than never. So a
candidate whose failure probability is proved to be less than ``within`` may be chosen without a look at the others.

The evidence holds at all numbers of draws at once (:func:`dssc_jax.statistics.log_evidence_of_less`), so the race may
look as often as it likes. A third of the error is spent on candidates that leave, a third on the end, and a third on
candidates that hardly ever fail.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dssc_jax.core.bisection import bisect
from dssc_jax.statistics import CONFIDENCE, log_evidence_of_less

FIRST = 24
"""Draws of each candidate before the first look."""
GROWTH = 1.3
"""Ratio of the draws at a look to the draws at the look before."""
HOPEFUL = 0.25
"""A candidate whose share of failures is larger than this share of ``within`` is not tried as rarely failing."""
TRIED = 4
"""Candidates that are tried as rarely failing, as a multiple of the number to find."""
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
        within: Largest difference of failure probabilities: each chosen candidate fails at most this much more often
            than any candidate not chosen, with confidence.
        remaining: Number of candidates that were still in the race at its end.
        simulations: Number of simulations.
    """

    chosen: np.ndarray
    draws: np.ndarray
    failures: np.ndarray
    within: float
    remaining: int
    simulations: int


class PairedFailures(NamedTuple):
    """Numbers of draws on which only one candidate of a pair fails, for pairs of n first and m second candidates.

    Args:
        first_alone: Number of draws on which only the first candidate fails, shape (n, m).
        second_alone: Number of draws on which only the second candidate fails, shape (n, m).
        draws: Number of draws of each candidate.
    """

    first_alone: np.ndarray
    second_alone: np.ndarray
    draws: int

    def all_within(self, difference: float, evidence_threshold: float) -> bool:
        """Whether each first candidate is proved to fail at most ``difference`` more often than each second one.

        Args:
            difference: Difference of failure probabilities.
            evidence_threshold: Logarithm of the evidence that counts as a proof.
        """
        evidence = log_evidence_of_less(self.first_alone, self.second_alone, self.draws, difference)
        return bool(np.all(evidence >= evidence_threshold))

    def proved_difference(self, evidence_threshold: float) -> float:
        """The smallest difference of failure probabilities for which :meth:`all_within` holds, by bisection in [0, 1].

        Args:
            evidence_threshold: Logarithm of the evidence that counts as a proof.
        """
        smallest, _ = bisect(
            lambda difference: self.all_within(float(difference), evidence_threshold),
            inside=1.0,
            outside=0.0,
            halvings=HALVINGS,
        )
        return float(smallest)


class Tally:
    """Draws and failures of each candidate so far, and the number of simulations.

    Args:
        failing: (candidates, draws) -> whether each candidate fails on each draw.
        count: Number of candidates.
    """

    def __init__(self, failing: Failing, count: int) -> None:
        """Start with 0 draws, failures and simulations."""
        self.failing = failing
        self.draws = np.zeros(count, int)
        self.failures = np.zeros(count, int)
        self.simulations = 0

    def simulate(self, candidates: np.ndarray, draws: slice) -> np.ndarray:
        """Simulate candidates, and return whether each fails on each draw, shape (candidates, draws).

        Only the number of simulations is counted here; the caller counts draws and failures.
        """
        failed = self.failing(candidates, draws)
        self.simulations += failed.size
        return failed

    def extend(self, candidates: np.ndarray, goal: int) -> None:
        """Simulate candidates on further draws until each has ``goal`` draws, and count draws and failures.

        Args:
            candidates: Indices of candidates that all have the same number of draws so far.
            goal: Number of draws that each has afterwards.
        """
        done = int(self.draws[candidates[0]])
        failed = self.simulate(candidates, slice(done, goal))
        self.failures[candidates] += np.count_nonzero(failed, axis=1)
        self.draws[candidates] = goal


def race(failing: Failing, count: int, keep: int, within: float, most_simulations: int) -> RaceResult:
    """Find the K candidates that fail least often, by ever more draws of the candidates in the race.

    After each look at the draws, a candidate leaves if K others are proved to be better. The race ends when the K best
    so far are proved to fail at most ``within`` more often than the others; or when K candidates are proved to have a
    failure probability below ``within``; or when the simulations are used up.

    Args:
        failing: (candidates, draws) -> whether each candidate fails on each draw.
        count: Number N of candidates.
        keep: Number K of candidates to find, less than ``count``.
        within: Difference of failure probabilities that does not matter, in (0, 1).
        most_simulations: Number of simulations after which the race ends; the last look may exceed it.
    """
    evidence_threshold = math.log(3.0 * keep * count / (1.0 - CONFIDENCE))  # for K N pairs and a third of the error
    tally = Tally(failing, count)
    running = np.arange(count)  # the candidates in the race
    failed = np.zeros((count, 0), bool)  # shape (running, draws)
    goal = FIRST
    while True:
        new_outcomes = tally.simulate(running, slice(failed.shape[1], goal))
        failed = np.concatenate([failed, new_outcomes], axis=1)
        tally.draws[running] = goal
        tally.failures[running] = failed.sum(axis=1)
        alone = sole_failure_counts(failed)
        # entry i, j: candidate i is proved to fail less often than candidate j
        is_better = log_evidence_of_less(alone, alone.T, goal, 0.0) >= evidence_threshold
        is_racing = is_better.sum(axis=0) < keep
        running = running[is_racing]
        failed = failed[is_racing]
        alone = alone[np.ix_(is_racing, is_racing)]
        order = np.argsort(tally.failures[running], kind="stable")
        best = order[:keep]
        rivals = order[keep:]
        pairs = PairedFailures(alone[np.ix_(best, rivals)], alone[np.ix_(rivals, best)].T, goal)
        winners = running[best]
        proved_within = within
        if rivals.size and not pairs.all_within(within, evidence_threshold):
            safe_candidates = rarely_failing(tally, running[order], keep, within, evidence_threshold)
            if safe_candidates is not None:
                winners = safe_candidates
            elif tally.simulations >= most_simulations:
                proved_within = pairs.proved_difference(evidence_threshold)
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

    Batches of ``keep`` candidates are tried, the most promising first. The draws of a candidate are doubled until the
    proof succeeds, the candidate fails too often for a proof to be likely, or it has as many draws as a proof may take.

    Args:
        tally: Draws and failures of all candidates; updated.
        order: The candidates of the race, the best first; all have the same draws.
        keep: Number of candidates to find.
        within: Upper limit of the failure probability.
        evidence_threshold: Logarithm of the evidence that counts as a proof.

    Returns:
        Indices of ``keep`` candidates, the best first; None if fewer were found.
    """
    # about twice the draws that a proof takes without a failure
    most_draws = math.ceil(2.0 * evidence_threshold / within)
    proved_candidates: list[int] = []
    for begin in range(0, TRIED * keep, keep):
        contenders = order[begin : begin + keep]
        while True:
            failures = tally.failures[contenders]
            draws = tally.draws[contenders]
            is_proved = log_evidence_of_less(failures, 0, draws, within) >= evidence_threshold
            proved_candidates += contenders[is_proved].tolist()
            is_hopeful = failures <= HOPEFUL * within * draws
            contenders = contenders[~is_proved & is_hopeful & (draws < most_draws)]
            if not contenders.size:
                break
            tally.extend(contenders, 2 * int(tally.draws[contenders[0]]))
        if len(proved_candidates) >= keep:
            shares = tally.failures[proved_candidates] / tally.draws[proved_candidates]
            best = np.argsort(shares, kind="stable")[:keep]
            return np.array(proved_candidates)[best]
    return None


def sole_failure_counts(failed: np.ndarray) -> np.ndarray:
    """For each pair (i, j), the number of draws on which candidate i fails and candidate j does not, shape (N, N).

    Args:
        failed: Whether each candidate fails on each draw, shape (N, draws).
    """
    failures = failed.astype(np.float32)  # exact up to 2^24 draws
    return failures @ (1.0 - failures.T)
