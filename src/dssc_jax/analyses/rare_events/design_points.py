"""Design points: the failures nearest to the median draw in standard normal space, and approximations there.

The most probable failures of one kind lie near a design point. Searches from several starts find several design points.
FORM replaces the limit state, the border of failure, by its tangent there, and SORM by a paraboloid. Both are
approximations without an interval.

References:
    R. Rackwitz, B. Fiessler, "Structural reliability under combined random load sequences", Computers and Structures 9
    (1978) 489-494, the search; Y. Zhang, A. Der Kiureghian, "Two improved algorithms for reliability analysis",
    Reliability and Optimization of Structural Systems (1995) 297-304, its merit; K. Breitung, "Asymptotic
    approximations for multinormal integrals", ASCE J. Engineering Mechanics 110 (1984) 357-366, SORM.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from scipy import special

SlopeFunction = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""(points, shape (n, d)) -> slacks, shape (n,), and their derivatives by the coordinates, shape (n, d)."""

ITERATIONS = 100
SHORTER = 0.4  # factor of a step after failure
LONGER = 2.0  # factor of a step after success
SUFFICIENT = 0.1  # share of the predicted decrease that a step has to reach
SMALLEST_STEP = 0.02
SETTLED = 0.02  # length of the last step of a search
ON_BORDER = 0.05  # distance from the border of failure of a point that counts as on it
SAME = 0.7  # distance of two design points that count as one
FARTHER = 2.5  # design points that lie so much farther out than the nearest contribute nothing
CURVATURE_STEP = 0.05  # step of a difference of slopes


class DesignPoint(NamedTuple):
    """The failure that is nearest to the median draw, at least locally.

    Args:
        point: Coordinates in standard normal space, shape (d,).
        distance: Distance beta from the origin, the median draw.
        second_order: Ratio of SORM's probability to FORM's, which is Phi(-beta); NaN if SORM does not exist.
    """

    point: np.ndarray
    distance: float
    second_order: float

    @property
    def first_order_probability(self) -> float:
        """FORM's probability of the failures around this point."""
        return float(special.ndtr(-self.distance))

    @property
    def second_order_probability(self) -> float:
        """SORM's probability of the failures around this point; NaN if it does not exist."""
        return self.first_order_probability * self.second_order


def find_design_points(slacks_and_slopes: SlopeFunction, starts: np.ndarray) -> list[DesignPoint]:
    """Search for design points from several starts at once.

    Each search steps to the point of the border's tangent that is nearest to the origin. A step that lowers the merit
    |u|^2/2 + c |g| by too little is shortened; g is the slack at the point u, and c = 2 |u|/|grad g|.

    Args:
        slacks_and_slopes: Computes the slacks and slopes of points.
        starts: The points at which the searches start, shape (n, d).

    Returns:
        Different design points, the nearest first, without those far beyond the nearest.
    """
    points = starts
    slacks, slopes = slacks_and_slopes(points)
    steps = np.ones(len(points))
    running = np.ones(len(points), bool)
    for _ in range(ITERATIONS):
        if not running.any():
            break
        steepness = np.linalg.norm(slopes, axis=1)
        squared_steepness = np.where(steepness > 0.0, steepness, 1.0) ** 2
        ahead = (np.einsum("ij,ij->i", slopes, points) - slacks) / squared_steepness
        directions = ahead[:, None] * slopes - points
        trials = points + steps[:, None] * directions
        trial_slacks, trial_slopes = slacks_and_slopes(trials)
        penalty = 2.0 * np.linalg.norm(points, axis=1) / np.sqrt(squared_steepness) + 1e-9
        merit = 0.5 * np.sum(points**2, axis=1) + penalty * np.abs(slacks)
        trial_merit = 0.5 * np.sum(trials**2, axis=1) + penalty * np.abs(trial_slacks)
        merit_slope = np.einsum("ij,ij->i", points, directions) - penalty * np.abs(slacks)
        better = running & (trial_merit < merit + SUFFICIENT * steps * merit_slope)
        lengths = np.linalg.norm(trials - points, axis=1)
        points = np.where(better[:, None], trials, points)
        slacks = np.where(better, trial_slacks, slacks)
        slopes = np.where(better[:, None], trial_slopes, slopes)
        steps = np.where(better, np.minimum(LONGER * steps, 1.0), SHORTER * steps)
        running &= ~(better & (lengths < SETTLED)) & (steps >= SMALLEST_STEP)
    on_border = np.abs(slacks) < ON_BORDER * np.linalg.norm(slopes, axis=1)
    distances = np.linalg.norm(points, axis=1)
    border_indices = [index for index in np.argsort(distances) if on_border[index]]
    return [
        DesignPoint(points[index], float(distances[index]), second_order=np.nan)  # with_curvature adds it
        for index in distinct_points(points, border_indices, SAME, len(points))
        if distances[index] <= distances[border_indices[0]] + FARTHER
    ]


def distinct_points(points: np.ndarray, order: Iterable[int], distance: float, most: int) -> list[int]:
    """Indices of points that lie apart from each other, taken one after the other in a given order.

    Args:
        points: Shape (n, d).
        order: Indices of points.
        distance: Distance that a point must exceed from all that were taken before.
        most: Largest number of indices.
    """
    taken: list[int] = []
    for index in order:
        if len(taken) == most:
            break
        if np.all(np.sum((points[taken] - points[index]) ** 2, axis=1) > distance**2):
            taken.append(index)
    return taken


def with_curvature(slacks_and_slopes: SlopeFunction, design_point: DesignPoint) -> DesignPoint:
    """The design point with SORM's factor prod (1 + beta kappa_i)^(-1/2), kappa_i being the border's curvatures.

    Second derivatives are differences of slopes. The factor stays NaN where it does not exist.

    Args:
        slacks_and_slopes: Computes the slacks and slopes of points.
        design_point: The design point.
    """
    point = design_point.point
    dimension = len(point)
    if dimension == 1 or design_point.distance == 0.0:
        return design_point._replace(second_order=1.0)
    shifts = CURVATURE_STEP * np.concatenate([np.eye(dimension), -np.eye(dimension)])
    _, slopes = slacks_and_slopes(point + shifts)
    hessian = (slopes[:dimension] - slopes[dimension:]) / (2.0 * CURVATURE_STEP)
    steepness = float(np.linalg.norm(slopes.mean(axis=0)))
    if not np.isfinite(hessian).all() or steepness == 0.0:
        return design_point
    basis, _ = np.linalg.qr(np.column_stack([point, np.eye(dimension)]))
    tangent = basis[:, 1:dimension]
    curvatures = np.linalg.eigvalsh(tangent.T @ (0.5 * (hessian + hessian.T)) @ tangent) / steepness
    factors = 1.0 + design_point.distance * curvatures
    second_order = float(np.prod(factors) ** -0.5) if np.all(factors > 0.0) else np.nan
    return design_point._replace(second_order=second_order)
