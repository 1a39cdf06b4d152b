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
    """Value of the information in which part of its law a number lies.

    Args:
        parts: Number B of parts; fewer if few draws failed.
        removed: Share of the variance of "fails or not" that the information removes; the estimate may be negative.
        removed_interval: Interval of ``removed``.
        changes: Probability that the information changes the decision: that the failure probability of the part lies on
            the other side of the limit than that of all draws.
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
    """Estimate the value of the information in which part of its law a number lies.

    The interval of the removed share is Student's t, with B - 1 degrees of freedom and the variance of a mean over
    pairs. The interval of the probability of another decision counts the parts that certainly, or possibly, lie on the
    other side of the limit, by exact intervals that hold for all parts together.

    Args:
        levels: Level of the number in its law in each draw, in (0, 1), shape (n,).
        failed: Whether each draw failed, shape (n,).
        limit: Largest failure probability allowed.
        confidence: Coverage, in (0, 1).

    Returns:
        None if fewer than 2 :data:`LEAST_IN_PART` draws failed.
    """
    failures = int(np.count_nonzero(failed))
    parts = min(MOST_PARTS, failures // LEAST_IN_PART)
    if parts < 2:
        return None
    part_of_draw = np.minimum((levels * parts).astype(int), parts - 1)
    counts = np.bincount(part_of_draw[failed], minlength=parts)
    sizes = np.bincount(part_of_draw, minlength=parts)
    removed, interval = removed_share(counts, len(failed), confidence)
    passes = failures <= limit * len(failed)
    intervals = clopper_pearson(counts, np.maximum(sizes, 1), 1.0 - (1.0 - confidence) / parts)
    exceeds = counts > limit * sizes
    surely_above = intervals[:, 0] > limit
    possibly_above = intervals[:, 1] > limit
    if passes:
        shares = exceeds.mean(), surely_above.mean(), possibly_above.mean()
    else:
        shares = (~exceeds).mean(), (~possibly_above).mean(), (~surely_above).mean()
    changes, low, high = map(float, shares)
    return PartInformation(parts, removed, interval, changes, (low, high))


def removed_share(counts: np.ndarray, draws: int, confidence: float) -> tuple[float, tuple[float, float]]:
    """Share of the variance of "fails or not" that the information removes, and its interval.

    Args:
        counts: Number of failed draws in each part, shape (B,).
        draws: Number of all draws.
        confidence: Coverage, in (0, 1).

    Reference:
        W. Hoeffding, Annals of Mathematical Statistics 19 (1948) 293-325: the variance of means over pairs.
    """
    parts = len(counts)
    failures = int(counts.sum())
    pairs = failures * (failures - 1.0)
    same_part = float(np.sum(counts * (counts - 1.0))) / pairs
    shares = counts / failures
    second = float(np.sum(shares**2))
    third = float(np.sum(shares**3))
    variance = (2.0 * (second - second**2) + 4.0 * (failures - 2.0) * (third - second**2)) / pairs
    odds = failures / max(draws - failures, 1)
    share_removed = odds * (parts * same_part - 1.0)
    spread = np.hypot(odds * parts * np.sqrt(variance), share_removed / np.sqrt(failures))
    reach = float(special.stdtrit(parts - 1, 0.5 * (1.0 + confidence)) * spread)
    return share_removed, (share_removed - reach, share_removed + reach)
