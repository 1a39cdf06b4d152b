import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics import (
    FixedCount,
    IntervalsAfterStop,
    Look,
    Replicated,
    clopper_pearson,
    describe_probability,
    lognormal_interval,
    replicate_interval,
    rounded_probability,
)


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


def test_wilson_would_not_do():
    """Why not the shorter interval: it covers 0.84 near p = 0.17/n, for every n."""
    for n in (100, 10_000):
        p = 0.17 / n
        found = [stats.binomtest(k, n).proportion_ci(0.95, "wilson") for k in range(20)]
        inside = np.array([interval.low <= p <= interval.high for interval in found])
        assert stats.binom.pmf(np.arange(20), n, p)[inside].sum() == pytest.approx(0.84, abs=0.01)


def test_every_method_names_itself_and_bounds_no_failure():
    none, some = np.zeros(160, dtype=bool), np.arange(160) % 10 == 0
    for method in (FixedCount(), IntervalsAfterStop((Look(160, -1, 161),), 3), Replicated(8, "scrambled Sobol")):
        assert method.name in describe_probability(some, method)
        assert "failure probability <= 0.0" in describe_probability(none, method)
        low, high = method.interval(some)
        assert low < 0.1 < high


def test_replicates_that_agree_leave_open_what_they_cannot_see():
    low, high = Replicated(8, "Latin hypercube").interval(np.zeros(800, dtype=bool))
    assert (low, high) == (0.0, pytest.approx(np.log(40.0) / 800))


def test_replicates_that_scatter_get_students_t():
    failed = np.random.default_rng(0).random((8, 100)) < np.linspace(0.2, 0.4, 8)[:, None]
    low, high = Replicated(8, "scrambled Sobol").interval(failed.T.reshape(-1))
    means = failed.mean(1)
    half = stats.t.ppf(0.975, 7) * stats.sem(means) + np.log(40.0) / 800
    np.testing.assert_allclose([low, high], [means.mean() - half, means.mean() + half])


def test_replicates_must_share_the_draws_evenly():
    with pytest.raises(ValueError, match="cannot be shared out"):
        Replicated(8, "scrambled Sobol").interval(np.zeros(100, dtype=bool))


@pytest.mark.parametrize("spread", [0.3, 0.65, 1.0])
@pytest.mark.parametrize("zeros", [0.0, 0.3])
def test_the_mean_of_skewed_estimates_lies_within_their_interval(spread, zeros):
    """On both sides; Student's t lies wholly below the mean far too often."""
    rng = np.random.default_rng(int(100 * spread))
    estimates = rng.lognormal(-0.5 * spread**2, spread, (4000, 10)) * (rng.random((4000, 10)) >= zeros) / (1.0 - zeros)
    low, high = np.array([lognormal_interval(row) for row in estimates]).T
    assert np.mean(high < 1.0) < 0.04
    assert np.mean(low > 1.0) < 0.035
    if zeros == 0.0:
        assert np.median(high / low) < 2.0 * np.exp(2.0 * 2.262 * spread / np.sqrt(10.0))  # and no longer than need be
    assert np.mean(replicate_interval(rng.lognormal(-0.5, 1.0, (4000, 10)), 10)[:, 1] < 1.0) > 0.1


def test_the_interval_of_a_mean_with_too_few_estimates():
    assert lognormal_interval(np.zeros(10)) == (0.0, np.inf)
    assert lognormal_interval(np.array([0.0, 0.1, 0.0])) == (0.0, np.inf)
    low, high = lognormal_interval(np.array([0.1, 0.1, 0.1]))
    assert low == pytest.approx(0.1)
    assert high == pytest.approx(0.1)
    with_zero = lognormal_interval(np.array([0.1, 0.2, 0.3, 0.0]))
    assert with_zero[0] < lognormal_interval(np.array([0.1, 0.2, 0.3]))[0]


@pytest.mark.parametrize(
    ("probability", "text"),
    [
        (0.0, "0"),
        (1.0, "1"),
        (0.12345, "0.123"),
        (0.9994, "0.999"),
        (0.99987654, "0.99988"),
        (1.0 - 1e-9, "0.999999999"),
    ],
)
def test_only_certainty_is_rounded_to_one(probability, text):
    assert rounded_probability(probability) == text
