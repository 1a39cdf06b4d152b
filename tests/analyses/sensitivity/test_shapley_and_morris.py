"""Shapley effects against closed forms for correlated normal numbers, and Morris screening against known effects."""

import itertools
import json
import math

import numpy as np
import pytest
from scipy import special, stats

import dssc_jax as dj
from dssc_jax.analyses.sensitivity.morris import elementary_effects, screening, trajectories
from dssc_jax.analyses.sensitivity.outputs import FAILURE, NOISE
from dssc_jax.analyses.sensitivity.shapley import chained_scores, random_orders, shapley_effects
from dssc_jax.analyses.sensitivity.sobol import saltelli_samples
from dssc_jax.cli.main import guarded
from tests.analyses.sensitivity.test_sensitivity import ishigami
from tests.runs.test_run_until import TABLE


def effects_of(function, correlation, rows, seed):
    """Estimates with intervals for a function of correlated normal scores."""
    order = random_orders(rows, len(correlation), (seed, 1))
    own, other = map(special.ndtri, saltelli_samples(rows, len(correlation), (seed,)))
    return shapley_effects(function(chained_scores(correlation, own, other, order)), order)


def explained(weights, correlation, known):
    """Variance of a linear function of normal scores that is explained if some are known."""
    with_known = correlation[:, known]
    return float(weights @ with_known @ np.linalg.solve(correlation[np.ix_(known, known)], with_known.T) @ weights)


def linear_effects(weights, correlation):
    """Shapley effects of a linear function of normal scores, by their definition over all orders."""
    count = len(weights)
    effects = np.zeros(count)
    for order in itertools.permutations(range(count)):
        told = [explained(weights, correlation, list(order[:known])) for known in range(count + 1)]
        effects[list(order)] += np.diff(told)
    return effects / math.factorial(count) / (weights @ correlation @ weights)


def random_correlation(rng, count):
    factor = rng.standard_normal((count, count + 1))
    covariance = factor @ factor.T
    scale = np.sqrt(np.diag(covariance))
    return covariance / np.outer(scale, scale)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_linear_functions_of_correlated_normal_numbers(count):
    rng = np.random.default_rng(count)
    correlation, weights = random_correlation(rng, count), rng.standard_normal(count)
    truth = linear_effects(weights, correlation)
    tables = np.stack([effects_of(lambda z: z @ weights, correlation, 1024, seed) for seed in range(60)])
    held = np.mean((tables[..., 1] <= truth) & (truth <= tables[..., 2]), axis=0)
    assert held.min() >= 0.87  # of 60; 95 % wanted
    assert tables[..., 0].mean(0) == pytest.approx(truth, abs=0.01)
    assert tables[..., 0].sum(1) == pytest.approx(1.0, abs=1e-12)
    assert np.mean(tables[..., 2] - tables[..., 1]) < 0.15


def test_two_correlated_numbers_by_the_formula():
    """Owen and Prieur (2017), theorem 2: f = x_1 + b x_2 with correlation r."""
    b, r = 2.0, -0.6
    variance = 1.0 + b**2 + 2.0 * r * b
    first = (1.0 + r * b + 0.5 * r**2 * (b**2 - 1.0)) / variance
    truth = linear_effects(np.array([1.0, b]), np.array([[1.0, r], [r, 1.0]]))
    assert truth == pytest.approx([first, 1.0 - first])


def test_a_copy_takes_half():
    """Of two numbers that are nearly equal each gets half, though only one enters."""
    nearly = np.array([[1.0, 1.0 - 1e-9], [1.0 - 1e-9, 1.0]])
    assert effects_of(lambda z: z[..., 0], nearly, 4096, 0)[:, 0] == pytest.approx([0.5, 0.5], abs=0.02)


def test_independent_factors_lie_between_their_sobol_indices():
    """Ishigami: the interaction of x and z, 0.243684 of the variance, is halved."""
    truth = [0.313905 + 0.243684 / 2.0, 0.442411, 0.243684 / 2.0]
    found = effects_of(lambda z: ishigami(special.ndtr(z).reshape(-1, 3)).reshape(z.shape[:-1]), np.eye(3), 8192, 5)
    assert np.all((found[:, 1] <= truth) & (truth <= found[:, 2]))
    assert found[:, 0] == pytest.approx(truth, abs=0.04)


def test_chained_scores_share_what_is_known():
    rng = np.random.default_rng(7)
    correlation = random_correlation(rng, 3)
    own, other = rng.standard_normal((2, 100_000, 3))
    order = np.tile([2, 0, 1], (100_000, 1))
    chain = chained_scores(correlation, own, other, order)
    for known, scores in enumerate(chain):
        assert np.corrcoef(scores.T) == pytest.approx(correlation, abs=0.02)
        shared = [2, 0, 1][:known]
        assert np.array_equal(scores[:, shared], chain[-1][:, shared])
    rest = chain[-1][:, 1] - chain[2][:, 1]  # independent given what both know
    known = chain[-1][:, [2, 0]]
    assert np.abs(np.corrcoef(np.column_stack([rest, known]).T)[0, 1:]).max() < 0.02


CORRELATED = {"draws": 512, "correlation.plant.k_p, plant.a_p": 0.8}


def test_a_study_with_correlated_numbers(tmp_path):
    study = dj.Study.from_table(TABLE).override(CORRELATED)
    found = dj.sensitivity(study, "shapley")
    assert (found.rows, found.simulations) == (512, 3 * 512)
    effects = found.outputs["error_rms"]["effect"]
    assert effects[:, 0].sum() == pytest.approx(1.0, abs=1e-9)
    assert found.outputs["error_max"] is None
    free = dj.sensitivity(study.override({"correlation": {}}), "shapley").outputs["error_rms"]["effect"]
    indices = dj.sensitivity(study.override({"correlation": {}})).outputs["error_rms"]
    room = 0.02
    assert np.all(indices["first"][:, 0] - room <= free[:, 0])
    assert np.all(free[:, 0] <= indices["total"][:, 0] + room)
    assert np.abs(np.diff(effects[:, 0])) < np.abs(np.diff(free[:, 0]))  # correlation levels out
    found.save(tmp_path / "s")
    assert dj.load(tmp_path / "s") == found
    assert dj.plot.sensitivity(found).axes[0].get_xlabel() == "share of the variance"


NOISY = {"disturbance": {"kind": "filtered_noise", "std": 0.5, "correlation_time": 0.2}}
NARROW = {"plant.k_p": {"uniform": [0.999, 1.001]}, "plant.a_p": {"uniform": [0.999, 1.001]}}


@pytest.mark.parametrize(("method", "part"), [("shapley", "effect"), ("morris", "size")])
def test_noise_is_a_factor_of_its_own(method, part):
    study = dj.Study.from_table(TABLE).override({"draws": 512, **NARROW, **NOISY})
    found = dj.sensitivity(study, method)
    assert found.factors[-1] == NOISE
    values = found.outputs["error_rms"][part][:, 0]
    assert values[-1] > 0.9 * values.sum()


def test_trajectories_move_each_factor_once():
    levels, order = trajectories(50, 4, (1,))
    steps = np.diff(levels, axis=0)
    assert np.all(np.sort(np.argmax(np.abs(steps), axis=2), axis=0) == np.arange(4)[:, None])
    assert np.array_equal(np.argmax(np.abs(steps), axis=2).T, order)
    assert np.all(np.isin(np.abs(steps[steps != 0.0]), 0.5))
    assert set(np.unique(levels)) == {0.125, 0.375, 0.625, 0.875}


def test_elementary_effects_of_a_function_with_an_interaction():
    """f = 4 x_1 - 2 x_2 + 8 (x_3 - 1/2)(x_4 - 1/2), and x_5 without effect."""

    def function(x):
        return 4.0 * x[..., 0] - 2.0 * x[..., 1] + 8.0 * (x[..., 2] - 0.5) * (x[..., 3] - 0.5)

    levels, order = trajectories(400, 5, (3,))
    effects = elementary_effects(function(levels), levels, order)
    assert effects[0] == pytest.approx(2.0)
    assert effects[1] == pytest.approx(-1.0)
    size, spread = screening(effects, 0.95)
    assert size[:2, 0] == pytest.approx([2.0, 1.0])
    assert spread[[0, 1, 4], 2] == pytest.approx(0.0, abs=1e-6)
    for part in (2, 3):  # 4 (x - 1/2) with x at the levels: sizes 0.5 and 1.5
        assert size[part, 1] <= 1.0 <= size[part, 2]
        assert spread[part, 1] <= math.sqrt(1.25) <= spread[part, 2]
    assert np.all(size[4] == 0.0)


def test_a_failure_that_no_move_has_changed_is_not_excluded():
    """Clopper and Pearson: none of 40 is consistent with 8.8 %."""
    effects = np.zeros((2, 40))
    effects[1, :20] = (-1.0) ** np.arange(20)
    size, spread = screening(effects, 0.95)
    assert size[0] == pytest.approx([0.0, 0.0, 1.0 - 0.025 ** (1 / 40)])
    assert spread[0, 2] == pytest.approx(math.sqrt(size[0, 2]))
    assert size[1] == pytest.approx([0.5, *stats.binomtest(20, 40).proportion_ci(0.95)])


def test_the_intervals_of_the_spread_cover():
    rng = np.random.default_rng(5)
    _, spread = screening(rng.standard_normal((2000, 40)), 0.95)
    assert 0.9 < np.mean((spread[:, 1] <= 1.0) & (spread[:, 2] >= 1.0)) < 0.98


def test_screening_of_a_study_by_command(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert guarded(["sensitivity", "mu_robustness", "--method", "morris", "--draws", "80", "--out", "s", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["method"] == "morris"
    assert content["simulations"] <= 80
    found = dj.load("s")
    assert found.headline.startswith("failure depends most on") or FAILURE in found.reasons
    assert guarded(["sensitivity", "mu_robustness", "--method", "morris", "--draws", "20"]) == 2
    assert "Morris screening of" in " ".join(capsys.readouterr().err.split())
    assert guarded(["sensitivity", "mu_robustness", "--method", "sobl"]) == 2
    assert "must be one of sobol, shapley, morris, got 'sobl'" in " ".join(capsys.readouterr().err.split())


def test_correlated_numbers_are_not_screened():
    with pytest.raises(dj.ConfigError, match="use the method 'shapley'"):
        dj.sensitivity(dj.Study.from_table(TABLE).override(CORRELATED), "morris")
