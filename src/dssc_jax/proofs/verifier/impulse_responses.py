"""Upper bounds of sums and peaks of impulse responses of z+ = A z: states in balls, samples in float64.

The samples of a block are a grid: sample i SIDE + k is (row A^k) (A^(i SIDE) z), where z is the block's first state and
i and k are below ``SIDE``. Both products are rounded. Let R and N be the magnitudes of row A^k and of A^(i SIDE). Then
the error of each product is at most ``ROUNDED`` times the product of the magnitudes, since it has fewer than n + 4
roundings of 2^-53 each. The error of both together is at most ``TWICE`` ROUNDED R N |z|.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import column, identity, quadratic_form, side_by_side, stack, total

SIDE = 32
"""Square root of the number of samples of a block."""
MOST_BLOCKS = 500
"""Number of blocks after which the responses count as too slow."""
TAIL_SHARE = 2e-5
"""Share of a sum below which the rest of the sum is bounded by V instead of computed."""
ROUNDED = 2.0**-44
"""Relative error of one rounded product of matrices, at most."""
TWICE = 2.0 + 2.0**-20
"""Number of rounded products, with a little more for their interaction."""
SUMMED = 1.0 + 2.0**-28
"""Factor that covers the rounding of the sums themselves, which have fewer than 2^22 terms."""
UNDERFLOW = 1e-290
"""Absolute error of a product, which exceeds any loss to underflow."""


class ResponseBounds(NamedTuple):
    """Upper bounds of how much inputs and starts can move the signals of z+ = A z + B w.

    Args:
        sums: Bounds of the sums over k of |row A^k input|, shape (rows, inputs).
        peaks: Bounds of the largest |offset + row A^k start| over all k, shape (rows, starts).
    """

    sums: np.ndarray
    peaks: np.ndarray


def middles(matrix: arb_mat) -> np.ndarray:
    """The midpoints of a matrix of balls, rounded to float64."""
    return np.array([[float(x.mid()) for x in row] for row in matrix.tolist()])


def magnitudes(matrix: arb_mat) -> np.ndarray:
    """Bounds of the magnitudes of a matrix of balls, in float64, enlarged by 2^60 times each radius.

    The enlargement lets ``ROUNDED`` times a bound cover the ball's radius besides the rounding of the midpoint.
    """
    radius_weight = arb(2) ** 60
    return np.array([[float((abs(x) + radius_weight * x.rad()).upper()) for x in row] for row in matrix.tolist()])


class Block(NamedTuple):
    """``SIDE``^2 successive samples of row A^k z, rounded, for all rows and all columns z, with bounds of the errors.

    At the beginning of each block the radii of the states' balls are dropped, so that the states are exact numbers.

    Args:
        response: The samples, shape (samples, rows, columns).
        error: Bound of a sample's rounding error, shape (rows, columns).
        error_sum: Bound of the sum of the rounding errors of all samples, shape (rows, columns).
        radius_effect: Bound of the error that all radii dropped so far cause in a sample of this or a later block,
            shape (rows, columns).
        tail: Bound of every sample after this block, including the effect of the radii, shape (rows, columns).
    """

    response: np.ndarray
    error: np.ndarray
    error_sum: np.ndarray
    radius_effect: np.ndarray
    tail: np.ndarray


def response_blocks(a: arb_mat, rows: arb_mat, z: arb_mat, p: arb_mat) -> Iterator[Block]:
    """Yield the responses row A^k z block by block, from k = 0 on, at most ``MOST_BLOCKS`` blocks.

    Balls would widen from block to block. So each block begins with the midpoints, and V bounds the effect of the
    dropped radii: V never rises, and where V <= 1 the signal of a row is at most (row P^-1 row')^(1/2).

    Args:
        a: A, shape (n, n).
        rows: Rows of the signals, shape (m, n).
        z: Columns of the first states, shape (n, columns).
        p: P of V = z'Pz, which falls from sample to sample, as the caller has shown.
    """
    n = a.nrows()
    m = rows.nrows()
    short_rows = stack(powers(rows, a))
    jumps = powers(identity(n), a**SIDE)
    long_jumps = stack(jumps)
    block_jump = jumps[-1] * a**SIDE
    short_middles = middles(short_rows)
    long_middles = middles(long_jumps).reshape(SIDE, n, n)
    long_sizes = np.concatenate(list(magnitudes(long_jumps).reshape(SIDE, n, n)), axis=1)
    error = (ROUNDED * TWICE * magnitudes(short_rows) @ long_sizes).reshape(SIDE, m, SIDE, n)
    error_sum = SUMMED * error.sum(axis=(0, 2))
    error_peak = error.max(axis=(0, 2))
    squares = rows * p.inv() * rows.transpose()
    largest_in_set = np.array([float(abs(squares[i, i]).upper().sqrt().upper()) for i in range(m)])  # |row z|, V <= 1
    largest_in_unit_cube = total([abs(entry) for row in p.tolist() for entry in row]).sqrt()  # V^(1/2), |z_i| <= 1
    count = z.ncols()
    dropped_sizes = [arb(0)] * count  # of each column, bound of V^(1/2) of all radii dropped so far
    for _ in range(MOST_BLOCKS):
        for j in range(count):
            largest_radius = max((z[i, j].rad() for i in range(n)), key=float)
            dropped_sizes[j] = dropped_sizes[j] + largest_in_unit_cube * largest_radius
        z = z.mid()
        state = middles(z)
        sizes = np.abs(state)
        response = (short_middles @ (long_middles @ state)).reshape(SIDE**2, m, -1)
        z = block_jump * z
        ends = [(state_size(p, z, j) + dropped_sizes[j]).upper() for j in range(count)]
        yield Block(
            response=response,
            error=error_peak @ sizes + UNDERFLOW,
            error_sum=error_sum @ sizes + UNDERFLOW,
            radius_effect=largest_in_set[:, None] * np.array([float(size.upper()) for size in dropped_sizes]),
            tail=largest_in_set[:, None] * np.array([float(end) for end in ends]),
        )


def response_bounds(
    a: arb_mat,
    rows: arb_mat,
    inputs: arb_mat,
    starts: arb_mat,
    p: arb_mat,
    decay: arb,
    offsets: arb_mat | None = None,
) -> ResponseBounds | None:
    """Bounds of the responses of z+ = A z to inputs and to starts.

    Args:
        a: A, shape (n, n).
        rows: Rows of the signals, shape (m, n).
        inputs: Columns of the inputs, shape (n, q).
        starts: Columns of the initial states, shape (n, s).
        p: P of V = z'Pz, shape (n, n).
        decay: Lower bound of the share of V that is lost in a sample, as the caller has shown.
        offsets: Constants that are added to the responses to the starts, shape (m, s); None: zero.

    Returns:
        The bounds; None if the responses have not decayed after ``MOST_BLOCKS`` blocks.
    """
    m = rows.nrows()
    q = inputs.ncols()
    sums = np.zeros((m, q))
    peaks = np.zeros((m, starts.ncols()))
    offset_middles = np.zeros(peaks.shape) if offsets is None else middles(offsets)
    offset_errors = np.zeros(peaks.shape) if offsets is None else ROUNDED * magnitudes(offsets)
    # V^(1/2) falls by the factor (1 - decay)^(1/2) in a sample, and the geometric series sums to 2/decay at most
    tail_factor = float((2 / decay).upper())
    for block in response_blocks(a, rows, side_by_side(inputs, starts), p):
        sums += np.abs(block.response[..., :q]).sum(axis=0) + block.error_sum[:, :q]
        largest = np.abs(block.response[..., q:] + offset_middles).max(axis=0) + block.error[:, q:]
        peaks = np.maximum(peaks, largest + offset_errors)
        tail_sums = block.tail[:, :q] * tail_factor
        tail_peaks = block.tail[:, q:]
        if np.all(tail_sums <= TAIL_SHARE * sums) and np.all(tail_peaks <= np.maximum(peaks, UNDERFLOW)):
            peaks = np.maximum(peaks + block.radius_effect[:, q:], tail_peaks + np.abs(offset_middles) + offset_errors)
            return ResponseBounds(SUMMED * (sums + tail_sums), SUMMED * peaks)
    return None


def powers(start: arb_mat, a: arb_mat) -> list[arb_mat]:
    """The ``SIDE`` matrices start, start a, start a^2, ..."""
    products = [start]
    for _ in range(SIDE - 1):
        products.append(products[-1] * a)
    return products


def state_size(p: arb_mat, z: arb_mat, j: int) -> arb:
    """Upper bound of V^(1/2) = (z'Pz)^(1/2) for column j of z."""
    return abs(quadratic_form(p, column(z, j))).upper().sqrt()
