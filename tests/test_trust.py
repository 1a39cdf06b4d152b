"""Code that a received file names: read without it, run only on request, and named before it runs."""

import json
import shutil
import sys
from pathlib import Path

import pytest
import xarray as xr

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.study import Described
from dssc_jax.study.code import code_file, code_names
from tests.conftest import UNCERTAIN
from tests.forging import resealed
from tests.mutations import document

SPY = """
from pathlib import Path
from typing import Annotated, NamedTuple

Path(__file__).with_name("imported").touch()

from dssc_jax.models.sensors import SENSORS
from dssc_jax.closed_loop.metrics.streaming import METRICS
from dssc_jax.models.plants import PLANTS
from dssc_jax.core.signals import Command
from dssc_jax.core.contracts import Controller
from dssc_jax.core.quantities import Quantity

PLANT = PLANTS["normal_form"].members[None]
SENSOR = SENSORS["ideal"].members[None]
effort = METRICS["command_rms"]._replace(unit="N", meaning="rms of the effort")


class Gains(NamedTuple):
    l0: Annotated[float, Quantity("1/s", "error pole", above=0.0)]
    stiffness: Annotated[float, Quantity("N/m", "spring's stiffness", above=0.0)]


class Info(NamedTuple):
    sliding_margin: float


def step(gains, state, measurement, reference, dt):
    spring = -gains.stiffness * (measurement.y - reference.y)
    return state, Command(spring - gains.l0 * measurement.y_dot, 0.0), Info(1.0 - spring)


CONTROLLER = Controller(gains=Gains, init=lambda gains, measurement, reference: (), step=step)
"""
OWN = {
    **UNCERTAIN,
    "plant": {**UNCERTAIN["plant"], "kind": "spy:PLANT"},
    "controller": {"kind": "spy:CONTROLLER", "l0": 1.0, "stiffness": {"uniform": [2.0, 4.0]}},
    "metrics": {"names": ["error_rms", "outside_sliding", "spy:effort"]},
    "requirement": [{"metric": "spy:effort", "after": 2.0, "max": 2.5}],
    "sweep": {"controller.l0": [0.5, 1.0]},
    "draws": 12,
}
SENSED = {
    **UNCERTAIN,
    "plant": {**UNCERTAIN["plant"], "zero_dynamics": {"a": [2.0, 1.5], "c": [0.2, 0.1]}},
    "controller": {
        **UNCERTAIN["controller"],
        "functions": {
            **dict.fromkeys(("phi_a", "phi_b", "kappa_a", "kappa_b", "kappa_c", "kappa_d", "epsilon", "gamma"), 1.0),
            **{"kind": "vgsta", "delta": 0.5, "tau_av": 0.05},
        },
    },
    "sensor": {"kind": "spy:SENSOR"},
    "disturbance": {"kind": "constant", "value": 0.1},
    "sweep": {"controller.l0": [0.5, 1.0]},
    "draws": 4,
}
"""Theorem 1 speaks of this loop, whose sensor it takes for ideal."""


@pytest.fixture
def spy(tmp_path, monkeypatch):
    """A folder on the module search path, whose module leaves a mark where it is imported; studies that name it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "spy", raising=False)
    (tmp_path / "spy.py").write_text(SPY)
    (tmp_path / "own.toml").write_bytes(document(OWN))
    yield tmp_path
    sys.modules.pop("spy", None)


def forget(folder: Path) -> Path:
    """The mark that an import leaves, taken away, so that the module is imported anew."""
    sys.modules.pop("spy", None)
    mark = folder / "imported"
    mark.unlink(missing_ok=True)
    return mark


@pytest.fixture
def received(spy):
    """A colleague's result: the folder, what was there when it was computed, and the mark of an import."""
    result = dj.run(dj.Study.load("own.toml"), spy / "received")
    assert (spy / "imported").exists()
    return result, forget(spy)


def test_a_result_is_read_without_its_code(received):
    whole, mark = received
    again = dj.load(whole.path)
    assert isinstance(again.study, Described)
    xr.testing.assert_identical(again.dataset, whole.dataset)
    assert again.summary() == whole.summary()
    assert "rms of the effort" in again.dataset["effort_after_2"].attrs["long_name"]
    assert again.dataset["controller.stiffness"].attrs["units"] == "N/m"
    for draw in (dj.plot.probability, dj.plot.typical, dj.plot.failures):
        draw(again if draw is not dj.plot.failures else again.at({"controller.l0": 0}))
    saved = again.save(whole.path.with_name("saved"))
    xr.testing.assert_identical(dj.load(saved).dataset, whole.dataset)
    assert not mark.exists()


def test_laws_of_a_result_need_no_code(spy, capsys):
    """How wrong they may be follows from its draws; new draws run the code, and are refused."""
    dj.run(dj.Study.load("own.toml").without_sweep(), spy / "plain")
    mark = forget(spy)
    arguments = ["laws", "plain", "--limit", "0.9", "--out", "l", "--json"]
    assert guarded(arguments) == 0
    assert "controller.stiffness" in json.loads(capsys.readouterr().out)["by_law"]
    assert isinstance(dj.load("l").study, Described)
    assert guarded([*arguments, "--fresh", "8"]) == 2
    assert "spy:" in capsys.readouterr().err
    assert not mark.exists()


def test_what_the_theorem_says_is_kept(spy):
    whole = dj.run(dj.Study.from_table(SENSED), spy / "sensed")
    assert "certified" in whole.with_theorem().dataset
    mark = forget(spy)
    again = dj.load(whole.path)
    assert again.certificate == whole.certificate
    xr.testing.assert_identical(again.with_theorem().dataset, whole.with_theorem().dataset)
    assert not mark.exists()


def test_commands_that_show_run_nothing(received, capsys):
    whole, mark = received
    folder = str(whole.path)
    assert guarded(["export", folder, "--to", "csv"]) == 0
    assert "effort_after_2" in (whole.path / "draws.csv").read_text().partition("\n")[0]
    assert guarded(["report", folder]) == 0
    page = (whole.path / "report.html").read_text()
    assert "rms of the effort" in page
    assert "spring&#39;s stiffness" in page
    assert "would run code that is not part of dssc_jax: <code>spy:CONTROLLER, spy:PLANT, spy:effort</code>" in page
    (whole.path / "report.html").unlink()
    assert guarded(["report", "--index", str(whole.path.parent)]) == 0
    assert "2 that cannot be shown" not in capsys.readouterr().out
    assert not mark.exists()


@pytest.mark.parametrize("command", [["replay", "--draw", "1"], ["verify"]])
def test_commands_that_simulate_ask_first(received, capsys, command):
    whole, mark = received
    arguments = [command[0], str(whole.path), *command[1:], "--json"]
    assert guarded(arguments) == 2
    said = capsys.readouterr().err
    assert len(said.strip().splitlines()) == 1
    assert f"spy:PLANT from {mark.with_name('spy.py')}" in said
    assert "--trust-code" in said
    assert "changed since" not in said
    assert not mark.exists()
    assert guarded([*arguments, "--trust-code"]) == 0
    out, said = capsys.readouterr()
    assert json.loads(out)["deviation"] < 1e-12
    assert said.startswith("this result runs code: spy:CONTROLLER from ")
    assert mark.exists()


def test_code_that_has_changed_is_told(received, capsys):
    whole, mark = received
    mark.with_name("spy.py").write_text(f"{SPY}\n# another day\n")
    assert guarded(["verify", str(whole.path)]) == 2
    assert capsys.readouterr().err.count("spy.py, changed since the run") == 3
    found = dj.verify(dj.load(whole.path, trust_code=True))
    assert found.verified
    assert any(line.startswith("code.spy:PLANT: ") for line in found.otherwise)
    with pytest.raises(ConfigError, match="nothing was written"):  # its rest would be another code's
        dj.run(dj.Study.from_table({**OWN, "draws": 20}), whole.path, resume=True)


def test_code_that_is_gone_is_missed_by_nobody_who_reads(received, capsys):
    whole, mark = received
    mark.with_name("spy.py").unlink()
    assert dj.load(whole.path).summary() == whole.summary()
    assert guarded(["replay", str(whole.path), "--draw", "0"]) == 2
    assert "spy:PLANT from no file that is found" in capsys.readouterr().err


def test_in_python_too(received):
    whole, mark = received
    again = dj.load(whole.path)
    for simulate in (
        lambda: dj.replay(again, 0),
        lambda: dj.verify(again),
        lambda: dj.run(again.study),
        lambda: dj.simulate(again.study),
        lambda: dj.margin(again.study, over="controller.l0", bounds=(0.5, 1.0)),
        lambda: again.study.override({"draws": 3}),
    ):
        with pytest.raises(ConfigError, match=r"runs code that was not loaded: .*trust_code=True"):
            simulate()
    assert not mark.exists()
    assert dj.replay(dj.load(whole.path, trust_code=True), 0).attrs["agreement"] == "agrees"


def test_analyses_are_read_without_code_too(spy):
    study = dj.Study.from_table({**OWN, "sweep": {}})
    margins = dj.margin(study, over="plant.k_p", bounds=(1.0, 3.0), points=4, bisections=2)
    margins.save("margins")
    mark = forget(spy)
    again = dj.load("margins")
    assert again.summary() == margins.summary()
    xr.testing.assert_identical(again.dataset, margins.dataset)
    dj.plot.margin(again)
    assert not mark.exists()


def test_a_comparison_is_read_without_code_too(spy):
    rival = {"kind": "spy:CONTROLLER", "l0": 1.0, "stiffness": 3.0}
    compared = dj.compare(
        dj.Study.from_table({**UNCERTAIN, "sweep": {}, "compare": {"spring": rival}}), ["dssc", "spring"]
    )
    compared.save("compared")
    mark = forget(spy)
    again = dj.load("compared")
    assert again.summary() == compared.summary()
    dj.plot.comparison(again)
    assert not mark.exists()


def test_a_study_of_ones_own_names_its_code_first(spy, capsys):
    (spy / "bad.toml").write_bytes(document({**OWN, "plant": {"kind": "spy:PLANT", "k_p": -1.0}}))
    assert guarded(["run", "bad.toml"]) == 2
    first, second = capsys.readouterr().err.strip().splitlines()
    assert first.startswith(f"this study runs code: spy:CONTROLLER from {spy / 'spy.py'}; spy:PLANT from ")
    assert "plant.k_p" in second
    table = {**UNCERTAIN, "sweep": {}}
    (spy / "plain.toml").write_bytes(document(table))
    own = ["--set", "sensor.kind=spy:SENSOR", "--draws", "2", "--json"]
    assert guarded(["run", "plain.toml", *own]) == 0
    out, said = capsys.readouterr()
    assert json.loads(out)["draws"] == 2
    assert said.strip() == f"this study runs code: spy:SENSOR from {spy / 'spy.py'}"


def test_resume_imports_nothing_that_only_the_folder_names(received, capsys):
    whole, mark = received
    (mark.parent / "plain.toml").write_bytes(document(UNCERTAIN))
    assert guarded(["sweep", "plain.toml", "--out", str(whole.path), "--resume"]) == 2
    assert "holds results of another study" in capsys.readouterr().err
    assert not mark.exists()


def test_a_folder_without_a_description_is_refused(received, capsys):
    """What was written before descriptions were kept."""
    whole, mark = received
    resealed(whole.path, code=None, described=None)
    assert guarded(["report", str(whole.path)]) == 2
    said = capsys.readouterr().err
    assert f"spy:PLANT from {mark.with_name('spy.py')}" in said
    assert "--trust-code" in said
    assert not mark.exists()
    assert dj.load(whole.path, trust_code=True).summary()["points"] == whole.summary()["points"]


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("numbers", 3),
        ("numbers", {}),
        ("fields", {"": "x"}),
        ("certified", [True]),
        ("silence", None),
        ("more", 1),
        ("metrics", {}),
        ("channels", ["a", "b"]),
    ],
)
def test_descriptions_are_data_that_may_be_damaged(received, place, value):
    whole, mark = received
    path = whole.path / "manifest.json"
    resealed(whole.path, described=whole.manifest["described"] | {place: value})
    with pytest.raises(ConfigError) as caught:
        dj.load(whole.path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not mark.exists()


def test_names_are_found_wherever_they_stand():
    table = {
        "a": [{"kind": "x.y:Z", "b": {"kind": "dssc"}}],
        "metrics": {"names": ["m:effort", "error_rms"]},
        "kind": 3,
    }
    assert code_names({**table, "requirement": [{"metric": "n:tilt"}]}) == ("m:effort", "n:tilt", "x.y:Z")
    assert code_names({}) == ()


def test_modules_are_located_without_importing_their_packages(spy):
    nested = spy / "outer" / "inner"
    nested.mkdir(parents=True)
    for folder in (nested, nested.parent):
        (folder / "__init__.py").write_text("raise SystemExit('imported')")
    (nested / "leaf.py").write_text("raise SystemExit('imported')")
    (spy / "space" / "deep").mkdir(parents=True)
    (spy / "space" / "deep" / "leaf.py").write_text("")
    assert code_file("outer.inner.leaf:X") == nested / "leaf.py"
    assert code_file("outer.inner:X") == nested / "__init__.py"
    assert code_file("space.deep.leaf:X") == spy / "space" / "deep" / "leaf.py"
    for name in ("outer.leaf:X", "nowhere:X", "nowhere.at.all:X", "..:x", ":x", "builtins:eval", "a b:c"):
        assert code_file(name) is None
    assert "outer" not in sys.modules


def test_a_folder_that_is_sent_elsewhere(received, monkeypatch):
    """Neither the study file nor its module are there."""
    whole, mark = received
    shutil.rmtree(mark.parent / "__pycache__", ignore_errors=True)
    for file in ("spy.py", "own.toml"):
        (mark.parent / file).unlink()
    moved = Path(shutil.move(whole.path, mark.parent / "moved"))
    page = dj.report.html(dj.load(moved))
    assert "spy:PLANT" in page
