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
RANDOM_POINTS = 64
FIRST_STEP = 0.5  # of the search along each number
SMALLEST_STEP = 1e-3
RADII = 24  # at which stability is tested along a direction
BISECTIONS = 16


class WorstPoint(NamedTuple):
    """The worst value of a quantity that a search found, and the point of the box that has it, shape (sides,)."""

    value: float
    point: np.ndarray


class Instability(NamedTuple):
    """The unstable point nearest to the middle of the box that a search found.

    Args:
        growth: Factor by which the box has to grow to reach it; infinite if no such point was found.
        point: Coordinates, shape (sides,); NaN if no such point was found.
    """

    growth: float
    point: np.ndarray


def start_points(sides: int) -> np.ndarray:
    """The centre, corners and random points of the box [-1, 1]^sides, shape (n, sides)."""
    rng = np.random.default_rng(0)
    corners = rng.choice([-1.0, 1.0], (RANDOM_POINTS, sides))
    if sides <= MOST_CORNERS:
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=sides)))
    return np.concatenate([np.zeros((1, sides)), corners, rng.uniform(-1.0, 1.0, (RANDOM_POINTS, sides))])


def radii_of(matrices: np.ndarray, channels: int = 1) -> np.ndarray:
    """Spectral radius of A in each [[A, B], [C, 0]], shape (n,); infinite where there is no equilibrium.

    Args:
        matrices: Shape (n, states + channels, states + channels).
        channels: Columns of B.
    """
    finite = np.all(np.isfinite(matrices), axis=(1, 2))
    radii = np.full(len(matrices), np.inf)
    if finite.any():
        radii[finite] = np.abs(np.linalg.eigvals(matrices[finite][:, :-channels, :-channels])).max(axis=1)
    return radii


def margins_at(matrices: np.ndarray, common_angles: np.ndarray, sample_time: float) -> np.ndarray:
    """The :data:`MARGINS` of n loops, shape (n, margins); an unstable loop has the worst values.

    Args:
        matrices: [[A, b], [c, 0]], shape (n, states + 1, states + 1).
        common_angles: omega T_s at which every loop is evaluated, besides angles near its poles.
        sample_time: T_s [s].
    """
    result = np.tile([UNSTABLE[MARGIN_KINDS[name].side] for name in MARGINS], (len(matrices), 1))
    stable = radii_of(matrices) < 1.0
    if stable.any():
        a = matrices[stable, :-1, :-1]
        b = matrices[stable, :-1, -1]
        c = matrices[stable, -1, :-1]
        open_loop_poles = np.linalg.eigvals(a - b[:, :, None] * c[:, None, :])
        angles = grid_with_poles(common_angles, np.concatenate([np.linalg.eigvals(a), open_loop_poles], axis=1))
        margins: ClassicalMargins = classical_margins(response_of(a, b, c), angles, sample_time)
        result[stable] = np.stack([getattr(margins, name) for name in MARGINS], axis=1)
    return result


def badness(margins: np.ndarray) -> np.ndarray:
    """The :data:`MARGINS`, shape (..., margins), signed so that larger values are worse."""
    return margins * np.array([-1.0 if MARGIN_KINDS[name].side == "lower" else 1.0 for name in MARGINS])


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
        remaining_points: Number of points that may still be evaluated.
    """

    def margins(points: np.ndarray) -> np.ndarray:
        return margins_at(evaluate(points), common_angles, sample_time)

    return worst_values(margins, badness, sides, remaining_points)


def worst_values(
    values_at: Callable[[np.ndarray], np.ndarray],
    badness: Callable[[np.ndarray], np.ndarray],
    sides: int,
    remaining_points: RemainingPoints,
) -> list[WorstPoint]:
    """Search the box for the worst value of each quantity: the worst of many points, improved by coordinate steps.

    Args:
        values_at: (points, shape (n, sides)) -> values, shape (n, quantities).
        badness: Values, shape (..., quantities) -> numbers of the same shape that are larger where they are worse.
        sides: Number of coordinates.
        remaining_points: Number of points that may still be evaluated.
    """
    points = start_points(sides)[: max(1, remaining_points())]
    values = values_at(points)
    best = np.argmax(badness(values), axis=0)
    worst_points = points[best]
    quantities = values.shape[1]
    worst = values[best, range(quantities)]
    step = FIRST_STEP
    moves = np.concatenate([np.eye(sides), -np.eye(sides)])
    while step >= SMALLEST_STEP and sides and not np.any(badness(worst) == np.inf):
        trials = np.clip(worst_points[:, None] + step * moves, -1.0, 1.0)
        if remaining_points() < len(moves) * quantities:
            break
        trial_values = values_at(trials.reshape(-1, sides)).reshape(*trials.shape[:2], quantities)
        scores = badness(trial_values)
        has_improved = False
        for index in range(quantities):
            k = int(np.argmax(scores[index, :, index]))
            if scores[index, k, index] > badness(worst)[index] + 1e-12:
                worst[index] = trial_values[index, k, index]
                worst_points[index] = trials[index, k]
                has_improved = True
        step = step if has_improved else 0.5 * step
    return [WorstPoint(float(value), point) for value, point in zip(worst, worst_points, strict=True)]


def nearest_instability(evaluate: Evaluate, sides: int, most: float, remaining_points: RemainingPoints) -> Instability:
    """Search for the least growth of the box that reaches an unstable loop.

    The growth is found along many directions from the middle, and the best direction is improved by coordinate steps.

    Args:
        evaluate: The loop at points of the grown box.
        sides: Number of coordinates.
        most: Largest growth to try.
        remaining_points: Number of points that may still be evaluated.
    """
    points_per_direction = RADII + 1 + BISECTIONS

    def growths(directions: np.ndarray) -> np.ndarray:
        """The growth at which the loop becomes unstable along each direction; infinite if it does not."""
        grid = np.linspace(0.0, most, RADII + 1)
        points = (grid[:, None, None] * directions).reshape(-1, sides)
        unstable = radii_of(evaluate(points)).reshape(RADII + 1, -1) >= 1.0
        first = np.argmax(unstable, axis=0)
        low = grid[np.maximum(first - 1, 0)]
        high = np.where(unstable.any(axis=0), grid[first], np.inf)
        unstable_directions = np.flatnonzero(np.isfinite(high) & (high > 0.0))
        for _ in range(BISECTIONS if unstable_directions.size else 0):
            middle = 0.5 * (low[unstable_directions] + high[unstable_directions])
            beyond = radii_of(evaluate(middle[:, None] * directions[unstable_directions])) >= 1.0
            high[unstable_directions] = np.where(beyond, middle, high[unstable_directions])
            low[unstable_directions] = np.where(beyond, low[unstable_directions], middle)
        return high

    directions = start_points(sides)[1:][: max(1, remaining_points() // points_per_direction)]
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    trial_growths = growths(directions)
    best = int(np.argmin(trial_growths))
    growth = trial_growths[best]
    direction = directions[best]
    step = FIRST_STEP
    moves = np.concatenate([np.eye(sides), -np.eye(sides)])
    while np.isfinite(growth) and growth > 0.0 and step >= SMALLEST_STEP:
        trials = np.clip(direction + step * moves, -1.0, 1.0)
        trials = trials[np.abs(trials).max(axis=1) > 0.0]
        trials /= np.abs(trials).max(axis=1, keepdims=True)
        if remaining_points() < len(trials) * points_per_direction:
            break
        trial_growths = growths(trials)
        best = int(np.argmin(trial_growths))
        if trial_growths[best] < growth * (1.0 - 1e-4):
            growth = trial_growths[best]
            direction = trials[best]
        else:
            step *= 0.5
    return Instability(float(growth), growth * direction if np.isfinite(growth) else np.full(sides, np.nan))
