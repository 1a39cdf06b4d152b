"""Impulse responses and decay of a linear system z+ = A z, in floating point."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

SIDE = 32
"""Root of the number of samples that are summed at a time."""
MOST_SAMPLES = 400_000
TAIL_LEFT_OUT = 1e-5
"""Share of a sum at which its tail is left out."""


class Responses(NamedTuple):
    """Responses of z+ = A z.

    Args:
        sums: Sums of the absolute impulse responses, (signals, inputs).
        peaks: Peaks of the responses to the starts, the largest of all starts, (signals,).
    """

    sums: np.ndarray
    peaks: np.ndarray


def responses(a: np.ndarray, rows: np.ndarray, inputs: np.ndarray, starts: np.ndarray) -> Responses | None:
    """The responses of z+ = A z; None if they last longer than ``MOST_SAMPLES``, or are not finite.

    Samples are computed in blocks of ``SIDE``^2, as products of rows A^k and columns A^(i SIDE) z.

    Args:
        a: A, (n, n).
        rows: Rows of the signals, (m, n).
        inputs: Columns of the inputs, (n, q).
        starts: Columns of the starts, (n, starts).
    """
    n, q, m = a.shape[0], inputs.shape[1], rows.shape[0]
    row_powers = [rows]
    jump_powers = [np.eye(n)]
    jump = np.linalg.matrix_power(a, SIDE)
    for _ in range(SIDE - 1):
        row_powers.append(row_powers[-1] @ a)
        jump_powers.append(jump @ jump_powers[-1])
    block_jump = jump @ jump_powers[-1]
    short_rows = np.concatenate(row_powers)
    long_jumps = np.concatenate(jump_powers)
    decay_share = 1.0 - spectral_radius(block_jump)
    z = np.concatenate([inputs, starts], axis=1)
    sums = np.zeros((m, q))
    peaks = np.zeros((m, starts.shape[1]))
    for _ in range(MOST_SAMPLES // SIDE**2):
        block = short_rows @ (long_jumps @ z).reshape(SIDE, n, -1)
        block = np.abs(block, out=block).reshape(SIDE**2, m, -1)
        block_sums = block.sum(axis=0)[:, :q]  # of all columns, which lie together
        sums = sums + block_sums
        peaks = np.maximum(peaks, block[..., q:].max(axis=0))
        if not np.all(np.isfinite(block_sums)):
            return None
        z = block_jump @ z
        tails = np.abs(rows @ z[:, q:])
        sums_converge = np.all(block_sums <= TAIL_LEFT_OUT * decay_share * sums)
        if sums_converge and np.all(tails <= np.maximum(1e-3 * peaks, 1e-300)):
            return Responses(sums, peaks.max(axis=1, initial=0.0))
    return None


def decay_of(a: np.ndarray) -> tuple[float, np.ndarray]:
    """The decay of z+ = A z: the share of V that is lost in a sample, and P of V = z'Pz, (n, n).

    V falls half as fast as the slowest mode of ``a`` allows. P follows from two Lyapunov equations, the second one in
    coordinates in which the solution of the first is the unit matrix.
    """
    n = a.shape[0]
    radius = spectral_radius(a)
    contraction = 0.5 * (1.0 + radius)
    gramian = solve_discrete_lyapunov(a / contraction, np.eye(n))
    scale = np.linalg.cholesky(0.5 * (gramian + gramian.T))
    inverse = np.linalg.inv(scale)
    scaled_p = solve_discrete_lyapunov((inverse @ a @ scale / contraction).T, np.eye(n))
    p = inverse.T @ scaled_p @ inverse
    return float(1.0 - contraction**2), 0.5 * (p + p.T)


def spectral_radius(a: np.ndarray) -> float:
    """The largest modulus of the eigenvalues of a matrix, (n, n)."""
    return np.max(np.abs(np.linalg.eigvals(a)))
