"""The structured singular value of matrices for diagonal complex perturbations: a bound from each side.

mu(M) is the inverse of the smallest delta for which some diagonal Delta with abs(Delta_ii) <= delta makes I - M Delta
singular. The largest singular value of D M D^-1 bounds it from above, for every positive diagonal D; a convex
minimisation in log D finds the best D. Up to three channels the best bound is mu itself. The spectral radius of M U
bounds it from below, for every diagonal U of unit modulus, and a perturbation that attains the bound comes with it.

References:
    A. Packard, J. Doyle, "The complex structured singular value", Automatica 29 (1993) 71-109.
    R. S. Sezginer, M. L. Overton, "The largest singular value of e^X A_0 e^-X is convex on convex sets of commuting
        matrices", IEEE Trans. Automatic Control 35 (1990) 229-230.
    E. E. Osborne, "On pre-conditioning of matrices", J. ACM 7 (1960) 338-345.
"""

import numpy as np

BALANCING_STEPS = 30  # passes over all channels
ELLIPSOID_STEPS = 300
FIRST_RADIUS = 2.0  # radius of the first ellipsoid in log D, about the balanced D
STILL = 1e-12  # change of log mu from the centre to the edge of an ellipsoid, below which it no longer moves
POWER_STEPS = 100
STARTS = 8  # starts of the power iteration
TINY = 1e-300  # in place of 0 in a denominator
ONE_WAY = 1e-8  # least ratio of row and column in a step, so that a coupling in one direction is scaled away


def balancing_log_scales(matrices: np.ndarray) -> np.ndarray:
    """log D of the diagonal D that minimises the Frobenius norm of D M D^-1, shape (n, channels) (Osborne).

    Each step scales one channel so that its row and its column of D M D^-1, without the diagonal, become equally large.
    For two channels this D also minimises the largest singular value.

    Args:
        matrices: M, shape (n, channels, channels).
    """
    count, channels, _ = matrices.shape
    squares = np.abs(matrices) ** 2
    squares[:, range(channels), range(channels)] = 0.0
    logs = np.zeros((count, channels))
    for _ in range(BALANCING_STEPS):
        for channel in range(channels):
            scaled_squares = squares * np.exp(2.0 * (logs[:, :, None] - logs[:, None, :]))
            row = np.sum(scaled_squares[:, channel, :], axis=1)
            column = np.sum(scaled_squares[:, :, channel], axis=1)
            is_coupled = (row > TINY) | (column > TINY)
            column_size = np.where(is_coupled, column + ONE_WAY * row, 1.0)
            row_size = np.where(is_coupled, row + ONE_WAY * column, 1.0)
            logs[:, channel] += 0.25 * np.log(column_size / row_size)  # sizes are squares, hence a quarter
    return logs


def scaled_norms(matrices: np.ndarray, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest singular values of D M D^-1, shape (n,), and a subgradient of their logarithms, shape (n, channels).

    Args:
        matrices: M, shape (n, channels, channels).
        logs: log D, shape (n, channels), by which the subgradient is taken.
    """
    ratios = np.exp(logs[:, :, None] - logs[:, None, :])  # entry i, j of D M D^-1 is M_ij times D_i/D_j
    left_vectors, values, right_vectors = np.linalg.svd(matrices * ratios)
    slopes = np.abs(left_vectors[:, :, 0]) ** 2 - np.abs(right_vectors[:, 0, :]) ** 2
    return values[:, 0], slopes


def upper_bounds(matrices: np.ndarray) -> np.ndarray:
    """Upper bounds of the structured singular value mu, shape (n,); equal to mu up to three channels.

    Args:
        matrices: M, shape (n, channels, channels).
    """
    norms, _ = scaled_norms(matrices, best_log_scales(matrices))
    return norms


def best_log_scales(matrices: np.ndarray) -> np.ndarray:
    """log D of the diagonal D that minimises the largest singular value of D M D^-1, shape (n, channels).

    The ellipsoid method finds D: each step keeps the half of an ellipsoid in which the subgradient allows the minimum,
    and encloses this half by a smaller ellipsoid. The method needs no smoothness, which is missing at the best D, where
    the two largest singular values are often equal. Any D gives a valid bound of mu, so an inexact minimum is safe. The
    first entry of log D stays 0, since a common factor of D changes nothing.

    Args:
        matrices: M, shape (n, channels, channels).
    """
    best_logs = balancing_log_scales(matrices)
    free = matrices.shape[1] - 1
    if free < 2:  # two channels: the balanced D is the best
        return best_logs
    least_norms, slopes = scaled_norms(matrices, best_logs)
    count = len(matrices)
    # the ellipsoid has the points x with (x - centre)' E^-1 (x - centre) <= 1; E: ellipsoid
    ellipsoid = np.broadcast_to(FIRST_RADIUS**2 * np.eye(free), (count, free, free)).copy()
    centre = best_logs[:, 1:] - best_logs[:, :1]
    for _ in range(ELLIPSOID_STEPS):
        slope = slopes[:, 1:]
        reach = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", slope, ellipsoid, slope), TINY))  # rise up to the edge
        is_moving = reach > STILL
        to_edge = np.einsum("nij,nj->ni", ellipsoid, slope) / reach[:, None]  # from the centre to the edge, uphill
        centre = centre - np.where(is_moving[:, None], to_edge, 0.0) / (free + 1.0)
        square = to_edge[:, :, None] * to_edge[:, None, :]
        smaller = free**2 / (free**2 - 1.0) * (ellipsoid - 2.0 / (free + 1.0) * square)  # encloses the lower half
        ellipsoid = np.where(is_moving[:, None, None], smaller, ellipsoid)
        logs = np.concatenate([np.zeros((count, 1)), centre], axis=1)
        norms, slopes = scaled_norms(matrices, logs)
        best_logs = np.where((norms < least_norms)[:, None], logs, best_logs)
        least_norms = np.minimum(least_norms, norms)
    return best_logs


def lower_bounds(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower bounds of the structured singular value mu, with perturbations that attain them.

    Args:
        matrices: M, shape (n, channels, channels).

    Returns:
        The bounds, shape (n,), and the diagonals of Delta with abs(Delta_ii) = 1/bound for which I - M Delta is
        singular, shape (n, channels); NaN where the bound is 0.
    """
    count, channels, _ = matrices.shape
    random = np.random.default_rng(0)
    bounds = np.zeros(count)
    diagonals = np.full((count, channels), np.nan, complex)
    rows = np.arange(count)
    for start in range(STARTS):
        vectors = np.ones((count, channels), complex)
        if start > 0:  # the further starts are random
            vectors = np.exp(2j * np.pi * random.random((count, channels)))
        units = power_iteration(matrices, vectors)
        eigenvalues = np.linalg.eigvals(matrices * units[:, None, :])
        largest = eigenvalues[rows, np.argmax(np.abs(eigenvalues), axis=1)]
        is_better = np.abs(largest) > bounds
        bounds = np.where(is_better, np.abs(largest), bounds)
        diagonals[is_better] = units[is_better] / largest[is_better, None]  # det(I - M U/lambda) = 0
    return bounds, diagonals


def power_iteration(matrices: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Diagonals U of unit modulus for which the spectral radius of M U is large, shape (n, channels).

    This is the power iteration of Packard and Doyle for diagonal complex perturbations, with their vectors a, b, z, w.

    Args:
        matrices: M, shape (n, channels, channels).
        start: Vectors with which the iteration starts, shape (n, channels).
    """

    def unit(vectors: np.ndarray) -> np.ndarray:
        """The entries divided by their moduli, shape (n, channels); 1 in place of an entry of 0."""
        size = np.abs(vectors)
        return np.where(size > TINY, vectors / np.maximum(size, TINY), 1.0)

    def normalised(vectors: np.ndarray) -> np.ndarray:
        """The vectors divided by their lengths, shape (n, channels); a vector of length 0 stays 0."""
        return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), TINY)

    b = normalised(start)
    w = b
    a = b
    for _ in range(POWER_STEPS):
        a = normalised(np.einsum("nij,nj->ni", matrices, b))
        z = unit(a) * np.abs(w)
        w = normalised(np.einsum("nji,nj->ni", matrices.conj(), z))
        b = unit(w) * np.abs(a)
    return unit(b) / unit(a)
