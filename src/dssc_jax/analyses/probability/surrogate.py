"""A prediction of the slack from some simulated draws, and of how likely a draw with a predicted slack fails.

Nothing rests on the prediction but the number of draws: the strata that it makes are sampled, whatever it is worth.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize, special
from scipy.spatial.distance import cdist

ROWS = 4096  # points of a batch
SMOOTHING = 1e-3  # of the interpolation, which does not follow in-loop noise
FOLDS = 4  # of the cross-validation
PRIOR = 0.05  # weight of the logistic curve's prior


def scaled(slacks: np.ndarray, level: float = 0.25) -> np.ndarray:
    """Slacks on a scale that is linear up to a quantile of their sizes, and logarithmic beyond.

    A slack without a value (-inf) becomes the smallest.
    """
    finite = np.isfinite(slacks)
    sizes = np.abs(slacks[finite])
    scale = (float(np.quantile(sizes, level)) if sizes.size else 1.0) or 1.0
    smallest = min(float(slacks[finite].min(initial=0.0)), -scale)
    return np.arcsinh(np.where(finite, slacks, smallest) / scale)


class Interpolation(NamedTuple):
    """A smooth function sum_i c_i |x - x_i|^3 + a + b.x of points of the unit cube.

    SciPy's RBFInterpolator gives the same values; this one takes a fifth of its time for many points.

    Args:
        centres: x_i, shape (n, d).
        coefficients: c_i, shape (n,).
        plane: a and b, shape (1 + d,).
    """

    centres: np.ndarray
    coefficients: np.ndarray
    plane: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Values at points of shape (m, d), shape (m,)."""
        values = self.plane[0] + points @ self.plane[1:]
        for start in range(0, len(points), ROWS):
            part = slice(start, start + ROWS)
            distances = cdist(points[part], self.centres)
            values[part] += (distances * distances * distances) @ self.coefficients
        return values


def interpolation(points: np.ndarray, values: np.ndarray) -> Interpolation:
    """The interpolation of values, shape (n,), at points, shape (n, d), smoothed.

    Reference:
        G. Wahba, Spline Models for Observational Data (1990), chapter 2.
    """
    count, dimension = points.shape
    matrix = spline_matrix(points, SMOOTHING)
    coefficients = linalg.solve(matrix, np.concatenate([values, np.zeros(dimension + 1)]), assume_a="sym")
    return Interpolation(points, coefficients[:count], coefficients[count:])


def spline_matrix(points: np.ndarray, smoothing: float) -> np.ndarray:
    """The symmetric matrix whose solution is an interpolation of points, shape (n, d); shape (n + d + 1, n + d + 1)."""
    count, dimension = points.shape
    matrix = np.zeros((count + dimension + 1, count + dimension + 1))
    matrix[:count, :count] = cdist(points, points) ** 3 + smoothing * np.eye(count)
    matrix[:count, count] = 1.0
    matrix[:count, count + 1 :] = points
    matrix[count:, :count] = matrix[:count, count:].T
    return matrix


@dataclass
class Surrogate:
    """A prediction of the slack.

    Args:
        points: Simulated points of the unit cube, shape (n, d).
        slacks: Their slacks, shape (n,).
        counts: How many points each stands for, shape (n,): less than 1 where points were chosen densely. The curve
            would otherwise be that of the chosen points, among which more predictions are in doubt.
    """

    points: np.ndarray
    slacks: np.ndarray
    counts: np.ndarray
    function: Interpolation = field(init=False)
    curve: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        values = scaled(self.slacks)
        self.function = interpolation(self.points, values)
        predicted = np.empty(len(values))
        fold = np.arange(len(values)) % FOLDS
        for part in range(FOLDS):
            left_out = fold == part
            function = interpolation(self.points[~left_out], values[~left_out])
            predicted[left_out] = function(self.points[left_out])
        self.curve = logistic_curve(predicted, self.slacks < 0.0, self.counts)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Predicted slacks, scaled, of points of shape (n, d)."""
        return self.function(points)

    def failing(self, predictions: np.ndarray) -> np.ndarray:
        """Probability that a draw with a prediction fails, by the logistic curve."""
        intercept, slope = self.curve
        return special.expit(intercept - slope * predictions)


def logistic_curve(predictions: np.ndarray, failed: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Intercept a and slope b of the curve 1/(1 + exp(-(a - b s))) of failures over predictions s, counted so often."""
    signs = np.where(failed, 1.0, -1.0)

    def loss(curve: np.ndarray) -> float:
        intercept, slope = curve
        fit = counts @ np.logaddexp(0.0, -signs * (intercept - slope * predictions))
        return float(fit + PRIOR * (intercept**2 + slope**2))

    return optimize.minimize(loss, np.array([0.0, 1.0]), method="Nelder-Mead").x
