"""The commands that analyse: margins, theory, comparisons, statistics."""

import json
import re

import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from tests.cli.conftest import STUDY, last_json


def test_margin(study, capsys):
    arguments = ["margin", str(study), "--over", "plant.k_p=1.2:0.01", "--points", "5", "--bisections", "6"]
    assert guarded([*arguments, "--out", "m", "--json"]) == 0
    found = last_json(capsys)
    assert found["parameter"] == "plant.k_p"
    assert len(found["critical"]) == 20
    assert sum(value is None for value in found["critical"]) == 20 * found["censored"]
    assert {"median", "lower_tolerance", "non_monotone", "degradation", "criterion"} <= found.keys()
    for name in ("data.zarr", "summary.json", "figures/margin.png"):
        assert (study.parent / "m" / name).exists()
    assert guarded([*arguments, "--out", "m"]) == 0
    shown = capsys.readouterr().out
    assert "none of 20 draws, 59 are needed" in shown
    assert "0.47 m" in shown
    assert "Theorem 1 does not apply: the controller is not DSSC" in shown


def test_a_walk_the_wrong_way_round_is_noticed(study, capsys):
    arguments = ["margin", str(study), "--over", "plant.k_p=0.01:1.2", "--points", "4", "--bisections", "2"]
    assert guarded([*arguments, "--draws", "59", "--set", "requirement.0.max=0.75", "--out", "m"]) == 0
    shown = capsys.readouterr().out
    assert "is 0.01 the safe end of the walk?" in shown
    assert re.search(r"Wilks\) +before the start", shown)


def test_margins_of_several_controllers(study, capsys):
    study.write_text(STUDY + "[compare.soft]\nk_p = 0.5\n")
    arguments = ["margin", str(study), "--over", "plant.k_p=1.2:0.01", "--points", "3", "--bisections", "2"]
    assert guarded([*arguments, "--controllers", "pi,soft", "--out", "m", "--json"]) == 0
    found = last_json(capsys)
    assert set(found["controllers"]) == {"pi", "soft"}
    assert (found["pairs"][0]["a"], found["pairs"][0]["b"]) == ("pi", "soft")
    assert (study.parent / "m" / "figures" / "margins.png").exists()
    assert guarded([*arguments, "--controllers", "pi,soft", "--out", "m"]) == 0
    assert "share of draws that go further" in capsys.readouterr().out
    assert guarded([*arguments, "--controllers", "pi"]) == 2
    assert "two different names" in capsys.readouterr().err


def test_theory(study, capsys):
    arguments = ["theory", str(study), "--over", "plant.k_p=1.2:0.01", "--points", "4", "--bisections", "3"]
    assert guarded([*arguments, "--draws", "8", "--out", "t", "--json"]) == 0
    found = last_json(capsys)
    assert {"certificate", "performance", "local", "oscillations", "not_covered"} <= found.keys()
    assert found["certificate"]["certified"] is None
    for name in ("theory.json", "figures/theory.png", "figures/theory.svg"):
        assert (study.parent / "t" / name).exists()
    assert guarded([*arguments, "--draws", "8", "--out", "t"]) == 0
    shown = capsys.readouterr().out
    assert "simulated" in shown
    assert "Theorem 1 does not apply" in shown


def test_compare(study, capsys):
    study.write_text(STUDY + "[compare.soft]\nk_p = 0.5\n")
    arguments = ["compare", str(study), "--controllers", "pi,soft", "--out", "c"]
    assert guarded([*arguments, "--tune", "2", "--json"]) == 0
    found = last_json(capsys)
    assert [(pair["a"], pair["b"]) for pair in found["pairs"]] == [("pi", "soft")]
    assert {"difference", "interval", "p_value"} <= found["pairs"][0].keys()
    assert found["tuned"]["controllers"].keys() == {"pi", "soft"}
    assert (study.parent / "c" / "figures" / "compare.png").exists()
    assert guarded([*arguments, "--tune", "0"]) == 0
    assert "McNemar" in capsys.readouterr().out


def test_worst_loop(study, capsys):
    """A worst case, written as a study, has its margin again."""
    arguments = ["worst-loop", str(study), "--cells", "500", "--draws", "8", "--out", "v"]
    assert guarded([*arguments, "--json"]) == 0
    found = last_json(capsys)["loops"]["input"]["margins"]["disk"]
    witness = dj.Study.load(study.parent / "v" / "witnesses" / "input-disk.toml").override({"draws": 1})
    again = dj.loop_margins(witness).dataset["disk"].sel(loop="input")
    assert float(again.values.min()) == pytest.approx(found["found"], rel=1e-6)
    assert (study.parent / "v" / "figures" / "worst-loop.png").exists()
    assert guarded(arguments) == 0
    shown = capsys.readouterr().out
    assert "worst found" in shown
    assert "robust stability" in shown


HOVER = """
name = "hover"
loop = { duration = 2.0, sample_time = 0.02 }
plant = { kind = "uav" }
controller = { kind = "pi", l0 = 1.0, k_p = 1.0, k_i = 0.1 }
wind = { kind = "bounded", speed = 4.0 }
"""


def test_worst_wind(study, capsys):
    """Its worst flight, written as a study, has the worst value again; its wind as CSV can be a record."""
    study.write_text(HOVER)
    arguments = ["worst-wind", str(study), "--segments", "4", "--rounds", "1", "--signal", "error_max_x", "--out", "w"]
    assert guarded([*arguments, "--json"]) == 0
    found = last_json(capsys)
    (answer,) = found["signals"]
    assert answer["signal"] == "error_max_x"
    assert found["flights"] > 500
    folder = study.parent / "w"
    for name in ("worst-wind.json", "figures/worst-wind.png", "flights/error_max_x.toml", "flights/error_max_x.csv"):
        assert (folder / name).exists()
    replayed = dj.simulate(dj.Study.load(folder / "flights" / "error_max_x.toml"))
    assert abs(replayed["x_e"].values).max() == pytest.approx(answer["worst"], rel=1e-9)
    columns = 'file = "w/flights/error_max_x.csv", columns = ["x", "y", "z"], interpolation = "hold"'
    study.write_text(HOVER.replace('"bounded", speed = 4.0', f'"record", {columns}'))
    recorded = dj.simulate(dj.Study.load(study))
    assert abs(recorded["x_e"].values).max() == pytest.approx(answer["worst"], rel=1e-2)
    study.write_text(HOVER)
    assert guarded(arguments) == 0
    shown = capsys.readouterr().out
    assert re.search(r"error_max_x +[0-9.]+ +[0-9.]+ +m", shown)
    assert "|w_h| <= 4 m/s, |w_z| <= 2 m/s, it may jump" in shown
    assert guarded([*arguments[:-4], "--signal", "error_max_w"]) == 2
    assert "unknown signal 'error_max_w'; did you mean" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["margin", "--over", "plant.k_p"], "must be NAME=LO:HI"),
        (["margin", "--over", "plant.k_p=1:2:3"], "must be NAME=LO:HI"),
        (["margin", "--over", "plant.kp=1:2"], "did you mean 'plant.k_p'"),
        (["margin", "--over", "plant.k_p=1:2", "--out", "."], "nothing was written"),
        (["theory", "--over", "plant.kp=1:2"], "did you mean 'plant.k_p'"),
        (["theory", "--over", "plant.k_p"], "must be NAME=LO:HI"),
        (["loop", "--at", "soon"], "must be times in seconds"),
        (["loop", "--at", "9"], "must ascend within"),
        (["region", "--over", "plant.k_p=1:2"], "must be given twice"),
        (["region", "--over", "plant.k_p=1:2", "--over", "plant.a_p=1:2:lin"], "must be NAME=LO:HI[:log]"),
        (["compare", "--controllers", "pi"], "needs two different names"),
        (["compare", "--controllers", "pi,sta"], "give [compare.sta]"),
        (["compare", "--controllers", "pi,pit"], "did you mean 'pi'"),
    ],
)
def test_bad_margins_and_comparisons(study, capsys, arguments, told):
    assert guarded([arguments[0], str(study), *arguments[1:]]) == 2
    assert told in capsys.readouterr().err


def test_laws(study, capsys):
    arguments = ["laws", str(study), "--draws", "200", "--limit", "0.9", "--out", "l"]
    assert guarded([*arguments, "--within", "kl=0.1", "--shift", "0.2", "--widening", "1.1", "--json"]) == 0
    found = last_json(capsys)
    assert {"failure", "total_variation", "kl", "chi_square", "mean_shift", "widening", "by_law"} <= found.keys()
    assert {"probability", "interval"} <= found["failure"].keys()
    assert list(found["by_law"]) == ["plant.k_p"]
    assert [row["kind"] for row in found["stated"]] == ["kl", "mean_shift", "widening"]
    for name in ("laws.json", "summary.json", "figures/laws.png"):
        assert (study.parent / "l" / name).exists()
    assert guarded([*arguments, "--fresh", "50"]) == 0
    shown = capsys.readouterr().out
    assert "at most 90 % fail up to" in shown
    assert "50 new draws" in shown


def test_laws_of_a_result(study, capsys):
    assert guarded(["run", str(study), "--draws", "200", "--out", "r", "--json"]) == 0
    failures = last_json(capsys)["points"][0]["failures"]
    assert guarded(["laws", "r", "--limit", "0.9", "--out", "l", "--json"]) == 0
    assert last_json(capsys)["failure"]["failures"] == failures
    assert guarded(["laws", str(study), "--draws", "200", "--limit", "0.9", "--out", "m", "--json"]) == 0
    assert last_json(capsys)["failure"]["failures"] == failures
    for option in (["--draws", "9"], ["--seed", "9"], ["--set", "seed=9"]):
        assert guarded(["laws", "r", *option]) == 2
        assert f"{option[0]}: has no meaning with a result" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--limit", "2"], "must lie in (0, 1), got 2"),
        (["--within", "kl"], "must be NAME=VALUE"),
        (["--within", "kl=much"], "must be NAME=RADIUS"),
        (["--within", "lk=1"], "'lk' is no divergence"),
        (["--shift", "-1"], "must be finite and 0 or more"),
        (["--widening", "0.5"], "must be finite and 1 or more"),
        (["--fresh", "-5"], "must be 0 or more"),
        (["--set", "sampling=sobol", "--draws", "32"], "needs independent draws"),
    ],
)
def test_bad_laws(study, capsys, arguments, told):
    assert guarded(["laws", str(study), *arguments]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("command", [["margin", "--over", "plant.k_p=1.2:0.1"], ["compare", "--controllers", "pi,smc"]])
def test_designs_of_draws_are_refused(study, capsys, command):
    smc = "[compare.smc]\nkind = 'smc'\nl0 = 1.0\ngain = 1.0\n"
    study.write_text(STUDY.replace("draws = 20", "draws = 16\nsampling = 'sobol'") + smc)
    assert guarded([command[0], str(study), *command[1:]]) == 2
    assert "needs independent draws" in capsys.readouterr().err


def test_plan(capsys):
    assert guarded(["plan", "--error", "0.01", "--confidence", "0.99", "--probability", "0.02", "--json"]) == 0
    draws = {answer["question"]: answer["draws"] for answer in last_json(capsys)["answers"]}
    assert draws["failure probability, whatever it is (Chernoff)"] == 26492
    assert guarded(["plan"]) == 0
    assert "Wilks" in capsys.readouterr().out
    assert guarded(["plan", "--error", "2"]) == 2


def test_run_until(study, capsys):
    arguments = ["run", str(study), "--max-draws", "200", "--json"]
    assert guarded([*arguments, "--until-width", "0.3"]) == 0
    found = last_json(capsys)
    assert "data-driven" in found["interval_method"]
    assert found["draws"] == found["stopping"]["looks"][-1]["draws"]
    assert guarded([*arguments, "--accept", "0.01", "--reject", "0.02"]) == 1  # it is rejected
    capsys.readouterr()


@pytest.mark.parametrize(
    "options",
    [
        ["--until-width", "0.1", "--accept", "0.1", "--reject", "0.2"],
        ["--accept", "0.1"],
        ["--accept", "0.2", "--reject", "0.1"],
        ["--until-width", "0"],
        ["--until-width", "0.1", "--draws", "50"],
        ["--until-width", "0.1", "--resume"],
        ["--max-draws", "50"],
    ],
)
def test_options_that_do_not_go_together(study, options, capsys):
    assert guarded(["run", str(study), *options]) == 2
    assert capsys.readouterr().err.startswith("error: --")


def test_sensitivity_and_rare(study, capsys):
    uncertain = ["--set", "plant.a_p={ normal = [1.0, 0.1] }"]
    assert guarded(["sensitivity", str(study), *uncertain, "--draws", "300", "--out", "s", "--json"]) == 0
    found = last_json(capsys)
    assert (found["rows"], found["simulations"]) == (256, 1024)
    assert (study.parent / "s" / "figures" / "sensitivity.png").stat().st_size > 10_000
    spent = ["--method", "splitting", "--particles", "20", "--moves", "2", "--repeats", "10", "--plain", "500"]
    seldom = [*uncertain, "--set", "requirement.0.max=0.743"]
    assert guarded(["rare", str(study), *seldom, *spent, "--out", "r"]) == 0
    shown = capsys.readouterr().out
    assert "10 independent repeats" in shown
    assert "of 500 plain draws failed" in shown
    stored = json.loads((study.parent / "r" / "summary.json").read_text())
    assert stored["plain"].keys() == {"draws", "failures", "interval", "contradicts"}
    assert dj.load(study.parent / "r").study.table["plant"]["a_p"] == {"normal": [1.0, 0.1]}
    assert guarded(["rare", str(study), *spent, "--out", "r"]) == 2  # another study's answer is there
    assert "another study" in capsys.readouterr().err
