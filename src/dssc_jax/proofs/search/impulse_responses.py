"""Impulse responses and decay of a linear system z+ = A z, in floating point."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

SIDE = 32
"""Square root of the number of samples in a block; A^(SIDE i + k) is the product of A^(SIDE i) and A^k."""
MOST_SAMPLES = 400_000
TAIL_LEFT_OUT = 1e-5
"""Share of a sum of absolute values below which the rest of the sum is left out."""


class Responses(NamedTuple):
    """Bounds of the effects of inputs and starts on the signals of z+ = A z + B w.

    Args:
        sums: Sum over all samples of |response| to a unit impulse (the l1 norm), shape (signals, inputs). An input of
            magnitude at most 1 moves the signal by at most this sum.
        peaks: Largest |response| over all samples and starts, shape (signals,).
    """

    sums: np.ndarray
    peaks: np.ndarray


def responses(a: np.ndarray, rows: np.ndarray, inputs: np.ndarray, starts: np.ndarray) -> Responses | None:
    """Simulate z+ = A z from impulses and starts until the responses have decayed.

    Samples are computed in blocks of ``SIDE``^2: sample SIDE i + k of a signal is (row A^k) (A^(SIDE i) z).

    Args:
        a: A, shape (n, n).
        rows: Rows of the signals over z, shape (m, n).
        inputs: Column of each input, shape (n, q).
        starts: States z_0 in which the system may start, as columns, shape (n, starts).

    Returns:
        Sums and peaks; None if the responses last longer than ``MOST_SAMPLES``, or are not finite.
    """
    n = a.shape[0]
    q = inputs.shape[1]
    m = rows.shape[0]
    row_powers = [rows]  # row A^k
    jump_powers = [np.eye(n)]  # A^(SIDE i)
    jump = np.linalg.matrix_power(a, SIDE)
    for _ in range(SIDE - 1):
        row_powers.append(row_powers[-1] @ a)
        jump_powers.append(jump @ jump_powers[-1])
    block_jump = jump @ jump_powers[-1]
    short_rows = np.concatenate(row_powers)
    long_jumps = np.concatenate(jump_powers)
    decay_share = 1.0 - spectral_radius(block_jump)  # share that the slowest mode loses in a block
    z = np.concatenate([inputs, starts], axis=1)
    sums = np.zeros((m, q))
    peaks = np.zeros((m, starts.shape[1]))
    for _ in range(MOST_SAMPLES // SIDE**2):
        block = short_rows @ (long_jumps @ z).reshape(SIDE, n, -1)
        block = np.abs(block, out=block).reshape(SIDE**2, m, -1)
        block_sums = block.sum(axis=0)[:, :q]  # summing all columns is faster, since they are contiguous
        sums = sums + block_sums
        peaks = np.maximum(peaks, block[..., q:].max(axis=0))
        if not np.all(np.isfinite(block_sums)):
            return None
        z = block_jump @ z
        # the later blocks add about block_sums/decay_share, a geometric series
        sums_converge = np.all(block_sums <= TAIL_LEFT_OUT * decay_share * sums)
        next_values = np.abs(rows @ z[:, q:])
        peaks_have_passed = np.all(next_values <= np.maximum(1e-3 * peaks, 1e-300))
        if sums_converge and peaks_have_passed:
            return Responses(sums, peaks.max(axis=1, initial=0.0))
    return None


class Decay(NamedTuple):
    """A V = z'Pz that falls along z+ = A z.

    Args:
        lost_share: The share of V that is lost in a sample.
        p: P, shape (n, n).
    """

    lost_share: float
    p: np.ndarray


def decay_of(a: np.ndarray) -> Decay:
    """Find a V = z'Pz that falls along z+ = A z, by which the verifier bounds the tails of the responses.

    V need only fall half as fast as the slowest mode allows, which leaves room for the verifier. P solves a Lyapunov
    equation in coordinates z = S x, in which the states that unit inputs in every direction excite have size 1. This
    keeps P well conditioned.

    Args:
        a: A, stable, shape (n, n).
    """
    contraction = 0.5 * (1.0 + spectral_radius(a))  # of the state in a sample; V shrinks by its square
    gramian = solve_discrete_lyapunov(a / contraction, np.eye(a.shape[0]))
    scale = np.linalg.cholesky(0.5 * (gramian + gramian.T))  # S
    inverse = np.linalg.inv(scale)
    scaled_p = solve_discrete_lyapunov((inverse @ a @ scale / contraction).T, np.eye(a.shape[0]))
    p = inverse.T @ scaled_p @ inverse
    return Decay(lost_share=float(1.0 - contraction**2), p=0.5 * (p + p.T))


def spectral_radius(a: np.ndarray) -> float:
    """The largest modulus of a matrix's eigenvalues; z+ = A z is stable if it is below 1."""
    return np.max(np.abs(np.linalg.eigvals(a)))
