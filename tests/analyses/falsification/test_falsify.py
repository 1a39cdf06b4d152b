"""The hunt finds what random draws would not, and its witness is a draw like any other."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.falsification.conditions import without_other_margins
from dssc_jax.analyses.falsification.falsify import search_worst_draw
from dssc_jax.analyses.falsification.search import SearchPrograms
from dssc_jax.core.errors import ConfigError

STUDIES = Path(__file__).parents[3] / "studies"


@pytest.fixture(scope="module")
def study():
    """Fails with a probability of about 1e-5: docs/tuning.md."""
    return dj.Study.load(STUDIES / "falsify_corner.toml")


def test_a_planted_failure(study):
    """Done-when: at least 9 of 10 seeds, with a hundredth of the 100,000 draws that random search would need."""
    programs = SearchPrograms.of(study, 1000)
    found = [search_worst_draw(programs, 1000, seed) for seed in range(10)]
    assert all(each.simulations <= 1000 for each in found)
    assert sum(each.slack < 0.0 for each in found) >= 9
    rare = dj.run(study).summary()["points"][0]
    assert rare["interval"][1] < 3e-4


def test_the_witness_is_a_draw(study):
    """Its study gives the slack that was found, and every number lies within its law's support."""
    found = dj.falsify(study, budget=300, seed=3)
    again = dj.run(found.witness_study).dataset
    slack = float(again["slack_error_max_after_1.5"].values[0]) / 0.8
    assert slack == pytest.approx(found.slack, rel=1e-9)
    assert found.slack == float(found.dataset["slack"].min())
    assert found.first_failure is not None
    for name, law in study.laws.items():
        low, high = law.support
        assert low <= found.witness[name] <= high
    assert found.witness_study.laws == {}


def test_the_worst_requirement_has_its_name(study):
    """With a second requirement that no draw comes near, and with one that every draw violates most."""
    own = {"metric": "error_max", "after": 1.5, "max": 0.8}
    for other, expected in (({"metric": "error_max", "max": 1e6}, 0), ({"metric": "error_rms", "max": 1e-6}, 1)):
        found = dj.falsify(study.override({"requirement": [own, other]}), budget=64)
        text = found.study.requirements[expected].text
        assert found.summary()["worst_requirement"] == text
        assert found.headline.endswith(f"where {text} is required")


def test_only_one_requirement_counts(study):
    """As in the study without the others, one of which every draw violates more."""
    counted = {"metric": "error_max", "after": 1.5, "max": 0.8}
    table = [{"metric": "error_rms", "max": 1e-6}, counted]
    found = dj.falsify(study.override({"requirement": table}), budget=200, requirement="error_max_after_1.5")
    alone = dj.falsify(study.override({"requirement": [counted]}), budget=200)
    assert found.slack == pytest.approx(alone.slack, rel=1e-6)
    assert found.summary()["requirements"] == alone.summary()["requirements"]
    assert found.binding_at(found.worst) == alone.binding_at(alone.worst)
    with pytest.raises(ConfigError, match=r"'error' is not required by this study; .*error_"):
        dj.falsify(study.override({"requirement": table}), budget=64, requirement="error")


def test_margins_that_do_not_count_are_not_computed(study):
    table = [*study.table["requirement"], {"margin": "phase", "min": "30 deg"}]
    both = study.override({"requirement": table})
    label = both.requirements[0].label
    assert [rule.label for rule in without_other_margins(both, label).requirements] == [label]
    assert without_other_margins(both, "") is both
    assert without_other_margins(both, both.requirements[1].label) is both


def test_the_worst_seen_of_each_requirement_is_a_draw_of_its_own(study):
    """Each worst point, run as a study without laws, has the value; no other point has a worse one."""
    own = [{"metric": "error_max", "after": 1.5, "max": 0.8}, {"metric": "error_rms", "max": 1e6}]
    found = dj.falsify(study.override({"requirement": own}), budget=64)
    metrics = ("error_max_after_1.5", "error_rms")
    assert len(found.worst_value_texts) == 2
    for metric, requirement in zip(metrics, found.study.requirements, strict=True):
        slacks = found.dataset[requirement.name].values
        table = {name: value for name, value in found.study.table.items() if name != "design"} | {"draws": 1}
        alone = dj.Study.from_table(table).override(found.numbers_at(int(np.argmin(slacks))))
        value = float(dj.run(alone).dataset[metric].values.ravel()[0])
        assert float(found.worst_value_texts[requirement.short_text].split()[0]) == pytest.approx(value, rel=1e-3)
        assert value == pytest.approx(requirement.bound - slacks.min(), rel=1e-6)


def test_a_bound_of_zero_does_not_hide_the_other_requirement(study):
    """An envelope is bounded by 0: its slack, in metres and always small here, counts in shares of its usual size."""
    narrow = {"signal": "e", "upper": [[3.96, 0.07], [4.0, 0.07]], "lower": [[3.96, -0.07], [4.0, -0.07]]}
    found = dj.falsify(study.override({"envelope": [narrow]}), budget=300, seed=4).summary()
    assert found["worst_requirement"] == "error_max after 1.5 s <= 0.8 m"
    assert found["slack"] < -0.04
    assert float(found["worst_value"].removesuffix(" m")) == pytest.approx(0.8 * (1.0 - found["slack"]), rel=1e-3)


@pytest.mark.parametrize("design", [{"sampling": "sobol", "draws": 64}, {"correlation": {"plant.k_p, plant.a_p": 0.5}}])
def test_the_witness_of_a_designed_sample(study, design):
    """A witness is one draw without laws: nothing of how the draws lie together may be asked of it."""
    found = dj.falsify(study.override(design), budget=64)
    assert found.witness_study.laws == {}
    assert float(dj.run(found.witness_study).dataset["outcome"][0]) == (10 if found.slack < 0.0 else 0)


def test_signals(study):
    """Knots of a disturbance as a spline are numbers like others: the hunt beats 1,000 random signals."""
    knots = {"kind": "spline", "knots": [{"uniform": [-0.5, 0.5]}] * 4, "interval": 1.0}
    bounded = study.override({"disturbance": knots, "plant.initial": [0.0, 0.0], "plant.k_p": 1.0, "plant.a_p": 1.0})
    found = dj.falsify(bounded, budget=300)
    random = dj.run(bounded.override({"draws": 1000})).dataset["slack_error_max_after_1.5"].values / 0.8
    assert found.slack < random.min()
    assert max(abs(value) for value in found.witness.values()) == pytest.approx(0.5, rel=1e-4)


def test_a_draw_that_ends_early_is_the_worst(study):
    unstable = study.override({"plant.a_p": {"uniform": [-400.0, 1.0]}})
    found = dj.falsify(unstable, budget=64)
    assert found.slack == -np.inf
    assert found.simulations < 64
    assert found.stopped == "a draw ended early, and no draw is worse"


def test_an_infinite_miss_names_its_requirement(study):
    """A root of a negative number is no number, which no draw can miss by more."""
    found = dj.falsify(study.override({"requirement": [{"name": "root", "formula": "always sqrt(e) > -1"}]}), budget=64)
    assert found.slack == -np.inf
    assert found.stopped == "a draw misses root by an infinite amount, and no draw is worse"


def test_simulations_that_are_left_are_told(study, tmp_path):
    """A budget that no whole number of generations spends, and one that they do."""
    loose = study.override({"requirement.0.max": 50.0})
    found = dj.falsify(loose, budget=250)
    told = re.fullmatch(r"the (\d+) simulations left are fewer than a generation of (\d+)", found.stopped)
    assert int(told[1]) == 250 - found.simulations
    assert int(told[1]) < int(told[2])
    found.save(tmp_path / "found")
    assert dj.load(tmp_path / "found").answer.stopped == found.stopped
    other = dj.falsify(loose, budget=found.simulations)
    assert (other.stopped == "") == (other.simulations == found.simulations)


def test_a_flat_search_ends(study):
    """No number matters where the reference is all that the formula judges."""
    flat = study.override({"requirement": [{"name": "flat", "formula": "always t < 100"}]})
    assert dj.falsify(flat, budget=250).stopped.endswith("draws of the last generation are equally bad")


@pytest.mark.parametrize(
    ("change", "options", "rule"),
    [
        ({"requirement": []}, {}, "nothing is required"),
        (
            {"plant.k_p": 1.0, "plant.a_p": 1.0, "plant.initial": [0.0, 0.0], "disturbance.value": 0.1},
            {},
            "no number is uncertain, and a search changes only numbers with laws: random noise .* stay those of draw 0",
        ),
        ({}, {"budget": 5}, "must be in 32 .."),
    ],
)
def test_bad_input(study, change, options, rule):
    with pytest.raises(dj.ConfigError, match=rule):
        dj.falsify(study.override(change), **options)


def test_command(study, tmp_path, monkeypatch, capsys):
    """falsify, then replay its witness, and simulate it by its own file."""
    from dssc_jax.cli.main import guarded
    from dssc_jax.study.tables import to_toml

    monkeypatch.chdir(tmp_path)
    (tmp_path / "planted.toml").write_text(to_toml(study.table))
    loose = ["--set", "requirement.0.max=50.0"]
    assert guarded(["falsify", "planted.toml", "--budget", "64", "--out", "loose", *loose]) == 0
    assert "no failure was found, which proves nothing" in capsys.readouterr().out
    assert guarded(["falsify", "planted.toml", "--budget", "200", "--out", "found", "--json"]) == 1
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["failed"]
    assert told["slack"] < 0.0
    assert guarded(["replay", told["replay"], "--draw", "0", "--csv", "w.csv"]) == 0
    assert dj.Study.load(told["witness_study"]).laws == {}
    assert guarded(["falsify", "planted.toml", "--budget", "7"]) == 2


def test_a_robustness_that_is_no_number_can_be_stored(tmp_path):
    """The root of a negative number is a NaN whose sign bit is set, and all simulations have one."""
    table = {
        "name": "root",
        "draws": 4,
        "loop": {"duration": 0.2, "sample_time": 0.01},
        "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "initial": [-1.0, 0.0]},
        "controller": {"kind": "pid", "k_p": 1.0},
        "requirement": [{"formula": "always sqrt(e) > -1"}],
    }
    found = dj.falsify(dj.Study.from_table(table), budget=32)
    assert found.slack == -np.inf
    found.save(tmp_path / "found")
    assert dj.load(tmp_path / "found").dataset["slack"].shape == found.dataset["slack"].shape


def test_how_a_draw_ends_is_told():
    """A pole at 700/s leaves the numbers within a second; the simulated draw says when, and what it violates before."""
    table = {
        "name": "diverging",
        "draws": 8,
        "loop": {"duration": 4.0, "sample_time": 0.01},
        "plant": {"kind": "normal_form", "k_p": 1.0, "a_p": {"uniform": [-800.0, -700.0]}, "initial": [1.0, 0.0]},
        "controller": {"kind": "pid", "k_p": 6.0, "k_d": 3.0},
        "requirement": [{"metric": "error_max", "after": 3.0, "max": 0.5}, {"metric": "command_max", "max": 100.0}],
    }
    found = dj.falsify(dj.Study.from_table(table), budget=32)
    run = dj.simulate(found.witness_study)
    worst = found.answer.worst
    assert worst.ending == "does not stay finite"
    assert worst.ended_at == pytest.approx(run.attrs["failed_at"])
    assert worst.first_violated == "command_max <= 100 m/s"
    passed = float(run["t"][np.flatnonzero(np.abs(run["u"].values) > 100.0)[0]])
    assert worst.violated_at == pytest.approx(passed)
    told = f"it does not stay finite at {worst.ended_at:.4g} s; before that it violates command_max <= 100 m/s at"
    assert found.course_at(found.worst) == f"{told} {passed:.4g} s"


def test_a_draw_that_never_settles_does_not_end_early():
    table = {
        "name": "unsettled",
        "draws": 8,
        "loop": {"duration": 1.0, "sample_time": 0.01},
        "plant": {"kind": "normal_form", "k_p": {"uniform": [0.5, 1.0]}, "initial": [1.0, 0.0]},
        "controller": {"kind": "pid", "k_p": 0.1},
        "requirement": [{"metric": "settling_time", "max": 0.5}],
    }
    found = dj.falsify(dj.Study.from_table(table), budget=32)
    worst = found.answer.worst
    assert worst.ending is None
    assert worst.worst_value == "inf s"
    assert "has inf s where settling_time <= 0.5 s is required" in found.headline
