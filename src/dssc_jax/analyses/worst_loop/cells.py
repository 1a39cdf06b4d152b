"""Bounds of the closed loop's response over a box of uncertain numbers and all frequencies, cell by cell.

A cell is a part of the box and an interval of angles theta = omega T_s. The response is a part of an inverse,

    G = [N^-1]_(v,w),    N = [[z I - A, -B, 0], [0, I, 0], [-C, 0, I]],    z = e^(j theta),

one entry for a loop that is broken in one channel. N = N_0 + D at a point u in [-1, 1]^k of the cell: k - 1 numbers and
the angle. With R = N_0^-1, its columns x at w and rows y at v, and absolute values taken entry by entry,

    G = G_0 - y D x + y D N^-1 D x,    abs(y D N^-1 D x) <= abs(y D) (I - K)^-1 abs(R D x),    K >= abs(R D),

where the spectral radius of K must be below 1; (I - K)^-1 >= 0 proves that it is. D is linear in u up to a remainder, D
= sum of u_i N_i + E. So an entry of G lies in a polygon, widened by a disk. Where such a K exists on all cells, no
eigenvalue of A meets the unit circle: a loop that is stable at one point of the box is stable on all of it. The cells
cover all frequencies. The states are the modes in the middle of each part of the box, in which K is smallest.

Reference:
    R. E. Moore, R. B. Kearfott, M. J. Cloud, Introduction to Interval Analysis (2009): mean-value form, subdivision.
    R. A. Horn, C. R. Johnson, Matrix Analysis, 2nd ed. (2012), chapter 8, for nonnegative matrices.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.worst_loop.family import Evaluate, RemainingPoints
from dssc_jax.analyses.worst_loop.linear_models import WIDENED, LinearModel, LinearModels, measurement_points
from dssc_jax.analyses.worst_loop.readouts import SINGLE_READOUT, Enclosure, Readout

FIRST_ANGLE = 1e-3  # end of the first interval of angles, which begins at 0, relative to the slowest pole
INTERVALS = 24  # further intervals of angles at the start, up to pi
BATCH_CELLS = 256  # most cells that are halved at once
CHEAPER = 3.0  # preference for halving an interval of angles, since half a box has to be linearised again
SQUARINGS = 4  # squarings of a matrix, after which its largest eigenvalue prevails


class Cells(NamedTuple):
    """n cells, each a part of the box and an interval of angles theta = omega T_s.

    Args:
        low: Lower corner of each part of the box, shape (n, sides).
        high: Upper corner of each part, shape (n, sides).
        start: First angle of each interval, shape (n,).
        end: Last angle of each interval, shape (n,).
    """

    low: np.ndarray
    high: np.ndarray
    start: np.ndarray
    end: np.ndarray

    def at(self, index: np.ndarray) -> "Cells":
        """The cells with some indices."""
        return Cells(*(part[index] for part in self))


class CellBounds(NamedTuple):
    """Bounds of the gains on n cells, and the side along which each cell is halved next.

    Args:
        gains: An upper bound of each gain of the readout, shape (n, gains); infinite where there is none.
        axis: Index of the side to halve, the angle being the last, shape (n,).
    """

    gains: np.ndarray
    axis: np.ndarray


class CoverBounds(NamedTuple):
    """Bounds of the gains over the whole box and all frequencies.

    Args:
        gains: A bound of each gain of the readout, shape (gains,); infinite where none was found.
        cells: Number of cells that were computed.
    """

    gains: np.ndarray
    cells: int

    @property
    def stable(self) -> bool:
        """Whether the bounds prove that the loop is stable on all of the box."""
        return bool(np.all(np.isfinite(self.gains)))


class Expansion(NamedTuple):
    """N on n cells as N_0 + sum of u_i N_i, up to a remainder E.

    Args:
        middle: N_0, shape (n, m + 1, m + 1).
        steps: N_i, the angle last, shape (n, sides + 1, m + 1, m + 1).
        remainder: A bound of abs(E), shape (n, m + 1, m + 1).
    """

    middle: np.ndarray
    steps: np.ndarray
    remainder: np.ndarray


def first_angles(poles: np.ndarray) -> np.ndarray:
    """Ends of the first intervals of angles, from 0 to pi, even in the logarithm from below the slowest pole on.

    Args:
        poles: Poles of the loop in the middle of the box, shape (states,).
    """
    lasting_poles = poles[np.abs(poles) > FIRST_ANGLE].astype(complex)
    slowest = np.abs(np.log(lasting_poles)).min(initial=1.0)
    first = min(FIRST_ANGLE * slowest, 0.1)
    return np.concatenate([[0.0], np.geomspace(first, np.pi, INTERVALS)])


def cover_box(
    evaluate: Evaluate,
    ends: tuple[np.ndarray, np.ndarray],
    goals: np.ndarray,
    most: int,
    remaining_points: RemainingPoints,
    readout: Readout = SINGLE_READOUT,
) -> CoverBounds:
    """Bound the gains over a box and all frequencies, by halving the worst cells until the goals are met.

    Args:
        evaluate: The loop at points of the box; it is stable at one of them.
        ends: Lower and upper corner of the box, shape (sides,).
        goals: Bounds that are good enough, shape (gains,).
        most: Number of cells to compute at most; the first :data:`INTERVALS` are computed in any case.
        remaining_points: Number of points that may still be evaluated.
        readout: The gains.
    """
    models = LinearModels(evaluate, readout.channels)
    channels = readout.channels
    points_per_cell = len(measurement_points(len(ends[0])))
    if remaining_points() < points_per_cell:
        return CoverBounds(np.full(readout.size, np.inf), 0)
    centre = evaluate(0.5 * (ends[0] + ends[1])[None])[0]
    angles = first_angles(np.linalg.eigvals(centre[:-channels, :-channels]))
    count = len(angles) - 1
    cells = Cells(np.tile(ends[0], (count, 1)), np.tile(ends[1], (count, 1)), angles[:-1], angles[1:])
    bounds = bound_cells(cells, models.on(cells.low, cells.high), goals, readout)
    cell_count = count
    while True:
        excess = np.max(bounds.gains / goals, axis=1)
        order = np.argsort(-excess)
        halvable = min(BATCH_CELLS, max(0, most - cell_count) // 2)
        worst = order[excess[order] > 1.0][:halvable]
        points = np.cumsum(np.where(bounds.axis[worst] == len(ends[0]), 0, 2 * points_per_cell))
        worst = worst[points <= remaining_points()]
        if not worst.size:
            return CoverBounds(bounds.gains.max(axis=0), cell_count)
        kept_cells = np.setdiff1d(order, worst)
        half_cells = halve(cells.at(worst), bounds.axis[worst])
        halves = bound_cells(half_cells, models.on(half_cells.low, half_cells.high), goals, readout)
        cells = Cells(*(np.concatenate(parts) for parts in zip(cells.at(kept_cells), half_cells, strict=True)))
        bounds = CellBounds(
            np.concatenate([bounds.gains[kept_cells], halves.gains]),
            np.concatenate([bounds.axis[kept_cells], halves.axis]),
        )
        cell_count += len(half_cells.start)


def halve(cells: Cells, axis: np.ndarray) -> Cells:
    """Halve cells: the lower half of each along its axis, then the upper halves.

    Args:
        cells: The n cells.
        axis: Index of the side of each, the angle being the last, shape (n,).
    """
    low, high, start, end = (part.copy() for part in cells)
    upper_low, lower_high, upper_start, lower_end = (part.copy() for part in (low, high, start, end))
    angular = axis == low.shape[1]
    middle = 0.5 * (start + end)
    upper_start[angular] = middle[angular]
    lower_end[angular] = middle[angular]
    rows = np.flatnonzero(~angular)
    sides = axis[rows]
    middles = 0.5 * (low[rows, sides] + high[rows, sides])
    upper_low[rows, sides] = middles
    lower_high[rows, sides] = middles
    return Cells(
        np.concatenate([low, upper_low]),
        np.concatenate([lower_high, high]),
        np.concatenate([start, upper_start]),
        np.concatenate([lower_end, end]),
    )


def bound_cells(cells: Cells, models: Sequence[LinearModel], goals: np.ndarray, readout: Readout) -> CellBounds:
    """Bound the gains on each cell, from the linear model of its part of the box.

    Args:
        cells: The n cells.
        models: The model of each cell's part of the box.
        goals: Bounds that are good enough, shape (gains,).
        readout: The gains.
    """
    centre, slopes, deviation, bends = (np.stack(parts) for parts in zip(*models, strict=True))
    finite = np.all(np.isfinite(deviation), axis=(1, 2)) & np.all(np.isfinite(centre), axis=(1, 2))
    sides = slopes.shape[1]
    channels = readout.channels
    states = slopes.shape[2] - channels
    n, steps, remainder = expansion(cells, centre, slopes, deviation, channels)
    n[~finite] = np.eye(states + 2 * channels)
    with np.errstate(all="ignore"):
        r = invert(n)
        x = r[:, :, states : states + channels]
        y = r[:, states + channels :]
        change = inverse_change(r, x, y, steps, remainder)
        response = y[:, :, states : states + channels]
        linear = y[:, None] @ (steps @ x[:, None])
        first = np.abs(y) @ remainder @ np.abs(x)
        second = change.left_size @ change.inverse @ change.right_size
        gains = readout.gains(Enclosure(response, linear, first + second, cells.end), goals)
        is_bounded = finite & np.all(change.inverse >= 0.0, axis=(1, 2))
        weights = side_weights(change, add_border(bends, channels), readout.scales(response), is_bounded)
    weights[:, sides] *= CHEAPER
    has_no_weights = ~np.all(np.isfinite(weights), axis=1)
    weights[has_no_weights, :sides] = (cells.high - cells.low)[has_no_weights]
    weights[has_no_weights, sides] = (cells.end - cells.start)[has_no_weights]
    return CellBounds(np.where(is_bounded[:, None], gains, np.inf), np.argmax(weights, axis=1))


class InverseChange(NamedTuple):
    """Sizes of the terms by which N^-1 differs from R on n cells, as the module names them; absolute values.

    Args:
        sizes: abs(R), shape (n, m + 1, m + 1).
        spread: abs(R N_i), shape (n, sides + 1, m + 1, m + 1).
        left: abs(y N_i), shape (n, sides + 1, channels, m + 1).
        right: abs(R N_i x), shape (n, sides + 1, m + 1, channels).
        left_size: A bound of abs(y D), shape (n, channels, m + 1).
        right_size: A bound of abs(R D x), shape (n, m + 1, channels).
        k: K, shape (n, m + 1, m + 1).
        inverse: (I - K)^-1, shape (n, m + 1, m + 1).
    """

    sizes: np.ndarray
    spread: np.ndarray
    left: np.ndarray
    right: np.ndarray
    left_size: np.ndarray
    right_size: np.ndarray
    k: np.ndarray
    inverse: np.ndarray


def inverse_change(
    r: np.ndarray, x: np.ndarray, y: np.ndarray, steps: np.ndarray, remainder: np.ndarray
) -> InverseChange:
    """Bound the terms by which N^-1 differs from R on each cell.

    Args:
        r: R, the inverse in the middle of the cell, shape (n, m + 1, m + 1).
        x: The columns of R at the inputs, shape (n, m + 1, channels).
        y: The rows of R at the outputs, shape (n, channels, m + 1).
        steps: N_i, shape (n, sides + 1, m + 1, m + 1).
        remainder: A bound of abs(E), shape (n, m + 1, m + 1).
    """
    sizes = np.abs(r)
    spread = np.abs(r[:, None] @ steps)
    left = np.abs(y[:, None] @ steps)
    right = np.abs(r[:, None] @ (steps @ x[:, None]))
    k = spread.sum(axis=1) + sizes @ remainder
    return InverseChange(
        sizes=sizes,
        spread=spread,
        left=left,
        right=right,
        left_size=left.sum(axis=1) + np.abs(y) @ remainder,
        right_size=right.sum(axis=1) + sizes @ remainder @ np.abs(x),
        k=k,
        inverse=invert(np.eye(k.shape[-1]) - k),
    )


def side_weights(change: InverseChange, bends: np.ndarray, scales: np.ndarray, is_bounded: np.ndarray) -> np.ndarray:
    """How much each side of a cell contributes to the bounds, shape (n, sides + 1); the largest is halved next.

    Where there is no bound yet, it is the contribution to the spectral radius of K.

    Args:
        change: Sizes of the terms of N^-1.
        bends: The deviation from a linear dependence along each side, shape (n, sides, m + 1, m + 1).
        scales: Positive weights of the channels, shape (n, channels).
        is_bounded: Whether each cell has a bound, shape (n,).
    """
    left_weights, right_weights = dominant_vectors(change.k)
    left_bounds = np.einsum("nc,nci->ni", scales, change.left_size @ change.inverse)
    right_bounds = np.einsum("nic,nc->ni", change.inverse @ change.right_size, 1.0 / scales)
    left_weights = np.where(is_bounded[:, None], left_bounds, left_weights)
    right_weights = np.where(is_bounded[:, None], right_bounds, right_weights)
    bend_weights = np.einsum("ni,nij,nkjl,nl->nk", left_weights, change.sizes, WIDENED * bends, right_weights)
    weights = np.einsum("ni,nkij,nj->nk", left_weights, change.spread, right_weights)
    direct = np.einsum("nc,nkci,ni->nk", scales, change.left, right_weights)
    direct += np.einsum("ni,nkic,nc->nk", left_weights, change.right, 1.0 / scales)
    weights += np.where(is_bounded[:, None], direct, 0.0)
    weights[:, : bends.shape[1]] += bend_weights
    return weights


def expansion(cells: Cells, centre: np.ndarray, slopes: np.ndarray, deviation: np.ndarray, channels: int) -> Expansion:
    """Expand N on each cell, as a linear function of the coordinates and the angle.

    Args:
        cells: The n cells.
        centre: [[A, B], [C, 0]] in the middle of each part of the box, shape (n, m, m).
        slopes: Its slopes along the sides, shape (n, sides, m, m).
        deviation: A bound of its deviations from the linear function, shape (n, m, m).
        channels: Columns of B.
    """
    states = centre.shape[-1] - channels
    middle = 0.5 * (cells.start + cells.end)
    width = 0.5 * (cells.end - cells.start)
    z = np.exp(1j * middle)
    identity = np.diag([*np.ones(states), *np.zeros(2 * channels)])
    n = z[:, None, None] * identity
    n[:, range(states, states + 2 * channels), range(states, states + 2 * channels)] = 1.0
    n -= add_border(centre, channels)
    angular = (1j * z * width)[:, None, None, None] * identity
    steps = np.concatenate([-add_border(slopes, channels), angular], axis=1)
    remainder = add_border(deviation, channels) + 0.5 * (width**2)[:, None, None] * identity
    return Expansion(n, steps, remainder)


def invert(matrices: np.ndarray) -> np.ndarray:
    """Inverses of n matrices, shape (n, m, m) both; NaN for a singular one."""
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


def dominant_vectors(k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Approximate left and right eigenvectors of the largest eigenvalues of nonnegative matrices, shape (n, m) each."""
    square = k
    for _ in range(SQUARINGS):
        square = square @ square
        square /= np.maximum(square.max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    return square.sum(axis=1), square.sum(axis=2)


def add_border(matrices: np.ndarray, channels: int) -> np.ndarray:
    """Matrices [[A, B], [C, 0]] extended to [[A, B, 0], [0, 0, 0], [C, 0, 0]], in the last two axes.

    Args:
        matrices: Shape (..., states + channels, states + channels).
        channels: Columns of B.
    """
    m = matrices.shape[-1]
    states = m - channels
    result = np.zeros((*matrices.shape[:-2], m + channels, m + channels), matrices.dtype)
    result[..., :states, :m] = matrices[..., :states, :]
    result[..., m:, :states] = matrices[..., states:, :states]
    return result
