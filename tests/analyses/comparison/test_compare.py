"""Comparisons: common draws and noise, pairs, and tuning on equal budgets."""

import copy
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.comparison.tuning import (
    RUNOFF,
    Tuning,
    best_gains,
    candidate_points,
    gain_ranges,
    slack_or_metric,
    untuned_reason,
)
from dssc_jax.closed_loop.metrics.performance import PERFORMANCE
from dssc_jax.closed_loop.metrics.streaming import METRICS
from dssc_jax.results.manifest import write_sealed
from dssc_jax.statistics import compare_failures
from tests.loops import LAGGED

TABLE = LAGGED | {
    "name": "duel",
    "seed": 9,
    "draws": 60,
    "unmodelled": {"kind": "lag", "order": 2, "mu": {"uniform": [0.02, 0.4]}},
    "disturbance": {"kind": "step", "value": {"uniform": [-0.6, 0.6]}, "at": 3.0},
    "metrics": {"names": ["error_rms", "command_tv"]},
    "requirement": [{"metric": "error_max", "after": 2.0, "max": 0.1}],
}


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(TABLE)


@pytest.fixture(scope="module")
def found(study):
    return dj.compare(study, ["dssc", "sta"], candidates=4, tuning_draws=8)


def test_every_controller_runs_alone_as_in_company(study, found):
    alone = dj.run(study.override({"controller": found.corresponding.tables["sta"]})).dataset
    together = found.corresponding.dataset.sel(controller="sta")
    for variable in ("error_rms", "command_tv", "outcome", "plant.k_p", "disturbance.value"):
        assert np.array_equal(alone[variable].values, together[variable].values), variable


@pytest.mark.parametrize(("name", "sign"), [("error_rms", -1.0), ("rotor_thrust_min", 1.0)])
def test_without_requirements_a_tuning_seeks_the_good_side_of_the_first_metric(name, sign):
    """Small errors, and a large least thrust."""
    measure = SimpleNamespace(name=name, metric=(METRICS | PERFORMANCE)[name])
    values = np.array([0.5, 2.0, np.nan])
    found = slack_or_metric(SimpleNamespace(requirements=(), measures=(measure,)), {name: values})
    np.testing.assert_array_equal(found, [sign * 0.5, sign * 2.0, -np.inf])


def test_noise_is_common(study):
    """The same controller under two names: on one stream of noise they cannot be told apart."""
    pi = {"kind": "pi", "l0": 1.0, "k_p": 4.0, "k_i": 2.0}
    noisy = study.override({"disturbance": {"kind": "filtered_noise", "std": 0.2, "correlation_time": 0.5}, "draws": 8})
    twins = dj.compare(noisy.override({"compare": {"left": pi, "right": pi}}), ["left", "right"])
    left, right = (twins.corresponding.dataset["error_rms"].sel(controller=name).values for name in ("left", "right"))
    assert np.array_equal(left, right)
    assert np.ptp(left) > 0.0
    assert twins.summary()["pairs"][0]["p_value"] == 1.0


def test_pairs(found):
    pairs = found.summary()["pairs"]
    assert [(pair["a"], pair["b"]) for pair in pairs] == [("dssc", "sta")]
    failed = found.corresponding.dataset["failed"]
    for pair in pairs:
        expected = compare_failures(*(failed.sel(controller=pair[side]).values for side in "ab"))
        assert pair["difference"] == expected.difference
        assert pair["interval"] == list(expected.interval)
        assert pair["p_value"] == expected.p_value
        low, high = pair["metrics"]["error_rms"]["interval"]
        assert low <= pair["metrics"]["error_rms"]["difference"] <= high
    assert "plant.k_p" not in pairs[0]["metrics"]
    assert "slack_error_max_after_2" not in pairs[0]["metrics"]


def test_each_controller_tells_which_requirement_its_draws_violate(study, found):
    """Counted again from the metric itself; a draw without a value violates."""
    for name, controller in found.answer.corresponding.controllers.items():
        values = found.corresponding.dataset["error_max_after_2"].sel(controller=name).values
        assert controller.violations == {"error_max_after_2": int(np.sum(~(values <= 0.1)))}


def test_the_given_tables_survive_tuning(study, found):
    assert study.table == TABLE
    assert found.corresponding.tables["dssc"]["functions"]["kappa1"] == 4.0


def test_tuning_gives_every_controller_the_same(study, found):
    assert found.budget == Tuning(candidates=4, draws=8, seed=10)
    assert found.budget.text in found.summary()["tuned"]["budget"]
    for name, gains in (("dssc", ("kappa1", "kappa2")), ("sta", ("kappa1", "kappa2"))):
        given, best = found.corresponding.tables[name], found.tuned.tables[name]
        given, best = (table.get("functions", table) for table in (given, best))
        for gain in gains:
            assert given[gain] / 10 * (1 - 1e-9) <= best[gain] <= given[gain] * 10 * (1 + 1e-9)
    names = found.dataset["controller"].values.tolist()
    assert names == ["dssc", "sta", "dssc_tuned", "sta_tuned"]


def test_the_best_candidate_is_the_best_by_hand(study):
    budget = Tuning(candidates=6, draws=10, seed=10)
    best = best_gains(study, budget, gain_ranges(study, {}))
    trial = study.override({"seed": 10, "draws": 10})
    candidates = candidate_points(trial, gain_ranges(study, {}), budget.candidates, budget.seed)
    data = dj.run(trial.override({"sweep": {name: column.tolist() for name, column in candidates.items()}})).dataset
    each = (range(6), range(6))  # the sweep is a grid, of which the candidates are the diagonal
    margin = data["slack_error_max_after_2"].values[each]
    failures = np.count_nonzero(data["outcome"].values[each] != 0, axis=-1)
    scores = list(zip(failures.tolist(), (-margin.min(axis=-1)).tolist(), range(6), strict=True))
    winner = min(scores)[-1]
    more = study.override({"seed": 10, "draws": 10 + RUNOFF})
    further = []
    for i in (0, winner):
        data = dj.run(more.override({name: float(column[i]) for name, column in candidates.items()})).dataset
        slack = np.sort(data["slack_error_max_after_2"].values[10:])
        further.append((np.count_nonzero(data["outcome"].values[10:]), -slack[math.ceil(0.05 * RUNOFF) - 1]))
    winner = winner if further[1] < further[0] else 0
    assert best == pytest.approx({name: column[winner] for name, column in candidates.items()}, rel=1e-12)
    assert candidates["controller.functions.kappa1"][0] == 4.0


def test_stated_ranges(study):
    stated = gain_ranges(study, {"functions.kappa1": [2.0, 3.0], "l0": [0.5, 2.0]})
    best = best_gains(study, Tuning(candidates=4, draws=4, seed=1), stated)
    assert 2.0 <= best["controller.functions.kappa1"] <= 3.0
    assert 0.5 <= best["controller.l0"] <= 2.0
    with pytest.raises(dj.ConfigError, match=r"tune.l0: must be \[lo, hi\]"):
        gain_ranges(study, {"l0": [2.0, 0.5]})


def test_a_saved_comparison_is_the_same_again(found, tmp_path):
    found.save(tmp_path / "c")
    assert json.loads((tmp_path / "c" / "summary.json").read_text())["pairs"][0]["a"] == "dssc"
    back = dj.load(tmp_path / "c")
    assert isinstance(back, dj.Comparison)
    assert back.summary() == found.summary()
    assert back.corresponding.dataset.identical(found.corresponding.dataset)
    assert back.tuned.dataset.identical(found.tuned.dataset)
    assert (back.budget, back.study.hash) == (found.budget, found.study.hash)


def test_a_damaged_comparison_is_told(found, tmp_path):
    found.save(tmp_path)
    about = json.loads((tmp_path / "compare.json").read_text())
    about["settings"]["corresponding_part"][1].append("nothing")
    write_sealed(tmp_path / "compare.json", {name: about[name] for name in about if name != "digest"})
    with pytest.raises(dj.ConfigError, match="damaged, or of another version"):
        dj.load(tmp_path)


@pytest.mark.parametrize(
    ("names", "options", "rule"),
    [
        (["dssc"], {}, "needs two different names"),
        (["dssc", "dssc"], {}, "needs two different names"),
        (["dssc", "dssk"], {}, "no such controller"),
        (["dssc", "pi"], {"candidates": -1}, "candidates: must be in 1"),
        (["dssc", "pi"], {"candidates": 2, "tuning_draws": 0}, "tuning draws: must be in 1"),
    ],
)
def test_bad_input(study, names, options, rule):
    with pytest.raises(dj.ConfigError, match=rule):
        dj.compare(study, names, **options)


def test_a_requirement_that_a_rival_cannot_have(study):
    changed = copy.deepcopy(TABLE) | {"requirement": [{"metric": "outside_sliding", "max": 0.1}]}
    with pytest.raises(dj.ConfigError, match=r"compare.pi: .*needs sliding_margin"):
        dj.compare(dj.Study.from_table(changed), ["dssc", "pi"])


def test_what_cannot_be_tuned_keeps_its_gains_and_is_named():
    """Gains that follow from a parameter, unless `tune` names them; weights that are fitted when the study is read."""
    pid = {"kind": "pid", "k_p": "=g", "k_i": "=g/4", "k_d": "=g/2", "filter": 0.02}
    lqg = {"kind": "lqg", "command_weight": 0.1, "output_weight": 1.0, "signal_std": [0.1], "disturbance_std": [0.1]}
    plant = {"kind": "state_space", "a": [[0.0, 1.0], [0.0, -1.0]], "b": [0.0, 1.0], "c": [1.0, 0.0], "x0": [1.0]}
    table = TABLE | {"draws": 8, "parameters": {"g": 4.0}, "plant": plant, "controller": pid}
    table |= {"compare": {"lqg": lqg, "tuned": pid | {"tune": {"k_p": [1.0, 8.0]}}}}
    study = dj.Study.from_table(table)
    found = dj.compare(study, ["pid", "lqg", "tuned"], candidates=2, tuning_draws=4)
    assert list(found.untuned) == ["pid", "lqg"]
    assert found.summary()["untuned"] == found.untuned
    assert found.untuned["pid"].startswith(
        "of its usual gains k_p follows from parameters, k_i follows from parameters"
    )
    assert found.untuned["lqg"] == "it declares no usual gains"
    assert found.tuned.tables["pid"] == found.corresponding.tables["pid"]
    assert 1.0 <= found.tuned.tables["tuned"]["k_p"] <= 8.0
    none = dj.compare(study, ["pid", "lqg"], candidates=2, tuning_draws=4)
    assert none.tuned is None
    assert none.untuned == {name: found.untuned[name] for name in ("pid", "lqg")}


def test_a_state_feedback_of_signals_alone_tells_what_it_lacks():
    """Its usual gains are those of y and y', which are 0; its integral gain is another number."""
    plant = {"kind": "state_space", "a": [[0.0, 1.0], [0.0, -1.0]], "b": [0.0, 1.0], "c": [1.0, 0.0], "x0": [1.0]}
    feedback = {"kind": "state_feedback", "signals": [4.0, 2.0], "k_i": 1.5}
    study = dj.Study.from_table({**TABLE, "plant": plant, "sensor": {"measures": "state"}, "controller": feedback})
    lacking = "of its usual gains k_1 = 0 is not positive, k_2 = 0 is not positive"
    assert untuned_reason(study, "sf") == f"{lacking}; [compare.sf.tune] may name others: k_i, signals.0, signals.1"
    assert gain_ranges(study, {}) == {}
    named = gain_ranges(study, {"k_i": [1.0, 2.0], "signals.0": [3.0, 5.0]})
    assert best_gains(study, Tuning(2, 4, 1), named).keys() == {"controller.k_i", "controller.signals.0"}
    feeding = study.override({"controller.k_2": 0.5})
    assert list(gain_ranges(feeding, {})) == ["controller.k_2"]
