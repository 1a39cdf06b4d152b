"""Sets for the next of several exchangeable flights, and a test of the study that describes them, without any law.

Each flight has a number that is computed in a way fixed before the flights. If n + 1 flights are exchangeable, the rank
of the last number among all is uniform, so that it is not above the k-th smallest of the others with a probability of
at least k/(n + 1) (V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a Random World (2005), chapter 2).

If the flights have the law of m draws, the share of the law beyond the k-th largest draw has a beta law with parameters
k and m + 1 - k, and the number of flights beyond is beta-binomial (S. S. Wilks, Annals of Mathematical Statistics 12
(1941) 91-96). This holds for any continuous law; ties make the test more cautious.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson

BEYOND = 0.05
"""Share of the draws beyond the line that flights are compared with."""
ROUNDING = 1e-9
"""Subtracted before rounding up, so that 0.9 * 10 counts as 9."""
MOST_FLIGHTS = 600
FEWEST_DRAWS = math.ceil(1.0 / BEYOND) - 1


def conformal_rank(flights: int, probability: float) -> int | None:
    """The rank k of the number that the next flight's does not exceed with this probability; None: too few flights.

    Args:
        flights: n, number of flights.
        probability: In (0, 1).

    Example:
        >>> conformal_rank(19, 0.95), conformal_rank(18, 0.95)
        (19, None)
    """
    rank = math.ceil(probability * (flights + 1) - ROUNDING)
    return rank if rank <= flights else None


def least_flights(probability: float) -> int:
    """The fewest flights n of which the largest number bounds the next one's with this probability.

    The largest does so with a probability of n/(n + 1), so n is at least p/(1 - p).

    Args:
        probability: p, in (0, 1).

    Example:
        >>> least_flights(0.9)
        9
    """
    return math.ceil(probability / (1.0 - probability) - ROUNDING)


def line_rank(draws: int) -> int:
    """The rank, from the largest on, of the draw beyond which :data:`BEYOND` of the draws lie at most."""
    return math.floor(BEYOND * (draws + 1) + 1e-9)


def beyond_p_value(beyond: int, flights: int, draws: int) -> float:
    """p-value of the test that the flights have the draws' law.

    It is the probability that at least ``beyond`` of such flights exceed the draws' line. The line is the
    :func:`line_rank`-th largest number of the draws.

    Args:
        beyond: Flights beyond the line.
        flights: Number of flights.
        draws: Number of draws, at least :data:`FEWEST_DRAWS`.

    Raises:
        ValueError: There are too few draws.
    """
    rank = line_rank(draws)
    if rank < 1:
        raise ValueError(f"needs at least {FEWEST_DRAWS} draws, got {draws}")
    return float(beyond_masses(flights, np.arange(beyond, flights + 1), draws).sum())


def beyond_masses(flights: ArrayLike, beyond: np.ndarray, draws: int) -> np.ndarray:
    """The beta-binomial probability that of n flights x are beyond the draws' line; 0 for more than n of them.

    Args:
        flights: n.
        beyond: x, shape (...); broadcasts with ``flights``.
        draws: Number of draws.
    """
    rank = line_rank(draws)
    within = np.maximum(np.subtract(flights, beyond), 0)
    logarithm = (
        -np.log(np.add(flights, 1.0))
        - special.betaln(beyond + 1.0, within + 1.0)
        + special.betaln(beyond + rank, within + draws + 1.0 - rank)
        - special.betaln(rank, draws + 1.0 - rank)
    )
    return np.where(beyond <= np.asarray(flights), np.exp(logarithm), 0.0)


@lru_cache(maxsize=8)
def beyond_tails(draws: int) -> np.ndarray:
    """Probability that at least x of n flights are beyond the draws' line, for n = 1 .. and x = 0 ..; shape (n, x)."""
    flights = np.arange(1, MOST_FLIGHTS + 1)[:, None]
    masses = beyond_masses(flights, np.arange(MOST_FLIGHTS + 2)[None], draws)
    return np.cumsum(masses[:, ::-1], axis=1)[:, ::-1]


def flights_to_refute(share: float, draws: int, confidence: float = CONFIDENCE) -> int | None:
    """The fewest flights that refute the study, with this probability, if a share of all flights is beyond the line.

    Args:
        share: Share of all flights that is beyond the line.
        draws: Number of draws that give the line.
        confidence: Confidence of the test, and probability that it refutes.

    Returns:
        None if :data:`MOST_FLIGHTS` do not suffice.
    """
    flights = np.arange(1, MOST_FLIGHTS + 1)
    critical = np.argmax(beyond_tails(draws) <= 1.0 - confidence, axis=1)
    power = np.where(critical <= flights, special.bdtrc(critical - 1.0, flights, share), 0.0)
    return fewest(power >= confidence)


def flights_to_confirm(share: float, draws: int, confidence: float = CONFIDENCE) -> int | None:
    """The fewest flights that show that less than a share is beyond the line, likely if the study is right.

    Args:
        share: The share, above :data:`BEYOND`.
        draws: Number of draws that give the line.
        confidence: Confidence of the interval, and probability that it ends below the share.

    Returns:
        None if :data:`MOST_FLIGHTS` do not suffice.
    """
    flights = np.arange(1, MOST_FLIGHTS + 1)
    likely = np.argmax(beyond_tails(draws) <= 1.0 - confidence, axis=1) - 1  # no more with the confidence
    high = clopper_pearson(np.minimum(likely, flights), flights, confidence)[:, 1]
    return fewest(high <= share)


def fewest(holds: np.ndarray) -> int | None:
    """The smallest number of flights for which a condition holds; None if none does."""
    return int(np.argmax(holds)) + 1 if holds.any() else None
