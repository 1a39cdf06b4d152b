"""Changed laws of the scores: their densities, slopes and second moments, against SciPy and differences."""

import numpy as np
import pytest
from scipy import integrate, stats

from dssc_jax.statistics.law_changes import Shift, Widening

CORRELATION = np.array([[1.0, 0.4, 0.0], [0.4, 1.0, -0.2], [0.0, -0.2, 1.0]])
PRECISION = np.linalg.inv(CORRELATION)
AMOUNTS = np.array([0.3, 0.0, 0.15])


def changed_law(change, amounts):
    """The changed law of the scores, by SciPy."""
    if isinstance(change, Shift):
        return stats.multivariate_normal(amounts, CORRELATION)
    scale = np.diag(np.exp(amounts))
    return stats.multivariate_normal(np.zeros(3), scale @ CORRELATION @ scale)


@pytest.fixture(params=[Shift, Widening])
def change(request):
    return request.param(PRECISION)


@pytest.fixture(scope="module")
def scores():
    return stats.multivariate_normal(np.zeros(3), CORRELATION).rvs(200, random_state=1)


def test_weights_are_ratios_of_densities(change, scores):
    draws = stats.multivariate_normal(np.zeros(3), CORRELATION)
    expected = changed_law(change, AMOUNTS).logpdf(scores) - draws.logpdf(scores)
    np.testing.assert_allclose(change.log_weights(AMOUNTS, scores), expected, atol=1e-12)
    np.testing.assert_allclose(change.log_weights(np.zeros(3), scores), 0.0, atol=1e-12)


def test_mean_slopes_are_derivatives(change, scores):
    shares = np.random.default_rng(6).dirichlet(np.ones(len(scores)))
    slope = change.mean_slope(AMOUNTS, scores, shares)
    for number in range(3):
        step = np.zeros(3)
        step[number] = 1e-6
        difference = change.log_weights(AMOUNTS + step, scores) - change.log_weights(AMOUNTS - step, scores)
        assert slope[number] == pytest.approx(shares @ difference / 2e-6, abs=1e-7)


def test_changed_scores_have_the_changed_law(change):
    scores = stats.multivariate_normal(np.zeros(3), CORRELATION).rvs(200_000, random_state=2)
    law = changed_law(change, AMOUNTS)
    changed = change.apply(AMOUNTS, scores)
    np.testing.assert_allclose(changed.mean(axis=0), law.mean, atol=0.02)
    np.testing.assert_allclose(np.cov(changed.T), law.cov, atol=0.03)


@pytest.mark.parametrize("amount", [0.05, 0.2, 0.33])
@pytest.mark.parametrize("family", [Shift, Widening])
def test_second_moment_of_one_number(family, amount):
    change = family(np.eye(1))

    def integrand(score):
        logarithm = change.log_weights(np.array([amount]), np.array([[score]]))[0]
        return np.exp(2.0 * logarithm + stats.norm.logpdf(score))

    expected, _ = integrate.quad(integrand, -60.0, 60.0, limit=400, points=[0.0])
    assert change.log_second_moment(np.array([amount])) == pytest.approx(np.log(expected), rel=1e-6)


def test_second_moment_with_correlations(change, scores):
    """As the mean of the weights over the changed law."""
    amounts = 0.5 * AMOUNTS
    changed = changed_law(change, amounts).rvs(400_000, random_state=3)
    mean = np.exp(change.log_weights(amounts, changed)).mean()
    assert change.log_second_moment(amounts) == pytest.approx(np.log(mean), abs=0.01)


def test_weights_of_wide_laws_have_no_second_moment():
    change = Widening(np.eye(2))
    assert np.isinf(change.log_second_moment(np.log([1.0, np.sqrt(2.0) + 1e-9])))
    assert np.isfinite(change.log_second_moment(np.log([1.0, 1.41])))


def test_corners_bound_all_shifts():
    rng = np.random.default_rng(4)
    change = Shift(PRECISION)
    free = np.array([True, False, True])
    for amounts in rng.uniform(-0.5, 0.5, (500, 3)) * free:
        assert change.log_second_moment(amounts) <= change.log_second_moment_bound(0.5, free) + 1e-12
    assert Shift(np.eye(3)).log_second_moment_bound(0.5, free) == pytest.approx(2 * 0.25)
    assert Widening(np.eye(3)).log_second_moment_bound(0.1, free) == pytest.approx(
        Widening(np.eye(2)).log_second_moment(np.full(2, 0.1))
    )
