"""The failure probability from strata: against closed forms, and whatever the prediction is worth."""

import copy

import numpy as np
import pytest
from scipy import special, stats
from scipy.interpolate import RBFInterpolator

import dssc_jax as dj
from dssc_jax import ConfigError
from dssc_jax.analyses.probability.strata import strata_edges, stratified_probability
from dssc_jax.analyses.probability.surrogate import SMOOTHING, fit_interpolation
from dssc_jax.statistics import clopper_pearson
from dssc_jax.statistics.stratified import allocate_draws, stratified_interval
from tests.analyses.test_one_shape import TABLE

P = 0.05


def half_space(points, _):
    return stats.norm.isf(P) - special.ndtri(points).sum(axis=1) / np.sqrt(points.shape[1])


def misleading(points, _):
    """The slack rises towards the border and jumps: no prediction tells where draws fail."""
    failing = np.modf(1e4 * points[:, 0])[0] < P
    return np.where(failing, -1.0, 1.0)


def test_few_simulations_where_failures_can_be_predicted():
    found = stratified_probability(half_space, 3, (1,), 0.006, 10**6)
    low, high = found.interval()
    assert low < P < high
    assert high - low < 0.006
    plain = 4.0 * stats.norm.isf(0.025) ** 2 * P * (1.0 - P) / 0.006**2
    assert found.simulations < plain / 3.0
    assert found.weights.sum(axis=1) == pytest.approx(1.0)
    again = stratified_probability(half_space, 3, (1,), 0.006, 10**6)
    assert again.probability == found.probability


def test_a_bad_prediction_costs_draws_and_no_validity():
    ends = np.array([stratified_probability(misleading, 2, (seed,), 0.1, 10**5).interval() for seed in range(20)])
    assert np.count_nonzero((ends[:, 0] < P) & (ends[:, 1] > P)) >= 17  # 2e-4 at a coverage of 95 %: P(X <= 16)


def test_draws_that_end_early_fail():
    def ended(points, _):
        return np.where(points[:, 0] > 0.9, -np.inf, 1.0)

    low, high = stratified_probability(ended, 2, (3,), 0.03, 10**5).interval()
    assert low < 0.1 < high


def test_the_interpolation_is_that_of_scipy():
    rng = np.random.default_rng(1)
    points = rng.random((60, 3))
    values = np.sin(4.0 * points[:, 0]) + points[:, 1] * points[:, 2]
    places = rng.random((50, 3))
    expected = RBFInterpolator(points, values, kernel="cubic", smoothing=SMOOTHING)(places)
    np.testing.assert_allclose(fit_interpolation(points, values)(places), expected, atol=1e-8)


def test_one_stratum_has_the_exact_interval():
    found = stratified_interval(np.ones((16, 1)), np.array([17]), np.array([200]))
    assert found == pytest.approx(tuple(clopper_pearson(17, 200)))


def test_single_failures_of_several_strata_add_up_as_one_count():
    """Equal weights: the exact limits of a Poisson count, here of 3 and then of 0."""
    weights = np.full((16, 4), 0.25)
    for counts, ends in (([1, 1, 1, 0], (0.6187, 8.7673)), ([0, 0, 0, 0], (0.0, 3.6889))):
        low, high = stratified_interval(weights, np.array(counts), np.full(4, 1000))
        assert (low, high) == pytest.approx(np.array(ends) * 0.25 / 1000, rel=1e-3)
        low, high = stratified_interval(weights, 1000 - np.array(counts), np.full(4, 1000))
        assert (1.0 - high, 1.0 - low) == pytest.approx(np.array(ends) * 0.25 / 1000, rel=1e-3)


def test_the_allocation_reaches_the_width_and_prefers_doubt():
    weights = np.array([0.05, 0.05, 0.9])
    shares = np.array([0.99, 0.5, 1e-4])
    draws = allocate_draws(weights, shares, 0.01, 10**6)
    low, high = stratified_interval(np.tile(weights, (16, 1)), np.round(shares * draws).astype(int), draws)
    assert 0.008 < high - low <= 0.0102
    assert draws[1] > 2 * draws[0]
    assert allocate_draws(weights, shares, 0.0001, 10**4).sum() < 1.1e4


def test_edges_lie_densely_at_the_border():
    predictions = np.linspace(-1.0, 9.0, 10_000)
    edges = strata_edges(predictions)
    assert np.any(np.abs(edges) < 2e-3)
    assert np.all(np.diff(edges) > 0.0)
    assert np.diff(edges)[np.searchsorted(edges, 0.0)] < 0.2
    assert strata_edges(np.ones(100)).size == 0 or np.all(strata_edges(np.ones(100)) == 1.0)


def test_a_study_agrees_with_its_plain_draws():
    study = dj.Study.from_table(copy.deepcopy(TABLE))
    found = dj.probability(study, 0.06)
    answer = found.answer
    plain = dj.run(study.override({"draws": 2000}), check=False).summary()["points"][0]["interval"]
    assert max(plain[0], answer.interval[0]) < min(plain[1], answer.interval[1])
    assert answer.simulations == 256 + answer.draws.sum()
    with pytest.raises(ConfigError, match="width in"):
        dj.probability(study, 2.0)
    with pytest.raises(ConfigError, match="at least one"):
        dj.probability(study.override({"requirement": []}))
