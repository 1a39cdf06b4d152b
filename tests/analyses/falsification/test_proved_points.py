"""Proofs beside simulation: margins, theory, and tunings under proof."""

import json
import shutil

import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.study.tables import to_toml
from tests.cli.conftest import last_json
from tests.tolerances import ROUNDING

CONSTANT = {"kind": "constant", "k_o": 5.0, "tau_av": 0.05, "tau_m": 0.5}
LOOP = dj.Study.load("studies/certified_margin.toml").override(
    {"controller.functions": CONSTANT, "controller.rho": 2.0, "loop.sample_time": 0.01, "draws": 8, "plant.a_p": 0.3}
)
TUNE = {
    "objective": {"error_rms": 1.0},
    "parameters": {"controller.functions.tau_m": [0.1, 2.0]},
    "steps": 2,
    "draws": 4,
    "validation": 4,
}


def test_a_margin_knows_how_far_the_loop_is_proved(tmp_path):
    """For all plants at once, so no further than the worst draw; the folder keeps it."""
    margins = dj.margin(LOOP, over="unmodelled.mu", bounds=(0.01, 0.5), log=True, points=5, bisections=4, prove=True)
    proof = margins.summary()["proof"]
    worst = margins.at_rank(1)
    assert worst is not None
    assert 0.01 < proof["proved_up_to"] <= worst
    loaded = dj.load(margins.save(tmp_path / "margin"))
    assert loaded.summary()["proof"] == proof
    labels = [text.get_text() for text in loaded.figure().axes[0].get_legend().get_texts()]
    assert any(label.startswith("proved as far as") for label in labels)
    wider = dj.margin(LOOP, over="spread", bounds=(0.1, 3.0), points=3, bisections=0, prove=True).summary()["proof"]
    assert wider["over"] == "spread"
    silent = LOOP.override({"sensor": {"kind": "noisy", "velocity_std": 0.01}})
    outside = dj.margin(silent, over="unmodelled.mu", bounds=(0.01, 0.5), points=3, bisections=0, prove=True)
    assert "A proof does not cover the loop: sigma is measured" in outside.summary()["proof"]["statement"]


def test_command_line_of_a_proved_margin(tmp_path, capsys):
    functions = '{kind = "constant", k_o = 5.0, tau_av = 0.05, tau_m = 0.5}'
    fixed = ["--set=loop.sample_time=0.01", f"--set=controller.functions={functions}"]
    walk = ["--over=unmodelled.mu=0.01:0.5", "--log", "--points=3", "--bisections=1", "--draws=4", "--prove", "--json"]
    assert guarded(["margin", "certified_margin", *walk, *fixed, "--out", str(tmp_path / "m")]) == 0
    assert last_json(capsys)["proof"]["over"] == "unmodelled.mu"
    assert guarded(["margin", "certified_margin", *walk, "--controllers", "dssc,pi", "--out", str(tmp_path / "n")]) == 2
    assert "is not for --controllers" in capsys.readouterr().err


def test_a_tuning_accepts_proved_points_only():
    study = LOOP.override({"unmodelled.mu": 0.02, "metrics": {"names": ["error_rms"]}, "tune": TUNE})
    tuned = dj.tune(study.override({"tune.proved": True}))
    assert tuned.facts.proved_points >= 1
    assert tuned.facts.proof.startswith("For every plant with k_p in [0.9, 1.1]")
    assert dj.prove(tuned.tuned_study).complete
    with pytest.raises(ConfigError, match="the start is infeasible: it is not proved"):
        dj.tune(study.override({"tune.proved": True, "controller.rho": 0.11}))
    with pytest.raises(ConfigError, match="a proof does not cover this loop"):
        dj.tune(study.override({"tune.proved": True, "controller.discretisation": "explicit"}))


SETTLED = {"names": ["error_max"], "after": 25.0}
PROVABLE = LOOP.override({"unmodelled.mu": 0.02, "requirement": [], "metrics": SETTLED})
AIMED = TUNE | {"objective": {"error_max": 1.0}, "aim": "proved_error", "steps": 3}
WALK = {"aim": "proved_up_to", "over": {"unmodelled.mu": [0.02, 0.3]}}


def test_a_tuning_lowers_the_proved_bound_of_the_error(tmp_path, capsys, monkeypatch):
    """The file alone proves the number told, and no draw of the tuned loop exceeds it."""
    study = PROVABLE.override({"tune": AIMED})
    (tmp_path / "small.toml").write_text(to_toml(study.table))
    monkeypatch.chdir(tmp_path)
    assert guarded(["tune", "small.toml", "--json"]) == 0
    told = last_json(capsys)
    assert told["method"] == "nelder_mead"
    assert told["aimed"]["result"] < told["aimed"]["start"]
    assert told["aimed"]["start"] == pytest.approx(dj.prove(study).error, rel=ROUNDING)  # a map there and back
    folder = tmp_path / told["result"]
    assert tmp_path / told["certificate"] == folder / "proof.json"
    alone = shutil.copy(folder / "proof.json", tmp_path / "alone.json")
    for file in (alone, folder / "proof.json"):
        assert guarded(["prove", str(file), "--json"]) == 0
        verdict = last_json(capsys)
        assert verdict["proved"]
        assert verdict["error"] == told["aimed"]["result"]
    tuned = dj.load(folder)
    assert isinstance(tuned, dj.Tuned)
    assert tuned.certificate == json.loads((folder / "proof.json").read_text())
    assert tuned.dataset["proved_error"].values[-1] == told["aimed"]["result"]
    assert (tuned.costs["tuned"] <= told["aimed"]["result"]).all()
    (folder / "proof.json").write_text(json.dumps(dj.prove(study).certificate()))
    assert guarded(["prove", str(folder / "proof.json"), "--json"]) == 1
    assert "another loop" in last_json(capsys)["reason"]


def test_a_tuning_carries_a_larger_proved_lag():
    study = PROVABLE.override({"tune": AIMED | WALK})
    tuned = dj.tune(study)
    aimed = tuned.facts.aimed
    before = dj.proved_up_to(study, "unmodelled.mu", (0.02, 0.3), log=True, boxes=1)
    assert aimed.result > aimed.start == before.proved
    assert dj.prove(tuned.tuned_study.override({"unmodelled.mu": aimed.result}), boxes=1).complete
    assert tuned.certificate is not None
    assert tuned.certificate["problem"]["mu"] == [aimed.result] * 2
    assert tuned.certificate["problem"] == tuned.proved_loop
    assert tuned.figure().axes[0].get_ylabel() == "last proved unmodelled.mu [s]"


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"controller.rho": 0.11}, "tune.aim: the start is infeasible: it is not proved: the equivalent control"),
        ({"tune": AIMED | WALK, "controller.rho": 0.11}, "not proved at the safe end unmodelled.mu = 0.02"),
        ({"controller.discretisation": "explicit"}, "tune.aim: a proof does not cover this loop"),
        ({"tune.optimiser": "adam"}, "tune.optimiser: belongs to aim"),
        ({"tune.over": {"unmodelled.mu": [0.1, 0.2]}}, 'tune.over: belongs to aim = "proved_up_to"'),
        ({"tune.aim": "proved_up_to"}, "tune.over: must be { NAME = "),
        ({"tune": AIMED | WALK | {"over": {"controller.functions.tau_m": [0.1, 0.2]}}}, "is tuned, too"),
        ({"tune": AIMED | WALK | {"over": {"unmodelled.nu": [0.1, 0.2]}}}, "unmodelled.nu"),
        ({"tune": AIMED | {"aim": "objective"} | {"over": WALK["over"]}}, "tune.over: belongs to aim"),
    ],
)
def test_bad_input_of_a_tuning_of_proved_numbers(change, rule):
    with pytest.raises(ConfigError) as caught:
        dj.tune(PROVABLE.override({"tune": AIMED}).override(change))
    assert rule in str(caught.value)
