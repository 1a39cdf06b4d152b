import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics import clopper_pearson, compare_failures, compare_metrics, difference_interval, mcnemar


@pytest.mark.parametrize(("a", "b"), [(0, 0), (0, 5), (9, 1), (30, 17), (200, 200), (3, 4)])
def test_mcnemar_is_the_binomial_test(a, b):
    expected = stats.binomtest(a, a + b, 0.5).pvalue if a + b else 1.0
    assert mcnemar(a, b) == pytest.approx(expected, rel=1e-12)


def coverage(n, only_a, only_b):
    """Exact coverage by summing the trinomial law."""
    a, b = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    inside = a + b <= n
    a, b = a[inside], b[inside]
    weight = stats.multinomial.pmf(np.stack([a, b, n - a - b], -1), n, [only_a, only_b, 1.0 - only_a - only_b])
    low, high = difference_interval(a, b, n).T
    truth = only_a - only_b
    return weight[(low <= truth) & (truth <= high)].sum()


@pytest.mark.parametrize(
    ("only_a", "only_b"), [(0.02, 0.02), (0.1, 0.01), (0.3, 0.3), (0.15, 0.0), (0.5, 0.4), (0.01, 0.0), (0.05, 0.2)]
)
def test_coverage_of_the_difference_is_at_least_nominal(only_a, only_b):
    assert coverage(60, only_a, only_b) >= 0.95


def test_the_paired_interval_is_narrower_than_two_separate_ones():
    """60 common failures and 5 and 15 of their own among 1000 draws."""
    low, high = difference_interval(5, 15, 1000)
    one, other = clopper_pearson(65, 1000), clopper_pearson(75, 1000)
    assert high - low < 0.6 * ((one[1] - one[0]) + (other[1] - other[0]))


def test_without_a_difference_the_interval_is_the_bound_of_seeing_none():
    low, high = difference_interval(0, 0, 100)
    assert -low == high == pytest.approx(clopper_pearson(0, 100, 0.99)[1])


def test_counts_come_from_the_draws():
    failed_a = np.array([True, True, False, False, True])
    failed_b = np.array([True, False, False, True, False])
    found = compare_failures(failed_a, failed_b)
    assert (found.only_a, found.only_b, found.draws, found.difference) == (2, 1, 5, pytest.approx(0.2))
    assert found.interval == pytest.approx(tuple(-x for x in reversed(compare_failures(failed_b, failed_a).interval)))


def test_draws_that_ended_early_are_not_dropped():
    nan = np.nan
    found = compare_metrics(np.array([1.0, nan, nan, 4.0, nan]), np.array([2.0, 1.0, nan, nan, 3.0]))
    assert found.difference == 0.0  # of -inf, -1, 0 (both ended), inf, inf
    assert (found.only_a, found.only_b, found.neither) == (2, 1, 1)


def test_the_median_difference_is_enclosed():
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(400):
        common = rng.standard_cauchy(50)
        low, high = compare_metrics(common + rng.exponential(size=50), common).interval
        hits += low <= np.log(2.0) <= high
    assert hits >= 372  # 95 % of 400 less two deviations


@pytest.mark.parametrize("call", [lambda: mcnemar(-1, 2), lambda: difference_interval(6, 5, 10)])
def test_bad_counts(call):
    with pytest.raises(ValueError, match=r"-1|draws"):
        call()


def test_shapes_must_agree():
    with pytest.raises(ValueError, match="one shape"):
        compare_metrics(np.zeros(3), np.zeros(4))
    with pytest.raises(ValueError, match="one shape"):
        compare_failures(np.zeros(3, bool), np.zeros(4, bool))
