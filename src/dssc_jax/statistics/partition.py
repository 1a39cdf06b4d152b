"""Value of the information in which part of its law a number lies, from the draws that failed.

The law of a number is divided into B parts of equal probability. If a draw fails, its number lies in part b with the
probability q_b, and the failure probability within part b is p_b = B p q_b. Knowledge of the part removes the share

    Var(p_b) / (p (1 - p)) = (B sum q_b^2 - 1) p / (1 - p)

of the variance of "fails or not". The sum is the probability that two failed draws lie in the same part, which pairs of
failed draws estimate without bias.
"""

from typing import NamedTuple

import numpy as np
from scipy import special

from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson

MOST_PARTS = 10
LEAST_IN_PART = 5
"""Least mean number of failed draws in a part."""


class PartInformation(NamedTuple):
    """The value of knowing in which part of its law a number lies.

    Args:
        parts: Number B of parts of equal probability; it is smaller if few draws failed.
        removed: Share of the variance of "fails or not" that the information removes; the estimate may be negative.
        removed_interval: Interval of ``removed``.
        changes: Probability that the information changes the decision: the failure probability within the part is on
            the other side of the limit than the failure probability of all draws.
        changes_interval: Interval of ``changes``.
    """

    parts: int
    removed: float
    removed_interval: tuple[float, float]
    changes: float
    changes_interval: tuple[float, float]


def part_information(
    levels: np.ndarray, failed: np.ndarray, limit: float, confidence: float = CONFIDENCE
) -> PartInformation | None:
    """Estimate the value of knowing in which part of its law a number lies.

    The interval of the removed share is Student's t, with B - 1 degrees of freedom and the variance of a mean over
    pairs. The interval of the probability of another decision follows from exact intervals that hold for all parts
    together.

    Args:
        levels: Level of the number in its law in each draw, in (0, 1), shape (n,).
        failed: Whether each draw failed, shape (n,).
        limit: Largest failure probability allowed.
        confidence: Coverage, in (0, 1).

    Returns:
        The information; None if fewer than 2 :data:`LEAST_IN_PART` draws failed.
    """
    failures = int(np.count_nonzero(failed))
    parts = min(MOST_PARTS, failures // LEAST_IN_PART)
    if parts < 2:
        return None
    part_of_draw = np.minimum((levels * parts).astype(int), parts - 1)
    failures_in_parts = np.bincount(part_of_draw[failed], minlength=parts)
    draws_in_parts = np.bincount(part_of_draw, minlength=parts)
    removed, removed_interval = removed_share(failures_in_parts, len(failed), confidence)
    changes, changes_interval = changing_share(failures_in_parts, draws_in_parts, limit, confidence)
    return PartInformation(parts, removed, removed_interval, changes, changes_interval)


def changing_share(
    failures: np.ndarray, draws: np.ndarray, limit: float, confidence: float
) -> tuple[float, tuple[float, float]]:
    """Share of the parts that change the decision, and its interval.

    A part changes the decision if its failure probability and that of all draws lie on different sides of the limit.
    The lower end of the interval counts the parts that certainly change it, and the upper end those that possibly
    change it.

    Args:
        failures: Number of failed draws in each part, shape (B,).
        draws: Number of draws in each part, shape (B,).
        limit: Largest failure probability allowed.
        confidence: Coverage for all parts together, in (0, 1).
    """
    intervals = clopper_pearson(failures, np.maximum(draws, 1), 1.0 - (1.0 - confidence) / len(failures))
    is_above = failures > limit * draws
    surely_above = intervals[:, 0] > limit
    possibly_above = intervals[:, 1] > limit
    decision_is_below = failures.sum() <= limit * draws.sum()
    if decision_is_below:
        return float(is_above.mean()), (float(surely_above.mean()), float(possibly_above.mean()))
    return float((~is_above).mean()), (float((~possibly_above).mean()), float((~surely_above).mean()))


def removed_share(counts: np.ndarray, draws: int, confidence: float) -> tuple[float, tuple[float, float]]:
    """Share of the variance of "fails or not" that knowledge of a number's part removes, and its interval.

    The share is (B sum q_b^2 - 1) p/(1 - p), as the module's text derives. The sum is the probability that two failed
    draws lie in the same part, estimated by the share of the pairs of failed draws that do.

    Args:
        counts: Number of failed draws in each part, shape (B,).
        draws: Number of all draws.
        confidence: Coverage, in (0, 1).

    Reference:
        W. Hoeffding, Annals of Mathematical Statistics 19 (1948) 293-325: the variance of means over pairs.
    """
    parts = len(counts)
    failures = int(counts.sum())
    ordered_pairs = failures * (failures - 1.0)
    same_part = float(np.sum(counts * (counts - 1.0))) / ordered_pairs
    q = counts / failures  # q_b: share of the failed draws in each part
    squares = float(np.sum(q**2))
    cubes = float(np.sum(q**3))
    # of the share of pairs, by Hoeffding
    variance = (2.0 * (squares - squares**2) + 4.0 * (failures - 2.0) * (cubes - squares**2)) / ordered_pairs
    odds = failures / max(draws - failures, 1)  # p/(1 - p)
    share = odds * (parts * same_part - 1.0)
    deviation = np.hypot(odds * parts * np.sqrt(variance), share / np.sqrt(failures))  # of the pairs, and of the odds
    half = float(special.stdtrit(parts - 1, 0.5 * (1.0 + confidence)) * deviation)
    return share, (share - half, share + half)
