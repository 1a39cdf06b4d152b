"""Bounds of the closed loop's response over a box of uncertain numbers and all frequencies, cell by cell.

A cell is a part of the box and an interval of angles theta = omega T_s. The response is an entry of an inverse,

    G = [N^-1]_(v,w),    N = [[z I - A, -b, 0], [0, 1, 0], [-c, 0, 1]],    z = e^(j theta),

with N = N_0 + D at a point u in [-1, 1]^k of the cell, k - 1 numbers and the angle. With R = N_0^-1, its column x at w
and its row y at v, and absolute values taken entry by entry,

    G = G_0 - y D x + y D N^-1 D x,    abs(y D N^-1 D x) <= abs(y D) (I - K)^-1 abs(R D x),    K >= abs(R D),

where the spectral radius of K must be below 1; (I - K)^-1 >= 0 proves that it is. D is linear in u up to a remainder, D
= sum of u_i N_i + E. So G lies in a polygon, widened by a disk. Where such a K exists on all cells, no eigenvalue of A
meets the unit circle: a loop that is stable at one point of the box is stable on all of it. The cells cover all
frequencies. The states are the modes in the middle of each part of the box, in which K is smallest.

Reference:
    R. E. Moore, R. B. Kearfott, M. J. Cloud, Introduction to Interval Analysis (2009): mean-value form, subdivision.
    R. A. Horn, C. R. Johnson, Matrix Analysis, 2nd ed. (2012), chapter 8, for nonnegative matrices.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import schur

DIRECTIONS = 64  # in which a polygon's extent is computed
WIDENED = 1.5
"""Multiple of the measured deviations from a linear dependence, for those between the points of measurement."""
CORNERED = 4  # numbers up to which the deviations are measured at all corners and edges
RANDOM_CORNERS = 32  # of a box with more numbers
FIRST_ANGLE = 1e-3  # relative to the slowest pole: the first interval of angles begins at 0
INTERVALS = 24  # of angles at the start
BATCH_CELLS = 256
CHEAPER = 3.0  # an interval of angles is halved rather than a box, which has to be linearised again
SQUARINGS = 4  # of a matrix, whose largest eigenvalue then prevails
MOST_PARALLEL = 1e6  # condition number of the modes
ROUNDING = 1e-9  # by which every bound is enlarged, relative
FEEDTHROUGHS = {"sensitivity_peak": 1.0, "complementary_peak": 0.0, "disk": 0.5}
"""What is added to G: S = 1 + G, T = -G, (S - T)/2 = G + 1/2."""
GAINS = (*FEEDTHROUGHS, "delay")
"""The gains that are bounded; that of ``delay`` is abs(T) theta."""

Evaluate = Callable[[np.ndarray], np.ndarray]
"""Points of shape (n, sides) -> [[A, b], [c, 0]] there, shape (n, states + 1, states + 1)."""


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
        gains: An upper bound of each of :data:`GAINS`, shape (n, gains); infinite: none.
        axis: Index of the side to halve next, the angle being the last, shape (n,).
    """

    gains: np.ndarray
    axis: np.ndarray


class Covered(NamedTuple):
    """Bounds over the whole box.

    Args:
        gains: A bound of each of :data:`GAINS`, shape (gains,); infinite: none was found.
        cells: Number of cells that were computed.
    """

    gains: np.ndarray
    cells: int

    @property
    def stable(self) -> bool:
        """Whether the loop is stable on all of the box."""
        return bool(np.all(np.isfinite(self.gains)))


class LinearModel(NamedTuple):
    """[[A, b], [c, 0]] on a part of the box as centre + sum of u_i slopes_i, up to ``deviation`` entry by entry.

    The states are the modes in the middle.

    Args:
        centre: [[A, b], [c, 0]] in the middle, shape (m, m).
        slopes: Shape (sides, m, m).
        deviation: Shape (m, m).
        bends: The part of the deviation along each side, shape (sides, m, m).
    """

    centre: np.ndarray
    slopes: np.ndarray
    deviation: np.ndarray
    bends: np.ndarray


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


def pattern(sides: int) -> np.ndarray:
    """Points of [-1, 1]^sides at which deviations are measured, shape (n, sides).

    The centre, the middles of faces and the points halfway to them come first. With few sides all corners and edges
    follow, else the corners of each pair of sides and random corners.
    """
    unit = np.eye(sides)
    points = [np.zeros((1, sides)), unit, -unit, 0.5 * unit, -0.5 * unit]
    if sides <= CORNERED:
        steps = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=sides)))
        points.append(steps[np.count_nonzero(steps, axis=1) >= max(2, sides - 1)])
    else:
        for i, j in itertools.combinations(range(sides), 2):
            points += [unit[[i]] + unit[[j]], unit[[i]] - unit[[j]], unit[[j]] - unit[[i]], -unit[[i]] - unit[[j]]]
        points.append(np.random.default_rng(0).choice([-1.0, 1.0], (RANDOM_CORNERS, sides)))
    return np.concatenate(points)


class LinearModels:
    """The linear models on parts of the box, each computed once.

    Args:
        evaluate: The loop at points of the box.
    """

    def __init__(self, evaluate: Evaluate) -> None:
        self.evaluate = evaluate
        self.models: dict[bytes, LinearModel] = {}

    def on(self, cells: Cells) -> list[LinearModel]:
        """The model of each cell's part of the box; the loop is evaluated once for all parts that are new."""
        keys = [low.tobytes() + high.tobytes() for low, high in zip(cells.low, cells.high, strict=True)]
        fresh = {key: index for index, key in enumerate(keys) if key not in self.models}
        if fresh:
            indices = list(fresh.values())
            points = pattern(cells.low.shape[1])
            middle = 0.5 * (cells.low + cells.high)[indices, None]
            half = 0.5 * (cells.high - cells.low)[indices, None]
            located = middle + half * points
            matrices = self.evaluate(located.reshape(-1, located.shape[-1]))
            for key, matrices_there in zip(fresh, np.split(matrices, len(indices)), strict=True):
                self.models[key] = linear_model(points, matrices_there)
        return [self.models[key] for key in keys]


def linear_model(points: np.ndarray, matrices: np.ndarray) -> LinearModel:
    """The linear model on a part of the box.

    Args:
        points: Those of :func:`pattern`, at which deviations are measured, shape (n, sides).
        matrices: The loop there, shape (n, m, m).
    """
    sides = points.shape[1]
    matrices = modal(matrices)
    centre = matrices[0]
    slopes = 0.5 * (matrices[1 : 1 + sides] - matrices[1 + sides : 1 + 2 * sides])
    deviations = np.abs(matrices - centre - np.einsum("ni,ijk->njk", points, slopes))
    bends = np.maximum(deviations[1 : 1 + sides], 4.0 * deviations[1 + 2 * sides : 1 + 3 * sides])
    deviation = np.maximum(deviations.max(axis=0), bends.sum(axis=0))
    return LinearModel(centre, slopes, WIDENED * deviation, bends)


def modal(matrices: np.ndarray) -> np.ndarray:
    """[[A, b], [c, 0]] in the modes of the first A, or in its Schur vectors where modes are nearly parallel."""
    a = matrices[0, :-1, :-1]
    if not np.all(np.isfinite(a)):
        return matrices.astype(complex)
    vectors = np.linalg.eig(a)[1]
    if np.linalg.cond(vectors) > MOST_PARALLEL:
        vectors = schur(a, output="complex")[1]
    result = matrices.astype(complex)
    result[:, :-1] = np.linalg.solve(vectors, result[:, :-1])
    result[:, :, :-1] = result[:, :, :-1] @ vectors
    return result


def first_angles(poles: np.ndarray) -> np.ndarray:
    """Ends of the first intervals of angles, from 0 to pi."""
    slowest = np.abs(np.log(poles[np.abs(poles) > FIRST_ANGLE].astype(complex))).min(initial=1.0)
    return np.concatenate([[0.0], np.geomspace(min(FIRST_ANGLE * slowest, 0.1), np.pi, INTERVALS)])


def cover(
    evaluate: Evaluate,
    ends: tuple[np.ndarray, np.ndarray],
    goals: np.ndarray,
    most: int,
    progress: Callable[[int], None],
) -> Covered:
    """Bound the gains over a box and all frequencies, by halving the worst cells until the goals are met.

    Args:
        evaluate: The loop at points of the box; it is stable at one of them.
        ends: Lower and upper corner of the box, shape (sides,).
        goals: Bounds that are good enough, shape (gains,).
        most: Number of cells to compute at most.
        progress: Called with the number of cells computed.
    """
    models = LinearModels(evaluate)
    centre = evaluate(0.5 * (ends[0] + ends[1])[None])[0]
    angles = first_angles(np.linalg.eigvals(centre[:-1, :-1]))
    count = len(angles) - 1
    cells = Cells(np.tile(ends[0], (count, 1)), np.tile(ends[1], (count, 1)), angles[:-1], angles[1:])
    bounds = enclose(cells, models.on(cells))
    computed = count
    while True:
        excess = np.max(bounds.gains / goals, axis=1)
        order = np.argsort(-excess)
        worst = order[excess[order] > 1.0][: min(BATCH_CELLS, (most - computed) // 2)]
        if not worst.size:
            return Covered(bounds.gains.max(axis=0), computed)
        kept = np.setdiff1d(order, worst)
        fresh = halved(cells.at(worst), bounds.axis[worst])
        halves = enclose(fresh, models.on(fresh))
        cells = Cells(*(np.concatenate(parts) for parts in zip(cells.at(kept), fresh, strict=True)))
        bounds = CellBounds(
            np.concatenate([bounds.gains[kept], halves.gains]), np.concatenate([bounds.axis[kept], halves.axis])
        )
        computed += len(fresh.start)
        progress(computed)


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


def enclose(cells: Cells, models: Sequence[LinearModel]) -> CellBounds:
    """Bound the gains on each cell, from the model of its part of the box."""
    centre, slopes, deviation, bends = (np.stack(parts) for parts in zip(*models, strict=True))
    finite = np.all(np.isfinite(deviation), axis=(1, 2)) & np.all(np.isfinite(centre), axis=(1, 2))
    _, sides, m, _ = slopes.shape
    states = m - 1
    n, steps, remainder = expansion(cells, centre, slopes, deviation)
    n[~finite] = np.eye(m + 1)
    with np.errstate(all="ignore"):
        r = inverses(n)
        x = r[:, :, states]
        y = r[:, m]
        sizes = np.abs(r)
        right = np.einsum("nkij,nj->nki", steps, x)  # N_i x
        left = np.einsum("ni,nkij->nkj", y, steps)  # y N_i
        linear = np.einsum("ni,nki->nk", y, right)
        spread = np.abs(r[:, None] @ steps)  # abs(R N_i)
        k = spread.sum(axis=1) + sizes @ remainder
        inverse = inverses(np.eye(m + 1) - k)
        lefts = np.abs(left)
        rights = np.abs(np.einsum("nij,nkj->nki", r, right))  # abs(R N_i x)
        left_size = lefts.sum(axis=1) + np.einsum("ni,nij->nj", np.abs(y), remainder)
        right_size = rights.sum(axis=1) + np.einsum("nij,njk,nk->ni", sizes, remainder, np.abs(x))
        first = np.einsum("ni,nij,nj->n", np.abs(y), remainder, np.abs(x))
        disk = first + np.einsum("ni,nij,nj->n", left_size, inverse, right_size)
        gains = []
        for feedthrough in FEEDTHROUGHS.values():
            gains.append((1.0 + ROUNDING) * (extent(r[:, m, states] + feedthrough, linear) + disk))
        gains.append(gains[1] * cells.end)
        bounded = finite & np.all(inverse >= 0.0, axis=(1, 2))
        left_weights, right_weights = dominant(k)
        left_weights = np.where(bounded[:, None], np.einsum("ni,nij->nj", left_size, inverse), left_weights)
        right_weights = np.where(bounded[:, None], np.einsum("nij,nj->ni", inverse, right_size), right_weights)
        bent = np.einsum("ni,nij,nkjl,nl->nk", left_weights, sizes, WIDENED * bordered(bends), right_weights)
        weights = np.einsum("ni,nkij,nj->nk", left_weights, spread, right_weights)
        direct = np.einsum("nki,ni->nk", lefts, right_weights) + np.einsum("ni,nki->nk", left_weights, rights)
        weights += np.where(bounded[:, None], direct, 0.0)
        weights[:, :sides] += bent
    weights[:, sides] *= CHEAPER
    unknown = ~np.all(np.isfinite(weights), axis=1)
    weights[unknown, :sides] = (cells.high - cells.low)[unknown]
    weights[unknown, sides] = (cells.end - cells.start)[unknown]
    return CellBounds(np.where(bounded[:, None], np.stack(gains, axis=1), np.inf), np.argmax(weights, axis=1))


def expansion(cells: Cells, centre: np.ndarray, slopes: np.ndarray, deviation: np.ndarray) -> Expansion:
    """N on each cell, from the stacked fields of its :class:`LinearModel`."""
    states = centre.shape[-1] - 1
    middle = 0.5 * (cells.start + cells.end)
    width = 0.5 * (cells.end - cells.start)
    z = np.exp(1j * middle)
    identity = np.diag([*np.ones(states), 0.0, 0.0])
    n = z[:, None, None] * identity
    n[:, states, states] = 1.0
    n[:, states + 1, states + 1] = 1.0
    n -= bordered(centre)
    angular = (1j * z * width)[:, None, None, None] * identity
    steps = np.concatenate([-bordered(slopes), angular], axis=1)
    remainder = bordered(deviation) + 0.5 * (width**2)[:, None, None] * identity
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


def bordered(matrices: np.ndarray) -> np.ndarray:
    """[[A, b], [c, 0]] as [[A, b, 0], [0, 0, 0], [c, 0, 0]], in the last two axes."""
    m = matrices.shape[-1]
    result = np.zeros((*matrices.shape[:-2], m + 1, m + 1), matrices.dtype)
    result[..., : m - 1, :m] = matrices[..., : m - 1, :]
    result[..., m, : m - 1] = matrices[..., m - 1, : m - 1]
    return result


def extent(centre: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """A bound of abs(centre + sum of u_i generators_i), u_i in [-1, 1]; shapes (n,) and (n, k)."""
    turns = np.exp(-2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
    reach = np.real(centre[:, None] * turns)
    for generator in generators.T:
        reach += np.abs(np.real(generator[:, None] * turns))
    return reach.max(axis=1) / np.cos(np.pi / DIRECTIONS)
