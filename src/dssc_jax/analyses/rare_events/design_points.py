"""Design points: the failures nearest to the median draw in standard normal space, and approximations there.

The most probable failures of a kind lie near a design point. Searches from several starts find several design points.
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
SAME = 0.7  # distance of two design points that count as the same
FARTHER = 2.5  # design points that lie so much farther out than the nearest contribute nothing
CURVATURE_STEP = 0.05  # step of a difference of slopes


class DesignPoint(NamedTuple):
    """A failure that is nearer to the median draw than all failures around it.

    The failures around this point have a probability of about Phi(-beta), with the standard normal distribution Phi and
    the distance beta. FORM, the first-order method, finds this by replacing the border of failure by its tangent. SORM,
    the second-order method, takes a paraboloid instead.

    Args:
        point: Coordinates in standard normal space, shape (d,).
        distance: Distance beta from the origin, which is the median draw.
        second_order: Ratio of the probability by SORM to the probability by FORM; NaN if it is not computed yet, or if
            the paraboloid does not bound the failures.
    """

    point: np.ndarray
    distance: float
    second_order: float

    @property
    def first_order_probability(self) -> float:
        """Probability of the failures around this point by FORM: Phi(-beta), the part behind the border's tangent."""
        return float(special.ndtr(-self.distance))

    @property
    def second_order_probability(self) -> float:
        """Probability of the failures around this point by SORM, behind the border's paraboloid; NaN without SORM."""
        return self.first_order_probability * self.second_order


def find_design_points(slacks_and_slopes: SlopeFunction, starts: np.ndarray) -> list[DesignPoint]:
    """Different design points, the nearest to the median draw first, from searches that start at several points.

    All searches advance together, so that slacks are computed in batches. Each search steps towards the point nearest
    to the origin on the tangent of the border of failure. A step that lowers the merit (:func:`merits`) too little is
    refused, and the next trial is shorter.

    Args:
        slacks_and_slopes: Computes the slacks and slopes of points.
        starts: The points at which the searches start, shape (n, d).

    Returns:
        The design points; those much farther away than the nearest one are left out. ``second_order`` is NaN;
        :func:`with_curvature` computes it.
    """
    points = starts
    slacks, slopes = slacks_and_slopes(points)
    steps = np.ones(len(points))  # each search's share of the full step to the tangent
    running = np.ones(len(points), bool)
    for _ in range(ITERATIONS):
        if not running.any():
            break
        full_steps, penalties = tangent_steps(points, slacks, slopes)
        trials = points + steps[:, None] * full_steps
        trial_slacks, trial_slopes = slacks_and_slopes(trials)
        merit_slopes = np.einsum("ij,ij->i", points, full_steps) - penalties * np.abs(slacks)  # along the full steps
        bounds = merits(points, slacks, penalties) + SUFFICIENT * steps * merit_slopes
        better = running & (merits(trials, trial_slacks, penalties) < bounds)
        has_settled = better & (np.linalg.norm(trials - points, axis=1) < SETTLED)
        points = np.where(better[:, None], trials, points)
        slacks = np.where(better, trial_slacks, slacks)
        slopes = np.where(better[:, None], trial_slopes, slopes)
        steps = np.where(better, np.minimum(LONGER * steps, 1.0), SHORTER * steps)
        running &= ~has_settled & (steps >= SMALLEST_STEP)
    is_on_border = np.abs(slacks) < ON_BORDER * np.linalg.norm(slopes, axis=1)
    distances = np.linalg.norm(points, axis=1)
    nearest_first = [index for index in np.argsort(distances) if is_on_border[index]]
    design_points = []
    for index in distinct_points(points, nearest_first, SAME, limit=len(points)):
        if distances[index] <= distances[nearest_first[0]] + FARTHER:
            design_points.append(DesignPoint(points[index], float(distances[index]), second_order=np.nan))
    return design_points


def tangent_steps(points: np.ndarray, slacks: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps of searches to the point nearest to the origin on the border's tangent, and penalties of the merit.

    At the point u with the slack g, the step is (grad g.u - g)/|grad g|^2 grad g - u, and the penalty is
    c = 2 |u|/|grad g|, large enough for the step to lower the merit.

    Args:
        points: Points u of the searches, shape (n, d).
        slacks: Slack g at each, shape (n,).
        slopes: Derivatives grad g of the slack, shape (n, d).

    Returns:
        The steps, shape (n, d), and the penalties c, shape (n,).
    """
    steepness = np.linalg.norm(slopes, axis=1)
    squared_steepness = np.where(steepness > 0.0, steepness, 1.0) ** 2
    multiples = (np.einsum("ij,ij->i", slopes, points) - slacks) / squared_steepness
    penalties = 2.0 * np.linalg.norm(points, axis=1) / np.sqrt(squared_steepness) + 1e-9
    return multiples[:, None] * slopes - points, penalties


def merits(points: np.ndarray, slacks: np.ndarray, penalties: np.ndarray) -> np.ndarray:
    """Merit |u|^2/2 + c |g| of each point, shape (n,): small near the origin and near the border of failure.

    Args:
        points: Points u, shape (n, d).
        slacks: Slack g at each, shape (n,).
        penalties: Factor c of each, shape (n,).
    """
    return 0.5 * np.sum(points**2, axis=1) + penalties * np.abs(slacks)


def distinct_points(points: np.ndarray, order: Iterable[int], distance: float, limit: int) -> list[int]:
    """Indices of points that lie apart from each other: each point taken excludes the later points near it.

    Args:
        points: The points, shape (n, d).
        order: Indices of points, in the order in which they are considered.
        distance: A point is taken only if it is farther than this from all points taken before.
        limit: Largest number of indices.
    """
    taken: list[int] = []
    for index in order:
        if len(taken) == limit:
            break
        squared_distances = np.sum((points[taken] - points[index]) ** 2, axis=1)
        if np.all(squared_distances > distance**2):
            taken.append(index)
    return taken


def with_curvature(slacks_and_slopes: SlopeFunction, design_point: DesignPoint) -> DesignPoint:
    """A copy of a design point with ``second_order``, the ratio of the probability by SORM to the probability by FORM.

    The ratio is prod (1 + beta kappa_i)^(-1/2), with the distance beta and the border's curvatures kappa_i. Second
    derivatives of the slack are differences of slopes. The ratio is NaN if some 1 + beta kappa_i is not positive, or
    if the curvatures cannot be computed.

    Args:
        slacks_and_slopes: Computes the slacks and slopes of points.
        design_point: The design point.
    """
    point = design_point.point
    dimension = len(point)
    if dimension == 1 or design_point.distance == 0.0:  # the border has no curvature, or beta = 0 makes every factor 1
        return design_point._replace(second_order=1.0)
    shifts = CURVATURE_STEP * np.concatenate([np.eye(dimension), -np.eye(dimension)])
    _, slopes = slacks_and_slopes(point + shifts)
    hessian = (slopes[:dimension] - slopes[dimension:]) / (2.0 * CURVATURE_STEP)
    steepness = float(np.linalg.norm(slopes.mean(axis=0)))
    if not np.isfinite(hessian).all() or steepness == 0.0:
        return design_point
    basis, _ = np.linalg.qr(np.column_stack([point, np.eye(dimension)]))  # its first column is along the point
    tangent = basis[:, 1:dimension]  # the directions within the border
    curvatures = np.linalg.eigvalsh(tangent.T @ (0.5 * (hessian + hessian.T)) @ tangent) / steepness
    factors = 1.0 + design_point.distance * curvatures
    second_order = float(np.prod(factors) ** -0.5) if np.all(factors > 0.0) else np.nan
    return design_point._replace(second_order=second_order)
