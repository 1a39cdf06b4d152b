"""A prediction of an output by polynomials, as a control variate of its Sobol indices: polynomial chaos.

The polynomials are products of at most two Legendre polynomials of the numbers' levels. They are orthonormal, so that
the indices of a prediction are sums of squared coefficients, without a simulation. An index of the output is the index
of the prediction plus a correction from the simulations. The better the prediction, the less the correction scatters.
The coefficients for the rows of a replicate come from all other replicates, so that the correction has no bias.

Reference:
    B. Sudret, Reliability Engineering and System Safety 93 (2008) 964-979.
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg

MOST_DEGREE = 10
DEGREES = ((3, 0), (5, 2), (8, 4), (MOST_DEGREE, 8))
"""Nested sets of polynomials: (largest degree in one number, largest degree in two numbers together)."""
MOST_TERMS = 700
SIMULATIONS_OF_TERM = 5
"""Least number of simulations in a fit for each polynomial."""
FIT_ROWS = 512  # largest number of rows of each sample in a fit
FEWEST_EXPLAINED = 0.3  # share of the variance that a prediction must explain to be used
RIDGE = 1.0  # added to the diagonal of the normal equations of a fit, which is about the number of simulations


class Term(NamedTuple):
    """A term of a prediction: a product of Legendre polynomials of two numbers, or a polynomial of one number.

    Args:
        first: Index of the first number.
        first_degree: Degree in the first number, at least 1.
        second: Index of the second number; for a polynomial of one number, the index of that number again.
        second_degree: Degree in the second number; 0 for a polynomial of one number.
    """

    first: int
    first_degree: int
    second: int
    second_degree: int


class ChaosPrediction(NamedTuple):
    """A prediction of an output, without its mean, and exact variances of the prediction.

    Each replicate has coefficients of its own, so the variances differ between replicates.

    Args:
        values: Predicted values at A, B and each AB_i, shape (2 + factors, rows).
        alone: For each of d numbers, the variance of the terms in this number only, shape (replicates, d).
        total: For each of d numbers, the variance of all terms that contain the number, shape (replicates, d).
        variance: Variance of the prediction, shape (replicates,).
    """

    values: np.ndarray
    alone: np.ndarray
    total: np.ndarray
    variance: np.ndarray


def nested_terms(dimension: int) -> tuple[list[Term], list[int]]:
    """The terms in d numbers, sorted so that each of the nested sets in :data:`DEGREES` consists of the first terms.

    Returns:
        All terms, and the number of terms of each set, in ascending order.
    """
    terms: dict[Term, None] = {}  # a dictionary keeps the order, and each term once
    counts = []
    for degree_alone, degree_together in DEGREES:
        for first in range(dimension):
            for degree in range(1, degree_alone + 1):
                terms[Term(first, degree, first, 0)] = None
            for second in range(first + 1, dimension):
                for p in range(1, degree_together):
                    for q in range(1, degree_together - p + 1):
                        terms[Term(first, p, second, q)] = None
        counts.append(len(terms))
    return list(terms), counts


class Chaos:
    """Predicts outputs by polynomials that are fitted on the samples of a design; see :meth:`predict`.

    All outputs share the polynomials' values and the normal equations, which are computed once.

    Args:
        samples: Points of the unit cube of A, B and each AB_i, shape (2 + factors, rows, d).
        replicates: Number of replicates; row i belongs to replicate i mod this number.
    """

    def __init__(self, samples: np.ndarray, replicates: int) -> None:
        """Choose the sets of polynomials for which there are enough samples, and factorise their normal equations."""
        self.samples = samples
        self.replicate_rows = [slice(r, None, replicates) for r in range(replicates)]
        self.training_points = samples[:, :FIT_ROWS]
        simulations = self.training_points.shape[0] * self.training_points.shape[1]
        largest = min(MOST_TERMS, simulations // SIMULATIONS_OF_TERM)
        terms, counts = nested_terms(samples.shape[-1])
        self.counts = [count for count in counts if count <= largest]
        self.terms = np.array(terms[: max(self.counts, default=0)], int).reshape(-1, 4)  # the fields of Term
        self.training_bases = [self.basis(points) for points in self.training_points]
        width = len(self.terms) + 1
        squares = np.zeros((replicates, width, width))
        for basis in self.training_bases:
            squares += np.stack([basis[rows].T @ basis[rows] for rows in self.replicate_rows])
        self.normal_factors = {}  # Cholesky factors, by number of terms
        for count in self.counts:
            self.normal_factors[count] = factorise_normal_equations(squares[:, : count + 1, : count + 1])

    def basis(self, points: np.ndarray) -> np.ndarray:
        """Values of the constant and of all terms at points of the unit cube, shape (n, 1 + terms).

        Args:
            points: Shape (n, d).
        """
        symmetric_points = 2.0 * points - 1.0
        legendre = np.ones((MOST_DEGREE + 1, *points.shape))  # by degree
        legendre[1] = symmetric_points
        for k in range(1, MOST_DEGREE):
            legendre[k + 1] = ((2 * k + 1) * symmetric_points * legendre[k] - k * legendre[k - 1]) / (k + 1)
        legendre *= np.sqrt(2.0 * np.arange(MOST_DEGREE + 1) + 1.0)[:, None, None]  # makes them orthonormal
        first, first_degree, second, second_degree = self.terms.T
        products = legendre[first_degree, :, first] * legendre[second_degree, :, second]
        return np.concatenate([np.ones((1, len(points))), products]).T

    def coefficients(self, products: np.ndarray, count: int) -> np.ndarray:
        """Fit the coefficients of the constant and the first terms for each replicate, shape (replicates, 1 + count).

        The coefficients for a replicate are fitted to the rows of all other replicates.

        Args:
            products: Sums of basis times output over the rows of each replicate, shape (replicates, 1 + terms).
            count: Number of terms.
        """
        targets = (products.sum(axis=0) - products)[:, : count + 1]
        pairs = zip(self.normal_factors[count], targets, strict=True)
        return np.array([linalg.cho_solve(factor, target) for factor, target in pairs])

    def predict(self, values: np.ndarray) -> ChaosPrediction | None:
        """Predict an output by the set of polynomials with the smallest error; None if no set explains enough of it.

        Args:
            values: The output at A, B and each AB_i, shape (2 + factors, rows).
        """
        training_values = values[:, : self.training_points.shape[1]]
        products = np.zeros((len(self.replicate_rows), len(self.terms) + 1))
        for basis, column in zip(self.training_bases, training_values, strict=True):
            products += np.stack([column[rows] @ basis[rows] for rows in self.replicate_rows])
        best = None
        smallest = (1.0 - FEWEST_EXPLAINED) * float(np.sum((training_values - training_values.mean()) ** 2))
        for count in self.counts:
            coefficients = self.coefficients(products, count)
            error = self.squared_error(training_values, coefficients)
            if error < smallest:
                best = coefficients
                smallest = error
        return None if best is None else self.prediction_from(best[:, 1:])

    def squared_error(self, training_values: np.ndarray, coefficients: np.ndarray) -> float:
        """Sum of the squared errors of a prediction over all training points.

        The rows of a replicate are predicted with the coefficients of this replicate.

        Args:
            training_values: The output at the training points, shape (2 + factors, training rows).
            coefficients: Coefficients of the constant and the first terms, shape (replicates, 1 + count).
        """
        width = coefficients.shape[1]
        error = 0.0
        for basis, column in zip(self.training_bases, training_values, strict=True):
            for rows, replicate_coefficients in zip(self.replicate_rows, coefficients, strict=True):
                error += float(np.sum((column[rows] - basis[rows, :width] @ replicate_coefficients) ** 2))
        return error

    def prediction_from(self, coefficients: np.ndarray) -> ChaosPrediction:
        """The prediction at all points of the samples, and its variances.

        The polynomials are orthonormal, so a variance is a sum of squared coefficients.

        Args:
            coefficients: Coefficients of the first terms, without the constant, shape (replicates, terms).
        """
        count = coefficients.shape[1]
        values = np.empty(self.samples.shape[:2])
        for points, column in zip(self.samples, values, strict=True):
            basis = self.basis(points)[:, 1 : count + 1]  # without the constant
            for rows, replicate_coefficients in zip(self.replicate_rows, coefficients, strict=True):
                column[rows] = basis[rows] @ replicate_coefficients
        first, _, second, second_degree = self.terms[:count].T
        contains = np.zeros((count, self.samples.shape[-1]))  # 1 where a term contains a number
        contains[np.arange(count), first] = 1.0
        contains[np.arange(count), second] = 1.0
        contains_alone = contains * (second_degree == 0)[:, None]
        squares = coefficients**2
        return ChaosPrediction(
            values, alone=squares @ contains_alone, total=squares @ contains, variance=squares.sum(axis=1)
        )


def factorise_normal_equations(squares: np.ndarray) -> list[tuple[np.ndarray, bool]]:
    """Cholesky factors of the normal equations of each replicate, which sum over the rows of all other replicates.

    Args:
        squares: Sums of products of n basis functions over the rows of each replicate, shape (replicates, n, n).

    Returns:
        The factor of each replicate, as :func:`scipy.linalg.cho_factor` returns it.
    """
    matrices = squares.sum(axis=0) - squares + RIDGE * np.eye(squares.shape[-1])
    return [linalg.cho_factor(matrix) for matrix in matrices]
