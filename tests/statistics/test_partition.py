"""What knowing the part of a number's law is worth, against half spaces whose parts are known."""

import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics.partition import part_information, removed_share

PART = np.array([2.0, 1.0, 0.0]) / np.sqrt(5.0)


def draws(p, count, seed):
    """Scores of three numbers, and whether each draw fails."""
    scores = np.random.default_rng(seed).standard_normal((count, 3))
    return scores, scores @ PART > stats.norm.isf(p)


def truths(p, number, parts, limit):
    """Share of the variance that knowing the part removes, and of parts beyond the limit, by the midpoint rule."""
    levels = (np.arange(parts * 2000) + 0.5) / (parts * 2000)
    spread = np.sqrt(1.0 - PART[number] ** 2)
    failing = stats.norm.sf((stats.norm.isf(p) - PART[number] * stats.norm.ppf(levels)) / spread)
    each = failing.reshape(parts, -1).mean(axis=1)
    return each.var() / (p * (1.0 - p)), float(np.mean(each > limit))


@pytest.mark.parametrize("p", [0.2, 0.05])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_intervals_cover(p, number):
    removed, changes = truths(p, number, 10, 2.0 * p)
    covered = np.zeros(2)
    for seed in range(300):
        scores, failed = draws(p, 2000, seed)
        found = part_information(stats.norm.cdf(scores[:, number]), failed, 2.0 * p)
        assert found is not None
        covered[0] += found.removed_interval[0] <= removed <= found.removed_interval[1]
        covered[1] += found.changes_interval[0] <= changes <= found.changes_interval[1]
    assert covered.min() >= 0.93 * 300


def test_the_removed_share_is_without_bias():
    estimates = []
    for seed in range(300):
        scores, failed = draws(0.1, 2000, seed)
        found = part_information(stats.norm.cdf(scores[:, 0]), failed, 0.2)
        assert found is not None
        estimates.append(found.removed)
    truth, _ = truths(0.1, 0, 10, 0.2)
    error = np.std(estimates) / np.sqrt(len(estimates))
    assert abs(np.mean(estimates) - truth) < 4.0 * error + 0.01 * truth


def test_pinned_values():
    """20 failures of 100 draws, all in one of two parts: the variance is p/(1-p) times 2 x 1 - 1."""
    removed, _ = removed_share(np.array([20, 0]), 100, 0.95)
    assert removed == pytest.approx(0.25)
    removed, interval = removed_share(np.array([10, 10]), 100, 0.95)
    assert removed == pytest.approx(0.25 * (2.0 * 180.0 / 380.0 - 1.0))
    assert interval[0] < 0.0 < interval[1]


def test_a_failing_study_may_pass_in_parts():
    """The decision is that too many fail; knowing the number may show that few do."""
    levels = (np.arange(1000) + 0.5) / 1000
    found = part_information(levels, levels > 0.5, 0.1)
    assert found is not None
    assert found.changes == pytest.approx(0.5)
    assert found.changes_interval == pytest.approx((0.5, 0.5))


def test_few_failures_say_nothing():
    assert part_information(np.linspace(0.01, 0.99, 100), np.arange(100) < 9, 0.1) is None
    few = part_information(np.linspace(0.01, 0.99, 100), np.arange(100) < 15, 0.1)
    assert few is not None
    assert few.parts == 3
