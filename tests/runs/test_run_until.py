"""Runs that end where their draws decide, and intervals that follow the design of the draws."""

import json

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.statistics import FixedCount, IntervalsAfterStop, Replicated

TABLE = {
    "name": "small",
    "draws": 64,
    "loop": {"duration": 1.0, "sample_time": 0.01},
    "plant": {
        "kind": "normal_form",
        "k_p": {"uniform": [0.8, 1.2]},
        "a_p": {"normal": [1.0, 0.1]},
        "initial": [1.0, 0.0],
    },
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.5},
    "requirement": [{"metric": "error_rms", "max": 0.9}],
}
PAIR = "plant.k_p, plant.a_p"


@pytest.fixture
def plain():
    return dj.Study.from_table(TABLE)


def test_the_result_is_that_of_the_final_number_of_draws(plain, tmp_path):
    told = []
    found = dj.run_until(
        plain, dj.UntilWidth(0.15), tmp_path / "r", most=1000, progress=lambda done, total: told.append(done)
    )
    stopping = found.manifest["stopping"]
    assert stopping["data_driven"]
    assert stopping["verdict"] == "narrow"
    assert stopping["looks"][0]["draws"] == 100
    draws = stopping["looks"][-1]["draws"]
    assert told[-1] == draws  # more may have been simulated, in whole blocks
    fixed = dj.run(plain.override({"draws": draws}))
    for name in fixed.dataset.data_vars:
        np.testing.assert_array_equal(fixed.dataset[name], found.dataset[name], err_msg=name)
    loaded = dj.load(tmp_path / "r")
    assert loaded.method == found.method
    assert isinstance(loaded.method, IntervalsAfterStop)
    (point,) = loaded.summary()["points"]
    (narrower,) = fixed.summary()["points"]
    assert point["interval"][1] - point["interval"][0] <= 0.15
    low, high = (point["metrics"]["error_rms"]["q50_interval"], narrower["metrics"]["error_rms"]["q50_interval"])
    assert low[0] <= high[0] <= high[1] <= low[1]
    assert "data-driven" in json.loads((tmp_path / "r" / "summary.json").read_text())["interval_method"]


def test_a_data_driven_result_is_not_resumed_nor_overwritten_by_another_rule(plain, tmp_path):
    found = dj.run_until(plain, dj.UntilWidth(0.5), tmp_path / "r", most=200)
    with pytest.raises(ConfigError, match="cannot be resumed"):
        dj.run(found.study, tmp_path / "r", resume=True)
    with pytest.raises(ConfigError, match="choose another"):
        dj.run_until(plain, dj.UntilWidth(0.4), tmp_path / "r", most=200)
    dj.run_until(plain, dj.UntilWidth(0.5), tmp_path / "r", most=200)  # the same question may be asked again


def test_verdicts(plain):
    assert dj.run_until(plain, dj.AcceptReject(0.01, 0.1)).manifest["stopping"]["verdict"] == "rejected"
    undecided = dj.run_until(plain, dj.UntilWidth(0.01), most=120)
    assert undecided.manifest["stopping"]["verdict"] == "undecided"
    assert undecided.study.config.draws == 120


def test_only_one_point_and_independent_draws(plain):
    with pytest.raises(ConfigError, match="one point"):
        dj.run_until(plain.override({"sweep.controller.k_p": [1.0, 2.0]}), dj.UntilWidth(0.1))
    with pytest.raises(ConfigError, match="independent draws"):
        dj.run_until(plain.override({"sampling": "lhs"}), dj.UntilWidth(0.1))
    with pytest.raises(ConfigError, match="at least 100 draws"):
        dj.run_until(plain, dj.UntilWidth(0.1), most=99)


def test_replicated_designs_have_their_own_interval(plain, tmp_path):
    sweep = {"sweep.controller.k_p": [1.0, 2.0], "sampling": "sobol", f"correlation.{PAIR}": 0.5}
    result = dj.run(plain.override(sweep), tmp_path / "r")
    assert isinstance(result.method, Replicated)
    summary = result.summary()
    assert "Student's t over 8 scrambled Sobol" in summary["interval_method"]
    assert "q50_interval" not in summary["points"][0]["metrics"]["error_rms"]
    assert result.manifest["sampling"]["correlation"][PAIR]["normal"] == pytest.approx(0.5176, abs=1e-4)
    labels = [text.get_text() for ax in dj.plot.sweep(result).axes for text in ax.get_legend().get_texts()]
    assert any("Student's t" in text for text in labels)
    pieces = dj.run(plain.override(sweep), block=7)
    np.testing.assert_array_equal(result.dataset["error_rms"], pieces.dataset["error_rms"])


def test_random_draws_keep_the_exact_interval(plain):
    result = dj.run(plain)
    assert result.method == FixedCount()
    assert result.summary()["interval_method"] == "Clopper-Pearson"
    assert "q95_interval" in result.summary()["points"][0]["metrics"]["error_rms"]


def test_a_latin_hypercube_is_not_extended(plain, tmp_path):
    study = plain.override({"sampling": "lhs", "draws": 32})
    result = dj.run(study, tmp_path / "r")
    assert "Latin hypercube" in result.method.name
    assert "no interval" in dj.plot.failures(result).axes[1].get_ylabel()
    with pytest.raises(ConfigError, match="depend on their number"):
        dj.run(study.override({"draws": 64}), tmp_path / "r", resume=True)
