"""Paired comparison of two systems on the same independent draws."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from dssc_jax.statistics.order import quantile_interval
from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson

STAKES = np.geomspace(0.003, 0.97, 16)
"""Stakes of the bets, as shares of the largest possible stake."""
DISCORDANCE = 0.2  # share of the error for how often the two systems differ; the remainder is for which of them fails


class FailureDifference(NamedTuple):
    """Difference P(a fails) - P(b fails) of two systems a and b, estimated on the same draws.

    Args:
        only_a: Number of draws on which a alone failed.
        only_b: Number of draws on which b alone failed.
        draws: Number of all draws.
        difference: Estimate (only_a - only_b)/draws.
        interval: Two-sided interval of the difference.
        p_value: P-value of the exact McNemar test of the hypothesis that both fail equally often.
    """

    only_a: int
    only_b: int
    draws: int
    difference: float
    interval: tuple[float, float]
    p_value: float


class MetricDifference(NamedTuple):
    """Quantile of the difference of a metric between two systems, a minus b, on the same draws.

    Args:
        level: Level of the quantile; 1/2 is the median.
        difference: Estimate of the quantile, an order statistic.
        interval: Order-statistic interval of the quantile.
        only_a: Number of draws on which only a has no value; such a difference counts as +inf.
        only_b: Number of draws on which only b has no value; such a difference counts as -inf.
        neither: Number of draws on which neither has a value; such a difference counts as 0.
    """

    level: float
    difference: float
    interval: tuple[float, float]
    only_a: int
    only_b: int
    neither: int


def mcnemar(only_a: int, only_b: int) -> float:
    """Two-sided p-value of the exact McNemar test of the hypothesis that two systems fail equally often.

    A draw is discordant if exactly one of the systems fails. Under the hypothesis, discordant draws are fair coin
    tosses.

    Args:
        only_a: Number of draws on which a alone failed.
        only_b: Number of draws on which b alone failed.

    Raises:
        ValueError: A count is negative.

    Example:
        >>> mcnemar(1, 9)
        0.021484375

    Reference:
        Q. McNemar, Psychometrika 12 (1947) 153-157, with the binomial law instead of the normal law.
    """
    if min(only_a, only_b) < 0:
        raise ValueError(f"counts must not be negative, got {only_a} and {only_b}")
    if only_a == only_b:
        return 1.0
    return float(min(1.0, 2.0 * special.bdtr(min(only_a, only_b), only_a + only_b, 0.5)))


def difference_interval(
    only_a: ArrayLike, only_b: ArrayLike, draws: ArrayLike, confidence: float = CONFIDENCE
) -> np.ndarray:
    """Interval of P(a fails) - P(b fails) from paired draws; its coverage is at least ``confidence``, for every n.

    A draw is discordant if exactly one of the two systems fails. The difference is theta (2 pi - 1). Here theta is the
    probability of a discordant draw, and pi is the probability that in such a draw system a fails. Both get exact
    (Clopper-Pearson) intervals, that of pi conditional on the number of discordant draws. Together the intervals err
    with a probability of at most 1 - confidence (Bonferroni). If the two systems hardly differ, pi matters most, so it
    receives the larger share of the error.

    Args:
        only_a: Number of draws on which a alone failed, any shape.
        only_b: Number of draws on which b alone failed, broadcastable.
        draws: Number of all draws, broadcastable.
        confidence: Coverage, in (0, 1).

    Returns:
        Shape (..., 2): lower and upper bound, in [-1, 1].

    Raises:
        ValueError: The counts are inconsistent.

    Example:
        >>> difference_interval(30, 10, 1000).round(4)
        array([0.0042, 0.0444])
    """
    a, b, n = np.broadcast_arrays(np.asarray(only_a), np.asarray(only_b), np.asarray(draws))
    if np.any(a < 0) or np.any(b < 0) or np.any(a + b > n):
        raise ValueError(f"needs only_a, only_b >= 0 and only_a + only_b <= draws, got {only_a}, {only_b}, {draws}")
    error = 1.0 - confidence
    discordant = a + b
    theta = clopper_pearson(discordant, n, 1.0 - DISCORDANCE * error)
    pi = clopper_pearson(a, np.maximum(discordant, 1), 1.0 - (1.0 - DISCORDANCE) * error)
    pi = np.where((discordant == 0)[..., None], [0.0, 1.0], pi)  # nothing is known of pi
    theta_low = theta[..., 0]
    theta_high = theta[..., 1]
    balance = 2.0 * pi - 1.0  # interval of the difference in a discordant draw
    balance_low = balance[..., 0]
    balance_high = balance[..., 1]
    low = np.where(balance_low >= 0.0, theta_low, theta_high) * balance_low  # the smallest product
    high = np.where(balance_high >= 0.0, theta_high, theta_low) * balance_high
    return np.stack([low, high], axis=-1)


def compare_failures(failed_a: np.ndarray, failed_b: np.ndarray, confidence: float = CONFIDENCE) -> FailureDifference:
    """Difference of the failure probabilities of two systems on the same independent draws, with interval and p-value.

    Args:
        failed_a: Whether a failed on each draw, shape (n,).
        failed_b: Whether b failed on each draw, shape (n,).
        confidence: Coverage of the interval.

    Raises:
        ValueError: The shapes differ.
    """
    if failed_a.shape != failed_b.shape:
        raise ValueError(f"paired draws have one shape, got {failed_a.shape} and {failed_b.shape}")
    only_a = int(np.count_nonzero(failed_a & ~failed_b))
    only_b = int(np.count_nonzero(failed_b & ~failed_a))
    draws = failed_a.size
    low, high = difference_interval(only_a, only_b, draws, confidence).tolist()
    return FailureDifference(
        only_a=only_a,
        only_b=only_b,
        draws=draws,
        difference=(only_a - only_b) / draws,
        interval=(low, high),
        p_value=mcnemar(only_a, only_b),
    )


def compare_metrics(
    a: np.ndarray, b: np.ndarray, level: float = 0.5, confidence: float = CONFIDENCE
) -> MetricDifference:
    """Quantile of the difference a - b of a metric of two systems on the same independent draws, with its interval.

    No draw is dropped. A draw that ended early has no value, and counts as infinitely worse than any value; if neither
    system has a value, they tie. Order statistics handle infinite values and any law. A mean with Student's t handles
    neither.

    Args:
        a: The metric under a, shape (n,); NaN if the draw has no value. Smaller values are better.
        b: The metric under b, shape (n,); NaN if the draw has no value.
        level: Level of the quantile, in (0, 1).
        confidence: Coverage of the interval.

    Raises:
        ValueError: The shapes differ, or level or confidence is outside (0, 1).
    """
    if a.shape != b.shape:
        raise ValueError(f"paired draws have one shape, got {a.shape} and {b.shape}")
    missing_a = ~np.isfinite(a)
    missing_b = ~np.isfinite(b)
    difference = np.where(missing_a, np.inf, a) - np.where(missing_b, 0.0, b)
    difference[missing_b] = -np.inf
    difference[missing_a & missing_b] = 0.0
    return MetricDifference(
        level=level,
        difference=float(np.quantile(difference, level, method="inverted_cdf")),
        interval=quantile_interval(difference, level, confidence),
        only_a=int(np.count_nonzero(missing_a & ~missing_b)),
        only_b=int(np.count_nonzero(missing_b & ~missing_a)),
        neither=int(np.count_nonzero(missing_a & missing_b)),
    )


def log_evidence_of_less(only_a: ArrayLike, only_b: ArrayLike, draws: ArrayLike, margin: float) -> np.ndarray:
    """Logarithm of the evidence that P(a fails) - P(b fails) is less than a margin, from paired draws.

    The evidence is the capital of a gambler who begins with 1 and bets that the difference is less than the margin.
    With a stake s, a draw multiplies the capital by 1 - s (1 - margin) if a alone fails, by 1 + s (1 + margin) if b
    alone fails, and by 1 + s margin otherwise. The result is the mean capital over the stakes :data:`STAKES`. If the
    difference is at least ``margin``, the capital is a supermartingale, so it ever exceeds 1/e with a probability of at
    most e (Ville), however often it is computed.

    Args:
        only_a: Number of draws on which a alone failed, any shape.
        only_b: Number of draws on which b alone failed, broadcastable.
        draws: Number of all draws, broadcastable.
        margin: Margin of the difference, in [0, 1).

    Returns:
        Shape of the broadcast arguments.

    Raises:
        ValueError: The margin is out of range.

    Example:
        >>> float(log_evidence_of_less(0, 40, 1000, 0.0).round(2))
        24.35

    Reference:
        I. Waudby-Smith, A. Ramdas, "Estimating means of bounded random variables by betting", J. Royal Statistical
        Society B 86 (2024) 1-27.
    """
    if not 0.0 <= margin < 1.0:
        raise ValueError(f"margin must be in [0, 1), got {margin}")
    a, b, n = np.broadcast_arrays(np.asarray(only_a, float), np.asarray(only_b, float), np.asarray(draws, float))
    log_sum = np.full(a.shape, -np.inf)  # logarithm of the sum of the capitals
    for stake in STAKES / (1.0 - margin):  # at the largest stake, the capital is lost if a alone fails
        discordant_gain = a * np.log1p(-stake * (1.0 - margin)) + b * np.log1p(stake * (1.0 + margin))
        log_capital = discordant_gain + (n - a - b) * np.log1p(stake * margin)
        log_sum = np.logaddexp(log_sum, log_capital)
    return log_sum - np.log(len(STAKES))
