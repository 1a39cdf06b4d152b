"""Importance sampling around design points against closed forms, and where it must not answer."""

import numpy as np
import pytest
from scipy import integrate, optimize, special, stats

import dssc_jax as dj
from dssc_jax.analyses.rare_events.design_points import find_design_points, with_curvature
from dssc_jax.analyses.rare_events.importance import (
    ImportanceSampling,
    WeightedEstimate,
    importance_sampling,
    systematic_sample,
)
from dssc_jax.analyses.rare_events.prediction import NOISY, fit_prediction
from tests.analyses.rare_events.test_rare import FOUR_BRANCH, four_branch, hidden
from tests.runs.test_run_until import TABLE

SURE = 0.9999  # of intervals: the last bits of the linear algebra choose other points on another processor


def sampled(slack, dimension, seed, settings=ImportanceSampling()):  # noqa: B008
    return importance_sampling(slack, dimension, (seed,), settings)


def half_space(probability, dimension):
    normal = np.arange(1.0, dimension + 1.0)
    normal /= np.linalg.norm(normal)
    return lambda z, _: -special.ndtri(probability) - z @ normal


def two_sides(z, _):
    """Failures of 1e-5 and of 3e-6 on opposite sides."""
    return np.minimum(-special.ndtri(1e-5) - z[:, 0], -special.ndtri(3e-6) + z[:, 0])


def two_modes(probability, angle):
    """Two half spaces of a probability together whose normals make an angle."""
    x, y = np.cos(angle), np.sin(angle)
    both = stats.multivariate_normal([0.0, 0.0], [[1.0, x], [x, 1.0]])
    distance = optimize.brentq(lambda b: 2.0 * stats.norm.sf(b) - both.cdf([-b, -b]) - probability, 0.0, 10.0)
    return lambda z, _: distance - np.maximum(z[:, 0], x * z[:, 0] + y * z[:, 1])


def jump(z, _):
    """Failures of 1e-4 in a half space in which the slack jumps."""
    return np.where(z[:, 0] > stats.norm.isf(1e-4), -1.0, 1.0)


def curved(z, _):
    """Failures behind a border that bends towards the median."""
    return 4.5 - z[:, 0] - 0.1 * np.sum(z[:, 1:] ** 2, axis=1)


def curved_probability(dimension):
    law = stats.chi2(dimension - 1)
    return integrate.quad(lambda c: law.pdf(c) * special.ndtr(0.1 * c - 4.5), 0.0, 150.0, points=(1.0, 10.0, 40.0))[0]


@pytest.mark.parametrize(
    ("slack", "dimension", "truth"),
    [
        (half_space(0.05, 3), 3, 0.05),
        (half_space(1e-6, 3), 3, 1e-6),
        (half_space(1e-4, 14), 14, 1e-4),
        (two_sides, 2, 1.3e-5),
        (four_branch, 2, FOUR_BRANCH),
        (two_modes(2e-5, np.deg2rad(110.0)), 3, 2e-5),
        (curved, 3, curved_probability(3)),
    ],
    ids=["likely", "one in a million", "many numbers", "two sides", "four branches", "110 degrees", "a curved border"],
)
def test_the_interval_covers(slack, dimension, truth):
    """With few simulations; the estimates scatter no more than they say."""
    answers = [sampled(slack, dimension, seed) for seed in range(4)]
    intervals = np.array([estimate.mean_interval(SURE) for estimate in answers])
    assert np.sum((intervals[:, 0] <= truth) & (truth <= intervals[:, 1])) >= 3
    means = np.array([estimate.mean for estimate in answers])
    assert means.mean() == pytest.approx(truth, rel=0.13)
    assert np.all([estimate.variation <= 0.1 for estimate in answers])
    assert np.mean([estimate.simulations for estimate in answers]) < 800


def test_a_jump_of_the_slack_is_covered_or_refused():
    """Where no search ends at the border, splitting answers; whether one does depends on the last bits of a jump."""
    answers = [sampled(jump, 2, seed) for seed in range(5)]
    estimates = [answer for answer in answers if not isinstance(answer, str)]
    assert len(estimates) >= 1  # about a quarter is refused
    intervals = np.array([estimate.mean_interval(SURE) for estimate in estimates])
    assert np.all((intervals[:, 0] <= 1e-4) & (intervals[:, 1] >= 1e-4))


def test_in_loop_noise_is_part_of_the_failure():
    """A fifth of the variance is noise that only its index knows."""
    p = 1e-4

    def slack(points, noise):
        unknown = np.array([np.random.default_rng((3, index)).standard_normal() for index in noise])
        return stats.norm.isf(p) - (2.0 * points[:, 0] + unknown) / np.sqrt(5.0)

    for seed in range(2):
        low, high = sampled(slack, 2, seed, ImportanceSampling(0.2)).mean_interval(SURE)
        assert low <= p <= high


@pytest.mark.parametrize("seed", range(4))
def test_rare_noise_far_from_the_predicted_border_counts(seed):
    """The largest of ten noisy readings exceeds 6, with 3e-4 at 4; a normal law would expect less than 1e-7 there."""
    points = np.linspace(-6.0, 6.0, 200)[:, None]
    noise = np.random.default_rng(4 + seed).standard_normal((200, 10)).max(axis=1)
    prediction = fit_prediction(points, 6.0 - points[:, 0] - 0.5 * noise)
    assert prediction.smoothing >= NOISY
    for place in (4.0, 4.4, 4.8):
        exact = -np.expm1(10.0 * stats.norm.logcdf((6.0 - place) / 0.5))
        assert 0.03 < prediction.failure_probability(np.array([[place]]))[0] / exact < 10.0


def test_the_prediction_is_that_of_a_plane_and_knows_its_error():
    rng = np.random.default_rng(5)
    points = rng.standard_normal((80, 2))
    exact = fit_prediction(points, 3.0 - points[:, 0])
    fresh = rng.standard_normal((50, 2))
    values, slopes = exact.slacks_and_slopes(fresh)
    np.testing.assert_array_equal(values < 0.0, fresh[:, 0] > 3.0)
    shift = np.array([0.0, 1e-6])
    differences = (exact.slacks_and_slopes(fresh + shift)[0] - exact.slacks_and_slopes(fresh - shift)[0]) / 2e-6
    np.testing.assert_allclose(slopes[:, 1], differences, atol=1e-6)
    noisy = fit_prediction(points, 0.3 * rng.standard_normal(80) - points[:, 0])
    border = np.array([[0.0, 0.3], [0.3, 0.0], [-0.3, 0.0]])
    middle, beyond, before = noisy.failure_probability(border)
    assert middle == pytest.approx(0.5, abs=0.25)
    assert beyond == pytest.approx(special.ndtr(1.0), abs=0.2)
    assert before == pytest.approx(special.ndtr(-1.0), abs=0.2)


def test_a_systematic_sample_keeps_its_chances():
    rng = np.random.default_rng(1)
    chances = np.array([1.0, 0.5, 0.25, 0.25, 0.6])
    counts = np.zeros(5)
    for _ in range(4000):
        indices = systematic_sample(chances, rng)
        assert len(indices) in (2, 3)
        assert len(set(indices.tolist())) == len(indices)
        counts[indices] += 1
    np.testing.assert_allclose(counts / 4000, chances, atol=0.03)


def test_design_points_and_their_approximations():
    """Of a parabola, whose second-order probability is known: Phi(-beta) (1 + 2 beta c)^(-1/2)."""

    def parabola(z, _):
        return 3.0 - z[:, 0] + 0.2 * z[:, 1] ** 2

    def parabola_slopes(z):
        return parabola(z, None), np.stack([-np.ones(len(z)), 0.4 * z[:, 1]], axis=1)

    (found,) = find_design_points(parabola_slopes, np.array([[1.0, 1.0], [0.5, -2.0]]))
    assert found.point == pytest.approx([3.0, 0.0], abs=0.05)
    assert found.first_order_probability == pytest.approx(special.ndtr(-3.0), rel=0.02)
    curved_point = with_curvature(parabola_slopes, found)
    assert curved_point.second_order == pytest.approx((1.0 + 2.0 * 3.0 * 0.2) ** -0.5, rel=0.02)


def test_both_of_two_sides_are_found():
    found = sampled(two_sides, 2, 3)
    assert isinstance(found, WeightedEstimate)
    distances = [design_point.distance for design_point in found.design_points]
    assert distances == pytest.approx([-special.ndtri(1e-5), -special.ndtri(3e-6)], abs=0.02)
    assert np.all(two_sides(found.points, None) < 0.0)


def test_a_hidden_failure_is_found_or_contradicted():
    """The slack leads to a failure of 2.9e-7, and does not show one of 6.9e-4 on the other side."""
    truth = stats.norm.sf(3.2) + stats.norm.sf(5.0)
    for seed in range(4):
        found = sampled(hidden, 1, seed)
        if isinstance(found, WeightedEstimate) and not found.contradicted and found.reached:
            low, high = found.interval(SURE)
            assert low <= truth <= high


def test_settings_out_of_range_are_refused():
    with pytest.raises(dj.ConfigError, match="variation"):
        ImportanceSampling(variation=0.0)
    with pytest.raises(dj.ConfigError, match="plain >= 1"):
        ImportanceSampling(plain=0)


def test_a_study_agrees_with_splitting_and_comes_back(tmp_path):
    study = dj.Study.from_table(TABLE).override({"requirement.0.max": 0.915})
    found = dj.rare(study, splitting=None)
    low, high = found.estimate.interval(SURE)
    split = dj.rare(study, None, dj.Splitting(particles=100, killed=50, repeats=10))
    below, above = split.estimate.interval(SURE)
    assert max(low, below) < min(high, above)
    answer = found.answer
    assert answer.method == "importance sampling"
    assert answer.simulations < 0.2 * split.answer.simulations
    assert answer.design_points[0].values["plant.k_p"] < 1.0  # weak gain fails
    found.save(tmp_path / "rare")
    assert dj.load(tmp_path / "rare") == found
    assert found.figure() is not None


def test_splitting_answers_where_importance_sampling_cannot():
    """An impossible failure has no design point."""
    study = dj.Study.from_table(TABLE).override({"requirement.0.max": 5.0})
    small = dj.Splitting(particles=10, killed=5, moves=1, repeats=10, smallest=0.01, plain=64)
    found = dj.rare(study, splitting=small)
    assert found.answer.method == "splitting"
    assert found.answer.refusal
    with pytest.raises(dj.ConfigError, match="no answer"):
        dj.rare(study, splitting=None)


def test_diverged_draws_are_failures():
    """They have the slack -inf; those with a slack lead to them."""

    def slack(points, _):
        return np.where(points[:, 0] > 3.0, -np.inf, 3.0 - points[:, 0])

    found = sampled(slack, 2, 1)
    low, high = found.mean_interval(SURE)
    assert low <= stats.norm.sf(3.0) <= high


def test_a_border_whose_probability_underflows():
    """It is 54 deviations away: no draw fails, or all do."""
    assert sampled(lambda z, _: 54.0 - z[:, 0], 2, 3) == "few failures carry the sum, as if 0 points failed"
    found = sampled(lambda z, _: -54.0 - z[:, 0], 2, 3)
    assert found.plain.failures == found.plain.draws
    low, high = found.mean_interval()
    assert low <= 1.0 <= high
    assert low > 0.7
