import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics import clopper_pearson, describe_probability


@pytest.mark.parametrize(("k", "n", "low", "high"), [(0, 100, 0.0, 0.036217), (10, 100, 0.049005, 0.176223)])
def test_published_values(k, n, low, high):
    np.testing.assert_allclose(clopper_pearson(k, n), [low, high], atol=5e-7)


def test_against_scipy_and_at_the_ends():
    for k, n in [(0, 1), (1, 1), (3, 17), (50, 50), (1, 10_000)]:
        found = stats.binomtest(k, n).proportion_ci(0.95, "exact")
        np.testing.assert_allclose(clopper_pearson(k, n), [found.low, found.high], rtol=1e-7, atol=1e-15)


def test_broadcasts():
    assert clopper_pearson([[0, 1], [2, 3]], 10).shape == (2, 2, 2)


@pytest.mark.parametrize(("k", "n"), [(-1, 10), (11, 10), (0, 0)])
def test_out_of_range(k, n):
    with pytest.raises(ValueError, match="0 <= failures <= draws"):
        clopper_pearson(k, n)


def test_coverage_is_at_least_nominal():
    """Exactly, by summing the binomial law: no simulation."""
    for n, p in [(20, 0.1), (60, 0.02), (200, 0.5)]:
        k = np.arange(n + 1)
        low, high = clopper_pearson(k, n).T
        assert stats.binom.pmf(k, n, p)[(low <= p) & (p <= high)].sum() >= 0.95


def test_no_failure_is_told_by_its_upper_bound():
    text = describe_probability(np.zeros(100, dtype=bool))
    assert "<= 0.0362" in text
    assert "probability 0 " not in text
