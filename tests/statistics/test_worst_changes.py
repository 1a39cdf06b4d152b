"""The worst change by the draws' weights, against half spaces, slabs and what is guaranteed."""

import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics import clopper_pearson
from dssc_jax.statistics.any_failures import AnyFailures
from dssc_jax.statistics.law_changes import Shift, Widening
from dssc_jax.statistics.worst_changes import LEAST_EFFECTIVE, WeightedDraws, largest_change

DRAWS = 20_000
PART = np.array([2.0, -1.0, 0.0]) / np.sqrt(5.0)
"""How the numbers take part in the failure of a half space; the third does not."""
EDGE = stats.norm.isf(0.02)
LIMIT = 0.05


def weighted(family, failed_of, draws=DRAWS, seed=0, correlation=None, free=(True, True, True)):
    """Draws of which those fail that a function of the scores names."""
    matrix = np.eye(3) if correlation is None else correlation
    scores = np.random.default_rng(seed).standard_normal((draws, 3)) @ np.linalg.cholesky(matrix).T
    change = family(np.linalg.inv(matrix))
    return WeightedDraws(change, scores, failed_of(scores), np.array(free), 0.95)


def half_space(scores):
    return scores @ PART > EDGE


def test_worst_shift_of_a_half_space():
    """The corner of the box that points into it: p = Phi(s |a|_1 - b)."""
    draws = weighted(Shift, half_space)
    worst = draws.worst(0.25)
    np.testing.assert_allclose(worst.amounts[:2], [0.25, -0.25], atol=1e-9)
    truth = stats.norm.sf(EDGE - 0.25 * np.abs(PART).sum())
    assert worst.interval[0] < truth < worst.interval[1]
    assert worst.probability == pytest.approx(truth, rel=0.1)
    best = draws.best(0.25)
    np.testing.assert_allclose(best.amounts[:2], [-0.25, 0.25], atol=1e-9)
    assert best.probability == pytest.approx(stats.norm.sf(EDGE + 0.25 * np.abs(PART).sum()), rel=0.15)


def test_largest_shift_and_widening_of_a_half_space():
    gap = EDGE - stats.norm.isf(LIMIT)
    for family, truth in ((Shift, gap / np.abs(PART).sum()), (Widening, np.log(EDGE / stats.norm.isf(LIMIT)))):
        found = largest_change(weighted(family, half_space), LIMIT)
        assert found.reason == ""
        assert found.estimate == pytest.approx(truth, rel=0.15)
        assert 0.7 * truth < found.bound < truth
        assert found.bound < found.estimate < found.explored


def test_one_number_alone():
    """Only the free number moves, and it takes a longer way."""
    found = largest_change(weighted(Shift, half_space, free=(False, True, False)), LIMIT)
    assert found.estimate == pytest.approx((EDGE - stats.norm.isf(LIMIT)) / abs(PART[1]), rel=0.15)
    assert found.worst.amounts[0] == found.worst.amounts[2] == 0.0
    assert found.worst.amounts[1] < 0.0


def test_the_correlated_half_space():
    """The means of correlated numbers move, each by its own standard deviation: their failure by a'd of sqrt(a'Ra)."""
    correlation = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]])
    spread = np.sqrt(PART @ correlation @ PART)
    draws = weighted(Shift, lambda scores: scores @ PART > EDGE * spread, correlation=correlation)
    found = largest_change(draws, LIMIT)
    truth = (EDGE - stats.norm.isf(LIMIT)) * spread / np.abs(PART).sum()
    assert found.estimate == pytest.approx(truth, rel=0.15)
    assert found.bound < truth


def test_the_worse_of_two_sides_is_found():
    """Failures on both sides of two numbers; one side is nearer. The mean of the failing draws points nowhere near."""
    low, high = stats.norm.isf(0.03), stats.norm.isf(0.025)

    def slab(scores):
        return (scores[:, 0] > high) | (scores[:, 0] < -low) | (scores[:, 1] > high)

    worst = weighted(Shift, slab).worst(0.5)
    assert worst.amounts[0] == pytest.approx(-0.5)
    assert worst.amounts[1] == pytest.approx(0.5)


def test_what_is_guaranteed_is_never_more_than_the_truth():
    """Of a half space that all numbers share alike it is the truth, but for the draws' uncertainty."""
    part = np.ones(3) / np.sqrt(3.0)
    draws = weighted(Shift, lambda scores: scores @ part > EDGE)
    exact = AnyFailures(np.eye(3), (0.02, 0.02))
    truth = (EDGE - stats.norm.isf(LIMIT)) / np.sqrt(3.0)
    assert exact.largest_shift(draws.free, LIMIT) == pytest.approx(truth, rel=1e-9)
    low, high = clopper_pearson(np.count_nonzero(draws.failed), DRAWS)
    bound = AnyFailures(np.eye(3), (low, high)).largest_shift(draws.free, LIMIT)
    assert 0.85 * truth < bound < truth
    assert bound < (EDGE - stats.norm.isf(LIMIT)) / np.abs(PART).sum()


def test_too_few_failures_are_refused():
    found = largest_change(weighted(Shift, half_space, draws=500), LIMIT)
    assert (found.bound, found.estimate, found.explored) == (0.0, None, 0.0)
    assert "failed draws, 20 are needed" in found.reason
    none = largest_change(weighted(Shift, lambda scores: scores[:, 0] > 50.0, draws=500), LIMIT)
    assert none.reason.startswith("0 failed draws")


def test_a_change_that_leaves_few_effective_draws_is_refused():
    draws = weighted(Shift, lambda scores: scores[:, 0] > 1.0, draws=1000)
    found = largest_change(draws, 0.9)
    assert found.estimate is None
    assert "effective draws" in found.reason
    assert found.bound == found.explored
    assert found.explored == pytest.approx(np.sqrt(np.log(1000 / LEAST_EFFECTIVE) / 3.0), rel=1e-5)
    assert not draws.is_trusted(found.explored + 1e-3)


def test_bounds_with_confidence_cover():
    """Of 100 sets of draws, the bound exceeds the truth in at most 2.5 %, and by chance in a few more."""
    truth = (EDGE - stats.norm.isf(LIMIT)) / np.abs(PART).sum()
    wrong = 0
    for seed in range(100):
        found = largest_change(weighted(Shift, half_space, draws=1500, seed=seed), LIMIT)
        wrong += found.bound > truth
    assert wrong <= 7
