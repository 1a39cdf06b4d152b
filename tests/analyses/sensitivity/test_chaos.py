"""Polynomials as a control variate of Sobol indices: orthonormal, exact where the output is one, silent on noise."""

import numpy as np
import pytest

from dssc_jax.analyses.sensitivity.chaos import DEGREES, Chaos, nested_terms
from dssc_jax.analyses.sensitivity.sobol import saltelli_samples, sobol_indices

REPLICATES = 8


def design(rows, dimension, seed=0):
    """A, B and each AB_i, shape (2 + d, rows, d)."""
    a, b = saltelli_samples(rows, dimension, (seed,))
    return np.stack([a, b, *(np.where(np.arange(dimension) == i, b, a) for i in range(dimension))])


def scores(points):
    """Levels with mean 0 and variance 1."""
    return np.sqrt(12.0) * (points - 0.5)


def bilinear(points):
    """Of variance 14: 1 and 9 from the first and the second number, and 4 from both together."""
    x, y = scores(points)[..., 0], scores(points)[..., 1]
    return 5.0 + x + 3.0 * y + 2.0 * x * y


def test_terms_are_orthonormal_by_quadrature():
    nodes, weights = np.polynomial.legendre.leggauss(DEGREES[-1][0] + 1)
    x, y = np.meshgrid(0.5 * (nodes + 1.0), 0.5 * (nodes + 1.0), indexing="ij")
    basis = Chaos(design(512, 2), REPLICATES).basis(np.stack([x.ravel(), y.ravel()], axis=1))
    both = 0.25 * np.outer(weights, weights).ravel()
    np.testing.assert_allclose(basis.T @ (both[:, None] * basis), np.eye(basis.shape[1]), atol=1e-12)


def test_sets_are_nested_and_no_term_comes_twice():
    terms, counts = nested_terms(4)
    assert counts == sorted(counts)
    assert len({frozenset(((t.first, t.first_degree), (t.second, t.second_degree))) for t in terms}) == counts[-1]
    assert all(t.first < t.second if t.second_degree else t.first == t.second for t in terms)


def test_an_output_that_is_a_polynomial_is_known_without_scatter():
    samples = design(256, 3)
    found = Chaos(samples, REPLICATES).predict(bilinear(samples))
    assert found is not None
    for row in range(REPLICATES):
        np.testing.assert_allclose(found.alone[row], [1.0, 9.0, 0.0], rtol=0.01, atol=1e-6)
        np.testing.assert_allclose(found.total[row], [5.0, 13.0, 0.0], rtol=0.01, atol=1e-6)
    np.testing.assert_allclose(found.variance, 14.0, rtol=0.01)
    np.testing.assert_allclose(found.values, bilinear(samples) - 5.0, atol=0.05)


def test_indices_are_those_of_the_closed_form_and_their_intervals_narrower():
    samples = design(256, 3)
    values = bilinear(samples)
    truth = np.array([[1.0, 9.0, 0.0], [5.0, 13.0, 0.0]]) / 14.0
    plain = np.stack(sobol_indices(values[0], values[1], values[2:]))
    found = np.stack(sobol_indices(values[0], values[1], values[2:], chaos=Chaos(samples, REPLICATES)))
    np.testing.assert_allclose(found[..., 0], truth, atol=1e-3)
    assert np.all(found[..., 2] - found[..., 1] <= plain[..., 2] - plain[..., 1] + 1e-4)
    assert found[0, 0, 2] - found[0, 0, 1] < 0.5 * (plain[0, 0, 2] - plain[0, 0, 1])


@pytest.mark.parametrize("dimension", [1, 3])
def test_noise_is_not_predicted(dimension):
    samples = design(256, dimension)
    values = np.random.default_rng(0).standard_normal(samples.shape[:2])
    assert Chaos(samples, REPLICATES).predict(values) is None


def test_too_many_numbers_for_a_few_rows_are_not_predicted():
    samples = np.random.default_rng(0).random((2, 64, 60))
    assert Chaos(samples, REPLICATES).predict(samples[..., 0]) is None
