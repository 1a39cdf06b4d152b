"""The search on margins whose critical values are known."""

import numpy as np
import pytest

from dssc_jax.analyses.margins.search import Censoring, Walk, search_critical


def crossing(at):
    """A slack that turns negative at a draw's own value."""
    at = np.asarray(at)
    return lambda which, values: at[which] - values


@pytest.mark.parametrize("log", [False, True])
def test_finds_the_crossing_from_below(log):
    at = np.array([0.11, 0.5, 0.99, 3.7, 9.9])
    walk = Walk(0.1, 10.0, log, points=9)
    found = search_critical(crossing(at), 5, walk, bisections=20)
    cell = np.log(100.0) / 8 if log else 9.9 / 8
    gap = np.log(at / found.value) if log else at - found.value
    assert np.all(gap >= 0.0)
    assert np.all(gap <= cell / 2**20 * (1 + 1e-6))
    assert not found.censoring.any()
    assert not found.non_monotone.any()


def test_walks_downwards():
    found = search_critical(lambda which, values: values - 0.3, 2, Walk(1.0, 0.0, points=5), bisections=30)
    assert found.value == pytest.approx(0.3, abs=1e-9)
    assert np.all(found.value >= 0.3)


def test_censored_draws_keep_their_side():
    found = search_critical(crossing([-1.0, 0.5, 2.0]), 3, Walk(0.0, 1.0))
    assert found.censoring.tolist() == [Censoring.BEFORE, Censoring.INSIDE, Censoring.BEYOND]
    assert np.isnan(found.value).tolist() == [True, False, True]


def test_an_island_of_failure_is_reported_and_its_near_shore_taken():
    def slack_of(which, values):
        return np.abs(values - 0.5) - 0.2  # fails between 0.3 and 0.7

    found = search_critical(slack_of, 1, Walk(0.0, 1.0, points=11), bisections=30)
    assert found.non_monotone.all()
    assert found.value == pytest.approx(0.3, abs=1e-9)


def test_passing_only_far_out_is_not_monotone_either():
    found = search_critical(lambda which, values: values - 0.5, 1, Walk(0.0, 1.0))
    assert found.censoring.tolist() == [Censoring.BEFORE]
    assert found.non_monotone.all()


def test_no_bisection_without_a_crossing():
    asked = []

    def slack_of(which, values):
        asked.append(len(which))
        return np.ones(len(which))

    search_critical(slack_of, 4, Walk(0.0, 1.0, points=3))
    assert asked == [4, 4, 4]


def test_a_slack_that_is_no_number_fails():
    found = search_critical(lambda which, values: np.where(values > 0.5, np.nan, 1.0), 1, Walk(0.0, 1.0, points=5))
    assert found.value == pytest.approx(0.5)


def test_values_part_a_length():
    walk = Walk(0.003, 0.1, points=7, parted=2.0)
    assert np.allclose(2.0 / walk.grid, np.round(2.0 / walk.grid), rtol=1e-12)


@pytest.mark.parametrize("log", [False, True])
def test_values_that_part_a_length_stay_within_the_bounds(log):
    """10 s / 0.8 s = 12.5 samples: the nearest whole number, 12, would be a value beyond the end."""
    for start, end in [(0.01, 0.8), (0.0298, 0.8), (0.8, 0.0298), (0.1, 0.5)]:
        grid = Walk(start, end, log, points=7, parted=10.0).grid
        assert min(start, end) * (1.0 - 1e-12) <= grid.min() <= grid.max() <= max(start, end) * (1.0 + 1e-12)
        assert np.allclose(10.0 / grid, np.round(10.0 / grid), rtol=1e-12)
    assert grid[[0, -1]].tolist() == [0.1, 0.5]
