"""Shapley effects of every metric and of failure: shares of the variance for numbers that may be correlated.

The effect of a factor is the variance that it explains when it becomes known after some others, averaged over all
orders in which the factors may become known. The effects are never negative and sum to 1. For independent factors each
lies between the first-order and the total Sobol index.

Every row has a random order of the factors and two independent points. Its simulations are chained: the first takes
all factors from the second point, and each further one takes one more factor, in that order, from the first point. With
correlated numbers the others follow their conditional law, since the normal scores of the Gaussian copula are mixed by
the Cholesky factor of the correlation in that order. So the pair of the last simulation and the k-th shares exactly
the first k factors, and half its mean square difference is the variance that these leave unexplained. In-loop noise
is one more factor, independent of the numbers.

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
from dssc_jax.analyses.sensitivity.sobol import saltelli
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator, inside_cube, score_mixing_matrix
from dssc_jax.statistics import CONFIDENCE, replicate_interval, unseen
from dssc_jax.study import Study


def random_orders(rows: int, factors: int, seeds: tuple[int, ...]) -> np.ndarray:
    """A random order of the factors for each row, shape (rows, factors).

    The orders come in pairs, one the reverse of the other, which lowers the variance. Both are of one replicate.
    """
    orders = generator(*seeds).permuted(np.tile(np.arange(factors), (rows // 2, 1)), axis=1)
    reverses = orders[:, ::-1]
    shape = (-1, REPLICATES, factors)
    return np.stack([orders.reshape(shape), reverses.reshape(shape)], axis=1).reshape(rows, factors)


def chained_scores(correlation: np.ndarray, first: np.ndarray, second: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Correlated normal scores of the chained simulations: the module tells how they are mixed.

    Args:
        correlation: Correlation of the scores, shape (factors, factors).
        first: Independent normal scores of the first point, shape (rows, factors).
        second: Independent normal scores of the second point, shape (rows, factors).
        order: The order in which the factors become known, shape (rows, factors).

    Returns:
        Shape (factors + 1, rows, factors); the k-th shares the first k factors of the order with the last.
    """
    factors = order.shape[1]
    cholesky = np.linalg.cholesky(correlation[order[:, :, None], order[:, None, :]])
    first_in_order = np.take_along_axis(first, order, axis=1)
    second_in_order = np.take_along_axis(second, order, axis=1)
    is_from_first = np.arange(factors) < np.arange(factors + 1)[:, None]
    mixed = np.einsum("rij,krj->kri", cholesky, np.where(is_from_first[:, None, :], first_in_order, second_in_order))
    scores = np.empty_like(mixed)
    np.put_along_axis(scores, np.broadcast_to(order, mixed.shape), mixed, axis=2)
    return scores


def shapley_effects(values: np.ndarray, order: np.ndarray, confidence: float = CONFIDENCE) -> np.ndarray:
    """Shapley effects of one output with their intervals.

    With f_k the value of the k-th simulation of a row, the factor at place k of its order gets
    ((f_last - f_(k-1))^2 - (f_last - f_k)^2)/2, whose mean is the variance that it adds to what is explained. Relative
    to the mean of (f_last - f_0)^2/2 these sum to 1. The interval of this ratio is linearised, and is widened by what
    this number of rows may have missed, as for Sobol indices.

    Args:
        values: Outputs of the chained simulations, shape (factors + 1, rows); row i belongs to replicate i mod R.
        order: The orders, shape (rows, factors).
        confidence: Confidence of the intervals.

    Returns:
        Estimate, lower and upper end, shape (factors, 3).
    """
    squares = 0.5 * (values[-1] - values) ** 2
    shares = np.empty_like(squares[1:])
    np.put_along_axis(shares, order.T, squares[:-1] - squares[1:], axis=0)
    variance = squares[0]
    effects = shares.mean(1, keepdims=True) / variance.mean()
    low, high = replicate_interval((shares - effects * variance) / variance.mean(), REPLICATES, confidence).T
    half = np.hypot(0.5 * (high - low), unseen(effective_row_count(values[0], values[-1]), confidence))[:, None]
    return np.concatenate([effects, effects - half, effects + half], axis=1)


def normal_scores(points: np.ndarray, noisy: bool) -> np.ndarray:
    """Normal scores of points of the unit cube, shape (rows, laws); with a further column of 0 for in-loop noise."""
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
    order = random_orders(rows, laws + noisy, seeds)
    correlation = np.eye(laws + noisy)
    matrix = score_mixing_matrix(study)
    correlation[:laws, :laws] = matrix @ matrix.T
    first, second = saltelli(rows, laws, seeds)
    chain = chained_scores(correlation, normal_scores(first, noisy), normal_scores(second, noisy), order)
    levels = inside_cube(special.ndtr(chain[..., :laws]))
    indices = np.tile(np.arange(rows), (len(chain), 1))
    if noisy:
        place = np.argmax(order == laws, axis=1)
        indices = np.where(place < np.arange(len(chain))[:, None], indices, indices + rows)
    return RowDesign(
        rows,
        [RowSample(*pair) for pair in zip(levels, indices, strict=True)],
        refusal=lambda values: refusal_reason(values[-1], values[0]),
        quantities=lambda values: (shapley_effects(values, order, confidence),),
    )
