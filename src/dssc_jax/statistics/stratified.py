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
    """Interval of a failure probability sum_k W_k p_k over strata k whose weights W_k are estimated.

    A stratum with at least :data:`DENSE` failures and passes has exact limits (Clopper-Pearson). In each other stratum
    either failures or passes are rare, and the weighted sum of the rare events has limits by Fay and Feuer. The
    uncertainty of the weights is Student's t over the nets. The squared distances of all limits from their estimates
    are added.

    Args:
        weights: Probability W_k of each stratum, estimated from each of R independent nets, shape (R, strata).
        failures: Number of failed draws in each stratum, shape (strata,).
        draws: Number of independent draws in each stratum, shape (strata,).
        confidence: Coverage, in (0, 1).

    Returns:
        Lower and upper limit, within [0, 1].
    """
    mean = weights.mean(axis=0)
    passes = draws - failures
    is_dense = np.minimum(failures, passes) >= DENSE
    squares_below, squares_above = dense_squares(mean[is_dense], failures[is_dense], draws[is_dense], confidence)
    has_few_passes = ~is_dense & (failures > passes)
    has_few_failures = ~is_dense & ~has_few_passes
    event_weights = mean / draws
    below, above = limit_distances(event_weights[has_few_failures], failures[has_few_failures], confidence)
    squares_below += below**2
    squares_above += above**2
    below, above = limit_distances(event_weights[has_few_passes], passes[has_few_passes], confidence)
    squares_below += above**2  # more passes: fewer failures
    squares_above += below**2
    estimate_of_net = weights @ (failures / draws)
    nets = len(estimate_of_net)
    half = special.stdtrit(nets - 1, 0.5 * (1.0 + confidence)) * estimate_of_net.std(ddof=1) / np.sqrt(nets)
    estimate = estimate_of_net.mean()
    low = estimate - np.sqrt(squares_below + half**2)
    high = estimate + np.sqrt(squares_above + half**2)
    return float(max(0.0, low)), float(min(1.0, high))


def dense_squares(
    weights: np.ndarray, failures: np.ndarray, draws: np.ndarray, confidence: float
) -> tuple[float, float]:
    """Sums over strata of the squared distances of the lower and of the upper exact limit from the estimate.

    Args:
        weights: Probability of each stratum, shape (strata,).
        failures: Number of failed draws in each stratum, shape (strata,).
        draws: Number of draws in each stratum, shape (strata,).
        confidence: Coverage, in (0, 1).
    """
    shares = failures / draws
    limits = clopper_pearson(failures, draws, confidence)
    squares_below = np.sum(np.square(weights * (shares - limits[:, 0])))
    squares_above = np.sum(np.square(weights * (limits[:, 1] - shares)))
    return squares_below, squares_above


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
    low, high = weighted_interval(events, draws=1, largest=float(weights.max()), confidence=confidence)
    total = float(events.sum())
    return total - low, high - total


def allocate_draws(weights: np.ndarray, shares: np.ndarray, width: float, limit: int) -> np.ndarray:
    """Number of draws in each stratum: as few as possible for an expected width of the interval.

    For a Lagrange multiplier m, every stratum takes the number of draws n that minimises n + m d^2, with the distances
    d of the limits from the estimate. A larger m gives more draws and a narrower interval. Bisection finds the smallest
    m at which the interval is narrow enough.

    Args:
        weights: Probability of each stratum, shape (strata,).
        shares: Expected share of failures in each stratum, in (0, 1), shape (strata,).
        width: Upper minus lower limit of the interval; if it is large, every stratum gets :data:`LEAST_DRAWS`.
        limit: Largest number of all draws together; the interval may then remain wider.

    Returns:
        Integers, shape (strata,).
    """
    numbers = np.unique(np.geomspace(LEAST_DRAWS, MOST_DRAWS, 400).round())  # of draws, to choose from
    limits = clopper_pearson(shares[:, None] * numbers, numbers)
    squares_below = np.square(weights[:, None] * (shares[:, None] - limits[..., 0]))
    squares_above = np.square(weights[:, None] * (limits[..., 1] - shares[:, None]))
    strata = np.arange(len(weights))

    def cheapest_columns(log_multiplier: float) -> np.ndarray:
        """Index of the best number of draws of each stratum, shape (strata,)."""
        return np.argmin(numbers + np.exp(log_multiplier) * (squares_below + squares_above), axis=1)

    def needs_more_draws(log_multiplier: float) -> float:
        """The number 1 if the interval is too wide and draws are left, otherwise -1.

        A bisection searches for the change of sign.
        """
        columns = cheapest_columns(log_multiplier)
        below = np.sqrt(squares_below[strata, columns].sum())
        above = np.sqrt(squares_above[strata, columns].sum())
        is_wide = below + above > width
        return 1.0 if is_wide and numbers[columns].sum() < limit else -1.0

    low = -20.0  # logarithms of multipliers
    high = 80.0
    if needs_more_draws(low) < 0.0:
        return numbers[cheapest_columns(low)].astype(int)
    log_multiplier = optimize.root_scalar(needs_more_draws, bracket=(low, high), method="bisect", xtol=1e-3).root
    return numbers[cheapest_columns(log_multiplier)].astype(int)
