"""Conformal prediction of the next flight, and a test of a study against several flights; no law is assumed.

Each flight yields a number, by a formula that was fixed before the flights. If n + 1 flights are exchangeable, the
rank of the last number among all is uniform. So it is at most the k-th smallest of the others with a probability of at
least k/(n + 1) (V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a Random World (2005), chapter 2).

The test counts the flights whose number lies beyond a line, the k-th largest number of m draws. If the flights have
the law of the draws, the share of that law beyond the line has a beta law with parameters k and m + 1 - k, and the
number of flights beyond it is beta-binomial (S. S. Wilks, Annals of Mathematical Statistics 12 (1941) 91-96). This
holds for any continuous law; ties make the test more cautious.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson

TAIL_SHARE = 0.05
"""Share of the draws beyond the line."""
ROUNDING = 1e-9
"""Allowance for rounding errors, so that 0.9 * 10 counts as 9."""
MOST_FLIGHTS = 600
FEWEST_DRAWS = math.ceil(1.0 / TAIL_SHARE) - 1


def conformal_rank(flights: int, probability: float) -> int | None:
    """Rank k such that the k-th smallest of n flights' numbers bounds the next flight's number with a probability.

    Args:
        flights: Number n of flights so far.
        probability: Least probability that the next number is at most the k-th smallest, in (0, 1).

    Returns:
        k, from 1 to n; None if n flights are too few.

    Example:
        >>> conformal_rank(19, 0.95), conformal_rank(18, 0.95)
        (19, None)
    """
    rank = math.ceil(probability * (flights + 1) - ROUNDING)
    return rank if rank <= flights else None


def least_flights(probability: float) -> int:
    """Fewest flights whose largest number bounds the next flight's number with a probability.

    The largest of n numbers bounds it with the probability n/(n + 1), so n must be at least p/(1 - p).

    Args:
        probability: Probability p, in (0, 1).

    Example:
        >>> least_flights(0.9)
        9
    """
    return math.ceil(probability / (1.0 - probability) - ROUNDING)


def line_rank(draws: int) -> int:
    """Rank k of the line: on average at most :data:`TAIL_SHARE` of the law lies beyond the k-th largest draw."""
    return math.floor(TAIL_SHARE * (draws + 1) + ROUNDING)


def beyond_p_value(count: int, flights: int, draws: int) -> float:
    """P-value of the hypothesis that the flights have the law of the draws.

    The line is the :func:`line_rank`-th largest number of the draws. The p-value is the probability that at least
    ``count`` flights lie beyond the line.

    Args:
        count: Number of flights beyond the line.
        flights: Number of all flights.
        draws: Number of draws, at least :data:`FEWEST_DRAWS`.

    Raises:
        ValueError: There are too few draws.
    """
    rank = line_rank(draws)
    if rank < 1:
        raise ValueError(f"needs at least {FEWEST_DRAWS} draws, got {draws}")
    return float(count_probabilities(flights, np.arange(count, flights + 1), draws).sum())


def count_probabilities(flights: ArrayLike, counts: np.ndarray, draws: int) -> np.ndarray:
    """Beta-binomial probability that exactly x of n flights lie beyond the line; 0 where x > n.

    Args:
        flights: Number n of flights, any shape.
        counts: Number x of flights beyond the line, broadcastable.
        draws: Number of draws that give the line.
    """
    rank = line_rank(draws)
    flights_within = np.maximum(np.subtract(flights, counts), 0)
    log_probability = (
        -np.log(np.add(flights, 1.0))
        - special.betaln(counts + 1.0, flights_within + 1.0)  # with the line before: ln of the binomial coefficient
        + special.betaln(counts + rank, flights_within + draws + 1.0 - rank)
        - special.betaln(rank, draws + 1.0 - rank)
    )
    return np.where(counts <= np.asarray(flights), np.exp(log_probability), 0.0)


@lru_cache(maxsize=8)
def beyond_tails(draws: int) -> np.ndarray:
    """Table of the probability that at least x of n flights lie beyond the line.

    The rows are n = 1 .. :data:`MOST_FLIGHTS`, the columns x = 0 .. :data:`MOST_FLIGHTS` + 1.

    Args:
        draws: Number of draws that give the line.
    """
    flights = np.arange(1, MOST_FLIGHTS + 1)[:, None]
    probabilities = count_probabilities(flights, np.arange(MOST_FLIGHTS + 2)[None], draws)  # of exactly x
    sums_from_the_end = np.cumsum(probabilities[:, ::-1], axis=1)
    return sums_from_the_end[:, ::-1]


def flights_to_refute(share: float, draws: int, confidence: float = CONFIDENCE) -> int | None:
    """Fewest flights whose test likely refutes the study, if too many flights lie beyond the line.

    Args:
        share: True share of all flights beyond the line.
        draws: Number of draws that give the line.
        confidence: Confidence of the test, and probability that the test refutes.

    Returns:
        The number of flights; None if :data:`MOST_FLIGHTS` do not suffice.
    """
    flights = np.arange(1, MOST_FLIGHTS + 1)
    refuting_counts = np.argmax(beyond_tails(draws) <= 1.0 - confidence, axis=1)  # fewest flights that refute
    power = np.where(refuting_counts <= flights, special.bdtrc(refuting_counts - 1.0, flights, share), 0.0)
    return first_flights(power >= confidence)


def flights_to_confirm(share: float, draws: int, confidence: float = CONFIDENCE) -> int | None:
    """Fewest flights that likely bound the share of flights beyond the line, if the study is right.

    Args:
        share: Upper bound to show, above :data:`TAIL_SHARE`.
        draws: Number of draws that give the line.
        confidence: Confidence of the interval of the share, and probability that the interval ends below the bound.

    Returns:
        The number of flights; None if :data:`MOST_FLIGHTS` do not suffice.
    """
    flights = np.arange(1, MOST_FLIGHTS + 1)
    most_expected = np.argmax(beyond_tails(draws) <= 1.0 - confidence, axis=1) - 1  # flights beyond, if it is right
    intervals = clopper_pearson(np.minimum(most_expected, flights), flights, confidence)
    return first_flights(intervals[:, 1] <= share)


def first_flights(condition: np.ndarray) -> int | None:
    """Smallest number of flights that meets a condition; None if no number does.

    Args:
        condition: Whether each number 1, 2, ... of flights meets the condition, shape (:data:`MOST_FLIGHTS`,).
    """
    return int(np.argmax(condition)) + 1 if condition.any() else None
