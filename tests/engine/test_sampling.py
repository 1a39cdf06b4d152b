"""Designs addressed by index, replicates, and correlated numbers."""

import numpy as np
import pytest
from scipy import stats

from dssc_jax import ConfigError
from dssc_jax.engine.sampling import draw, unit_points

PAIR = "correlation.plant.k_p, plant.a_p"


@pytest.fixture
def plain(uncertain):
    return uncertain.without_sweep()


@pytest.mark.parametrize("kind", ["random", "sobol", "lhs"])
def test_a_point_depends_on_its_index_only(plain, kind):
    study = plain.override({"sampling": kind, "draws": 512})
    complete = unit_points(study, np.arange(512))
    for start, stop in [(0, 1), (3, 200), (500, 512)]:
        np.testing.assert_array_equal(unit_points(study, np.arange(start, stop)), complete[start:stop])
    assert np.all((complete > 0.0) & (complete < 1.0))
    assert len(np.unique(complete)) == complete.size


@pytest.mark.parametrize("kind", ["random", "sobol"])
def test_more_draws_keep_the_first_ones(plain, kind):
    short, long = (plain.override({"sampling": kind, "draws": n}) for n in (128, 1024))
    np.testing.assert_array_equal(unit_points(short, np.arange(128)), unit_points(long, np.arange(128)))


@pytest.mark.parametrize(("kind", "cells"), [("sobol", 64), ("lhs", 75)])
def test_every_replicate_is_stratified_and_differs_from_the_others(plain, kind, cells):
    study = plain.override({"sampling": kind, "draws": 8 * cells})
    points = unit_points(study, np.arange(8 * cells)).reshape(cells, 8, -1)
    for replicate in range(8):
        for column in points[:, replicate].T:
            assert sorted(np.floor(column * cells)) == list(range(cells))
    assert not np.array_equal(points[:, 0], points[:, 1])


def test_another_seed_gives_other_points(plain):
    for kind in ("sobol", "lhs"):
        first, second = (plain.override({"sampling": kind, "draws": 64, "seed": s}) for s in (1, 2))
        assert not np.any(unit_points(first, np.arange(64)) == unit_points(second, np.arange(64)))


def test_another_law_does_not_move_the_latin_columns_of_the_others(plain):
    study = plain.override({"sampling": "lhs", "draws": 64})
    fixed = study.override({"plant.k_p": 1.0})
    left, right = draw(study, np.arange(64)), draw(fixed, np.arange(64))
    for name in fixed.laws:
        np.testing.assert_array_equal(left[name], right[name])


@pytest.mark.parametrize("rank", [-0.8, 0.3, 0.9])
def test_the_rank_correlation_is_the_one_declared(plain, rank):
    study = plain.override({PAIR: rank, "sampling": "sobol", "draws": 8 * 1024})
    found = draw(study, np.arange(8 * 1024))
    assert stats.spearmanr(found["plant.k_p"], found["plant.a_p"]).statistic == pytest.approx(rank, abs=0.01)
    assert stats.spearmanr(found["plant.k_p"], found["controller.rho"]).statistic == pytest.approx(0.0, abs=0.02)
    free = draw(study.override({"correlation": {}}), np.arange(8 * 1024))
    for name in study.laws:  # each keeps its own law, those of no pair their very values
        gaps = np.sort(study.laws[name].quantile(np.linspace(0.1, 0.9, 9))) - np.quantile(
            found[name], np.linspace(0.1, 0.9, 9)
        )
        assert np.abs(gaps).max() < 0.02 * np.ptp(free[name])
    np.testing.assert_array_equal(found["plant.k_p"].round(9), free["plant.k_p"].round(9))
    np.testing.assert_array_equal(found["controller.rho"], free["controller.rho"])


THREE = {"plant.k_p, plant.a_p": 0.9, "plant.a_p, controller.rho": 0.9, "plant.k_p, controller.rho": -0.5}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"correlation": THREE}, r'correlation."plant.k_p, .*": .*not positive definite \(smallest eigenvalue -0.5'),
        ({"correlation": {"plant.k_p": 0.5}}, "two different numbers"),
        ({"correlation": {"plant.kp, plant.a_p": 0.5}}, "did you mean 'plant.k_p'"),
        ({PAIR: 1.0}, r"must lie in \(-1, 1\), got 1"),
        ({"correlation": {"plant.k_p, plant.a_p": 0.1, "plant.a_p, plant.k_p": 0.1}}, "given twice"),
        ({PAIR: 0.1, "sweep.plant.k_p": [1.0, 1.1]}, "is swept"),
        ({"sampling": "sobol", "draws": 100}, r"8 \* 2\^m with m >= 1, got 100; the nearest is 128"),
        ({"sampling": "lhs", "draws": 100}, "multiple of replicates = 8, .* got 100; the nearest is 96"),
        ({"sampling": "sobol", "draws": 64, "replicates": 4}, "replicates"),
        ({"replicates": 8}, "replicates belong to sampling"),
    ],
)
def test_bad_designs_are_told(plain, changes, message):
    with pytest.raises(ConfigError, match=message):
        plain.override(changes)
