"""What a command line is expected to know: its version, help, completion, names of everything, and nearby mistakes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from tests.cli.conftest import last_json


def test_version(capsys):
    assert guarded(["--version"]) == 0
    assert capsys.readouterr().out == f"dssc-jax {dj.__version__}\n"


@pytest.mark.parametrize("options", [[], ["--quiet"]])
def test_quiet(options, tmp_path):
    """As a program of its own, because progress goes to standard error once and for all."""
    arguments = [*options, "run", "motor", "--draws", "4", "--out", str(tmp_path / "out")]
    command = [Path(sys.executable).parent / "dssc-jax", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0
    assert "failure probability" in done.stdout
    assert bool(done.stderr) != bool(options)


@pytest.mark.parametrize("arguments", [["-h"], ["run", "-h"], ["info", "-h"]])
def test_short_help(arguments, capsys):
    assert guarded(arguments) == 0
    short = capsys.readouterr().out
    assert guarded([*arguments[:-1], "--help"]) == 0
    assert capsys.readouterr().out == short
    assert "Usage: " in short


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion(shell):
    """As the script of each shell asks for it: commands that begin with `sim`."""
    words = {"bash": {"COMP_WORDS": "dssc-jax sim", "COMP_CWORD": "1"}}
    asked = words.get(shell, {"_TYPER_COMPLETE_ARGS": "dssc-jax sim", "_TYPER_COMPLETE_FISH_ACTION": "get-args"})
    environment = {**os.environ, "_DSSC_JAX_COMPLETE": f"complete_{shell}", **asked}
    command = Path(sys.executable).parent / "dssc-jax"
    done = subprocess.run([command], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "simulate" in done.stdout
    assert "report" not in done.stdout


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("uniform", "law uniform = "),
        ("rise_time", "metric rise_time [s]: time in which a step response"),
        ("chirp", "first frequency"),
        ("pid", "set-point weight b"),
        ("lag", "time constant mu"),
    ],
)
def test_info_knows_every_name(name, shown, capsys):
    assert guarded(["info", name]) == 0
    assert shown in " ".join(capsys.readouterr().out.split())


def test_info_of_ones_own_model(tmp_path, monkeypatch, capsys):
    (tmp_path / "own_gains.py").write_text(
        "from typing import Annotated, NamedTuple\n"
        "from dssc_jax.types import Controller, Quantity\n"
        "class Gains(NamedTuple):\n"
        '    l0: Annotated[float, Quantity("1/s", "error pole", above=0.0)]\n'
        '    stiff: Annotated[float, Quantity("u/y", "stiffness of a spring", above=0.0)] = 2.0\n'
        "OWN = Controller(Gains, None, None)\n"
        "WORD = 'no model'\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    assert guarded(["info", "own_gains:OWN"]) == 2
    assert "cannot import 'own_gains:OWN'" in capsys.readouterr().err
    assert guarded(["info", "own_gains:OWN", "--allow-local"]) == 0
    said = capsys.readouterr()
    assert "stiffness of a spring" in said.out
    assert "this command runs code: own_gains:OWN from " in said.err
    assert guarded(["info", "own_gains:WORD", "--allow-local"]) == 2
    assert "must be a model or its parameters, got str" in capsys.readouterr().err
    sys.modules.pop("own_gains", None)


def test_a_file_beside_is_suggested_before_a_packaged_study(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mu_robustnes2.toml").write_text("")
    assert guarded(["run", "mu_robustnes"]) == 2
    assert "did you mean 'mu_robustnes2.toml'?" in capsys.readouterr().err


def test_python_takes_a_packaged_study_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert dj.Study.load("motor").name == "motor"
    with pytest.raises(ConfigError, match="did you mean 'motor'"):
        dj.Study.load("motro")


def test_tune_without_a_table_shows_one(capsys):
    assert guarded(["tune", "motor"]) == 2
    said = capsys.readouterr().err
    table = '[tune] parameters = { "controller.k_p" = [33.3, 300] }, objective = { error_rms = 1.0 }'
    assert f"is required and missing; for example: {table}" in said


def test_matlab_reads_a_result(tmp_path):
    study = dj.Study.load("motor").override({"draws": 5})
    result = dj.run(study)
    (file,) = dj.export(result, "mat", tmp_path / "motor.mat")
    content = loadmat(file, simplify_cells=True)
    np.testing.assert_array_equal(content["rise_time"]["values"], result.dataset["rise_time"].values)
    assert content["parameters_L"]["units"] == "H"
    assert content["steady_state_error_after_4_5"]["units"] == "rad/s"
    assert content["study"]["study_hash"] == study.hash
    assert all(len(name) <= 63 for name in content)


def test_a_complete_result_is_shown_and_not_computed_again(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = ["run", "motor", "--draws", "4", "--out", "here", "--json"]
    assert guarded(command) == 0
    first = capsys.readouterr()
    assert guarded(command) == 0
    second = capsys.readouterr()
    assert "here is complete, computed " in second.err
    assert "--fresh computes it again" in second.err
    assert json.loads(second.out) == json.loads(first.out)  # times too: nothing ran
    assert guarded([*command, "--fresh"]) == 0
    third = capsys.readouterr()
    assert "is complete" not in third.err
    assert json.loads(third.out)["points"] == json.loads(first.out)["points"]
    (array,) = (tmp_path / "here" / "data.zarr" / "rise_time" / "c").iterdir()
    array.write_bytes(array.read_bytes()[:-1])
    assert guarded(command) == 0  # a damaged one is computed again
    last = capsys.readouterr()
    assert "is complete" not in last.err
    assert json.loads(last.out)["points"] == json.loads(first.out)["points"]


def test_compiling_is_announced_before_it_begins(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    command = Path(sys.executable).parent / "dssc-jax"
    for arguments in (["simulate", "motor"], ["run", "motor", "--draws", "4"]):
        done = subprocess.run([command, *arguments], capture_output=True, text=True, cwd=tmp_path)
        assert done.stderr.startswith("motor: compiling, which takes a few seconds")


def test_an_edited_study_has_a_folder_of_its_own(study, capsys):
    """The results of the study as it was remain."""
    assert guarded(["run", study.name, "--json"]) == 0
    first = last_json(capsys)["result"]
    assert guarded(["run", study.name, "--json"]) == 0
    assert last_json(capsys)["result"] == first
    study.write_text(study.read_text().replace("draws = 20", "draws = 21"))
    assert guarded(["run", study.name, "--json"]) == 0
    second = last_json(capsys)
    assert second["result"].startswith(f"{first}-")
    assert second["draws"] == 21


def test_a_run_whose_figures_cannot_be_drawn_is_kept(study, monkeypatch):
    """The result is complete before its figures are drawn."""

    def failing(*arguments):
        raise RuntimeError("no fonts")

    monkeypatch.setattr("dssc_jax.plotting.save_all", failing)
    with pytest.raises(RuntimeError, match="no fonts"):
        guarded(["run", str(study), "--out", "kept"])
    assert json.loads(Path("kept/manifest.json").read_text())["complete"]
    assert dj.load("kept").dataset.sizes["draw"] == 20


def test_a_figure_library_that_does_not_load_ends_a_command_before_it_computes(study):
    command = [sys.executable, "-m", "dssc_jax.cli", "run", str(study), "--out", "kept"]
    done = subprocess.run(command, env={**os.environ, "MPLBACKEND": "nonsense"}, capture_output=True, text=True)
    assert done.returncode != 0
    assert "nonsense" in done.stderr
    assert not Path("kept").exists()


def test_a_warning_of_the_library_is_a_plain_line(tmp_path):
    """As a program of its own, because Python's own form has the file, the line and the class."""
    script = "import sys, warnings; from dssc_jax.cli import main; import dssc_jax.cli.main as m;"
    script += "m.guarded = lambda arguments: warnings.warn('the log is damaged', UserWarning) or 0; m.main()"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0
    assert done.stderr == "warning: the log is damaged\n"


def test_simulate_names_units(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert guarded(["simulate", "motor", "--draw", "3", "--no-check"]) == 0
    rows = {line.split()[0]: line.split()[-1] for line in capsys.readouterr().out.splitlines() if line.split()}
    assert rows["disturbance.value"] == rows["command_max"] == "V"
    assert rows["error_rms"] == "rad/s"
    assert rows["rise_time"] == "s"


def test_loop_prints_one_table_for_two_places_with_the_same_margins(tmp_path, monkeypatch, capsys):
    """PID takes y alone, so that command and measurement are one signal; state feedback takes y' too."""
    monkeypatch.chdir(tmp_path)
    assert guarded(["loop", "motor", "--draws", "4"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("gain margin") == 2  # with the lower one
    assert "input and output, at the equilibrium" in printed
    feedback = "controller={ kind = 'state_feedback', k_1 = 50.0, k_2 = 5.0 }"
    assert guarded(["loop", "motor", "--draws", "4", "--set", feedback]) == 0
    printed = capsys.readouterr().out
    assert "input and output" not in printed
    assert "output, at the equilibrium" in printed


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--set", "requirement.1.max=5"], "small.toml: requirement.1.max: requirement has 1 entry, whose index is 0;"),
        (["--set", "plant.initial.2=1"], "small.toml: plant.initial.2: plant.initial has 2 entries, whose indices are"),
        (["--set", "plant..k_p=3"], "small.toml: plant..k_p: has an empty part;"),
        (["--set", "plant.initial.0.x=1"], "small.toml: plant.initial.0.x: leads nowhere: 'x' is"),
        (["--draws", "10", "--set", "draws=12"], "--draws: gives a second value of draws; leave out this option, or"),
        (["--seed", "1", "--set", "seed=2"], "--seed: gives a second value of seed; leave out this option, or --set"),
    ],
)
def test_a_change_that_leads_nowhere_says_why_once(study, options, message, capsys):
    assert guarded(["run", study.name, *options]) == 2
    assert capsys.readouterr().err.startswith(f"error: {message}")
