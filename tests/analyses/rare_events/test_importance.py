"""Importance sampling around design points against closed forms, and where it must not answer."""

import numpy as np
import pytest
from scipy import integrate, special, stats

import dssc_jax as dj
from dssc_jax.analyses.rare_events.design_points import find_design_points, with_curvature
from dssc_jax.analyses.rare_events.importance import ImportanceSampling, WeightedEstimate, importance_sampling
from tests.analyses.rare_events.test_rare import FOUR_BRANCH, four_branch, hidden
from tests.runs.test_run_until import TABLE


def slopes_of(slack):
    """Central differences of a slack, as a program with derivatives would give."""

    def slope(points, noise):
        shifts = 1e-6 * np.eye(points.shape[1])
        columns = [(slack(points + shift, noise) - slack(points - shift, noise)) / 2e-6 for shift in shifts]
        return slack(points, noise), np.stack(columns, axis=1)

    return slope


def sampled(slack, dimension, seed, settings=ImportanceSampling()):  # noqa: B008
    return importance_sampling(slack, slopes_of(slack), dimension, (seed,), settings)


def half_space(probability, dimension):
    normal = np.arange(1.0, dimension + 1.0)
    normal /= np.linalg.norm(normal)
    return lambda z, _: -special.ndtri(probability) - z @ normal


def two_sides(z, _):
    """Failures of 1e-5 and of 3e-6 on opposite sides."""
    return np.minimum(-special.ndtri(1e-5) - z[:, 0], -special.ndtri(3e-6) + z[:, 0])


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
        (curved, 3, curved_probability(3)),
    ],
    ids=["likely", "one in a million", "many numbers", "two sides", "four branches", "a curved border"],
)
def test_the_interval_covers(slack, dimension, truth):
    found = [sampled(slack, dimension, seed) for seed in range(20)]
    answers = [estimate for estimate in found if isinstance(estimate, WeightedEstimate)]
    assert len(answers) >= 19
    intervals = np.array([estimate.mean_interval() for estimate in answers])
    assert np.sum((intervals[:, 0] <= truth) & (truth <= intervals[:, 1])) >= len(answers) - 3
    means = np.array([estimate.mean for estimate in answers])
    assert means.mean() == pytest.approx(truth, rel=0.1)
    assert means.std() / truth == pytest.approx(np.mean([estimate.variation for estimate in answers]), rel=0.6)
    assert np.mean([estimate.simulations for estimate in answers]) < 5000


def test_design_points_and_their_approximations():
    """Of a parabola, whose second-order probability is known: Phi(-beta) (1 + 2 beta c)^(-1/2)."""

    def parabola(z, _):
        return 3.0 - z[:, 0] + 0.2 * z[:, 1] ** 2

    slope = slopes_of(parabola)
    (found,) = find_design_points(slope, np.array([[1.0, 1.0], [0.5, -2.0]]), np.array([4, 5]))
    assert found.point == pytest.approx([3.0, 0.0], abs=0.05)
    assert found.first_order_probability == pytest.approx(special.ndtr(-3.0), rel=0.02)
    curved_point = with_curvature(slope, found)
    assert curved_point.second_order == pytest.approx((1.0 + 2.0 * 3.0 * 0.2) ** -0.5, rel=0.02)


def test_both_of_two_sides_are_found():
    found = sampled(two_sides, 2, 3)
    assert isinstance(found, WeightedEstimate)
    distances = [design_point.distance for design_point in found.design_points]
    assert distances == pytest.approx([-special.ndtri(1e-5), -special.ndtri(3e-6)], abs=1e-3)
    assert np.all(two_sides(found.points, None) < 0.0)


def test_a_hidden_failure_is_found_or_contradicted():
    """The slack leads to a failure of 2.9e-7, and does not show one of 6.9e-4 on the other side."""
    truth = stats.norm.sf(3.2) + stats.norm.sf(5.0)
    for seed in range(10):
        found = sampled(hidden, 1, seed)
        if isinstance(found, WeightedEstimate) and not found.contradicted and found.reached:
            low, high = found.interval(0.999)
            assert low <= truth <= high


def test_a_slack_without_slopes_has_no_answer():
    found = sampled(lambda z, _: np.where(z[:, 0] > 3.0, -1.0, 1.0), 2, 0)
    assert found == "no search ended at the border of failure"
    with pytest.raises(dj.ConfigError, match="variation"):
        ImportanceSampling(variation=0.0)
    with pytest.raises(dj.ConfigError, match="plain >= 1"):
        ImportanceSampling(plain=0)


def test_a_study_agrees_with_splitting_and_comes_back(tmp_path):
    study = dj.Study.from_table(TABLE).override({"requirement.0.max": 0.915})
    found = dj.rare(study, splitting=None)
    low, high = found.estimate.interval(0.999)
    split = dj.rare(study, None, dj.Splitting(particles=100, killed=50, repeats=10))
    below, above = split.estimate.interval(0.999)
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
    assert found.answer.refusal == "no search ended at the border of failure"
    with pytest.raises(dj.ConfigError, match="no answer"):
        dj.rare(study, splitting=None)


def test_a_start_that_diverges_begins_no_search():
    """It has the slack -inf and slopes of 0; the other start finds the design point, without a warning of NumPy."""

    def slack(points, noise):
        return np.where(points[:, 0] < -1.0, -np.inf, 3.0 - points[:, 0])

    def slope(points, noise):
        slopes = np.where(points[:, :1] < -1.0, 0.0, -np.eye(1, 2))
        return slack(points, noise), slopes

    (found,) = find_design_points(slope, np.array([[-2.0, 0.5], [1.0, 0.5]]), np.zeros(2, int))
    assert found.point == pytest.approx([3.0, 0.0], abs=1e-3)
