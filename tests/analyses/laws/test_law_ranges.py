"""Lowest and highest failure probability over ranges of laws, on a loop whose failure is a half space."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.cli.main import guarded

FILE = """
name = "start"
draws = 2000
loop = { duration = 0.5, sample_time = 0.05 }
plant = { kind = "normal_form", k_p = 1.0, initial = [{ normal = [[1.98, 2.02], 0.1] }, 0.0] }
controller = { kind = "pi", l0 = 1.0, k_p = 1.0, k_i = 0.5 }
[[requirement]]
metric = "error_max"
max = 2.15
"""
INITIAL = "plant.initial.0"
TABLE = {
    "name": "start",
    "seed": 1,
    "draws": 2000,
    "loop": {"duration": 0.5, "sample_time": 0.05},
    "plant": {
        "kind": "normal_form",
        "k_p": {"uniform": [0.7, 1.2]},
        "initial": [{"normal": [[1.98, 2.02], [0.08, 0.12]]}, 0.0],
    },
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.5},
    "requirement": [{"metric": "error_max", "max": 2.15}],
}
LOWEST = stats.norm.sf((2.15 - 1.98) / 0.08)
HIGHEST = stats.norm.sf((2.15 - 2.02) / 0.12)


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(TABLE)


@pytest.fixture(scope="module")
def found(study):
    return dj.law_ranges(study, limit=0.2)


def test_the_interval_holds_the_closed_form(found):
    answer = found.answer
    low, high = answer.interval
    assert low <= LOWEST
    assert high >= HIGHEST
    assert answer.probability == pytest.approx((LOWEST, HIGHEST), rel=0.25)
    assert answer.verdict == "kept by all laws"
    assert answer.highest.laws == {INITIAL: {"normal": pytest.approx([2.02, 0.12], rel=1e-3)}}
    assert answer.lowest.laws == {INITIAL: {"normal": pytest.approx([1.98, 0.08], rel=1e-3)}}


def test_new_draws_are_those_of_the_laws_found(study, found):
    """As of a study in which the law stands."""
    answer = found.answer
    assert answer.verified
    worst = dj.run(study.override({"plant.initial": [answer.highest.laws[INITIAL], 0.0], "draws": 4000}), check=False)
    assert answer.fresh_draws == 2000
    assert answer.highest.fresh_failures == np.count_nonzero(worst.failed.values[2000:])
    low, high = answer.highest.fresh_interval
    assert low < HIGHEST < high


def test_verdicts(study):
    assert dj.law_ranges(study, limit=0.05, fresh=200).verdict == "not decided"
    assert dj.law_ranges(study, limit=0.005, fresh=200).verdict == "exceeded by all laws"


def test_the_interval_contains_new_draws_that_contradict_the_weights(found):
    """The new draws are simulations of the law itself, and their interval is exact."""
    below = replace(found.lowest, fresh_interval=(0.0, found.lowest.interval[0] / 2))
    above = replace(found.highest, fresh_interval=(0.3, 0.4))
    contradicted = replace(found, lowest=below, highest=above)
    assert not contradicted.verified
    assert contradicted.interval == (0.0, 0.4)
    assert contradicted.verdict == "not decided"
    assert replace(found, highest=above).interval == (found.interval[0], 0.4)


def test_parameters_have_ranges(study):
    """What follows from a parameter moves with it."""
    table = {**TABLE, "parameters": {"start": {"normal": [[1.98, 2.02], 0.1]}}}
    table["plant"] = {**TABLE["plant"], "initial": ["=start", 0.0]}
    low, high = dj.law_ranges(dj.Study.from_table(table), fresh=200).interval
    assert low <= stats.norm.sf(1.7)
    assert stats.norm.sf(1.3) <= high


def test_few_draws_are_doubled(study):
    few = study.override({"draws": 40, "plant.initial": [{"normal": [[1.7, 2.1], [0.02, 0.12]]}, 0.0]})
    found = dj.law_ranges(few, fresh=100)
    assert found.draws > 100
    assert found.least_effective >= 100.0


def test_what_is_refused(study):
    for subject, arguments, told in (
        (study.override({"plant.initial": [2.0, 0.0]}), {}, "no argument of a law is a range"),
        (study.override({"sampling": "lhs"}), {}, "needs independent draws"),
        (study, {"limit": 1.0}, "limit: must lie in"),
        (study, {"fresh": 0}, "fresh: must be at least 1"),
        (
            study.override({"draws": 4, "plant.initial": [{"normal": [[-9.0, 2.0], [0.001, 2.0]]}, 0.0]}),
            {},
            r"too wide for 64 draws: they are worth \d+ draws of some of the laws, and 100 are needed",
        ),
    ):
        with pytest.raises(dj.ConfigError, match=told):
            dj.law_ranges(subject, **arguments)


def test_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "start.toml").write_text(FILE)
    assert guarded(["laws", "start.toml", "--limit", "0.2", "--out", "r"]) == 0
    told = capsys.readouterr().out
    assert "for every law within the ranges" in told
    assert "plant.initial.0: mean" in told
    assert guarded(["laws", "start.toml", "--limit", "0.2", "--out", "r", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["verdict"] == "kept by all laws"
    assert guarded(["report", "r"]) == 0
    page = (tmp_path / "r" / "report.html").read_text()
    assert "The failure probability over ranges of laws" in page
    assert "normal([1.98, 2.02], 0.1)" in page
    capsys.readouterr()
    assert guarded(["run", "start.toml"]) == 2
    assert "`laws` gives the failure probability over all of them" in capsys.readouterr().err
    assert guarded(["laws", "start.toml", "--shift", "0.1"]) == 2
    assert "--shift: has no meaning with laws whose arguments are ranges" in capsys.readouterr().err
