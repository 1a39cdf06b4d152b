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

from dssc_jax.analyses.worst_loop.family import Evaluate, RemainingPoints, unlimited
from dssc_jax.analyses.worst_loop.linear_models import WIDENED, LinearModel, LinearModels, pattern
from dssc_jax.analyses.worst_loop.readouts import SINGLE, Enclosure, Readout

FIRST_ANGLE = 1e-3  # relative to the slowest pole: the first interval of angles begins at 0
INTERVALS = 24  # intervals of angles at the start
BATCH_CELLS = 256
CHEAPER = 3.0  # an interval of angles is halved rather than a box, which has to be linearised again
SQUARINGS = 4  # squarings of a matrix, whose largest eigenvalue then prevails


class Cells(NamedTuple):
    """n cells.

    Args:
        low: Lower corners in the box, shape (n, sides).
        high: Upper corners.
        start: First angles, shape (n,).
        end: Last angles.
    """

    low: np.ndarray
    high: np.ndarray
    start: np.ndarray
    end: np.ndarray

    def at(self, index: np.ndarray) -> "Cells":
        """Some of the cells."""
        return Cells(*(part[index] for part in self))


class CellBounds(NamedTuple):
    """Bounds on n cells.

    Args:
        gains: An upper bound of each gain of the readout, shape (n, gains); infinite: none.
        axis: Index of the side to halve next, the angle being the last, shape (n,).
    """

    gains: np.ndarray
    axis: np.ndarray


class Covered(NamedTuple):
    """Bounds over the whole box.

    Args:
        gains: A bound of each gain of the readout, shape (gains,); infinite: none was found.
        cells: Number of cells that were computed.
    """

    gains: np.ndarray
    cells: int

    @property
    def stable(self) -> bool:
        """Whether the loop is stable on all of the box."""
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
    """Ends of the first intervals of angles, from 0 to pi."""
    slowest = np.abs(np.log(poles[np.abs(poles) > FIRST_ANGLE].astype(complex))).min(initial=1.0)
    return np.concatenate([[0.0], np.geomspace(min(FIRST_ANGLE * slowest, 0.1), np.pi, INTERVALS)])


def cover(
    evaluate: Evaluate,
    ends: tuple[np.ndarray, np.ndarray],
    goals: np.ndarray,
    most: int,
    remaining_points: RemainingPoints = unlimited,
    readout: Readout = SINGLE,
) -> Covered:
    """Bound the gains over a box and all frequencies, by halving the worst cells until the goals are met.

    Args:
        evaluate: The loop at points of the box; it is stable at one of them.
        ends: Lower and upper corner of the box, shape (sides,).
        goals: Bounds that are good enough, shape (gains,).
        most: Number of cells to compute at most.
        remaining_points: Number of points that may still be evaluated.
        readout: The gains.
    """
    models = LinearModels(evaluate, readout.channels)
    channels = readout.channels
    points_per_cell = len(pattern(len(ends[0])))
    if remaining_points() < points_per_cell:
        return Covered(np.full(readout.size, np.inf), 0)
    centre = evaluate(0.5 * (ends[0] + ends[1])[None])[0]
    angles = first_angles(np.linalg.eigvals(centre[:-channels, :-channels]))
    count = len(angles) - 1
    cells = Cells(np.tile(ends[0], (count, 1)), np.tile(ends[1], (count, 1)), angles[:-1], angles[1:])
    bounds = enclose(cells, models.on(cells.low, cells.high), goals, readout)
    cell_count = count
    while True:
        excess = np.max(bounds.gains / goals, axis=1)
        order = np.argsort(-excess)
        worst = order[excess[order] > 1.0][: min(BATCH_CELLS, (most - cell_count) // 2)]
        points = np.cumsum(np.where(bounds.axis[worst] == len(ends[0]), 0, 2 * points_per_cell))
        worst = worst[points <= remaining_points()]
        if not worst.size:
            return Covered(bounds.gains.max(axis=0), cell_count)
        kept_cells = np.setdiff1d(order, worst)
        half_cells = halved(cells.at(worst), bounds.axis[worst])
        halves = enclose(half_cells, models.on(half_cells.low, half_cells.high), goals, readout)
        cells = Cells(*(np.concatenate(parts) for parts in zip(cells.at(kept_cells), half_cells, strict=True)))
        bounds = CellBounds(
            np.concatenate([bounds.gains[kept_cells], halves.gains]),
            np.concatenate([bounds.axis[kept_cells], halves.axis]),
        )
        cell_count += len(half_cells.start)


def halved(cells: Cells, axis: np.ndarray) -> Cells:
    """Both halves of each cell along its axis."""
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


def enclose(cells: Cells, models: Sequence[LinearModel], goals: np.ndarray, readout: Readout) -> CellBounds:
    """Bound the gains on each cell, from the model of its part of the box."""
    centre, slopes, deviation, bends = (np.stack(parts) for parts in zip(*models, strict=True))
    finite = np.all(np.isfinite(deviation), axis=(1, 2)) & np.all(np.isfinite(centre), axis=(1, 2))
    sides = slopes.shape[1]
    channels = readout.channels
    states = slopes.shape[2] - channels
    n, steps, remainder = expansion(cells, centre, slopes, deviation, channels)
    n[~finite] = np.eye(states + 2 * channels)
    with np.errstate(all="ignore"):
        r = inverses(n)
        x = r[:, :, states : states + channels]
        y = r[:, states + channels :]
        sizes = np.abs(r)
        right = steps @ x[:, None]  # N_i x
        left = y[:, None] @ steps  # y N_i
        spread = np.abs(r[:, None] @ steps)  # abs(R N_i)
        k = spread.sum(axis=1) + sizes @ remainder
        inverse = inverses(np.eye(states + 2 * channels) - k)
        lefts = np.abs(left)
        rights = np.abs(r[:, None] @ right)  # abs(R N_i x)
        left_size = lefts.sum(axis=1) + np.abs(y) @ remainder
        right_size = rights.sum(axis=1) + sizes @ remainder @ np.abs(x)
        first = np.abs(y) @ remainder @ np.abs(x)
        response = y[:, :, states : states + channels]
        enclosure = Enclosure(response, y[:, None] @ right, first + left_size @ inverse @ right_size, cells.end)
        gains = readout.gains(enclosure, goals)
        is_bounded = finite & np.all(inverse >= 0.0, axis=(1, 2))
        scales = readout.scales(response)
        left_weights, right_weights = dominant(k)
        left_bounds = np.einsum("nc,nci->ni", scales, left_size @ inverse)
        right_bounds = np.einsum("nic,nc->ni", inverse @ right_size, 1.0 / scales)
        left_weights = np.where(is_bounded[:, None], left_bounds, left_weights)
        right_weights = np.where(is_bounded[:, None], right_bounds, right_weights)
        bend_weights = np.einsum(
            "ni,nij,nkjl,nl->nk", left_weights, sizes, WIDENED * bordered(bends, channels), right_weights
        )
        weights = np.einsum("ni,nkij,nj->nk", left_weights, spread, right_weights)
        direct = np.einsum("nc,nkci,ni->nk", scales, lefts, right_weights)
        direct += np.einsum("ni,nkic,nc->nk", left_weights, rights, 1.0 / scales)
        weights += np.where(is_bounded[:, None], direct, 0.0)
        weights[:, :sides] += bend_weights
    weights[:, sides] *= CHEAPER
    has_no_weights = ~np.all(np.isfinite(weights), axis=1)
    weights[has_no_weights, :sides] = (cells.high - cells.low)[has_no_weights]
    weights[has_no_weights, sides] = (cells.end - cells.start)[has_no_weights]
    return CellBounds(np.where(is_bounded[:, None], gains, np.inf), np.argmax(weights, axis=1))


def expansion(cells: Cells, centre: np.ndarray, slopes: np.ndarray, deviation: np.ndarray, channels: int) -> Expansion:
    """N on each cell, from the stacked fields of its :class:`LinearModel`."""
    states = centre.shape[-1] - channels
    middle = 0.5 * (cells.start + cells.end)
    width = 0.5 * (cells.end - cells.start)
    z = np.exp(1j * middle)
    identity = np.diag([*np.ones(states), *np.zeros(2 * channels)])
    n = z[:, None, None] * identity
    n[:, range(states, states + 2 * channels), range(states, states + 2 * channels)] = 1.0
    n -= bordered(centre, channels)
    angular = (1j * z * width)[:, None, None, None] * identity
    steps = np.concatenate([-bordered(slopes, channels), angular], axis=1)
    remainder = bordered(deviation, channels) + 0.5 * (width**2)[:, None, None] * identity
    return Expansion(n, steps, remainder)


def inverses(matrices: np.ndarray) -> np.ndarray:
    """Inverses of n matrices; NaN for those that have none."""
    try:
        return np.linalg.inv(matrices)
    except np.linalg.LinAlgError:
        result = np.full_like(matrices, np.nan)
        for index, matrix in enumerate(matrices):
            try:
                result[index] = np.linalg.inv(matrix)
            except np.linalg.LinAlgError:
                continue
        return result


def dominant(k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Left and right vectors near those of the largest eigenvalue of nonnegative matrices, shape (n, m) each."""
    square = k
    for _ in range(SQUARINGS):
        square = square @ square
        square /= np.maximum(square.max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    return square.sum(axis=1), square.sum(axis=2)


def bordered(matrices: np.ndarray, channels: int) -> np.ndarray:
    """[[A, B], [C, 0]] as [[A, B, 0], [0, 0, 0], [C, 0, 0]], in the last two axes."""
    m = matrices.shape[-1]
    states = m - channels
    result = np.zeros((*matrices.shape[:-2], m + channels, m + channels), matrices.dtype)
    result[..., :states, :m] = matrices[..., :states, :]
    result[..., m:, :states] = matrices[..., states:, :states]
    return result
