"""A prediction of the slack in standard normal space with its uncertainty, from simulated points.

The prediction decides where to simulate, and hence how many simulations an answer takes. A bad prediction leaves the
answer valid.

Reference:
    G. Matheron, "The intrinsic random functions and their applications", Advances in Applied Probability 5 (1973)
    439-468; S. Dubrule, "Cross validation of kriging in a unique neighborhood", Mathematical Geology 15 (1983) 687-699.
"""

from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.spatial.distance import cdist

from dssc_jax.analyses.probability.surrogate import ROWS, scale_slacks, spline_matrix

SMOOTHINGS = (1e-6, 1e-3, 0.1, 10.0)
NOISY = 0.1  # least smoothing at which the slack is taken to contain in-loop noise or a jump
LOGISTIC_SCALE = np.sqrt(3.0) / np.pi  # scale of the logistic law with standard deviation 1
LEAST_VARIANCE = 1e-12


@dataclass(frozen=True)
class Prediction:
    """A prediction of the scaled slack at any point u: the spline sum_i c_i |u - u_i|^3 + a + b.u.

    Kriging models the slack as a realisation of a random function. This gives the variance of the spline's error.

    Args:
        centres: Simulated points u_i, shape (n, d).
        inverse: Inverse of the spline's matrix, shape (n + d + 1, n + d + 1).
        coefficients: c_i, a and b in this order, shape (n + d + 1,).
        smoothing: Variance of the noise in the slacks, as a multiple of ``variance``.
        variance: Scale of the random function's variance.
    """

    centres: np.ndarray
    inverse: np.ndarray
    coefficients: np.ndarray
    smoothing: float
    variance: float

    @property
    def surprise(self) -> float:
        """How unlikely the simulated slacks are under this prediction: -2 times a log likelihood, up to a constant.

        The likelihood is that of the errors with which each slack is predicted from all other points. In Kriging the
        error at the point i is normal with the variance v/P_ii, where v is :attr:`variance` and P is :attr:`inverse`
        (Dubrule). The squared errors do not appear, since v is such that their mean relative to v/P_ii is 1.
        """
        count = len(self.centres)
        precisions = np.diag(self.inverse)[:count]
        return count * np.log(self.variance) - float(np.log(precisions).sum())

    def failure_probability(self, points: np.ndarray) -> np.ndarray:
        """Predicted probability that a simulation at each of several points fails, shape (n,).

        The error of a smooth slack is assumed to be normal. The error of a noisy slack, such as the largest of many
        readings, has longer tails, and is assumed to be logistic; a normal law would make some failures so improbable
        that, if they occur after all, each would carry much weight.

        Args:
            points: Points in standard normal space, shape (n, d).
        """
        is_noisy = self.smoothing >= NOISY
        probabilities = np.empty(len(points))
        for start in range(0, len(points), ROWS):  # in parts, whose matrices fit into memory
            part = slice(start, start + ROWS)
            basis = self.basis(points[part])
            relative_variance = self.smoothing - np.einsum("ij,ij->i", basis @ self.inverse, basis)
            standard_error = np.sqrt(self.variance * np.maximum(relative_variance, LEAST_VARIANCE))
            scores = -(basis @ self.coefficients) / standard_error
            probabilities[part] = special.expit(scores / LOGISTIC_SCALE) if is_noisy else special.ndtr(scores)
        return probabilities

    def slacks_and_slopes(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predicted slacks, shape (m,), and their derivatives by the coordinates, shape (m, d), at points u.

        The gradient of the spline is sum_i 3 c_i |u - u_i| (u - u_i) + b.

        Args:
            points: Points u, shape (m, d).
        """
        count, dimension = self.centres.shape
        basis = self.basis(points)
        distances = np.cbrt(basis[:, :count])
        factors = 3.0 * distances * self.coefficients[:count]
        slopes = factors.sum(axis=1)[:, None] * points - factors @ self.centres + self.coefficients[-dimension:]
        return basis @ self.coefficients, slopes

    def basis(self, points: np.ndarray) -> np.ndarray:
        """The functions |u - u_i|^3, 1 and u that the coefficients multiply, at points u of shape (m, d).

        Returns:
            Values of the functions, shape (m, n + 1 + d).
        """
        return np.column_stack([cdist(points, self.centres) ** 3, np.ones(len(points)), points])


def fit_prediction(points: np.ndarray, slacks: np.ndarray, smoothings: tuple[float, ...] = SMOOTHINGS) -> Prediction:
    """Fit a prediction to simulated slacks, with the likeliest of several smoothings.

    The likeliest smoothing has the least :attr:`Prediction.surprise`.

    Args:
        points: Simulated points in standard normal space, shape (n, d).
        slacks: Slack at each, shape (n,).
        smoothings: Smoothings to choose from.
    """
    scaled_slacks = scale_slacks(slacks, 0.5)
    predictions = [predict_with(smoothing, points, scaled_slacks) for smoothing in smoothings]
    surprises = [prediction.surprise for prediction in predictions]
    return predictions[surprises.index(min(surprises))]


def predict_with(smoothing: float, points: np.ndarray, scaled_slacks: np.ndarray) -> Prediction:
    """Fit a prediction with a given smoothing, and with the likeliest variance.

    If the slack at the point i is predicted from all other points, the error is c_i/P_ii, with the coefficient c_i and
    the inverse P of the spline's matrix. The variance of this error is v/P_ii, so the likeliest v is the mean of
    c_i^2/P_ii.

    Args:
        smoothing: The smoothing.
        points: Simulated points in standard normal space, shape (n, d).
        scaled_slacks: Scaled slack at each, shape (n,).
    """
    count, dimension = points.shape
    inverse = np.linalg.inv(spline_matrix(points, smoothing))
    coefficients = inverse @ np.concatenate([scaled_slacks, np.zeros(dimension + 1)])
    precisions = np.diag(inverse)[:count]
    variance = max(float(np.mean(coefficients[:count] ** 2 / precisions)), LEAST_VARIANCE)
    return Prediction(points, inverse, coefficients, smoothing, variance)
