"""A prediction of the slack from some simulated draws, and the probability of failure at a predicted slack.

The prediction only decides how many draws an answer takes. A bad prediction leaves the answer valid.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize, special
from scipy.spatial.distance import cdist

ROWS = 4096  # points of a batch
SMOOTHING = 1e-3  # smoothing of the interpolation, so that it does not follow in-loop noise
FOLDS = 4  # folds of the cross-validation
PRIOR = 0.05  # weight of the prior of the logistic curve


def scale_slacks(slacks: np.ndarray, level: float = 0.25) -> np.ndarray:
    """Slacks on a scale that is linear near 0 and logarithmic far from it, arcsinh(s/scale), shape (n,).

    A spline predicts the scaled slack well on both sides of the border of failure.

    Args:
        slacks: The slacks s, shape (n,). A slack that is not finite, such as -inf for a draw without a slack, is
            replaced by the smallest finite slack, or by minus the scale if that is smaller.
        level: The scale is this quantile of |s|; 1 if it is 0.
    """
    finite = np.isfinite(slacks)
    sizes = np.abs(slacks[finite])
    scale = float(np.quantile(sizes, level)) if sizes.size else 1.0
    if scale == 0.0:
        scale = 1.0
    smallest = min(float(slacks[finite].min(initial=0.0)), -scale)
    return np.arcsinh(np.where(finite, slacks, smallest) / scale)


class Interpolation(NamedTuple):
    """A smooth function of points x of the unit cube: the spline sum_i c_i |x - x_i|^3 + a + b.x.

    SciPy's RBFInterpolator gives the same values, in five times the time for many points.

    Args:
        centres: The points x_i to which the function was fitted, shape (n, d).
        coefficients: c_i, shape (n,).
        plane: a, then b, shape (1 + d,).
    """

    centres: np.ndarray
    coefficients: np.ndarray
    plane: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Values of the function, shape (m,).

        Args:
            points: Shape (m, d).
        """
        values = self.plane[0] + points @ self.plane[1:]
        for start in range(0, len(points), ROWS):  # in parts, whose distances fit into memory
            part = slice(start, start + ROWS)
            distances = cdist(points[part], self.centres)
            values[part] += (distances * distances * distances) @ self.coefficients
        return values


def fit_interpolation(points: np.ndarray, values: np.ndarray) -> Interpolation:
    """Fit a spline to values at points, with a little smoothing, so that it does not follow in-loop noise.

    Args:
        points: Points of the unit cube, shape (n, d).
        values: Value at each, shape (n,).

    Reference:
        G. Wahba, Spline Models for Observational Data (1990), chapter 2.
    """
    count, dimension = points.shape
    matrix = spline_matrix(points, SMOOTHING)
    coefficients = linalg.solve(matrix, np.concatenate([values, np.zeros(dimension + 1)]), assume_a="sym")
    return Interpolation(points, coefficients[:count], coefficients[count:])


def spline_matrix(points: np.ndarray, smoothing: float) -> np.ndarray:
    """The symmetric matrix of the linear equations for the coefficients of a spline :class:`Interpolation`.

    The first n equations set the values at the points. The other d + 1 equations make the coefficients c_i orthogonal
    to the constant and to each coordinate of the points x_i.

    Args:
        points: Points x_i, shape (n, d).
        smoothing: Added to the diagonal of the first n equations; 0: the function passes through all values.

    Returns:
        Shape (n + d + 1, n + d + 1), for the coefficients c_i, a and b of :class:`Interpolation`.
    """
    count, dimension = points.shape
    matrix = np.zeros((count + dimension + 1, count + dimension + 1))
    matrix[:count, :count] = cdist(points, points) ** 3 + smoothing * np.eye(count)
    matrix[:count, count] = 1.0
    matrix[:count, count + 1 :] = points
    matrix[count:, :count] = matrix[:count, count:].T
    return matrix


@dataclass
class Surrogate:
    """A prediction of the slack at any point of the unit cube, from simulated points.

    A logistic curve gives the probability of failure at a predicted slack. The curve is fitted to predictions by
    cross-validation, whose errors are about as large as the errors at new points.

    Args:
        points: Simulated points of the unit cube, shape (n, d).
        slacks: Slack at each point, shape (n,).
        counts: Weight of each point in the logistic curve, shape (n,): below 1 where points were chosen densely.
        function: Predicts the scaled slack; fitted here.
        curve: Intercept and slope of the logistic curve, see :func:`logistic_curve`; fitted here.
    """

    points: np.ndarray
    slacks: np.ndarray
    counts: np.ndarray
    function: Interpolation = field(init=False)
    curve: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        """Fit the prediction to all points, and the logistic curve to predictions of points left out of the fit."""
        values = scale_slacks(self.slacks)
        self.function = fit_interpolation(self.points, values)
        predicted = np.empty(len(values))
        fold_of_point = np.arange(len(values)) % FOLDS
        for fold in range(FOLDS):
            left_out = fold_of_point == fold
            function = fit_interpolation(self.points[~left_out], values[~left_out])
            predicted[left_out] = function(self.points[left_out])
        self.curve = logistic_curve(predicted, self.slacks < 0.0, self.counts)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Predicted slacks on the scale of :func:`scale_slacks`, shape (n,).

        Args:
            points: Points of the unit cube, shape (n, d).
        """
        return self.function(points)

    def failure_probability(self, predictions: np.ndarray) -> np.ndarray:
        """Probability that a draw with each predicted slack fails, by the logistic curve, shape (n,).

        Args:
            predictions: Predicted slacks, scaled, shape (n,).
        """
        intercept, slope = self.curve
        return special.expit(intercept - slope * predictions)


def logistic_curve(predictions: np.ndarray, failed: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Fit a logistic curve to failures: the probability 1/(1 + exp(-(a - b s))) over the predicted slack s.

    Args:
        predictions: Predicted slacks s, shape (n,).
        failed: Whether each draw failed, shape (n,).
        counts: Weight of each draw, shape (n,).

    Returns:
        Intercept a and slope b, shape (2,).
    """
    signs = np.where(failed, 1.0, -1.0)

    def loss(curve: np.ndarray) -> float:
        """Negative log likelihood of the failures, plus a normal prior on ``curve`` (a, b), which keeps both finite."""
        intercept, slope = curve
        surprise = counts @ np.logaddexp(0.0, -signs * (intercept - slope * predictions))
        return float(surprise + PRIOR * (intercept**2 + slope**2))

    first_curve = np.array([0.0, 1.0])
    return optimize.minimize(loss, first_curve, method="Nelder-Mead").x
