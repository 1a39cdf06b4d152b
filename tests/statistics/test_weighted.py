"""Intervals from importance weights, against exact ones, and how often they cover."""

import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics.weighted import effective_size, weighted_interval


@pytest.mark.parametrize("events", [0, 1, 7, 60])
def test_equal_weights_give_the_interval_of_a_poisson_count(events):
    low, high = weighted_interval(np.full(events, 2.0), 1000, 2.0)
    assert high == pytest.approx(2.0 * stats.gamma.ppf(0.975, events + 1) / 1000, rel=1e-10)
    assert low == pytest.approx(2.0 * stats.gamma.ppf(0.025, events) / 1000 if events else 0.0, rel=1e-10)


def test_effective_size():
    assert effective_size(np.full(9, 0.3)) == pytest.approx(9.0)
    assert effective_size(np.array([1.0, 3.0])) == pytest.approx(16.0 / 10.0)
    assert effective_size(np.empty(0)) == 0.0


def test_intervals_cover_a_moved_half_space():
    """The scores' law is moved by half a standard deviation towards the failures."""
    rng = np.random.default_rng(2)
    edge = stats.norm.isf(0.03)
    truth = stats.norm.sf(edge - 0.5)
    covered = 0
    for _ in range(1000):
        scores = rng.standard_normal(1000)
        weights = np.exp(0.5 * scores - 0.125)
        low, high = weighted_interval(weights[scores > edge], 1000, weights.max())
        covered += low <= truth <= high
    assert covered >= 940
