"""Upper bounds of sums and peaks of impulse responses of z+ = A z: exact states in balls, what is summed in float64.

Within a block of samples, every response is a row times the block's first state. That product is rounded; its error is
at most ``ROUNDED`` times the product of the magnitudes, since n + 4 roundings of 2^-53 each are less.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat

BLOCK, MOST_BLOCKS = 128, 4000
"""Samples of a block, and the largest number of blocks."""
TAIL_SHARE = 2e-5
"""Share of a sum at which its tail is bounded instead of computed."""
ROUNDED = 2.0**-44
SUMMED = 1.0 + 2.0**-30
"""Covers the rounding of the sums themselves, of which there are fewer than 2^20 terms."""
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
    stack = [rows]
    for _ in range(BLOCK - 1):
        stack.append(stack[-1] * a)
    whole = arb_mat([[each[i, j] for j in range(n)] for each in stack for i in range(m)])
    value, size = middles(whole), magnitudes(whole)
    jump, inverse = a**BLOCK, p.inv()
    shadow = rows * inverse * rows.transpose()
    reach = np.array([float(abs(shadow[i, i]).upper().sqrt().upper()) for i in range(m)])
    ones = sum((abs(p[i, j]) for i, j in product(range(n), range(n))), arb(0)).sqrt()
    z = arb_mat([[*(inputs[i, j] for j in range(q)), *(starts[i, j] for j in range(starts.ncols()))] for i in range(n)])
    lost = [arb(0)] * z.ncols()
    sums, peaks = np.zeros((m, q)), np.zeros((m, starts.ncols()))
    for block in range(MOST_BLOCKS):
        for j in range(z.ncols()):  # go on with exact numbers; V bounds what the difference can still cause
            lost[j] = lost[j] + ones * max((z[i, j].rad() for i in range(n)), key=float)
        z = arb_mat([[z[i, j].mid() for j in range(z.ncols())] for i in range(n)])
        now = middles(z)
        response = (np.abs(value @ now) + ROUNDED * (size @ np.abs(now)) + UNDERFLOW).reshape(BLOCK, m, -1)
        sums += response[:, :, :q].sum(axis=0)
        peaks = np.maximum(peaks, response[:, :, q:].max(axis=0))
        z = jump * z
        if block % 8 == 7:
            ends = [(state_size(p, z, j) + lost[j]).upper() for j in range(z.ncols())]
            after = reach[:, None] * np.array([float(each) for each in ends])
            tails = after[:, :q] * float((2 / decay).upper())
            if np.all(tails <= TAIL_SHARE * sums) and np.all(after[:, q:] <= np.maximum(peaks, UNDERFLOW)):
                within = peaks + reach[:, None] * np.array([float(each.upper()) for each in lost[q:]])
                peaks = np.maximum(within, after[:, q:]).max(axis=1, initial=0.0)
                return ResponseBounds(SUMMED * (sums + tails), SUMMED * peaks)
    return None


def state_size(p: arb_mat, z: arb_mat, j: int) -> arb:
    """Bound of V^(1/2) of a column."""
    state = arb_mat([[z[i, j]] for i in range(z.nrows())])
    return abs((state.transpose() * p * state)[0, 0]).upper().sqrt()
