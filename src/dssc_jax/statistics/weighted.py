"""Probability of an event under another law than the draws have, from weighted independent draws."""

import numpy as np
from scipy import special

from dssc_jax.statistics.proportions import CONFIDENCE


def weighted_interval(
    weights: np.ndarray, draws: int, largest: float, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Interval of a probability from the importance weights of the draws in which the event happened.

    In the limit of rare events, the sum of the weights is a compound Poisson variable. A scaled chi-square variable
    with the same mean and variance approximates it. For the upper limit, an event of the largest weight is added. With
    equal weights the interval is the exact interval of a Poisson count.

    Args:
        weights: Density of the other law over the density of the draws' law, at each draw with the event, shape (k,).
        draws: Number n of all draws.
        largest: Largest weight of all draws, which a further event could have had.
        confidence: Coverage, in (0, 1).

    Returns:
        Lower and upper limit, within [0, 1].

    Reference:
        M. P. Fay, E. J. Feuer, Statistics in Medicine 16 (1997) 791-801.
    """
    tail = 0.5 * (1.0 - confidence)
    total = float(np.sum(weights))
    variance = float(np.sum(np.square(weights)))
    low = 0.0
    if total > 0.0:
        low = 0.5 * variance / total * float(special.chdtri(2.0 * total**2 / variance, 1.0 - tail))
    total_above = total + largest
    variance_above = variance + largest**2
    high = 0.5 * variance_above / total_above * float(special.chdtri(2.0 * total_above**2 / variance_above, tail))
    return low / draws, min(1.0, high / draws)


def effective_size(weights: np.ndarray) -> float:
    """Kish's effective sample size (sum w)^2 / sum w^2 of weights w: that many equal weights would be as precise.

    The size is 0 if there are no weights, or if all are 0.

    Args:
        weights: Weights >= 0, shape (n,).

    Reference:
        L. Kish, Survey Sampling (1965), section 11.7.
    """
    squares = float(np.sum(np.square(weights)))
    return float(np.sum(weights)) ** 2 / squares if squares else 0.0
