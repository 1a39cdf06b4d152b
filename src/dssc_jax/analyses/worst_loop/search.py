"""Search for the worst perturbations of the loop: the worst margins within the box, and the nearest instability."""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.loop_margins.result import MARGIN_KINDS
from dssc_jax.analyses.worst_loop.family import Evaluate, PointsLeft, unlimited
from dssc_jax.engine.linearisation.response import ClassicalMargins, classical_margins, grid_with_poles, response_of

MARGINS = ("gain_upper", "gain_lower", "phase", "delay", "disk", "sensitivity_peak", "complementary_peak")
"""The margins whose worst case is searched."""
UNSTABLE = {"lower": 0.0, "upper": np.inf}
"""The value of a margin of an unstable loop, by the side of its limit."""
MOST_CORNERS = 6  # numbers up to which all corners are tried
RANDOM_POINTS = 64
FIRST_STEP = 0.5  # of the search along each number
SMALLEST_STEP = 1e-3
RADII = 24  # at which stability is tested along a direction
BISECTIONS = 16


class Worst(NamedTuple):
    """The worst value found of a margin, and the point of the box that has it."""

    value: float
    point: np.ndarray


class Instability(NamedTuple):
    """The nearest unstable point found; the growth of the box that reaches it is infinite if none was."""

    growth: float
    point: np.ndarray


def start_points(sides: int) -> np.ndarray:
    """The centre, corners and random points of the box, shape (n, sides)."""
    rng = np.random.default_rng(0)
    corners = rng.choice([-1.0, 1.0], (RANDOM_POINTS, sides))
    if sides <= MOST_CORNERS:
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=sides)))
    return np.concatenate([np.zeros((1, sides)), corners, rng.uniform(-1.0, 1.0, (RANDOM_POINTS, sides))])


def radii_of(matrices: np.ndarray, channels: int = 1) -> np.ndarray:
    """Spectral radius of A in each [[A, B], [C, 0]]; infinite where there is no equilibrium."""
    finite = np.all(np.isfinite(matrices), axis=(1, 2))
    radii = np.full(len(matrices), np.inf)
    if finite.any():
        radii[finite] = np.abs(np.linalg.eigvals(matrices[finite][:, :-channels, :-channels])).max(axis=1)
    return radii


def margins_at(matrices: np.ndarray, common: np.ndarray, sample_time: float) -> np.ndarray:
    """The margins of loops, shape (n, margins); unstable ones have the worst value.

    Args:
        matrices: [[A, b], [c, 0]], shape (n, states + 1, states + 1).
        common: Angles at which every loop is evaluated.
        sample_time: T_s [s].
    """
    result = np.tile([UNSTABLE[MARGIN_KINDS[name].side] for name in MARGINS], (len(matrices), 1))
    stable = radii_of(matrices) < 1.0
    if stable.any():
        a = matrices[stable, :-1, :-1]
        b = matrices[stable, :-1, -1]
        c = matrices[stable, -1, :-1]
        opened = np.linalg.eigvals(a - b[:, :, None] * c[:, None, :])
        angles = grid_with_poles(common, np.concatenate([np.linalg.eigvals(a), opened], axis=1))
        found: ClassicalMargins = classical_margins(response_of(a, b, c), angles, sample_time)
        result[stable] = np.stack([getattr(found, name) for name in MARGINS], axis=1)
    return result


def badness(margins: np.ndarray) -> np.ndarray:
    """Margins, shape (..., margins), with a sign such that larger values are worse."""
    return margins * np.array([-1.0 if MARGIN_KINDS[name].side == "lower" else 1.0 for name in MARGINS])


def worst_margins(
    evaluate: Evaluate, sides: int, common: np.ndarray, sample_time: float, left: PointsLeft = unlimited
) -> list[Worst]:
    """The worst value found of each margin of a loop that is broken in one channel."""

    def margins(points: np.ndarray) -> np.ndarray:
        return margins_at(evaluate(points), common, sample_time)

    return worst_values(margins, badness, sides, left)


def worst_values(
    values_at: Callable[[np.ndarray], np.ndarray],
    badness: Callable[[np.ndarray], np.ndarray],
    sides: int,
    left: PointsLeft = unlimited,
) -> list[Worst]:
    """The worst value found of each quantity: the worst of many points, improved by steps along each number.

    Args:
        values_at: (points, shape (n, sides)) -> values, shape (n, quantities).
        badness: Values, shape (..., quantities) -> numbers of the same shape that are larger where they are worse.
        sides: Number of coordinates.
        left: Number of points that may still be evaluated.
    """
    points = start_points(sides)[: max(1, left())]
    values = values_at(points)
    best = np.argmax(badness(values), axis=0)
    at = points[best]
    quantities = values.shape[1]
    worst = values[best, range(quantities)]
    step = FIRST_STEP
    moves = np.concatenate([np.eye(sides), -np.eye(sides)])
    while step >= SMALLEST_STEP and sides and not np.any(badness(worst) == np.inf):
        trials = np.clip(at[:, None] + step * moves, -1.0, 1.0)
        if left() < len(moves) * quantities:
            break
        found = values_at(trials.reshape(-1, sides)).reshape(*trials.shape[:2], quantities)
        scores = badness(found)
        moved = False
        for index in range(quantities):
            k = int(np.argmax(scores[index, :, index]))
            if scores[index, k, index] > badness(worst)[index] + 1e-12:
                worst[index] = found[index, k, index]
                at[index] = trials[index, k]
                moved = True
        step = step if moved else 0.5 * step
    return [Worst(float(value), point) for value, point in zip(worst, at, strict=True)]


def nearest_instability(evaluate: Evaluate, sides: int, most: float, left: PointsLeft = unlimited) -> Instability:
    """The least growth of the box found that reaches an unstable loop.

    Args:
        evaluate: The loop at points.
        sides: Number of coordinates.
        most: Largest growth to try.
        left: Number of points that may still be evaluated.
    """
    along = RADII + 1 + BISECTIONS  # points on one direction

    def growths(directions: np.ndarray) -> np.ndarray:
        grid = np.linspace(0.0, most, RADII + 1)
        points = (grid[:, None, None] * directions).reshape(-1, sides)
        unstable = radii_of(evaluate(points)).reshape(RADII + 1, -1) >= 1.0
        first = np.argmax(unstable, axis=0)
        low = grid[np.maximum(first - 1, 0)]
        high = np.where(unstable.any(axis=0), grid[first], np.inf)
        reached = np.flatnonzero(np.isfinite(high) & (high > 0.0))
        for _ in range(BISECTIONS if reached.size else 0):
            middle = 0.5 * (low[reached] + high[reached])
            beyond = radii_of(evaluate(middle[:, None] * directions[reached])) >= 1.0
            high[reached] = np.where(beyond, middle, high[reached])
            low[reached] = np.where(beyond, low[reached], middle)
        return high

    directions = start_points(sides)[1:][: max(1, left() // along)]
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    found = growths(directions)
    best = int(np.argmin(found))
    growth = found[best]
    direction = directions[best]
    step = FIRST_STEP
    moves = np.concatenate([np.eye(sides), -np.eye(sides)])
    while np.isfinite(growth) and growth > 0.0 and step >= SMALLEST_STEP:
        trials = np.clip(direction + step * moves, -1.0, 1.0)
        trials = trials[np.abs(trials).max(axis=1) > 0.0]
        trials /= np.abs(trials).max(axis=1, keepdims=True)
        if left() < len(trials) * along:
            break
        found = growths(trials)
        best = int(np.argmin(found))
        if found[best] < growth * (1.0 - 1e-4):
            growth = found[best]
            direction = trials[best]
        else:
            step *= 0.5
    return Instability(float(growth), growth * direction if np.isfinite(growth) else np.full(sides, np.nan))
