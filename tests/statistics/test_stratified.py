"""Draws of strata: as few as an interval needs, at least some of each, at most what is allowed."""

import numpy as np
import pytest

from dssc_jax.statistics import clopper_pearson
from dssc_jax.statistics.stratified import LEAST_DRAWS, allocate_draws

WEIGHTS = np.array([0.5, 0.5])
SHARES = np.array([0.01, 0.99])


def expected_width(draws):
    limits = clopper_pearson(SHARES * draws, draws)
    below = np.sum(np.square(WEIGHTS * (SHARES - limits[:, 0])))
    above = np.sum(np.square(WEIGHTS * (limits[:, 1] - SHARES)))
    return np.sqrt(below) + np.sqrt(above)


def test_a_wide_interval_takes_the_least_draws():
    assert expected_width(np.array([LEAST_DRAWS] * 2)) < 0.6
    np.testing.assert_array_equal(allocate_draws(WEIGHTS, SHARES, 0.6, 1000), [LEAST_DRAWS] * 2)


@pytest.mark.parametrize("width", [0.1, 0.02])
def test_the_interval_is_as_wide_as_asked(width):
    draws = allocate_draws(WEIGHTS, SHARES, width, 10**6)
    assert 0.9 * width < expected_width(draws) < 1.05 * width


def test_no_more_draws_than_allowed():
    draws = allocate_draws(WEIGHTS, SHARES, 1e-3, 5000)
    assert 2500 < draws.sum() < 7000
