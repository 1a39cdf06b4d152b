"""Operations on many matrices at once: inverses, dominant eigenvectors, and the places of A, B and C in N."""

import numpy as np

SQUARINGS = 4  # squarings of a matrix, after which its largest eigenvalue prevails


def invert(matrices: np.ndarray) -> np.ndarray:
    """Inverses of n matrices, shape (n, m, m) both; NaN for a singular matrix."""
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

    A high power of a matrix is nearly a multiple of v w', with the right eigenvector v and the left eigenvector w of
    the matrix. So the column sums of the power are nearly proportional to w, and its row sums to v.

    Args:
        matrices: The matrices, shape (n, m, m).
    """
    power = matrices
    for _ in range(SQUARINGS):
        power = power @ power
        power /= np.maximum(power.max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    return power.sum(axis=1), power.sum(axis=2)


def add_border(matrices: np.ndarray, channels: int) -> np.ndarray:
    """Extend matrices [[A, B], [C, 0]] to [[A, B, 0], [0, 0, 0], [C, 0, 0]].

    A, B and C then have the places that they have in N = [[z I - A, -B, 0], [0, I, 0], [-C, 0, I]].

    Args:
        matrices: [[A, B], [C, 0]], shape (..., states + channels, states + channels).
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
