"""Sobol indices: functions with known answers, in-loop noise, and what is refused."""

import json

import numpy as np
import pytest
from scipy import special, stats

import dssc_jax as dj
from dssc_jax.analyses.sensitivity.outputs import FAILURE, NOISE, refusal_reason
from dssc_jax.analyses.sensitivity.sobol import saltelli_samples, sobol_indices
from dssc_jax.console.analyses import show_sensitivity
from tests.runs.test_run_until import TABLE

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
    a, b = saltelli_samples(rows, factors, (seed,))
    return sobol_indices(function(a), function(b), np.stack([function(ab) for ab in mixed(a, b)]))


def covered(function, truth, rows, seeds):
    """Share of intervals that hold the truth, for each index, and their mean width."""
    tables = np.stack([indices(function, rows, seed, truth.shape[1]) for seed in range(seeds)])
    low, high = tables[..., 1], tables[..., 2]
    return np.mean((low <= truth) & (truth <= high), axis=0), np.mean(high - low, axis=0)


def test_ishigami_lies_within_the_intervals():
    held, width = covered(ishigami, np.stack([FIRST, TOTAL]), 1024, 40)
    assert held.min() >= 0.9
    theirs = np.mean([widths_of_scipy(1024, seed) for seed in range(6)], axis=0)
    assert np.mean(width) < 0.85 * theirs.mean()
    assert np.all(width.ravel() <= 1.1 * theirs)  # its bootstrap has no seed: a width scatters by 5 %


def widths_of_scipy(rows, seed):
    law = [stats.uniform(-np.pi, 2.0 * np.pi)] * 3
    found = stats.sobol_indices(func=lambda x: ishigami((x.T / np.pi + 1.0) / 2.0), n=rows, dists=law, rng=seed)
    resampled = found.bootstrap()
    bounds = [order.confidence_interval for order in (resampled.first_order, resampled.total_order)]
    return np.concatenate([bound.high - bound.low for bound in bounds])


def test_the_g_function_lies_within_the_intervals_of_few_rows():
    damping = np.array([0.0, 1.0, 4.5, 9.0, 99.0, 99.0, 99.0, 99.0])
    alone = 1.0 / (3.0 * (1.0 + damping) ** 2)
    every = np.prod(1.0 + alone)
    truth = np.stack([alone, alone * every / (1.0 + alone)]) / (every - 1.0)
    held, _ = covered(lambda u: np.prod((np.abs(4.0 * u - 2.0) + damping) / (1.0 + damping), axis=-1), truth, 256, 100)
    assert held.min() >= 0.93


WEIGHTS = np.array([2.0, 1.0, 0.0]) / np.sqrt(5.0)


def half_space(p):
    return lambda points: (special.ndtri(points) @ WEIGHTS > stats.norm.isf(p)).astype(float)


def truth_of_half_space(p):
    """Failures of two draws with common factors are correlated normal variables beyond one threshold."""

    def shared(correlation):
        law = stats.multivariate_normal([0.0, 0.0], [[1.0, correlation], [correlation, 1.0]], allow_singular=True)
        both = law.cdf(np.full(2, -stats.norm.isf(p)))
        return (both - p**2) / (p * (1.0 - p))

    return np.array([[shared(w) for w in WEIGHTS**2], [1.0 - shared(1.0 - w) for w in WEIGHTS**2]])


def test_indices_of_a_rare_failure_hold_where_they_are_told():
    held, width = covered(half_space(0.01), truth_of_half_space(0.01), 4096, 60)
    assert held.min() >= 0.93
    assert width.max() < 0.4
    table = np.concatenate(indices(half_space(0.01), 8192, 0))
    assert table[2, 1] < 0.0 < table[2, 2]  # the factor that plays no part


@pytest.mark.parametrize(("p", "rows", "needed"), [(0.05, 256, 1024), (0.01, 1024, 4096), (0.002, 4096, 16384)])
def test_indices_of_too_few_failures_are_refused(p, rows, needed):
    """With the number of rows that do."""
    a, b = saltelli_samples(rows, 3, (3,))
    function = half_space(p)
    assert f"needs {needed:,} rows" in refusal_reason(function(a), function(b))
    more_a, more_b = saltelli_samples(needed, 3, (4,))
    assert refusal_reason(function(more_a), function(more_b)) is None
    assert "needs" in refusal_reason(1.0 - function(a), 1.0 - function(b))  # a rare success is a failure's mirror image
    constant = np.full(rows, 0.1)  # whose mean is not exactly 0.1
    assert refusal_reason(constant, constant) == "does not vary"
    enormous = 1e200 * function(a)
    assert refusal_reason(enormous, 1e200 * function(b)) == refusal_reason(function(a), function(b))


def test_a_study_with_a_rare_failure(capsys):
    """The failure is refused and says so everywhere; the metrics have their indices."""
    study = dj.Study.from_table(TABLE).override({"draws": 512, "requirement.0.max": 0.908})
    found = dj.sensitivity(study)
    assert found.outputs["error_rms"] is not None
    assert found.outputs[FAILURE] is None
    assert "of 512 rows carry its variance" in found.reasons[FAILURE]
    content = json.loads(json.dumps(found.summary()))
    assert content["outputs"][FAILURE] is None
    assert content["reasons"][FAILURE] == found.reasons[FAILURE]
    assert content["reasons"]["error_max"] == "does not vary"
    show_sensitivity(found, [])
    assert f"no answer: failure ({found.reasons[FAILURE]})" in " ".join(capsys.readouterr().out.split())
    (text,) = dj.plot.sensitivity(found).axes[0].texts
    assert " ".join(text.get_text().split()) == f"no answer; it {found.reasons[FAILURE]}"


def test_every_required_metric_is_told(capsys):
    """Of a headline metric without indices the first required one that has some takes the place."""
    required = [{"metric": name, "max": 50.0} for name in ("error_max", "error_rms", "command_rms")]
    study = dj.Study.from_table({**TABLE, "requirement": required, "draws": 256})
    found = dj.sensitivity(study)
    assert found.answer.headline == [FAILURE, "error_rms"]
    assert found.headline.startswith("error_rms depends most on")
    show_sensitivity(found, [])
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "no answer: failure (does not vary); error_max (does not vary)" in lines
    (brief,) = (line for line in lines if line.startswith("command_rms "))
    table = found.outputs["command_rms"]["total"]
    leading = int(np.argmax(table[:, 0]))
    assert f"command_rms {found.factors[leading]} {table[leading, 0]:.3g} [" in brief


def test_an_inert_factor_is_consistent_with_nothing():
    found = indices(lambda u: u[:, 0] + 0.0 * u[:, 1], 1024, 3, factors=2)
    assert found.first[0] == pytest.approx(1.0, abs=0.02)
    assert found.first[1, 1] <= 0.0 <= found.first[1, 2] < 0.02
    assert found.total[1, 0] == 0.0


def test_a_study():
    study = dj.Study.from_table(TABLE).override({"draws": 600})
    told = []
    found = dj.sensitivity(study, progress=lambda done, total: told.append((done, total)))
    assert (found.rows, found.simulations, told[-1]) == (512, 2048, (2048, 2048))
    assert found.factors == ("plant.k_p", "plant.a_p")
    rms = found.outputs["error_rms"]
    assert rms["first"][:, 0].sum() == pytest.approx(1.0, abs=0.02)  # nearly additive
    assert np.all(rms["total"][:, 0] >= rms["first"][:, 0] - 0.02)
    failure = found.outputs[FAILURE]
    assert failure["total"][:, 0].sum() > failure["first"][:, 0].sum()  # a threshold makes factors interact
    content = json.loads(json.dumps(found.summary()))
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
    assert table["first"][-1, 0] > 0.95
    assert np.all(table["total"][:-1, 2] < 0.05)  # the parameters are not charged with the noise


def test_what_is_refused():
    study = dj.Study.from_table(TABLE)
    with pytest.raises(dj.ConfigError, match="make them independent: correlation"):
        dj.sensitivity(study.override({"draws": 512, "correlation.plant.k_p, plant.a_p": 0.5}))
    with pytest.raises(dj.ConfigError, match="nothing is uncertain"):
        dj.sensitivity(study.override({"draws": 512, "plant.k_p": 1.0, "plant.a_p": 1.0}))
    with pytest.raises(dj.ConfigError, match="draws >= 256, got 64"):
        dj.sensitivity(study)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "sobol"}, "needs draws >= 256, got 20"),
        ({"method": "shapley"}, "needs draws >= 256, got 20"),
        ({"method": "morris"}, "Morris screening of . factors needs draws >= .*, got 20"),
        ({"method": "sobol", "confidence": 1.5}, r"must lie in \(0, 1\), got 1.5"),
        ({"method": "range"}, "must be one of sobol, shapley, morris"),
    ],
)
def test_arguments_are_refused_before_anything_is_compiled(monkeypatch, arguments, message):
    """Nor is a draw simulated to see whether the loop has noise."""
    monkeypatch.setattr("dssc_jax.analyses.sensitivity.analysis.Engine", None)
    study = dj.Study.from_table({**TABLE, "draws": 20})
    with pytest.raises(dj.ConfigError, match=message):
        dj.sensitivity(study, **arguments)
