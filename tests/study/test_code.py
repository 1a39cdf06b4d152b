"""Which files of a user's code a run records, and who tells that one of them has changed."""

import json
import sys

import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.results.manifest import machinery_differences
from dssc_jax.study.code import code_digests, imported_files
from tests.conftest import UNCERTAIN
from tests.mutations import document

SPRING = """
from typing import Annotated, NamedTuple
import recorded_gain
from dssc_jax.types import Command, Controller, Quantity
class Gains(NamedTuple):
    l0: Annotated[float, Quantity("1/s", "error pole", above=0.0)] = 1.0
def step(gains, state, measurement, reference, dt):
    return state, Command(-recorded_gain.GAIN * measurement.y, 0.0), ()
SPRING = Controller(Gains, lambda gains, measurement, reference: (), step)
"""
NAME = "recorded_spring:SPRING"
TABLE = {**UNCERTAIN, "sweep": {}, "draws": 4, "controller": {"kind": NAME}}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a controller, the module of its gain, and the study; modules are imported from there."""
    (tmp_path / "recorded_spring.py").write_text(SPRING)
    (tmp_path / "recorded_gain.py").write_text("GAIN = 1.0\n")
    (tmp_path / "spring.toml").write_bytes(document(TABLE))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in ("recorded_spring", "recorded_gain"):
        sys.modules.pop(name, None)


def test_resume_is_refused_when_an_imported_module_has_changed(folder):
    study = dj.Study.load("spring.toml")
    dj.run(study, "done")
    dj.run(study.override({"draws": 8}), "done", resume=True)
    (folder / "recorded_gain.py").write_text("GAIN = 0.3\n")
    with pytest.raises(ConfigError, match=r"was begun otherwise \(code\.recorded_gain"):
        dj.run(study.override({"draws": 12}), "done", resume=True)


def test_replay_and_verify_tell_that_an_imported_module_has_changed(folder, capsys):
    dj.run(dj.Study.load("spring.toml"), "done")
    (folder / "recorded_gain.py").write_text("GAIN = 1.0  # the same number\n")
    assert guarded(["replay", "done", "--draw", "1", "--json", "--trust-code"]) == 0
    said = capsys.readouterr().err
    assert f"recorded_gain from {folder / 'recorded_gain.py'}, which it imports, changed since the run" in said
    assert guarded(["verify", "done", "--json", "--trust-code"]) == 0
    assert "recorded_gain" in str(json.loads(capsys.readouterr().out))


def test_a_manifest_without_imported_modules_is_no_difference(folder):
    new = code_digests(TABLE)
    old = {name: entry for name, entry in new.items() if name == NAME}
    assert set(new) == {NAME, "recorded_gain"}
    assert machinery_differences({"code": old}, {"code": new}) == []
    assert machinery_differences({"code": new}, {"code": old}) != []


def test_modules_of_the_user_alone_are_recorded(folder):
    """Through packages and relative imports; not those of Python, of installed packages, or of other folders."""
    package = folder / "recorded_parts"
    (package / "deep").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "tables.py").write_text("import recorded_gain\nimport no_such_module\n")
    (package / "broken.py").write_text("x = (\n")
    (package / "deep" / "__init__.py").write_text("")
    (package / "deep" / "plant.py").write_text(
        "import math, numpy, jax.numpy, dssc_jax.types\n"
        "def late():\n    from .. import tables, broken\n    from ..tables import VALUE\n"
    )
    expected = {
        "recorded_parts": package / "__init__.py",
        "recorded_parts.deep": package / "deep" / "__init__.py",
        "recorded_parts.tables": package / "tables.py",
        "recorded_parts.broken": package / "broken.py",
        "recorded_gain": folder / "recorded_gain.py",
    }
    assert imported_files("recorded_parts.deep.plant:PLANT") == expected
    assert "recorded_parts" not in sys.modules
    assert imported_files("no_such_module:X") == {}
