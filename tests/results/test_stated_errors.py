"""The interval of the failure probability if the laws are wrong by stated amounts, beside the usual one of a run."""

import json

import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.report import html
from dssc_jax.results.stated_errors import StatedAmounts

EDGE = 1.5
"""Standard deviations from the mean of the initial value to the largest error allowed."""

TABLE = {
    "name": "start",
    "seed": 4,
    "draws": 2000,
    "loop": {"duration": 0.5, "sample_time": 0.05},
    "plant": {"kind": "normal_form", "k_p": 1.0, "initial": [{"normal": [2.0, 0.1]}, 0.0]},
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.5},
    "requirement": [{"metric": "error_max", "max": 2.0 + 0.1 * EDGE}],
}
FILE = """
name = "start"
draws = 200
loop = { duration = 0.5, sample_time = 0.05 }
plant = { kind = "normal_form", k_p = 1.0, initial = [{ normal = [2.0, 0.1] }, 0.0] }
controller = { kind = "pi", l0 = 1.0, k_p = 1.0, k_i = 0.5 }
[[requirement]]
metric = "error_max"
max = 2.15
"""


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(TABLE)


@pytest.fixture(scope="module")
def ran(study, tmp_path_factory):
    folder = tmp_path_factory.mktemp("stated") / "r"
    return dj.run(study, folder, check=False, within={"kl": 0.02}, shift=0.2, widening=1.1)


def test_intervals_contain_the_half_space(ran):
    """Worst and best of all moved or widened normal laws, and of the ball by tilting the half space."""
    kl, shift, widening = ran.summary()["points"][0]["stated"]
    assert [one["amount"] for one in (kl, shift, widening)] == [0.02, 0.2, 1.1]
    for stated, truths in (
        (shift, (stats.norm.sf(EDGE + 0.2), stats.norm.sf(EDGE - 0.2))),
        (widening, (stats.norm.sf(EDGE), stats.norm.sf(EDGE / 1.1))),
    ):
        for low, high in (stated["interval"], stated["weighted_interval"]):
            assert low <= truths[0]
            assert truths[1] <= high
    p = stats.norm.sf(EDGE)
    tilted = np.linspace(p, 0.5, 200_001)
    radii = tilted * np.log(tilted / p) + (1.0 - tilted) * np.log((1.0 - tilted) / (1.0 - p))
    assert kl["interval"][1] >= tilted[radii <= 0.02].max()
    assert kl["weighted_interval"] is None


def test_they_are_those_of_laws(ran):
    found = dj.laws(ran, limit=0.3, within={"kl": 0.02}, shift=0.2, widening=1.1)
    assert found.stated == ran.stated_errors(ran.stated)


def test_the_folder_keeps_the_amounts(ran):
    loaded = dj.load(ran.path)
    assert loaded.stated == StatedAmounts({"kl": 0.02}, 0.2, 1.1)
    stored = json.loads((ran.path / "summary.json").read_text())
    assert stored["points"][0]["stated"] == loaded.summary()["points"][0]["stated"]
    page = html(loaded, worst=1)
    assert "The failure probability if the laws are wrong" in page
    assert "mean shift up to 0.2" in page


def test_new_amounts_need_no_new_draws(study, ran, tmp_path):
    first = dj.run(study, tmp_path / "r", check=False)
    assert first.stated is None
    assert "stated" not in first.summary()["points"][0]
    second = dj.run(study, tmp_path / "r", resume=True, check=False, shift=0.3)
    assert second.manifest["started"] == first.manifest["started"]
    assert dj.load(tmp_path / "r").stated == StatedAmounts({}, 0.3, None)


def test_a_stopping_rule_asks_for_more_confidence(study):
    stopped = dj.run_until(study, dj.UntilWidth(0.08), check=False, within={"total_variation": 0.01})
    point = stopped.summary()["points"][0]
    low, high = point["interval"]
    assert point["stated"][0]["interval"] == pytest.approx([max(0.0, low - 0.01), high + 0.01])


def test_what_has_no_answer_is_refused(study):
    swept = study.override({"sweep": {"controller.k_p": {"linspace": [0.5, 1.0, 2]}}})
    certain = study.override({"plant.initial": [2.0, 0.0]})
    design = study.override({"sampling": "sobol", "draws": 64, "replicates": 8})
    for subject, told in (
        (swept, "has a sweep"),
        (certain, "no law can be changed"),
        (design, "needs independent draws"),
    ):
        with pytest.raises(dj.ConfigError, match=told):
            dj.run(subject, check=False, shift=0.1)
    with pytest.raises(dj.ConfigError, match="0 or more"):
        dj.run(study, check=False, shift=-0.1)


def test_the_command_line(tmp_path, monkeypatch, capsys):
    """The second command takes the draws of the first one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "start.toml").write_text(FILE)
    assert guarded(["run", "start.toml", "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    options = ["run", "start.toml", "--within", "kl=0.1", "--shift", "0.5"]
    assert guarded([*options, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["result"] == plain["result"]
    assert answer["seconds"] == plain["seconds"]
    assert [stated["kind"] for stated in answer["points"][0]["stated"]] == ["kl", "mean_shift"]
    assert guarded(options) == 0
    told = capsys.readouterr().out
    assert "kl up to 0.1" in told
    assert "mean shift up to 0.5" in told
    assert guarded(["run", "start.toml", "--within", "klx=0.1"]) == 2
    assert "did you mean 'kl'" in capsys.readouterr().err
