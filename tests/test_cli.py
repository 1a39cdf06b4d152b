"""The command line as a person or a program meets it."""

import json
import re
import resource
import signal
import subprocess
import sys
import time

import pytest

from dssc_jax.cli import guarded
from dssc_jax.cli.shared import parse_over, parse_value

COMMANDS = ["run", "sweep", "simulate", "replay", "margin", "theory", "compare", "plan", "sensitivity", "rare"]
COMMANDS += ["verify", "export", "report", "check", "design", "studies", "info"]
STUDY = """
name = "small"
seed = 3
draws = 20
[loop]
duration = 2.0
sample_time = 0.01
[plant]
kind = "normal_form"
k_p = { uniform = [0.8, 1.2] }
initial = [1.0, 0.0]
[controller]
kind = "pi"
l0 = 1.0
k_p = 1.0
k_i = 0.5
[[requirement]]
metric = "error_max"
after = 1.0
max = 0.47
[sweep]
"controller.k_p" = { linspace = [0.5, 2.0, 3] }
"""
DESIGN = """
[bounds]
k_min = 0.8
k_max = 1.2
a_max = 1.0
k_d4 = 0.1
[free]
l0 = 0.5
phi_a = 0.05
eps = 0.5
delta = 1.0
eps_1 = 0.1
eps_2 = 0.1
eps_3 = 2.0
"""


@pytest.fixture
def study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "small.toml"
    path.write_text(STUDY)
    return path


def timed(*arguments):
    """Output and processor time [s] of a command as a process; unlike wall time it is not others' doing."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "dssc_jax.cli", *arguments], capture_output=True, text=True, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def last_json(capsys):
    """stdout is one JSON object and nothing else."""
    out = capsys.readouterr().out
    return json.loads(out)


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help_starts_in_under_half_a_second(command):
    out, seconds = timed(*([command] if command else []), "--help")
    assert "Usage" in out
    assert seconds < 0.5


def test_run(study, capsys):
    assert guarded(["run", str(study), "--json"]) == 0
    found = last_json(capsys)
    assert found["draws"] == 20
    (point,) = found["points"]
    assert {"failures", "probability", "interval", "certified"} <= point.keys()
    assert {"rate", "compile_seconds", "seconds", "result"} <= found.keys()
    assert found["result"] == "results/small-run"
    assert guarded(["run", str(study)]) == 0
    shown = capsys.readouterr().out
    assert f"{point['failures']} failures in 20 draws" in shown
    assert "Clopper-Pearson" in shown
    assert "error_max after 1 s <= 0.47 m" in shown


def test_sweep_options(study, capsys):
    arguments = ["sweep", str(study), "--over", "controller.k_i=0.1:10:3:log", "--set", "controller.l0=0.7"]
    assert guarded([*arguments, "--draws", "9", "--seed", "5", "--out", "elsewhere", "--json"]) == 0
    found = last_json(capsys)
    assert [point["controller.k_i"] for point in found["points"]] == pytest.approx([0.1, 1.0, 10.0])
    assert "controller.k_p" not in found["points"][0]
    manifest = json.loads((study.parent / "elsewhere" / "manifest.json").read_text())
    assert (manifest["seed"], manifest["counts"]["draws"], manifest["study"]["controller"]["l0"]) == (5, 9, 0.7)
    assert (study.parent / "elsewhere" / "figures" / "sweep.png").stat().st_size > 10_000


def test_sweep_table_and_again(study, capsys):
    assert guarded(["sweep", str(study)]) == 0
    assert "controller.k_p" in capsys.readouterr().out
    assert guarded(["sweep", str(study)]) == 0  # the same study starts over


def test_simulate_and_replay(study, capsys):
    assert guarded(["simulate", str(study), "--draw", "7", "--csv", "a.csv", "--figure", "a.png", "--json"]) == 0
    single = last_json(capsys)
    head, *rows = (study.parent / "a.csv").read_text().splitlines()
    assert head.split(",") == ["t", "y", "y_dot", "y_ref", "e", "sigma", "u", "u_total", "integral"]
    assert len(rows) == 200
    assert guarded(["run", str(study), "--json"]) == 0
    capsys.readouterr()
    assert guarded(["replay", "results/small-run", "--draw", "7", "--csv", "b.csv", "--json"]) == 0
    again = last_json(capsys)
    assert again["deviation"] == 0.0
    assert again["error_rms"] == pytest.approx(single["error_rms"], rel=1e-12)
    assert (study.parent / "b.csv").read_text() == (study.parent / "a.csv").read_text()


def test_replay_of_a_sweep_takes_the_point(study, capsys):
    guarded(["sweep", str(study), "--json"])
    capsys.readouterr()
    assert guarded(["replay", "results/small-sweep", "--draw", "2", "--at", "controller.k_p=1.2", "--json"]) == 0
    assert last_json(capsys)["controller.k_p"] == 1.25


def test_report_and_index(study, capsys):
    assert guarded(["run", str(study), "--json"]) == 0
    capsys.readouterr()
    assert guarded(["report", "results/small-run", "--worst", "1", "--json"]) == 0
    found = last_json(capsys)
    page = study.parent / found["report"]
    assert page == study.parent / "results" / "small-run" / "report.html"
    assert page.stat().st_size == found["bytes"]
    (study.parent / "results" / "broken").mkdir()
    assert guarded(["report", "--index", "results", "--json"]) == 0
    found = last_json(capsys)
    assert [bool(row["trouble"]) for row in found["results"]] == [True, False]
    assert guarded(["report", "--index", "results"]) == 0
    assert "1 results, 1 that cannot be shown" in capsys.readouterr().out


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
    assert "Theorem 1 is silent: the controller is not DSSC" in shown


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
    assert (study.parent / "m" / "figures" / "margin.png").exists()
    assert guarded([*arguments, "--controllers", "pi,soft", "--out", "m"]) == 0
    assert "share of draws that go further" in capsys.readouterr().out
    assert guarded([*arguments, "--controllers", "pi"]) == 2
    assert "two different names" in capsys.readouterr().err


def test_theory(study, capsys):
    arguments = ["theory", str(study), "--over", "plant.k_p=1.2:0.01", "--points", "4", "--bisections", "3"]
    assert guarded([*arguments, "--draws", "8", "--out", "t", "--json"]) == 0
    found = last_json(capsys)
    assert {"certificate", "performance", "local", "oscillations", "silent"} <= found.keys()
    assert found["certificate"]["certified"] is None
    for name in ("theory.json", "figures/theory.png", "figures/theory.svg"):
        assert (study.parent / "t" / name).exists()
    assert guarded([*arguments, "--draws", "8", "--out", "t"]) == 0
    shown = capsys.readouterr().out
    assert "simulated" in shown
    assert "Theorem 1 is silent" in shown


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


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["margin", "--over", "plant.k_p"], "must be NAME=LO:HI"),
        (["margin", "--over", "plant.k_p=1:2:3"], "must be NAME=LO:HI"),
        (["margin", "--over", "plant.kp=1:2"], "did you mean 'plant.k_p'"),
        (["margin", "--over", "plant.k_p=1:2", "--out", "."], "nothing was written"),
        (["theory", "--over", "plant.kp=1:2"], "did you mean 'plant.k_p'"),
        (["theory", "--over", "plant.k_p"], "must be NAME=LO:HI"),
        (["compare", "--controllers", "pi"], "needs two different names"),
        (["compare", "--controllers", "pi,sta"], "give [compare.sta]"),
        (["compare", "--controllers", "pi,pit"], "did you mean 'pi'"),
    ],
)
def test_bad_margins_and_comparisons(study, capsys, arguments, told):
    assert guarded([arguments[0], str(study), *arguments[1:]]) == 2
    assert told in capsys.readouterr().err


def test_dssc_columns(tmp_path, capsys):
    assert guarded(["simulate", "mu_robustness", "--csv", str(tmp_path / "a.csv"), "--every", "100", "--json"]) == 0
    head, *rows = (tmp_path / "a.csv").read_text().splitlines()
    wanted = ["sigma_hat", "u_av", "rho", "k_o", "tau_m", "tau_av", "sigma_tilde"]
    assert set(wanted) <= set(head.split(","))
    assert len(rows) == 120


def test_check(tmp_path, capsys):
    path = tmp_path / "design.toml"
    path.write_text(DESIGN)
    assert guarded(["check", str(path), "--json"]) == 0
    found = last_json(capsys)
    assert found["certified"] is True
    assert {"name", "equation", "slack", "state", "printed_slack"} <= found["inequalities"][0].keys()
    path.write_text('recipe = "printed"\n' + DESIGN)
    assert guarded(["check", str(path)]) == 1
    assert "boundary" in capsys.readouterr().out


def test_studies_and_info(capsys):
    assert guarded(["studies", "--json"]) == 0
    assert "mu_robustness" in [row["name"] for row in last_json(capsys)["studies"]]
    assert guarded(["studies"]) == 0
    assert guarded(["info", "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert "square_root" not in found["kinds"]["controller"]
    assert "dssc" in found["kinds"]["controller"]
    assert found["metrics"]["chattering_index"]["unit"] == "1"
    assert guarded(["info"]) == 0
    assert "share of the robust command above 1 Hz" in capsys.readouterr().out


BAD = {
    "no such study": (["run", "mu_robustnes"], "did you mean 'mu_robustness'"),
    "no such file": (["run", "none.toml"], "none.toml: cannot be read"),
    "no such command": (["sweeep"], "sweeep"),
    "no such option": (["run", "small.toml", "--drawz", "3"], "--drawz"),
    "misspelt name": (
        ["run", "small.toml", "--set", "controller.kp=1"],
        "controller.kp: unknown name; did you mean 'k_p'",
    ),
    "assignment without value": (["run", "small.toml", "--set", "draws"], "--set: must be NAME=VALUE, got 'draws'"),
    "broken axis": (["sweep", "small.toml", "--over", "controller.k_p=1:2"], "--over: must be NAME=LO:HI:COUNT[:log]"),
    "axis of words": (["sweep", "small.toml", "--over", "controller.k_p=a:b:c"], "got 'controller.k_p=a:b:c'"),
    "unknown axis": (["sweep", "small.toml", "--over", "controller.kp=1:2:3"], "did you mean 'controller.k_p'"),
    "sweep without axes": (["sweep", "small.toml", "--set", "sweep={}"], "has no [sweep]"),
    "no draws": (["run", "small.toml", "--draws", "0"], "draws"),
    "draw out of range": (["simulate", "small.toml", "--draw", "20"], "draw must be in 0 .. 19, got 20"),
    "negative draw": (["simulate", "small.toml", "--draw", "-1"], "draw must be in 0 .. 19, got -1"),
    "no result": (["replay", "nothing", "--draw", "0"], "is not a results folder"),
    "csv nowhere": (["simulate", "small.toml", "--csv", "no/such/folder/a.csv"], "cannot be written"),
    "figure of an unknown type": (["simulate", "small.toml", "--figure", "a.xyz"], "cannot be written"),
    "report of nothing": (["report"], "takes a results folder, or --index"),
    "report of two": (["report", "a", "--index", "b"], "and not both"),
    "report of no result": (["report", "nothing"], "is not a results folder"),
    "index of no folder": (["report", "--index", "small.toml"], "is not a folder of results"),
    "index elsewhere": (["report", "--index", ".", "--out", "a.html"], "is for one report"),
    "no such design": (["check", "none.toml"], "cannot be read"),
    "study as design": (["check", "small.toml"], "small.toml: "),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_2(study, capsys, case):
    arguments, message = BAD[case]
    assert guarded(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    lines = said.err.strip().splitlines()
    assert len(lines) == 1, said.err
    assert message in lines[0]
    assert not (study.parent / "results").exists()


def test_out_of_another_study(study, capsys):
    assert guarded(["run", str(study), "--out", "r", "--json"]) == 0
    capsys.readouterr()
    assert guarded(["run", str(study), "--out", "r", "--seed", "9"]) == 2
    assert "another study" in capsys.readouterr().err


def test_interrupt_is_130(study, monkeypatch, capsys):
    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("dssc_jax.api.run", interrupted)
    assert guarded(["run", str(study), "--set", "controller.k_p={ uniform = [1, 2] }"]) == 130
    wanted = f"go on with: dssc-jax run {study} --set 'controller.k_p={{ uniform = [1, 2] }}' --resume\n"
    assert capsys.readouterr().err.endswith(wanted)
    monkeypatch.setattr("dssc_jax.api.simulate", interrupted)
    assert guarded(["simulate", str(study)]) == 130
    assert capsys.readouterr().err == "interrupted\n"  # nothing to go on from


def test_a_signal_keeps_what_is_finished(study, capsys):
    """SIGINT in the middle of a sweep of six blocks: exit 130, and --resume does not begin at zero."""
    arguments = ["--set", "loop.duration=60.0", "--draws", "17000", "--out", "cut"]
    process = subprocess.Popen([sys.executable, "-m", "dssc_jax.cli", "sweep", str(study), *arguments], stderr=-1)

    def blocks():
        chunks = (study.parent / "cut" / "data.zarr" / "outcome" / "c").rglob("*")
        return [file for file in chunks if file.is_file() and file.suffix != ".partial"]

    deadline = time.monotonic() + 60
    while not blocks() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=60)[1].decode()
    assert process.returncode == 130
    assert "--resume" in said
    assert "Traceback" not in said
    assert 0 < len(blocks()) < 6


def test_parsing():
    assert parse_value("0.5") == 0.5
    assert parse_value("{ uniform = [0, 1] }") == {"uniform": [0, 1]}
    assert parse_value("implicit") == "implicit"
    assert parse_over("a.b=0:1:5") == ("a.b", {"linspace": [0.0, 1.0, 5]})
    assert parse_over("a.b=1e-3:1:5:log") == ("a.b", {"logspace": [1e-3, 1.0, 5]})


def test_one_trajectory_is_no_chore():
    """simulate of one 80 s draw, compile included."""
    _, seconds = timed("simulate", "mu_robustness", "--set", "loop.duration=80.0", "--json")
    print(f"\nsimulate of 80 s: {seconds:.2f} s of processor time")
    assert seconds < 8.0


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
    spent = ["--particles", "20", "--moves", "2", "--repeats", "10"]
    assert guarded(["rare", str(study), *uncertain, *spent, "--out", "r"]) == 0
    shown = capsys.readouterr().out
    assert "10 independent repeats" in shown
    stored = json.loads((study.parent / "r" / "rare.json").read_text())
    assert stored["inputs"]["plant"]["a_p"] == {"normal": [1.0, 0.1]}
    assert guarded(["rare", str(study), *spent, "--out", "r"]) == 2  # another study's answer is there
    assert "another study" in capsys.readouterr().err
