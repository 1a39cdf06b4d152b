"""The command line as a person or a program meets it."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
import typer

from dssc_jax.cli.application import app
from dssc_jax.cli.main import guarded
from dssc_jax.cli.parsing import parse_sweep_axis, parse_value
from tests.cli.conftest import last_json
from tests.tolerances import ROUNDING

COMMANDS = sorted(typer.main.get_command(app).commands)
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


STARTUP = """
import sys
from typer.testing import CliRunner
from dssc_jax.cli.application import app
for arguments in {arguments}:
    result = CliRunner().invoke(app, [*arguments, "--help"])
    assert result.exit_code == 0 and "Usage" in result.output, arguments
print(*sorted({{name.partition(".")[0] for name in sys.modules}}))
"""
HEAVY = {"clarabel", "dask", "flint", "jax", "jaxlib", "matplotlib", "numpy", "optax", "scipy", "xarray", "zarr"}


def test_help_loads_no_numerical_library():
    """Help comes at once because it imports nothing that computes."""
    arguments = [[], *([command] for command in COMMANDS)]
    done = subprocess.run(
        [sys.executable, "-c", STARTUP.format(arguments=arguments)], capture_output=True, text=True, check=True
    )
    assert "typer" in done.stdout.split()
    assert not HEAVY & set(done.stdout.split())


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
    assert head.split(",") == [
        "t",
        "y",
        "y_dot",
        "y_ref",
        "e",
        "sigma",
        "y_measured",
        "y_dot_measured",
        "sigma_measured",
        "u",
        "u_total",
        "integral",
    ]
    assert len(rows) == 200
    assert guarded(["run", str(study), "--json"]) == 0
    capsys.readouterr()
    assert guarded(["replay", "results/small-run", "--draw", "7", "--csv", "b.csv", "--json"]) == 0
    again = last_json(capsys)
    assert again["agreement"] == "agrees"
    assert again["error_rms"] == pytest.approx(single["error_rms"], rel=1e-12)
    one, other = (np.genfromtxt(study.parent / name, delimiter=",", names=True) for name in ("a.csv", "b.csv"))
    assert one.dtype.names == other.dtype.names
    for name in one.dtype.names:  # machine code, and plain XLA
        np.testing.assert_allclose(one[name], other[name], rtol=ROUNDING, atol=1e-12, err_msg=name)


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
    assert "share of the robust command above the chattering frequency" in capsys.readouterr().out


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
    "report of no result": (["report", "nothing"], "is no folder"),
    "index of no folder": (["report", "--index", "small.toml"], "is not a folder of results"),
    "index elsewhere": (["report", "--index", ".", "--out", "a.html"], "applies to one report"),
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

    monkeypatch.setattr("dssc_jax.runs.run.run", interrupted)
    assert guarded(["run", str(study), "--set", "controller.k_p={ uniform = [1, 2] }"]) == 130
    wanted = f"continue with: dssc-jax run {study} --set 'controller.k_p={{ uniform = [1, 2] }}' --resume\n"
    assert capsys.readouterr().err.endswith(wanted)
    monkeypatch.setattr("dssc_jax.runs.trajectory.simulate", interrupted)
    assert guarded(["simulate", str(study)]) == 130
    assert capsys.readouterr().err.endswith("\ninterrupted\n")  # nothing to go on from


@pytest.mark.parametrize(
    ("number", "code", "options"),
    [
        (signal.SIGINT, 130, ["--cluster", "local:2"]),
        (signal.SIGTERM, 143, ["--cluster", "local:2"]),
        (signal.SIGHUP, 129, []),
    ],
)
def test_a_signal_keeps_what_is_finished(study, number, code, options):
    """In the middle of a sweep of six blocks: the same is said of all, --resume does not begin at zero, nobody is left.

    Ctrl-C goes to all processes of a terminal, the other signals to one.
    """
    arguments = ["--set", "loop.duration=200.0", "--draws", "17000", "--out", "cut", *options]
    before = signal.signal(number, signal.SIG_DFL)  # a shell's background job inherits "ignored"
    command = [sys.executable, "-m", "dssc_jax.cli", "sweep", str(study), *arguments]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True)
    signal.signal(number, before)

    def blocks():
        chunks = (study.parent / "cut" / "data.zarr" / "outcome" / "c").rglob("*")
        return [file for file in chunks if file.is_file() and file.suffix != ".partial"]

    while not blocks() and process.poll() is None:
        time.sleep(0.01)
    helpers = psutil.Process(process.pid).children(recursive=True)
    assert len(helpers) >= (2 if options else 0)
    (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
    said = process.communicate(timeout=600)[1].decode()
    assert process.returncode == code
    assert f"interrupted; finished blocks are kept, continue with: dssc-jax sweep {study} --set" in said
    assert said.strip().endswith("--resume")
    assert "Traceback" not in said
    assert 0 < len(blocks()) < 6
    assert psutil.wait_procs(helpers, timeout=600)[1] == []


@pytest.mark.parametrize("wait", [0.0, 1.0])
def test_a_terminal_that_is_gone_is_not_written_to(study, wait):
    """The hang-up of a closed window: nothing can be said any more, and the code is still the signal's.

    It is so even where the progress meets the closed terminal long before the signal comes.
    """
    leader, terminal = os.openpty()
    options = ["--set", "loop.duration=20000.0", "--draws", "100000", "--out", "cut"]
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    process = subprocess.Popen(
        [sys.executable, "-m", "dssc_jax.cli", "run", str(study), *options], stdout=terminal, stderr=terminal
    )
    signal.signal(signal.SIGHUP, before)
    os.close(terminal)
    shown = b""
    while b"small" not in shown:  # the progress
        shown += os.read(leader, 1024)
    os.close(leader)
    time.sleep(wait)
    process.send_signal(signal.SIGHUP)
    assert process.wait(timeout=600) == 129


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["run", "--until-width", "0.2"], r"small took 100 of at most 100,000 draws: the rule is met"),
        (
            ["margin", "--over", "controller.k_p=0.5:2"],
            r"small took \d+ of at most 620 simulations: every critical value is found",
        ),
        (["run"], None),
    ],
)
def test_progress_tells_how_it_ended(study, arguments, told, capsys):
    command, *options = arguments
    assert guarded([command, str(study), *options]) == 0
    said = capsys.readouterr().err
    counts = re.findall(r"(\d+)/(\d+)", said)
    assert counts[-1][0] == counts[-1][1]
    assert bool(told) == (" took " in said)
    assert re.search(told or "small", said)


def test_parsing():
    assert parse_value("0.5") == 0.5
    assert parse_value("{ uniform = [0, 1] }") == {"uniform": [0, 1]}
    assert parse_value("implicit") == "implicit"
    assert parse_sweep_axis("a.b=0:1:5") == ("a.b", {"linspace": [0.0, 1.0, 5]})
    assert parse_sweep_axis("a.b=1e-3:1:5:log") == ("a.b", {"logspace": [1e-3, 1.0, 5]})


def test_signals_of_a_file_that_are_no_table_are_refused(study, tmp_path, capsys):
    """--column changes the file's table of columns; a file without such a table was a traceback once."""
    table = tmp_path / "columns.toml"
    table.write_text("signals = 3\n")
    log = tmp_path / "log.csv"
    log.write_text("t,a\n0,1\n0.01,2\n")
    assert guarded(["compare-log", str(study), str(log), "--columns", str(table), "--column", "y=a"]) == 2
    assert "signals: must be a table, got 3" in capsys.readouterr().err
