"""Sobol indices: functions with known answers, in-loop noise, and what is refused."""

import json

import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.global_sensitivity import FAILURE, NOISE, saltelli, sobol_indices
from tests.test_stopping import TABLE

FIRST, TOTAL = np.array([0.313905, 0.442411, 0.0]), np.array([0.557589, 0.442411, 0.243684])


def ishigami(points):
    x, y, z = np.pi * (2.0 * points.T - 1.0)
    return np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)


def mixed(a, b):
    """AB_i for each column."""
    for column in range(a.shape[1]):
        found = a.copy()
        found[:, column] = b[:, column]
        yield found


def indices(function, rows, seed, factors=3):
    a, b = saltelli(rows, factors, (seed,))
    return sobol_indices(function(a), function(b), np.stack([function(ab) for ab in mixed(a, b)]), (seed,))


def test_ishigami_lies_within_the_intervals():
    inside, width = [], []
    for seed in range(40):
        found = indices(ishigami, 1024, seed)
        table, truth = np.concatenate(found), np.concatenate([FIRST, TOTAL])
        inside.append((table[:, 1] <= truth) & (truth <= table[:, 2]))
        width.append(table[:, 2] - table[:, 1])
    assert np.mean(inside, axis=0).min() >= 0.93
    theirs = np.mean([widths_of_scipy(1024, seed) for seed in range(6)], axis=0)
    assert np.mean(width) < 0.95 * theirs.mean()
    assert np.all(np.mean(width, axis=0) <= 1.1 * theirs)  # its bootstrap has no seed: a width scatters by 5 %


def widths_of_scipy(rows, seed):
    law = [stats.uniform(-np.pi, 2.0 * np.pi)] * 3
    found = stats.sobol_indices(func=lambda x: ishigami((x.T / np.pi + 1.0) / 2.0), n=rows, dists=law, rng=seed)
    resampled = found.bootstrap()
    bounds = [order.confidence_interval for order in (resampled.first_order, resampled.total_order)]
    return np.concatenate([bound.high - bound.low for bound in bounds])


def test_an_inert_factor_is_consistent_with_nothing():
    found = indices(lambda u: u[:, 0] + 0.0 * u[:, 1], 1024, 3, factors=2)
    assert found.first[0] == pytest.approx(1.0, abs=0.02)
    assert found.first[1, 1] <= 0.0 <= found.first[1, 2] < 0.02
    assert found.total[1, 0] == 0.0


def test_a_study(tmp_path):
    study = dj.Study.from_table(TABLE).override({"draws": 600})
    told = []
    found = dj.sensitivity(study, progress=lambda done, total: told.append((done, total)))
    assert (found.rows, found.simulations, told[-1]) == (512, 2048, (2048, 2048))
    assert found.factors == ("plant.k_p", "plant.a_p")
    rms = found.outputs["error_rms"]
    assert rms.first[:, 0].sum() == pytest.approx(1.0, abs=0.02)  # nearly additive
    assert np.all(rms.total[:, 0] >= rms.first[:, 0] - 0.02)
    failure = found.outputs[FAILURE]
    assert failure.total[:, 0].sum() > failure.first[:, 0].sum()  # a threshold makes factors interact
    content = json.loads(json.dumps(found.to_dict()))
    low, high = content["outputs"]["error_rms"]["plant.k_p"]["first_interval"]
    assert low < content["outputs"]["error_rms"]["plant.k_p"]["first"] < high
    assert content["outputs"]["error_max"] is None  # the initial error, whatever the draw
    figure = dj.plot.sensitivity(found)
    assert [ax.get_title() for ax in figure.axes] == ["failure", "error_rms"]


def test_noise_is_a_factor_of_its_own():
    study = dj.Study.from_table(TABLE).override({"draws": 512, "plant.k_p": {"uniform": [0.999, 1.001]}})
    quiet = study.override({"plant.a_p": {"uniform": [0.999, 1.001]}})
    noise = {"disturbance": {"kind": "filtered_noise", "std": 0.5, "correlation_time": 0.2}}
    found = dj.sensitivity(quiet.override(noise))
    assert found.factors[-1] == NOISE
    assert found.simulations == 5 * 512
    table = found.outputs["error_rms"]
    assert table.first[-1, 0] > 0.95
    assert np.all(table.total[:-1, 2] < 0.05)  # the parameters are not charged with the noise


def test_what_is_refused():
    study = dj.Study.from_table(TABLE)
    with pytest.raises(dj.ConfigError, match="make them independent with --set correlation"):
        dj.sensitivity(study.override({"draws": 512, "correlation.plant.k_p, plant.a_p": 0.5}))
    with pytest.raises(dj.ConfigError, match="nothing is uncertain"):
        dj.sensitivity(study.override({"draws": 512, "plant.k_p": 1.0, "plant.a_p": 1.0}))
    with pytest.raises(dj.ConfigError, match="draws >= 256, got 64"):
        dj.sensitivity(study)
