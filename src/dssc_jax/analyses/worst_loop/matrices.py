"""Operations on many matrices at once: inverses, dominant eigenvectors, and the places of A, B and C in N."""

import numpy as np

SQUARINGS = 4  # squarings of a matrix, after which its largest eigenvalue prevails


def invert(matrices: np.ndarray) -> np.ndarray:
    """Inverses of n matrices, of their shape (n, m, m); NaN for a singular one."""
    try:
        return np.linalg.inv(matrices)  # all at once, which fails if one is singular
    except np.linalg.LinAlgError:
        result = np.full_like(matrices, np.nan)
        for index, matrix in enumerate(matrices):
            try:
                result[index] = np.linalg.inv(matrix)
            except np.linalg.LinAlgError:
                continue
        return result


def dominant_vectors(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Approximate left and right eigenvectors of the largest eigenvalues of n nonnegative matrices, shape (n, m) each.

    A high power of a matrix is nearly a multiple of the product v w' of its right eigenvector v and its left one w. So
    the sums of its columns are nearly proportional to w, and the sums of its rows to v.

    Args:
        matrices: Shape (n, m, m).
    """
    power = matrices
    for _ in range(SQUARINGS):
        power = power @ power
        power /= np.maximum(power.max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    return power.sum(axis=1), power.sum(axis=2)


def add_border(matrices: np.ndarray, channels: int) -> np.ndarray:
    """Matrices [[A, B, 0], [0, 0, 0], [C, 0, 0]], from [[A, B], [C, 0]].

    A, B and C lie where N = [[z I - A, -B, 0], [0, I, 0], [-C, 0, I]] has them.

    Args:
        matrices: Shape (..., states + channels, states + channels).
        channels: Columns of B.

    Returns:
        Shape (..., states + 2 channels, states + 2 channels).
    """
    size = matrices.shape[-1]
    states = size - channels
    result = np.zeros((*matrices.shape[:-2], size + channels, size + channels), matrices.dtype)
    result[..., :states, :size] = matrices[..., :states, :]
    result[..., size:, :states] = matrices[..., states:, :states]
    return result
