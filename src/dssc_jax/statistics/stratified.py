"""Interval of a failure probability from strata, and the numbers of draws that make it narrow.

References:
    G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures: a general approach", Statistics in
    Medicine 27 (2008) 1693-1702: squares of the distances of limits from estimates add up. J. Neyman, Journal of the
    Royal Statistical Society 97 (1934) 558-625: draws in proportion to weight and standard deviation.
"""

import numpy as np
from scipy import optimize, special

from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson
from dssc_jax.statistics.weighted import weighted_interval

DENSE = 10  # failures and passes of a stratum with limits of its own
LEAST_DRAWS = 8  # of a stratum
MOST_DRAWS = 10**8


def stratified_interval(
    weights: np.ndarray, failures: np.ndarray, draws: np.ndarray, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Interval of sum_k W_k p_k.

    A stratum with at least ``DENSE`` failures and passes has exact limits (Clopper-Pearson). The failures of all other
    strata are weighted rare events, whose limits are those of their sum (Fay and Feuer); so are the passes where passes
    are rare. The limits of the weights are Student's t over the nets.

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
    passes = draws - failures
    dense = np.minimum(failures, passes) >= DENSE
    limits = clopper_pearson(failures[dense], draws[dense], confidence)
    below = np.sum(np.square(mean[dense] * (shares[dense] - limits[:, 0])))
    above = np.sum(np.square(mean[dense] * (limits[:, 1] - shares[dense])))
    has_few_passes = ~dense & (failures > passes)
    has_few_failures = ~dense & ~has_few_passes
    event_weights = mean / draws
    lower, upper = distances(event_weights[has_few_failures], failures[has_few_failures], confidence)
    below += lower**2
    above += upper**2
    lower, upper = distances(event_weights[has_few_passes], passes[has_few_passes], confidence)
    below += upper**2
    above += lower**2
    by_net = weights @ shares
    nets = len(by_net)
    half = special.stdtrit(nets - 1, 0.5 * (1.0 + confidence)) * by_net.std(ddof=1) / np.sqrt(nets)
    estimate = by_net.mean()
    return (
        float(max(0.0, estimate - np.sqrt(below + half**2))),
        float(min(1.0, estimate + np.sqrt(above + half**2))),
    )


def distances(weights: np.ndarray, counts: np.ndarray, confidence: float) -> tuple[float, float]:
    """Distances of the lower and the upper limit from a weighted sum of rare events.

    Args:
        weights: Weight of an event in each stratum, shape (strata,).
        counts: Events of each stratum, shape (strata,).
        confidence: Coverage, in (0, 1).
    """
    if not len(weights):
        return 0.0, 0.0
    events = np.repeat(weights, counts)
    low, high = weighted_interval(events, 1, float(weights.max()), confidence)
    total = float(events.sum())
    return total - low, high - total


def allocation(
    weights: np.ndarray, shares: np.ndarray, width: float, most: int, confidence: float = CONFIDENCE
) -> np.ndarray:
    """The fewest draws of each stratum with which an interval is expected to have a width.

    Args:
        weights: Probability of each stratum, shape (strata,).
        shares: Expected share of failures in each stratum, in (0, 1), shape (strata,).
        width: Upper minus lower limit; a large one is reached by :data:`LEAST_DRAWS` of each stratum.
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
        columns = best(logarithm)
        length = np.sqrt(below[rows, columns].sum()) + np.sqrt(above[rows, columns].sum())
        total = numbers[columns].sum()
        return 1.0 if length > width and total < most else -1.0

    cheapest, narrowest = -20.0, 80.0
    if excess(cheapest) < 0.0:
        return numbers[best(cheapest)].astype(int)
    log_multiplier = optimize.root_scalar(excess, bracket=(cheapest, narrowest), method="bisect", xtol=1e-3).root
    return numbers[best(log_multiplier)].astype(int)
