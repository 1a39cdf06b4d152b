"""Bounds of the closed loop's response over a box of uncertain numbers and all frequencies, cell by cell.

A cell is a part of the box and an interval of angles theta = omega T_s. The loop x+ = A x + B w, v = C x is broken in
some channels: w enters there and v comes back. Its response G from w to v is a block of an inverse,

    G = [N^-1]_(v,w),    N = [[z I - A, -B, 0], [0, I, 0], [-C, 0, I]],    z = e^(j theta),

a single entry if one channel is broken. N_0 is N in the middle of the cell. At a point u in [-1, 1]^k of the cell N is
N_0 + D; the coordinates u are those of k - 1 numbers and, last, of the angle. With R = N_0^-1, its columns x at w, its
rows y at v, and absolute values taken entry by entry,

    G = G_0 - y D x + y D N^-1 D x,    abs(y D N^-1 D x) <= abs(y D) (I - K)^-1 abs(R D x),    K >= abs(R D),

where the spectral radius of K must be below 1; (I - K)^-1 >= 0 proves that it is. D is linear in u up to a remainder E:
D = sum of u_i N_i + E. So an entry of G lies in a polygon, widened by a disk. Where such a K exists on all cells, no
eigenvalue of A meets the unit circle: a loop that is stable at one point of the box is stable on all of it. The cells
cover all frequencies. The states are the modes in the middle of each part of the box, in which K is smallest.

Shapes: N has m rows, a row for each state and two for each channel.

Reference:
    R. E. Moore, R. B. Kearfott, M. J. Cloud, Introduction to Interval Analysis (2009): mean-value form, subdivision.
    R. A. Horn, C. R. Johnson, Matrix Analysis, 2nd ed. (2012), chapter 8, for nonnegative matrices.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.worst_loop.family import Evaluate, RemainingPoints
from dssc_jax.analyses.worst_loop.linear_models import (
    WIDENED,
    LinearModel,
    LinearModels,
    measurement_points,
    stack_models,
)
from dssc_jax.analyses.worst_loop.matrices import add_border, dominant_vectors, invert
from dssc_jax.analyses.worst_loop.readouts import SINGLE_READOUT, Enclosure, Readout

FIRST_ANGLE = 1e-3  # end of the first interval of angles, which begins at 0, relative to the slowest pole
INTERVALS = 24  # further intervals of angles at the start, up to pi
BATCH_CELLS = 256  # most cells that are halved at once
CHEAPER = 3.0  # preference for halving an interval of angles, since half a box has to be linearised again
GAP = 1.05  # ratio of a bound to the value found, at which the search for a better bound ends
UNBOUNDED = np.inf  # the bound of a gain that has none


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

    def select(self, indices: np.ndarray) -> "Cells":
        """The cells at some indices."""
        return Cells(self.low[indices], self.high[indices], self.start[indices], self.end[indices])

    def join(self, further: "Cells") -> "Cells":
        """These cells, then further ones."""
        return Cells(*(np.concatenate(columns) for columns in zip(self, further, strict=True)))


class CellBounds(NamedTuple):
    """Bounds of the gains on n cells, and the side along which each cell is halved next.

    Args:
        gains: An upper bound of each gain of the readout, shape (n, gains); infinite where there is none.
        axis: Index of the side to halve, shape (n,); the index after the last side means the angle.
    """

    gains: np.ndarray
    axis: np.ndarray

    def select(self, indices: np.ndarray) -> "CellBounds":
        """The bounds on the cells at some indices."""
        return CellBounds(self.gains[indices], self.axis[indices])

    def join(self, further: "CellBounds") -> "CellBounds":
        """The bounds on these cells, then those on further ones."""
        return CellBounds(np.concatenate([self.gains, further.gains]), np.concatenate([self.axis, further.axis]))


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
        """Whether all bounds are finite, which shows that the loop is stable on all of the box."""
        return bool(np.all(np.isfinite(self.gains)))


class Expansion(NamedTuple):
    """N on n cells as N_0 + sum of u_i N_i + E, where N = [[z I - A, -B, 0], [0, I, 0], [-C, 0, I]].

    Args:
        middle: N_0, N in the middle of each cell, shape (n, m, m).
        steps: N_i, half the change of N across the cell along each side and, last, along the angle; shape
            (n, sides + 1, m, m).
        remainder: A bound of abs(E), what is not linear in the coordinates u, shape (n, m, m).
    """

    middle: np.ndarray
    steps: np.ndarray
    remainder: np.ndarray


def first_angles(poles: np.ndarray) -> np.ndarray:
    """Ends of the first intervals of angles omega T_s, from 0 to pi, shape (INTERVALS + 1,).

    The first interval begins at 0 and ends well below the angle of the slowest pole. From there on, the ends are evenly
    spaced in the logarithm.

    Args:
        poles: Poles of the loop in the middle of the box, shape (states,).
    """
    lasting_poles = poles[np.abs(poles) > FIRST_ANGLE].astype(complex)  # the others decay within one sample
    slowest_pole_angle = np.abs(np.log(lasting_poles)).min(initial=1.0)  # |s| T_s, as z = exp(s T_s)
    first = min(FIRST_ANGLE * slowest_pole_angle, 0.1)
    return np.concatenate([[0.0], np.geomspace(first, np.pi, INTERVALS)])


def cover_box(
    evaluate: Evaluate,
    ends: tuple[np.ndarray, np.ndarray],
    goals: np.ndarray,
    most_cells: int,
    remaining_points: RemainingPoints,
    readout: Readout = SINGLE_READOUT,
) -> CoverBounds:
    """Bound the gains over a box and all frequencies, by halving the worst cells until the goals are met.

    Args:
        evaluate: The loop at points of the box; it is stable at one of them.
        ends: Lower and upper corner of the box, shape (sides,).
        goals: Bounds that are good enough, shape (gains,).
        most_cells: Largest number of cells to compute; the first :data:`INTERVALS` are computed in any case.
        remaining_points: () -> number of points that may still be evaluated.
        readout: The gains, and how they are bounded.
    """
    sides = len(ends[0])
    points_per_part = len(measurement_points(sides))
    if remaining_points() < points_per_part:
        return CoverBounds(np.full(readout.size, UNBOUNDED), cells=0)
    models = LinearModels(evaluate, readout.channels)
    cells = first_cells(evaluate, ends, readout.channels)
    bounds = bound_cells(cells, models.on(cells.low, cells.high), goals, readout)
    cell_count = len(cells.start)
    while True:
        excess = np.max(bounds.gains / goals, axis=1)
        worst_first = np.argsort(-excess)
        halvable = min(BATCH_CELLS, max(0, most_cells - cell_count) // 2)
        worst = worst_first[excess[worst_first] > 1.0][:halvable]
        is_angular = bounds.axis[worst] == sides  # both halves share the linear model of their part of the box
        points_so_far = np.cumsum(np.where(is_angular, 0, 2 * points_per_part))
        worst = worst[points_so_far <= remaining_points()]
        if not worst.size:
            return CoverBounds(bounds.gains.max(axis=0), cell_count)
        kept = np.setdiff1d(worst_first, worst)
        halves = halve(cells.select(worst), bounds.axis[worst])
        half_bounds = bound_cells(halves, models.on(halves.low, halves.high), goals, readout)
        cells = cells.select(kept).join(halves)
        bounds = bounds.select(kept).join(half_bounds)
        cell_count += len(halves.start)


def first_cells(evaluate: Evaluate, ends: tuple[np.ndarray, np.ndarray], channels: int) -> Cells:
    """The cells with which a cover begins: the whole box, at each of :data:`INTERVALS` intervals of angles.

    Args:
        evaluate: The loop at points of the box.
        ends: Lower and upper corner of the box, shape (sides,).
        channels: Number of channels in which the loop is broken.
    """
    low, high = ends
    middle = 0.5 * (low + high)
    matrices = evaluate(middle[None])[0]  # [[A, B], [C, 0]]
    angles = first_angles(np.linalg.eigvals(matrices[:-channels, :-channels]))
    count = len(angles) - 1
    return Cells(np.tile(low, (count, 1)), np.tile(high, (count, 1)), angles[:-1], angles[1:])


def halve(cells: Cells, axis: np.ndarray) -> Cells:
    """Halve n cells, each along one of its sides: 2 n cells, all lower halves first, then the upper halves.

    Args:
        cells: The n cells.
        axis: For each cell the index of the side to halve, shape (n,); the index after the last side means the angle.
    """
    lower = Cells(*(part.copy() for part in cells))
    upper = Cells(*(part.copy() for part in cells))
    is_angular = axis == cells.low.shape[1]
    middle_angles = 0.5 * (cells.start + cells.end)
    lower.end[is_angular] = middle_angles[is_angular]
    upper.start[is_angular] = middle_angles[is_angular]
    rows = np.flatnonzero(~is_angular)
    sides = axis[rows]
    middles = 0.5 * (cells.low[rows, sides] + cells.high[rows, sides])
    lower.high[rows, sides] = middles
    upper.low[rows, sides] = middles
    return lower.join(upper)


def bound_cells(cells: Cells, models: Sequence[LinearModel], goals: np.ndarray, readout: Readout) -> CellBounds:
    """Bound the gains on each cell, from the linear model of its part of the box.

    On a cell the response is G = G_0 - y D x + y D N^-1 D x, with N = N_0 + D and R = N_0^-1, whose columns at the
    broken channels' inputs are x and whose rows at their outputs are y.

    Args:
        cells: The n cells.
        models: The linear model of each cell's part of the box.
        goals: Bounds that are good enough, shape (gains,).
        readout: The gains, and how they are bounded.
    """
    centre, slopes, deviation, bends = stack_models(models)
    is_finite = np.all(np.isfinite(deviation), axis=(1, 2)) & np.all(np.isfinite(centre), axis=(1, 2))
    sides = slopes.shape[1]
    channels = readout.channels
    states = slopes.shape[2] - channels
    inputs = slice(states, states + channels)
    outputs = slice(states + channels, None)
    n_0, steps, remainder = expand(cells, centre, slopes, deviation, channels)
    n_0[~is_finite] = np.eye(states + 2 * channels)  # a matrix with an inverse; these cells get no bound
    with np.errstate(all="ignore"):
        r = invert(n_0)
        x = r[:, :, inputs]
        y = r[:, outputs]
        change = inverse_change(r, x, y, steps, remainder)
        response = y[:, :, inputs]  # G_0
        linear = y[:, None] @ (steps @ x[:, None])  # y N_i x; the sign does not matter, since u_i takes both
        nonlinear = np.abs(y) @ remainder @ np.abs(x)  # abs(y E x) at most
        second_order = change.left_size @ change.inverse @ change.right_size  # abs(y D N^-1 D x) at most
        gains = readout.gains(Enclosure(response, linear, nonlinear + second_order, cells.end), goals)
        is_bounded = is_finite & np.all(change.inverse >= 0.0, axis=(1, 2))
        weights = side_weights(change, add_border(bends, channels), readout.scales(response), is_bounded)
    weights[:, sides] *= CHEAPER  # index sides: the angle
    has_no_weights = ~np.all(np.isfinite(weights), axis=1)  # for such cells the widest side is halved
    weights[has_no_weights, :sides] = (cells.high - cells.low)[has_no_weights]
    weights[has_no_weights, sides] = (cells.end - cells.start)[has_no_weights]
    return CellBounds(np.where(is_bounded[:, None], gains, UNBOUNDED), np.argmax(weights, axis=1))


class InverseChange(NamedTuple):
    """Sizes of the terms by which the inverse N^-1 differs on n cells from R, the inverse in the middle of each cell.

    N = N_0 + D with D = sum of u_i N_i + E. The columns of R at the inputs of the broken channels are x, and the rows
    of R at their outputs are y. Absolute values are taken entry by entry.

    Args:
        sizes: abs(R), shape (n, m, m).
        spread: abs(R N_i), shape (n, sides + 1, m, m).
        left: abs(y N_i), shape (n, sides + 1, channels, m).
        right: abs(R N_i x), shape (n, sides + 1, m, channels).
        left_size: A bound of abs(y D), shape (n, channels, m).
        right_size: A bound of abs(R D x), shape (n, m, channels).
        k: K, a bound of abs(R D), shape (n, m, m).
        inverse: (I - K)^-1, shape (n, m, m); a negative entry shows that K is too large for a bound.
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
    """Bound the terms by which N^-1 differs from R, the inverse in the middle of each of n cells.

    Args:
        r: R, shape (n, m, m).
        x: The columns of R at the inputs, shape (n, m, channels).
        y: The rows of R at the outputs, shape (n, channels, m).
        steps: N_i, half the change of N across the cell along each side and the angle, shape (n, sides + 1, m, m).
        remainder: A bound of abs(E), the change of N that is not linear, shape (n, m, m).
    """
    sizes = np.abs(r)
    spread = np.abs(r[:, None] @ steps)
    left = np.abs(y[:, None] @ steps)
    right = np.abs(r[:, None] @ (steps @ x[:, None]))
    k = spread.sum(axis=1) + sizes @ remainder  # bounds abs(R D) for D = N - N_0 = sum of u_i N_i + E
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
    """How much each side of a cell contributes to the cell's bounds, shape (n, sides + 1), the angle last.

    With weights s of the channels, the second-order bound is s |y D| (I - K)^-1 |R D x| 1/s. The weight of side i is
    the change of this bound with the size of N_i: a sum of three terms, one for each factor. If a cell has no bound
    yet, the weight is the change of the spectral radius of K, which must become less than 1. The side with the largest
    weight is halved next.

    Args:
        change: Sizes of the terms of N^-1.
        bends: Deviations of N from a linear dependence on each coordinate alone, shape (n, sides, m, m).
        scales: s, positive, shape (n, channels).
        is_bounded: Whether each cell has a bound, shape (n,).
    """
    left_eigenvectors, right_eigenvectors = dominant_vectors(change.k)
    left_bounds = np.einsum("nc,nci->ni", scales, change.left_size @ change.inverse)  # s |y D| (I - K)^-1
    right_bounds = np.einsum("nic,nc->ni", change.inverse @ change.right_size, 1.0 / scales)
    left_weights = np.where(is_bounded[:, None], left_bounds, left_eigenvectors)
    right_weights = np.where(is_bounded[:, None], right_bounds, right_eigenvectors)
    # n: cell, k: side, c: channel; i, j, l: rows and columns of N
    bend_weights = np.einsum("ni,nij,nkjl,nl->nk", left_weights, change.sizes, WIDENED * bends, right_weights)
    weights = np.einsum("ni,nkij,nj->nk", left_weights, change.spread, right_weights)
    outer_factors = np.einsum("nc,nkci,ni->nk", scales, change.left, right_weights)
    outer_factors += np.einsum("ni,nkic,nc->nk", left_weights, change.right, 1.0 / scales)
    weights += np.where(is_bounded[:, None], outer_factors, 0.0)
    weights[:, : bends.shape[1]] += bend_weights  # the angle has no bends
    return weights


def expand(cells: Cells, centre: np.ndarray, slopes: np.ndarray, deviation: np.ndarray, channels: int) -> Expansion:
    """Expand N = [[z I - A, -B, 0], [0, I, 0], [-C, 0, I]] on each cell, to first order in coordinates and angle.

    Args:
        cells: The n cells.
        centre: [[A, B], [C, 0]] in the middle of each part of the box, shape (n, states + channels, states + channels).
        slopes: Half the change of [[A, B], [C, 0]] along each side, shape (n, sides, states + channels,
            states + channels).
        deviation: A bound of the deviations of [[A, B], [C, 0]] from the linear function, of the shape of ``centre``.
        channels: Columns of B.
    """
    states = centre.shape[-1] - channels
    middle_angle = 0.5 * (cells.start + cells.end)
    half_width = 0.5 * (cells.end - cells.start)
    z = np.exp(1j * middle_angle)
    state_identity = np.diag([*np.ones(states), *np.zeros(2 * channels)])  # the matrix by which z is multiplied
    n_0 = z[:, None, None] * state_identity
    n_0[:, range(states, states + 2 * channels), range(states, states + 2 * channels)] = 1.0
    n_0 -= add_border(centre, channels)
    angular_step = (1j * z * half_width)[:, None, None, None] * state_identity  # dz/dtheta = j z
    steps = np.concatenate([-add_border(slopes, channels), angular_step], axis=1)
    second_order = 0.5 * (half_width**2)[:, None, None] * state_identity  # |z - z_0 - j z_0 dtheta| <= dtheta^2 / 2
    remainder = add_border(deviation, channels) + second_order
    return Expansion(n_0, steps, remainder)
