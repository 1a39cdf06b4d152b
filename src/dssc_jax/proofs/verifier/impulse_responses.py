"""Upper bounds of sums and peaks of impulse responses of z+ = A z: exact states in balls, what is summed in float64.

A block of samples is a grid: sample i LONG + k is row A^k times A^(i LONG) times the block's first state, for i and k
below ``SIDE``. Both products are rounded. With S and N the magnitudes of the rows row A^k and of the matrices, the
error of each is at most ``ROUNDED`` times the product of the magnitudes, since n + 4 roundings of 2^-53 each are less;
so that of both is at most ``TWICE`` ROUNDED S N |z|.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat

SIDE, MOST_BLOCKS = 32, 500
"""Root of the number of samples of a block, and the largest number of blocks."""
TAIL_SHARE = 2e-5
"""Share of a sum at which its tail is bounded instead of computed."""
ROUNDED, TWICE = 2.0**-44, 2.0 + 2.0**-20
SUMMED = 1.0 + 2.0**-28
"""Covers the rounding of the sums themselves, of which there are fewer than 2^22 terms."""
UNDERFLOW = 1e-290


class ResponseBounds(NamedTuple):
    """Upper bounds.

    Args:
        sums: Of the sums over k of |row A^k input|, (rows, inputs).
        peaks: Of the largest |row A^k start| over all k and starts, (rows,).
    """

    sums: np.ndarray
    peaks: np.ndarray


def middles(matrix: arb_mat) -> np.ndarray:
    """The middles of the balls, rounded."""
    return np.array([[float(matrix[i, j].mid()) for j in range(matrix.ncols())] for i in range(matrix.nrows())])


def magnitudes(matrix: arb_mat) -> np.ndarray:
    """Bounds of the magnitudes, with each ball's radius weighted so that ROUNDED times them covers it, too."""
    weight = arb(2) ** 60
    entries = [[matrix[i, j] for j in range(matrix.ncols())] for i in range(matrix.nrows())]
    return np.array([[float((abs(x) + weight * x.rad()).upper()) for x in row] for row in entries])


def response_bounds(
    a: arb_mat, rows: arb_mat, inputs: arb_mat, starts: arb_mat, p: arb_mat, decay: arb
) -> ResponseBounds | None:
    """Bounds of the responses to inputs and to starts; None if they decay too slowly.

    Args:
        a: A, (n, n).
        rows: Rows of the signals, (m, n).
        inputs: Columns of the inputs, (n, q).
        starts: Columns of the initial states, (n, s).
        p: V = z'Pz, which falls by at least the share ``decay`` in a sample, as the caller has shown.
        decay: Its share.
    """
    n, m, q = a.nrows(), rows.nrows(), inputs.ncols()
    near, far = powers(rows, a), powers(identity(n), a**SIDE)
    value, size = (of(rows_below(near)) for of in (middles, magnitudes))
    jumps = middles(rows_below(far)).reshape(SIDE, n, n)
    error = ROUNDED * TWICE * size @ np.concatenate(list(magnitudes(rows_below(far)).reshape(SIDE, n, n)), axis=1)
    error = error.reshape(SIDE, m, SIDE, n)
    error_sum, error_peak = SUMMED * error.sum(axis=(0, 2)), error.max(axis=(0, 2))
    jump, inverse = far[-1] * a**SIDE, p.inv()
    shadow = rows * inverse * rows.transpose()
    reach = np.array([float(abs(shadow[i, i]).upper().sqrt().upper()) for i in range(m)])
    ones = sum((abs(p[i, j]) for i, j in product(range(n), range(n))), arb(0)).sqrt()
    z = arb_mat([[*(inputs[i, j] for j in range(q)), *(starts[i, j] for j in range(starts.ncols()))] for i in range(n)])
    lost = [arb(0)] * z.ncols()
    sums, peaks = np.zeros((m, q)), np.zeros((m, starts.ncols()))
    for _ in range(MOST_BLOCKS):
        for j in range(z.ncols()):  # go on with exact numbers; V bounds what the difference can still cause
            lost[j] = lost[j] + ones * max((z[i, j].rad() for i in range(n)), key=float)
        z = z.mid()
        now = middles(z)
        response = np.abs(value @ (jumps @ now)).reshape(SIDE**2, m, -1)
        sums += response[..., :q].sum(axis=0) + error_sum @ np.abs(now[:, :q]) + UNDERFLOW
        largest = response[..., q:].max(axis=0) + error_peak @ np.abs(now[:, q:]) + UNDERFLOW
        peaks = np.maximum(peaks, largest)
        z = jump * z
        ends = [(state_size(p, z, j) + lost[j]).upper() for j in range(z.ncols())]
        after = reach[:, None] * np.array([float(each) for each in ends])
        tails = after[:, :q] * float((2 / decay).upper())
        if np.all(tails <= TAIL_SHARE * sums) and np.all(after[:, q:] <= np.maximum(peaks, UNDERFLOW)):
            within = peaks + reach[:, None] * np.array([float(each.upper()) for each in lost[q:]])
            peaks = np.maximum(within, after[:, q:]).max(axis=1, initial=0.0)
            return ResponseBounds(SUMMED * (sums + tails), SUMMED * peaks)
    return None


def identity(n: int) -> arb_mat:
    """The unit matrix."""
    return arb_mat([[int(i == j) for j in range(n)] for i in range(n)])


def powers(first: arb_mat, a: arb_mat) -> list[arb_mat]:
    """The first ``SIDE`` of first, first a, first a^2, ..."""
    result = [first]
    for _ in range(SIDE - 1):
        result.append(result[-1] * a)
    return result


def rows_below(parts: list[arb_mat]) -> arb_mat:
    """Matrices below one another."""
    return arb_mat([[each[i, j] for j in range(each.ncols())] for each in parts for i in range(each.nrows())])


def state_size(p: arb_mat, z: arb_mat, j: int) -> arb:
    """Bound of V^(1/2) of a column."""
    state = arb_mat([[z[i, j]] for i in range(z.nrows())])
    return abs((state.transpose() * p * state)[0, 0]).upper().sqrt()
