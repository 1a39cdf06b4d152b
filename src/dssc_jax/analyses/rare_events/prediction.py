"""A prediction of the slack in standard normal space with its uncertainty, from simulated points.

It decides where to simulate, and hence how many simulations an answer takes. A bad prediction leaves the answer valid.

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
    """A spline sum_i c_i |u - u_i|^3 + a + b.u of the scaled slack, with the variance of its error by kriging.

    Args:
        centres: Simulated points u_i, shape (n, d).
        inverse: Inverse of the spline's matrix, shape (n + d + 1, n + d + 1).
        coefficients: c_i, a and b, shape (n + d + 1,).
        smoothing: Variance of the noise, relative to ``variance``.
        variance: Factor of the error's variance.
    """

    centres: np.ndarray
    inverse: np.ndarray
    coefficients: np.ndarray
    smoothing: float
    variance: float

    def failure_probability(self, points: np.ndarray) -> np.ndarray:
        """Probability that a simulation at each point of shape (n, d) fails, shape (n,).

        The error of a smooth slack is assumed to be normal. That of a noisy one, such as the largest of many readings,
        has longer tails and is assumed to be logistic, since an unexpected failure would carry much weight.
        """
        probabilities = np.empty(len(points))
        for start in range(0, len(points), ROWS):
            part = slice(start, start + ROWS)
            basis = self.basis(points[part])
            variance = self.smoothing - np.einsum("ij,ij->i", basis @ self.inverse, basis)
            error = np.sqrt(self.variance * np.maximum(variance, LEAST_VARIANCE))
            scores = -(basis @ self.coefficients) / error
            is_noisy = self.smoothing >= NOISY
            probabilities[part] = special.expit(scores / LOGISTIC_SCALE) if is_noisy else special.ndtr(scores)
        return probabilities

    def slacks_and_slopes(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predicted slacks, shape (n,), and their slopes, shape (n, d), at points of shape (n, d)."""
        count, dimension = self.centres.shape
        basis = self.basis(points)
        factors = 3.0 * np.cbrt(basis[:, :count]) * self.coefficients[:count]
        slopes = factors.sum(axis=1)[:, None] * points - factors @ self.centres + self.coefficients[-dimension:]
        return basis @ self.coefficients, slopes

    def basis(self, points: np.ndarray) -> np.ndarray:
        """The values at points of shape (m, d) that the coefficients multiply, shape (m, n + 1 + d)."""
        return np.column_stack([cdist(points, self.centres) ** 3, np.ones(len(points)), points])


def fit_prediction(points: np.ndarray, slacks: np.ndarray, smoothings: tuple[float, ...] = SMOOTHINGS) -> Prediction:
    """Fit a prediction to slacks, shape (n,), at points, shape (n, d).

    The smoothing is the one under which the points, each predicted from all others, are most likely.
    """
    count, dimension = points.shape
    values = np.concatenate([scale_slacks(slacks, 0.5), np.zeros(dimension + 1)])
    candidates = []
    for smoothing in smoothings:
        inverse = np.linalg.inv(spline_matrix(points, smoothing))
        coefficients = inverse @ values
        precisions = np.diag(inverse)[:count]
        variance = max(float(np.mean(coefficients[:count] ** 2 / precisions)), LEAST_VARIANCE)
        surprise = count * np.log(variance) - float(np.log(precisions).sum())
        candidates.append((surprise, Prediction(points, inverse, coefficients, smoothing, variance)))
    return min(candidates, key=lambda candidate: candidate[0])[1]
