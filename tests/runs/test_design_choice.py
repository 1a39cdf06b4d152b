"""The design that a run chooses: why, by which pilot, and the same again by resume and blocks."""

import tomllib

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax import ConfigError
from dssc_jax.cli.main import guarded
from dssc_jax.runs.design_choice import DesignWarning, nets_of
from dssc_jax.statistics import Replicated, clopper_pearson, design_effect

STUDY = """
name = "chosen"
draws = 500
sampling = "auto"
loop = { duration = 1.0, sample_time = 0.01 }
plant = { kind = "normal_form", k_p = { uniform = [0.5, 1.5] }, a_p = { uniform = [0.5, 1.5] }, initial = [1.0, 0.0] }
controller = { kind = "pid", k_p = 6.0, k_d = 3.0 }

[[requirement]]
metric = "error_max"
after = 0.8
max = 0.33
"""


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(tomllib.loads(STUDY))


@pytest.fixture(scope="module")
def result(study, tmp_path_factory):
    return dj.run(study, tmp_path_factory.mktemp("chosen") / "out", check=False)


def test_a_run_takes_nets_where_draws_fail_and_tells_why(result):
    config = result.study.config
    assert (config.sampling, config.replicates, config.draws) == ("sobol", 32, 512)
    entry = result.manifest["design"]
    assert entry["pilot"] == 288
    failures = int(entry["reason"].split(": ")[1].split()[0])
    low, high = clopper_pearson(failures, 256, 0.999)
    assert low < result.failed.values.mean() < high
    summary = result.summary()["design"]
    assert summary["reason"].startswith("32 Sobol nets of 16 points")
    assert summary["effect"]["plain_draws"] > 512


def test_blocks_and_a_second_run_give_the_same(study, result, tmp_path):
    again = dj.run(study, tmp_path / "again", block=100, check=False)
    assert again.manifest["design"] == result.manifest["design"]
    np.testing.assert_array_equal(again.dataset["error_max"], result.dataset["error_max"])


def test_resumed_draws_keep_the_choice(study, tmp_path):
    out = tmp_path / "out"
    few = dj.run(study.override({"draws": 200}), out, check=False)
    assert few.study.config.draws == 25 * 8
    more = dj.run(study, out, resume=True, check=False)
    assert (more.study.config.replicates, more.study.config.draws) == (25, 25 * 32)
    np.testing.assert_array_equal(more.dataset["error_max"][:200], few.dataset["error_max"])
    assert dj.load(out).manifest["design"]["asked_draws"] == 500


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"draws": 100}, "too few for 16 Sobol nets"),
        ({"requirement.0.max": 3.0}, "0 of 256 pilot draws fail; Sobol points save nothing"),
        ({"plant.k_p": 1.0, "plant.a_p": 1.0}, "no number is uncertain"),
        ({"sensor": {"kind": "noisy", "position_std": 0.01}}, "in-loop noise"),
    ],
)
def test_plain_draws_otherwise(study, changes, reason):
    chosen = dj.run(study.override(changes), check=False)
    assert chosen.study.config.sampling == "random"
    assert reason in chosen.manifest["design"]["reason"]
    same = dj.run(study.override(changes | {"sampling": "random"}), check=False)
    np.testing.assert_array_equal(chosen.dataset["error_max"], same.dataset["error_max"])


def test_a_sweep_decides_in_its_middle(study):
    swept = dj.run(study.override({"sweep.controller.k_d": [1.0, 3.0]}), check=False)
    assert "in the middle of the sweep" in swept.manifest["design"]["reason"]
    assert swept.summary()["design"]["effect"] is None


def test_a_stopping_rule_has_plain_draws(study):
    stopped = dj.run_until(study, dj.UntilWidth(0.2), most=1000, check=False)
    assert stopped.study.config.sampling == "random"
    assert "data-driven stop" in stopped.manifest["design"]["reason"]
    low, high = stopped.summary()["points"][0]["interval"]
    assert high - low <= 0.2


def test_replicates_are_not_chosen_twice(study):
    with pytest.raises(ConfigError, match="'auto' chooses their number"):
        study.override({"replicates": 16})


@pytest.mark.parametrize("draws", [128, 129, 500, 1000, 4096, 100_000])
def test_nets_hold_all_draws(draws):
    nets, size = nets_of(draws)
    assert 16 <= nets <= 32
    assert draws <= nets * size < draws + size


def test_the_effect_of_a_design():
    """Independent draws as replicates have a ratio of 1, a point in each cell hardly any variance."""
    rng = np.random.default_rng(1)
    independent = design_effect(rng.random(16 * 4096) < 0.2, 16)
    assert independent.ratio_interval[0] < 1.0 < independent.ratio_interval[1]
    stratified = (np.arange(512)[:, None] + rng.random((512, 16))) / 512 < 0.2
    found = design_effect(stratified.ravel(), 16)
    assert found.variance_ratio < 0.01
    ends = Replicated(16, "").interval(stratified.ravel())
    low, high = clopper_pearson(0.2 * found.plain_draws, found.plain_draws)
    assert high - low == pytest.approx(ends[1] - ends[0], rel=0.01)
    assert design_effect(np.zeros(160, bool), 16) is None


def test_the_command_shows_a_complete_result_again(tmp_path, capsys):
    file = tmp_path / "chosen.toml"
    file.write_text(STUDY)
    arguments = ["run", str(file), "--out", str(tmp_path / "out"), "--no-check"]
    assert guarded(arguments) == 0
    first = capsys.readouterr().out
    assert "32 Sobol nets of 16 points" in first
    assert "of that of independent draws" in first
    assert guarded(arguments) == 0
    assert "is complete" in capsys.readouterr().err


def test_a_draw_of_the_study_is_not_taken_for_one_of_the_run(study, result, recwarn):
    """The run chose Sobol points, and other commands take random draws."""
    drawn = float(result.dataset["plant.k_p"].values[3])
    assert dj.simulate(result.study, draw=3).attrs["plant.k_p"] == drawn
    assert dj.lane(result.study).draws(4)[0]["plant.k_p"][3] == drawn
    assert not recwarn
    with pytest.warns(DesignWarning, match=r"sampling = 'auto' counts as 'random' here.*replay FOLDER --draw I"):
        assert dj.simulate(study, draw=3).attrs["plant.k_p"] != drawn
    lane = dj.lane(study)
    assert set(lane.example[0]) == set(study.laws)
    with pytest.raises(ConfigError, match=r"sampling: is 'auto'.*dj\.lane\(result\.study\)"):
        lane.draws(4)


def test_a_run_that_takes_plain_draws_anyway_needs_no_warning(study, recwarn):
    dj.simulate(study.override({"draws": 100}))
    assert not recwarn
