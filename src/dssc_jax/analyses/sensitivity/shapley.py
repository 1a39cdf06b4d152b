"""Shapley effects of every metric and of failure: shares of the variance for numbers that may be correlated.

The effect of a factor is the variance that it explains when it becomes known after some others, averaged over all
orders in which the factors may become known. The effects are never negative and sum to 1. For independent factors each
lies between the first-order and the total Sobol index.

Every row has a random order of the factors and two independent points. Its simulations are chained: the first takes all
factors from the second point, and each further simulation takes a further factor, in that order, from the first point.
With correlated numbers the others follow their conditional law, since the normal scores of the Gaussian copula are
mixed by the Cholesky factor of the correlation in that order. So the pair of the last simulation and the k-th shares
exactly the first k factors, and half its mean square difference is the variance that these leave unexplained. In-loop
noise is one more factor, independent of the numbers.

Reference:
    E. Song, B. L. Nelson, J. Staum, SIAM/ASA Journal on Uncertainty Quantification 4 (2016) 1060-1083; A. B. Owen,
    C. Prieur, SIAM/ASA Journal on Uncertainty Quantification 5 (2017) 986-1002.
"""

import numpy as np
from scipy import special

from dssc_jax.analyses.sensitivity.outputs import (
    REPLICATES,
    RowDesign,
    RowSample,
    effective_row_count,
    refusal_reason,
    row_count,
)
from dssc_jax.analyses.sensitivity.sobol import saltelli_samples
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator, inside_cube, score_mixing_matrix
from dssc_jax.statistics import CONFIDENCE, replicate_interval, unseen
from dssc_jax.study import Study


def random_orders(rows: int, factors: int, seeds: tuple[int, ...]) -> np.ndarray:
    """The order in which the factors become known in each row, as indices of factors, shape (rows, factors).

    The orders are random, but come in pairs: the second order of a pair is the reverse of the first, which lowers the
    variance. Both rows of a pair belong to the same replicate (row i belongs to replicate i mod R).

    Args:
        rows: Number of rows, a multiple of twice the number R of replicates.
        factors: Number of factors.
        seeds: Seeds of the random generator.
    """
    orders = generator(*seeds).permuted(np.tile(np.arange(factors), (rows // 2, 1)), axis=1)
    reverses = orders[:, ::-1]
    by_replicate = (-1, REPLICATES, factors)
    pairs = np.stack([orders.reshape(by_replicate), reverses.reshape(by_replicate)], axis=1)
    return pairs.reshape(rows, factors)


def chained_scores(correlation: np.ndarray, first: np.ndarray, second: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Correlated normal scores of the chained simulations, which move from the second to the first point.

    Simulation k takes the first k factors of the order from the first point, and the other factors from the second. The
    Cholesky factor of the correlation matrix, sorted in this order, mixes the independent scores. So the other factors
    follow their conditional law given the first k factors.

    Args:
        correlation: Correlation of the scores, shape (factors, factors).
        first: Independent normal scores of the first point, shape (rows, factors).
        second: Independent normal scores of the second point, shape (rows, factors).
        order: The order in which the factors become known, shape (rows, factors).

    Returns:
        Scores of the factors in simulations 0 to factors, shape (factors + 1, rows, factors).
    """
    factors = order.shape[1]
    cholesky = np.linalg.cholesky(correlation[order[:, :, None], order[:, None, :]])
    first_in_order = np.take_along_axis(first, order, axis=1)
    second_in_order = np.take_along_axis(second, order, axis=1)
    is_from_first = np.arange(factors) < np.arange(factors + 1)[:, None]  # (simulations, places in the order)
    independent = np.where(is_from_first[:, None, :], first_in_order, second_in_order)
    scores_in_order = np.einsum("rij,krj->kri", cholesky, independent)
    scores = np.empty_like(scores_in_order)
    np.put_along_axis(scores, np.broadcast_to(order, scores.shape), scores_in_order, axis=2)
    return scores


def shapley_effects(values: np.ndarray, order: np.ndarray, confidence: float = CONFIDENCE) -> np.ndarray:
    """Shapley effects of an output, the share of its variance that each factor explains, with their intervals.

    The mean of half the squared difference between the last simulation and simulation k is the variance that the first
    k factors leave unexplained. Its decrease from k - 1 to k is the part of the factor at place k of the order. An
    effect is the ratio of the mean part to the variance. The interval of this ratio is linearised, and widened for
    rare rows that a sample of this size may have missed.

    Args:
        values: Outputs of the chained simulations, shape (factors + 1, rows); row i belongs to replicate i mod R.
        order: The order in which the factors become known, shape (rows, factors).
        confidence: Confidence of the intervals.

    Returns:
        Estimate, lower and upper end, shape (factors, 3). The estimates sum to 1.
    """
    unexplained = 0.5 * (values[-1] - values) ** 2
    parts = np.empty_like(unexplained[1:])  # by factor and row
    np.put_along_axis(parts, order.T, unexplained[:-1] - unexplained[1:], axis=0)
    variance = unexplained[0]
    effects = parts.mean(1, keepdims=True) / variance.mean()
    low, high = replicate_interval((parts - effects * variance) / variance.mean(), REPLICATES, confidence).T
    missed = unseen(effective_row_count(values[0], values[-1]), confidence)
    half = np.hypot(0.5 * (high - low), missed)[:, None]
    return np.concatenate([effects, effects - half, effects + half], axis=1)


def normal_scores(points: np.ndarray, noisy: bool) -> np.ndarray:
    """Standard normal scores of the factors at points of the unit cube, shape (rows, factors).

    In-loop noise has the last column, with the score 0: draw indices, not scores, decide it.

    Args:
        points: Points of the unit cube, shape (rows, laws).
        noisy: Whether in-loop noise is a factor.
    """
    scores = special.ndtri(inside_cube(points))
    return np.pad(scores, ((0, 0), (0, int(noisy))))


def shapley_design(study: Study, noisy: bool, confidence: float) -> RowDesign:
    """The design of Shapley effects: the chained simulations of every row.

    Args:
        study: The study; its number of draws, rounded down to a power of two, is the number of rows.
        noisy: Whether in-loop noise is a factor.
        confidence: Confidence of the intervals.

    Raises:
        ConfigError: There are too few draws.
    """
    rows = row_count(study)
    laws = len(study.laws)
    seeds = (study.config.seed, stream("shapley"))
    factors = laws + int(noisy)
    order = random_orders(rows, factors, seeds)
    correlation = np.eye(factors)  # the noise is independent of the laws
    matrix = score_mixing_matrix(study)
    correlation[:laws, :laws] = matrix @ matrix.T
    first, second = saltelli_samples(rows, laws, seeds)
    chain = chained_scores(correlation, normal_scores(first, noisy), normal_scores(second, noisy), order)
    levels = inside_cube(special.ndtr(chain[..., :laws]))
    indices = np.tile(np.arange(rows), (len(chain), 1))
    if noisy:  # its factor has the index laws; until it becomes known, a row has the second point's noise
        place_of_noise = np.argmax(order == laws, axis=1)
        is_known = place_of_noise < np.arange(len(chain))[:, None]
        indices = np.where(is_known, indices, indices + rows)
    return RowDesign(
        rows,
        samples=[RowSample(levels[k], indices[k]) for k in range(len(chain))],
        refusal=lambda values: refusal_reason(values[-1], values[0]),
        quantities=lambda values: (shapley_effects(values, order, confidence),),
    )
