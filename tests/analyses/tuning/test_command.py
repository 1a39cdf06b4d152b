"""The command `tune`: files, the JSON object, exit codes."""

import json

import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.study.tables import to_toml
from tests.analyses.tuning.cases import SMALL


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "small.toml").write_text(to_toml(SMALL))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_tune(folder, capsys):
    assert guarded(["tune", "small.toml", "--set", "tune.steps=5", "--out", "better.toml", "--json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    told = json.loads(lines[-1])
    assert len(lines) == 1
    assert told["verdict"]["reduction"] > 0.0
    better = dj.Study.load(folder / "better.toml")
    assert {name: better.leaves()[name] for name in told["tuned"]} == told["tuned"]
    figures = sorted(path.name for path in (folder / told["result"] / "figures").iterdir())
    assert figures == ["tune.png", "tune.svg"]


def test_for_people_and_limits_that_cannot_be_met(folder, capsys):
    """Exit 1; nothing else differs."""
    assert guarded(["tune", "small.toml", "--set", "tune.steps=5", "--set", "tune.limits.command_tv=1e-6"]) == 1
    assert "no point met every limit" in capsys.readouterr().out


def test_bad_input(folder, capsys):
    assert guarded(["tune", "small.toml", "--set", "tune.objective.nothing=1.0"]) == 2
    assert guarded(["tune", "small.toml", "--robust"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2
