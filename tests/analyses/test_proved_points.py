"""Proofs beside simulation: margins, theory, and a tuning that accepts proved points only."""

import pytest

import dssc_jax as dj
from dssc_jax.cli import guarded
from dssc_jax.core.errors import ConfigError
from tests.cli.conftest import last_json

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
    assert tuned.facts["proved_points"] >= 1
    assert tuned.facts["proof"].startswith("For every plant with k_p in [0.9, 1.1]")
    assert dj.prove(tuned.tuned_study).complete
    with pytest.raises(ConfigError, match="the start is infeasible: it is not proved"):
        dj.tune(study.override({"tune.proved": True, "controller.rho": 0.11}))
    with pytest.raises(ConfigError, match="a proof does not cover this loop"):
        dj.tune(study.override({"tune.proved": True, "controller.discretisation": "explicit"}))
