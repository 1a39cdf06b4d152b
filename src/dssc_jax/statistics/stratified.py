"""Interval of a failure probability from stratified draws, and the numbers of draws that make it narrow.

References:
    G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures: a general approach", Statistics in
    Medicine 27 (2008) 1693-1702: squares of the distances of limits from estimates add up. J. Neyman, Journal of the
    Royal Statistical Society 97 (1934) 558-625: draws in proportion to weight and standard deviation.
"""

import numpy as np
from scipy import optimize, special

from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson
from dssc_jax.statistics.weighted import weighted_interval

DENSE = 10  # least failures, and least passes, of a stratum whose interval is computed separately
LEAST_DRAWS = 8  # least draws of a stratum
MOST_DRAWS = 10**8  # most draws of a stratum


def stratified_interval(
    weights: np.ndarray, failures: np.ndarray, draws: np.ndarray, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Interval of a failure probability sum_k W_k p_k over strata k.

    A stratum with at least ``DENSE`` failures and passes has exact limits (Clopper-Pearson). In all other strata either
    failures or passes are rare, and the weighted sum of these rare events has limits of its own (Fay and Feuer). The
    uncertainty of the weights is Student's t over the nets. The squares of all distances add up.

    Args:
        weights: Probability W_k of each stratum, estimated from each of R independent nets, shape (R, strata).
        failures: Number of failed draws in each stratum, shape (strata,).
        draws: Number of independent draws in each stratum, shape (strata,).
        confidence: Coverage, in (0, 1).

    Returns:
        Lower and upper limit, within [0, 1].
    """
    shares = failures / draws
    mean = weights.mean(axis=0)
    passes = draws - failures
    dense = np.minimum(failures, passes) >= DENSE
    limits = clopper_pearson(failures[dense], draws[dense], confidence)
    squares_below = np.sum(np.square(mean[dense] * (shares[dense] - limits[:, 0])))
    squares_above = np.sum(np.square(mean[dense] * (limits[:, 1] - shares[dense])))
    has_few_passes = ~dense & (failures > passes)
    has_few_failures = ~dense & ~has_few_passes
    event_weights = mean / draws
    lower, upper = limit_distances(event_weights[has_few_failures], failures[has_few_failures], confidence)
    squares_below += lower**2
    squares_above += upper**2
    lower, upper = limit_distances(event_weights[has_few_passes], passes[has_few_passes], confidence)
    squares_below += upper**2
    squares_above += lower**2
    by_net = weights @ shares
    nets = len(by_net)
    half = special.stdtrit(nets - 1, 0.5 * (1.0 + confidence)) * by_net.std(ddof=1) / np.sqrt(nets)
    estimate = by_net.mean()
    low = estimate - np.sqrt(squares_below + half**2)
    high = estimate + np.sqrt(squares_above + half**2)
    return float(max(0.0, low)), float(min(1.0, high))


def limit_distances(weights: np.ndarray, counts: np.ndarray, confidence: float) -> tuple[float, float]:
    """Distances of the lower and the upper limit from the weighted sum of rare events.

    Args:
        weights: Weight of an event in each stratum, shape (strata,).
        counts: Number of events in each stratum, shape (strata,).
        confidence: Coverage, in (0, 1).
    """
    if not len(weights):
        return 0.0, 0.0
    events = np.repeat(weights, counts)
    low, high = weighted_interval(events, 1, float(weights.max()), confidence)
    total = float(events.sum())
    return total - low, high - total


def allocate_draws(weights: np.ndarray, shares: np.ndarray, width: float, limit: int) -> np.ndarray:
    """Fewest draws in each stratum for an expected width of the interval.

    A Lagrange multiplier trades draws against the squared distances of the limits; it is found by bisection.

    Args:
        weights: Probability of each stratum, shape (strata,).
        shares: Expected share of failures in each stratum, in (0, 1), shape (strata,).
        width: Upper minus lower limit of the interval; if it is large, every stratum gets :data:`LEAST_DRAWS`.
        limit: Largest number of all draws together; the interval may then remain wider.

    Returns:
        Integers, shape (strata,).
    """
    numbers = np.unique(np.geomspace(LEAST_DRAWS, MOST_DRAWS, 400).round())
    limits = clopper_pearson(shares[:, None] * numbers, numbers)
    squares_below = np.square(weights[:, None] * (shares[:, None] - limits[..., 0]))
    squares_above = np.square(weights[:, None] * (limits[..., 1] - shares[:, None]))
    strata = np.arange(len(weights))

    def best_columns(log_multiplier: float) -> np.ndarray:
        return np.argmin(numbers + np.exp(log_multiplier) * (squares_below + squares_above), axis=1)

    def needs_more(log_multiplier: float) -> float:
        columns = best_columns(log_multiplier)
        lower = np.sqrt(squares_below[strata, columns].sum())
        upper = np.sqrt(squares_above[strata, columns].sum())
        is_wide = lower + upper > width
        return 1.0 if is_wide and numbers[columns].sum() < limit else -1.0

    cheapest = -20.0
    narrowest = 80.0
    if needs_more(cheapest) < 0.0:
        return numbers[best_columns(cheapest)].astype(int)
    log_multiplier = optimize.root_scalar(needs_more, bracket=(cheapest, narrowest), method="bisect", xtol=1e-3).root
    return numbers[best_columns(log_multiplier)].astype(int)
