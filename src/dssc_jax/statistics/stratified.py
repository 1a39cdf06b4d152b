"""Interval of a failure probability from strata, and the numbers of draws that make it narrow.

References:
    G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures: a general approach", Statistics in
    Medicine 27 (2008) 1693-1702: squares of the distances of limits from estimates add up. J. Neyman, Journal of the
    Royal Statistical Society 97 (1934) 558-625: draws in proportion to weight and standard deviation.
"""

import numpy as np
from scipy import optimize, special

from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson

LEAST_DRAWS = 8  # of a stratum
MOST_DRAWS = 10**8


def stratified_interval(
    weights: np.ndarray, failures: np.ndarray, draws: np.ndarray, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Interval of sum_k W_k p_k.

    The limits of each stratum are exact (Clopper-Pearson), and those of the weights Student's t over the nets.

    Args:
        weights: Probability W_k of each stratum from each of R independent nets, shape (R, strata).
        failures: Failed draws of each stratum, shape (strata,).
        draws: Independent draws of each stratum, shape (strata,).
        confidence: Coverage, in (0, 1).

    Returns:
        Lower and upper limit, within [0, 1].
    """
    shares = failures / draws
    mean = weights.mean(axis=0)
    limits = clopper_pearson(failures, draws, confidence)
    below = np.sum(np.square(mean * (shares - limits[:, 0])))
    above = np.sum(np.square(mean * (limits[:, 1] - shares)))
    by_net = weights @ shares
    nets = len(by_net)
    half = special.stdtrit(nets - 1, 0.5 * (1.0 + confidence)) * by_net.std(ddof=1) / np.sqrt(nets)
    estimate = by_net.mean()
    return (
        float(max(0.0, estimate - np.sqrt(below + half**2))),
        float(min(1.0, estimate + np.sqrt(above + half**2))),
    )


def allocation(
    weights: np.ndarray, shares: np.ndarray, width: float, most: int, confidence: float = CONFIDENCE
) -> np.ndarray:
    """The fewest draws of each stratum with which an interval is expected to have a width.

    Args:
        weights: Probability of each stratum, shape (strata,).
        shares: Expected share of failures in each stratum, in (0, 1), shape (strata,).
        width: Upper minus lower limit.
        most: Largest number of all draws, which may leave the interval wider.
        confidence: Coverage, in (0, 1).

    Returns:
        Whole numbers, shape (strata,).
    """
    numbers = np.unique(np.geomspace(LEAST_DRAWS, MOST_DRAWS, 400).round())
    limits = clopper_pearson(shares[:, None] * numbers, numbers, confidence)
    below = np.square(weights[:, None] * (shares[:, None] - limits[..., 0]))
    above = np.square(weights[:, None] * (limits[..., 1] - shares[:, None]))
    rows = np.arange(len(weights))

    def best(logarithm: float) -> np.ndarray:
        return np.argmin(numbers + np.exp(logarithm) * (below + above), axis=1)

    def excess(logarithm: float) -> float:
        chosen = best(logarithm)
        length = np.sqrt(below[rows, chosen].sum()) + np.sqrt(above[rows, chosen].sum())
        total = numbers[chosen].sum()
        return 1.0 if length > width and total < most else -1.0

    found = optimize.root_scalar(excess, bracket=(-20.0, 80.0), method="bisect", xtol=1e-3).root
    return numbers[best(found)].astype(int)
