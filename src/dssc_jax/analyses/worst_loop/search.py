"""Search for the worst perturbations of the loop: the worst margins within the box, and the nearest instability."""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.loop_margins.result import MARGIN_KINDS
from dssc_jax.analyses.worst_loop.family import Evaluate, RemainingPoints
from dssc_jax.engine.linearisation.response import ClassicalMargins, classical_margins, grid_with_poles, response_of

MARGINS = ("gain_upper", "gain_lower", "phase", "delay", "disk", "sensitivity_peak", "complementary_peak")
"""The margins whose worst case is searched."""
UNSTABLE = {"lower": 0.0, "upper": np.inf}
"""The value of a margin of an unstable loop, by the side of its limit."""
MOST_CORNERS = 6  # numbers up to which all corners are tried
RANDOM_POINTS = 64  # random points at which a search begins
FIRST_STEP = 0.5  # first step of a search along each coordinate
SMALLEST_STEP = 1e-3
LEAST_GAIN = 1e-12  # least amount by which a step has to worsen the worst value
LEAST_SHRINKAGE = 1e-4  # share by which a step has to reduce the growth to an instability
GROWTH_STEPS = 24  # steps of the growth along a direction, after each of which stability is tested
BISECTIONS = 16  # bisections of the step of growth in which a loop becomes unstable


class WorstPoint(NamedTuple):
    """The worst value of a quantity that a search found, and its point of the box, shape (sides,)."""

    value: float
    point: np.ndarray


class Instability(NamedTuple):
    """The point with an unstable loop, nearest to the middle of the box, that a search found.

    Args:
        growth: Factor by which the box has to grow to reach the point; infinite if no such point was found.
        point: Coordinates of the point, shape (sides,); NaN if no such point was found.
    """

    growth: float
    point: np.ndarray


def start_points(sides: int) -> np.ndarray:
    """The points of the box [-1, 1]^sides at which a search begins: centre, corners, random points; shape (n, sides).

    With at most :data:`MOST_CORNERS` sides these are all corners, with more sides random corners.
    """
    rng = np.random.default_rng(0)
    corners = rng.choice([-1.0, 1.0], (RANDOM_POINTS, sides))
    if sides <= MOST_CORNERS:
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=sides)))
    return np.concatenate([np.zeros((1, sides)), corners, rng.uniform(-1.0, 1.0, (RANDOM_POINTS, sides))])


def unit_moves(sides: int) -> np.ndarray:
    """Moves by 1 along each coordinate, then by -1 along each, shape (2 sides, sides)."""
    return np.concatenate([np.eye(sides), -np.eye(sides)])


def spectral_radii(matrices: np.ndarray, channels: int = 1) -> np.ndarray:
    """Largest modulus of a pole of each loop, shape (n,): below 1 for a stable loop, infinite without an equilibrium.

    Args:
        matrices: [[A, B], [C, 0]], shape (n, states + channels, states + channels); NaN without an equilibrium.
        channels: Columns of B.
    """
    is_finite = np.all(np.isfinite(matrices), axis=(1, 2))
    radii = np.full(len(matrices), np.inf)
    if is_finite.any():
        poles = np.linalg.eigvals(matrices[is_finite][:, :-channels, :-channels])
        radii[is_finite] = np.abs(poles).max(axis=1)
    return radii


def margins_at(matrices: np.ndarray, common_angles: np.ndarray, sample_time: float) -> np.ndarray:
    """The :data:`MARGINS` of n loops, shape (n, margins); those of an unstable loop are the worst possible values.

    Args:
        matrices: [[A, b], [c, 0]], shape (n, states + 1, states + 1).
        common_angles: omega T_s at which every loop is evaluated, besides angles near its poles.
        sample_time: T_s [s].
    """
    of_unstable_loop = [UNSTABLE[MARGIN_KINDS[name].side] for name in MARGINS]
    result = np.tile(of_unstable_loop, (len(matrices), 1))
    is_stable = spectral_radii(matrices) < 1.0
    if is_stable.any():
        a = matrices[is_stable, :-1, :-1]
        b = matrices[is_stable, :-1, -1]
        c = matrices[is_stable, -1, :-1]
        closed_loop_poles = np.linalg.eigvals(a)
        open_loop_poles = np.linalg.eigvals(a - b[:, :, None] * c[:, None, :])
        angles = grid_with_poles(common_angles, np.concatenate([closed_loop_poles, open_loop_poles], axis=1))
        margins: ClassicalMargins = classical_margins(response_of(a, b, c), angles, sample_time)
        result[is_stable] = np.stack([getattr(margins, name) for name in MARGINS], axis=1)
    return result


def badness(margins: np.ndarray) -> np.ndarray:
    """Margins in the order of :data:`MARGINS`, shape (..., margins), with signs that make larger values worse."""
    signs = [-1.0 if MARGIN_KINDS[name].side == "lower" else 1.0 for name in MARGINS]
    return margins * np.array(signs)


def worst_margins(
    evaluate: Evaluate,
    sides: int,
    common_angles: np.ndarray,
    sample_time: float,
    remaining_points: RemainingPoints,
) -> list[WorstPoint]:
    """Search the box for the worst value of each of the :data:`MARGINS`; the loop is broken in one channel.

    Args:
        evaluate: The loop at points of the box.
        sides: Number of coordinates.
        common_angles: omega T_s at which every loop is evaluated.
        sample_time: T_s [s].
        remaining_points: () -> number of points that may still be evaluated.
    """

    def margins_at_points(points: np.ndarray) -> np.ndarray:
        """The :data:`MARGINS` of the loops at points of shape (n, sides), shape (n, margins)."""
        return margins_at(evaluate(points), common_angles, sample_time)

    return worst_values(margins_at_points, badness, sides, remaining_points)


def worst_values(
    values_at: Callable[[np.ndarray], np.ndarray],
    badness: Callable[[np.ndarray], np.ndarray],
    sides: int,
    remaining_points: RemainingPoints,
) -> list[WorstPoint]:
    """Search the box for the worst value of each quantity: the worst of many points, improved by coordinate steps.

    The step is halved when it improves no quantity. The search ends when the step is below its smallest size, when no
    points are left, or when a quantity has an infinitely bad value.

    Args:
        values_at: (points, shape (n, sides)) -> values, shape (n, quantities).
        badness: Values, shape (..., quantities) -> numbers of the same shape that are larger where they are worse.
        sides: Number of coordinates.
        remaining_points: () -> number of points that may still be evaluated.
    """
    points = start_points(sides)[: max(1, remaining_points())]
    values = values_at(points)
    quantities = values.shape[1]
    worst_rows = np.argmax(badness(values), axis=0)  # one for each quantity
    worst_points = points[worst_rows]
    worst = values[worst_rows, range(quantities)]
    step = FIRST_STEP
    moves = unit_moves(sides)
    while step >= SMALLEST_STEP and sides and not np.any(badness(worst) == np.inf):
        if remaining_points() < len(moves) * quantities:
            break
        trials = np.clip(worst_points[:, None] + step * moves, -1.0, 1.0)
        trial_values = values_at(trials.reshape(-1, sides)).reshape(*trials.shape[:2], quantities)
        trial_badness = badness(trial_values)
        has_improved = False
        for index in range(quantities):
            k = int(np.argmax(trial_badness[index, :, index]))  # among the trials about this quantity's worst point
            if trial_badness[index, k, index] > badness(worst)[index] + LEAST_GAIN:
                worst[index] = trial_values[index, k, index]
                worst_points[index] = trials[index, k]
                has_improved = True
        if not has_improved:
            step *= 0.5
    return [WorstPoint(float(value), point) for value, point in zip(worst, worst_points, strict=True)]


def nearest_instability(
    evaluate: Evaluate, sides: int, most_growth: float, remaining_points: RemainingPoints
) -> Instability:
    """Search for the least growth of the box that reaches an unstable loop.

    The growth is computed along many directions from the middle of the box. Coordinate steps then improve the direction
    with the least growth.

    Args:
        evaluate: The loop at points of the grown box.
        sides: Number of coordinates.
        most_growth: Largest growth to try.
        remaining_points: Number of points that may still be evaluated.
    """
    points_per_direction = GROWTH_STEPS + 1 + BISECTIONS
    without_centre = start_points(sides)[1:]
    directions = to_faces(without_centre[: max(1, remaining_points() // points_per_direction)])
    growths = growths_to_instability(evaluate, directions, most_growth)
    best = int(np.argmin(growths))
    growth = growths[best]
    direction = directions[best]
    step = FIRST_STEP
    while np.isfinite(growth) and growth > 0.0 and step >= SMALLEST_STEP:
        trials = np.clip(direction + step * unit_moves(sides), -1.0, 1.0)
        trials = to_faces(trials[np.any(trials != 0.0, axis=1)])  # the middle has no direction
        if remaining_points() < len(trials) * points_per_direction:
            break
        growths = growths_to_instability(evaluate, trials, most_growth)
        best = int(np.argmin(growths))
        if growths[best] < growth * (1.0 - LEAST_SHRINKAGE):
            growth = growths[best]
            direction = trials[best]
        else:
            step *= 0.5
    return Instability(float(growth), growth * direction if np.isfinite(growth) else np.full(sides, np.nan))


def to_faces(directions: np.ndarray) -> np.ndarray:
    """Scale directions of shape (n, sides) so that each ends on a face of the box [-1, 1]^sides."""
    return directions / np.abs(directions).max(axis=1, keepdims=True)


def growths_to_instability(evaluate: Evaluate, directions: np.ndarray, most_growth: float) -> np.ndarray:
    """The growth of the box at which the loop becomes unstable along each direction, shape (n,).

    The growth is infinite if no loop tested along the direction is unstable, and 0 if the loop in the middle of the box
    is unstable. Stability is tested on a grid of growths. The step of the grid in which it is lost is bisected.

    Args:
        evaluate: The loop at points of the grown box.
        directions: Points on the faces of the box, shape (n, sides).
        most_growth: Largest growth to try.
    """
    sides = directions.shape[1]
    grid = np.linspace(0.0, most_growth, GROWTH_STEPS + 1)
    points = (grid[:, None, None] * directions).reshape(-1, sides)
    is_unstable = spectral_radii(evaluate(points)).reshape(GROWTH_STEPS + 1, -1) >= 1.0
    first = np.argmax(is_unstable, axis=0)
    low = grid[np.maximum(first - 1, 0)]
    high = np.where(is_unstable.any(axis=0), grid[first], np.inf)
    bisected = np.flatnonzero(np.isfinite(high) & (high > 0.0))
    if not bisected.size:
        return high
    for _ in range(BISECTIONS):
        middle = 0.5 * (low[bisected] + high[bisected])
        is_beyond = spectral_radii(evaluate(middle[:, None] * directions[bisected])) >= 1.0
        high[bisected] = np.where(is_beyond, middle, high[bisected])
        low[bisected] = np.where(is_beyond, low[bisected], middle)
    return high
