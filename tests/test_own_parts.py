"""Models of one's own in every command, what a failed import says, and what a folder may not do."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dssc_jax as dj
from dssc_jax.analyses.comparison import controller_table, with_own_controllers
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.first_gains import first_gains
from dssc_jax.study import Described
from dssc_jax.study.importing import allow_imports
from tests.conftest import UNCERTAIN
from tests.mutations import document
from tests.page_examples import BLOCK

SPRING = """
from typing import Annotated, NamedTuple
from pathlib import Path
Path(__file__).with_name("imported").touch()
from dssc_jax.types import Command, Controller, Quantity
class Gains(NamedTuple):
    l0: Annotated[float, Quantity("1/s", "error pole", above=0.0)]
    stiffness: Annotated[float, Quantity("u/y", "stiffness", above=0.0)] = 3.0
class Info(NamedTuple):
    spring: float
def step(gains, state, measurement, reference, dt):
    spring = -gains.stiffness * (measurement.y - reference.y)
    return state, Command(spring - gains.l0 * measurement.y_dot, 0.0), Info(spring)
SPRING = Controller(gains=Gains, init=lambda gains, measurement, reference: (), step=step)
"""
STUDY = {**UNCERTAIN, "sweep": {}, "draws": 8}
OWN = {**STUDY, "controller": {"kind": "own_spring:SPRING", "l0": 1.0}}
WALK = {"over": "plant.k_p", "bounds": (1.0, 3.0), "points": 3, "bisections": 1}


@pytest.fixture
def beside(tmp_path, monkeypatch):
    """A folder with two studies and a controller beside them, from which nothing can be imported yet."""
    folder = tmp_path / "mine"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (folder / "own_spring.py").write_text(SPRING)
    (folder / "plain.toml").write_bytes(document(STUDY))
    (folder / "own.toml").write_bytes(document(OWN))
    yield folder
    sys.modules.pop("own_spring", None)


def forget(folder):
    sys.modules.pop("own_spring", None)
    mark = folder / "imported"
    mark.unlink(missing_ok=True)
    return mark


def test_a_controller_of_ones_own_enters_a_comparison_by_name(beside, capsys):
    names = "dssc,own_spring:SPRING"
    arguments = ["compare", "plain.toml", "--controllers", names, "--tune", "0", "--json"]
    assert guarded([*arguments, "--allow-local"]) == 0
    out, said = capsys.readouterr()
    assert f"this command runs code: own_spring:SPRING from {beside / 'own_spring.py'}" in said
    summary = json.loads(out)
    assert summary["controllers"]["own_spring:SPRING"]["controller"] == {"kind": "own_spring:SPRING", "l0": 1.0}
    assert guarded([*arguments, "--allow-local"]) == 0  # the same question again, into the same folder
    written = dj.Study.from_table({**STUDY, "compare": {"spring": {"kind": "own_spring:SPRING", "l0": 1.0}}})
    by_table = dj.compare(written, ["dssc", "spring"])
    by_name = dj.compare(dj.Study.load("plain.toml"), names.split(","))
    np.testing.assert_array_equal(by_name.dataset["error_rms"].values, by_table.dataset["error_rms"].values)
    mark = forget(beside)
    sys.path.remove(str(beside))
    again = dj.load(by_name.save("compared"))
    assert isinstance(again.study, Described)
    assert again.summary()["pairs"] == by_name.summary()["pairs"]
    assert not mark.exists()


def test_the_table_of_a_controller_by_name_needs_no_kind(beside):
    """It was merged into the study's own controller."""
    allow_imports(beside)
    study = dj.Study.from_table({**STUDY, "compare": {"own_spring:SPRING": {"stiffness": 2.0}}})
    study = with_own_controllers(study, ["own_spring:SPRING"])
    expected = {"kind": "own_spring:SPRING", "l0": 1.0, "stiffness": 2.0}
    assert controller_table(study, "own_spring:SPRING") == expected


def test_margins_of_a_controller_by_name(beside):
    allow_imports(beside)
    margins = dj.compare_margins(dj.Study.load("plain.toml"), ["dssc", "own_spring:SPRING"], **WALK)
    margins.save("walked")
    mark = forget(beside)
    assert dj.load("walked").summary() == margins.summary()
    assert not mark.exists()


def test_stored_controllers_cannot_name_code_that_the_study_does_not(beside):
    """A folder whose author hid the code from the table that readers look at."""
    allow_imports(beside)
    margins = dj.compare_margins(dj.Study.load("plain.toml"), ["dssc", "smc"], **WALK)
    mark = forget(beside)
    margins.tables["smc"] = {"kind": "own_spring:SPRING", "l0": 1.0}
    margins.save("forged")
    with pytest.raises(ConfigError, match="name code that its study does not, own_spring:SPRING"):
        dj.load("forged")
    assert not mark.exists()


def test_one_s_own_result_is_simulated_again_from_elsewhere(beside, tmp_path, monkeypatch, capsys):
    assert guarded(["run", "own.toml", "--allow-local", "--out", "done", "--json"]) == 0
    forget(beside)
    sys.path.remove(str(beside))
    monkeypatch.chdir(tmp_path)
    asked = ["replay", "mine/done", "--draw", "1", "--json", "--trust-code"]
    assert guarded(asked) == 2
    said = capsys.readouterr().err
    assert f"(the run used {beside / 'own_spring.py'})" in said
    assert "if it lies in the study's folder, --allow-local finds it" in said
    assert "changed since" not in said
    assert guarded([*asked, "--allow-local"]) == 0
    assert json.loads(capsys.readouterr().out)["agreement"] == "agrees"
    for command in (["verify", "mine/done"], ["report", "mine/done", "--worst", "1"]):
        assert guarded([*command, "--trust-code", "--allow-local", "--json"]) == 0


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        ("SPRING = 1", "own_spring:SPRIN", "the module has no 'SPRIN'; did you mean 'SPRING'?"),
        ("import no_such_library", "own_spring:X", "needs 'no_such_library', which is not installed"),
        ("x = (", "own_spring:X", "SyntaxError: '(' was never closed in line 1 of "),
        ("y = 1\nx = 1 / 0", "own_spring:X", "ZeroDivisionError: division by zero in line 2 of "),
        ("", "own_sprin:X", "there is no module 'own_sprin'; if it lies in the study's folder, `allow_local`"),
    ],
)
def test_a_failed_import_says_what_to_do(beside, text, name, said):
    (beside / "own_spring.py").write_text(text)
    allow_imports(beside)
    with pytest.raises(ConfigError, match="cannot import") as caught:
        dj.Study.from_table({**OWN, "controller": {"kind": name, "l0": 1.0}})
    assert said in str(caught.value)


def test_files_beside_a_study_never_replace_installed_modules(beside, capsys):
    """Neither of the standard library nor of others: only what no installed module is called comes from there."""
    (beside / "optax.py").write_text("raise SystemExit('not this one')")
    (beside / "colorsys.py").write_text("raise SystemExit('not this one')")
    sys.modules.pop("colorsys", None)
    assert guarded(["run", "own.toml", "--allow-local", "--draws", "2", "--json"]) == 0
    import colorsys

    assert str(beside) not in colorsys.__file__


METRIC = """
import jax.numpy as jnp
from dssc_jax.closed_loop.metrics.streaming import Metric
def update(total, sample, window):
    worst = total
    {update}
    return worst
EFFORT = Metric("u", "effort", update, lambda worst, window, span: {value})
"""


@pytest.mark.parametrize(
    ("update", "value", "said", "line"),
    [
        ("worst = sample.nothing", "worst", "AttributeError: 'Sample' object has no attribute 'nothing'", 6),
        ("worst = worst + (1 if sample.e > 0 else 0)", "worst", "TracerBoolConversionError: ", 6),
        ("worst = worst + 1 / 0", "worst", "ZeroDivisionError: division by zero", 6),
        ("worst = worst + sample.u * jnp.ones(3)", "worst", "TypeError: it must return numbers, got arrays", 4),
        ("worst = (worst, worst)", "worst", "TypeError: it must return PyTreeDef(*)", 4),
        ("pass", "worst[0]", "IndexError: ", 8),
    ],
)
def test_an_error_in_a_metric_names_the_metric_and_the_line(beside, update, value, said, line):
    (beside / "own_metrics.py").write_text(METRIC.format(update=update, value=value))
    allow_imports(beside)
    table = {**STUDY, "metrics": {"names": ["own_metrics:EFFORT"]}, "requirement": []}
    try:
        with pytest.raises(ConfigError) as caught:
            dj.run(dj.Study.from_table(table))
    finally:
        del sys.modules["own_metrics"]
    assert caught.value.where == "metric 'EFFORT'"
    assert said in caught.value.rule
    assert "\n" not in str(caught.value)
    assert caught.value.rule.endswith(f", in line {line} of {beside / 'own_metrics.py'}")


@pytest.mark.parametrize(
    ("info", "rule"), [("()", None), ("{'spring': spring}", "must report a NamedTuple as its info")]
)
def test_a_controller_may_report_nothing_but_no_other_type(info, rule, tmp_path, monkeypatch):
    """In every command that reads what a controller reports."""
    name = f"silent_{'nothing' if rule is None else 'other'}"
    (tmp_path / f"{name}.py").write_text(SPRING.replace("Info(spring)", info))
    monkeypatch.syspath_prepend(tmp_path)
    table = OWN | {"controller": {"kind": f"{name}:SPRING", "l0": 1.0}}
    if rule is not None:
        with pytest.raises(ConfigError, match=rf"controller: {rule}"):
            dj.run(dj.Study.from_table(table))
        return
    study = dj.Study.from_table(table)
    assert "error_rms" in dj.run(study).dataset
    assert "u" in dj.simulate(study)


CUBE = """
from typing import Annotated, NamedTuple
import jax.numpy as jnp
from dssc_jax.types import SMOOTH, Measurement, NamedSignal, Plant, Quantity
class Params(NamedTuple):
    k: Annotated[float, Quantity("1/s", "stiffness", above=0.0)] = 1.0
class State(NamedTuple):
    x: float
class Info(NamedTuple):
    force: Annotated[float, Quantity("N", "force of the spring")]
def derivative(params, state, drive, t):
    return State(-params.k * state.x**3 + drive.command)
CUBE = Plant(Params, lambda params: State(2.0), derivative,
    lambda params, state, drive: Measurement(state.x, derivative(params, state, drive, 0.0).x), lambda params: 1.0,
    monitor=lambda params, state, drive: Info(params.k * state.x**3), info=Info, smooth=SMOOTH)
"""


@pytest.fixture
def cube(tmp_path, monkeypatch):
    """x' = -k x^3 + u, held at x = 2, where its slope is -12 k and its command 8 k."""
    (tmp_path / "own_cube.py").write_text(CUBE)
    monkeypatch.syspath_prepend(tmp_path)
    table = {
        "name": "cube", "draws": 4, "loop": {"duration": 0.5, "sample_time": 0.01},
        "plant": {"kind": "own_cube:CUBE", "k": {"uniform": [0.9, 1.1]}},
        "reference": {"kind": "step", "size": 0.0, "offset": 2.0},
        "controller": {"kind": "pid", "k_p": 3.0, "k_i": 5.0, "low": 0.0, "high": 20.0},
        "requirement": [{"signal": "force", "metric": "max_abs", "max": 20.0}],
    }  # fmt: skip
    yield table
    sys.modules.pop("own_cube", None)


def test_a_nonlinear_plant_is_linearised_where_its_reference_holds_it(cube):
    """The sampled loop of x' = -12 k x + u under PI has these poles; at 0 it would be another one."""
    study = dj.Study.from_table(cube | {"plant": {"kind": "own_cube:CUBE"}, "draws": 1})
    data = dj.loop_margins(study).dataset
    decay = np.exp(-12.0 * 0.01)
    omega = np.linspace(1e-3, np.pi, 20_001)
    z = np.exp(1j * omega)
    open_loop = (1.0 - decay) / 12.0 / (z - decay) * (3.0 + 0.05 / (z - 1.0))
    peak = float(data["sensitivity_peak"].max())
    assert peak == pytest.approx(np.max(np.abs(1.0 / (1.0 + open_loop))), rel=1e-4)


def test_first_gains_are_those_at_the_command_that_holds_the_start(cube):
    gains = first_gains(dj.Study.from_table(cube), "pid", 5.0)
    linear = {"kind": "state_space", "a": [[-12.0]], "b": [1.0], "c": [1.0]}
    expected = first_gains(dj.Study.from_table(cube | {"plant": linear, "requirement": []}), "pid", 5.0)
    assert gains.table == expected.table


def test_a_stored_result_keeps_the_units_of_a_plant_s_own_outputs(cube, tmp_path):
    dj.run(dj.Study.from_table(cube), tmp_path / "done")
    sys.modules.pop("own_cube")
    loaded = dj.load(tmp_path / "done")
    assert isinstance(loaded.study, Described)
    assert loaded.dataset["max_abs_force"].attrs["units"] == "N"


def documented(name):
    """The file of this name that the page on parts of one's own gives."""
    page = (Path(__file__).parents[1] / "docs" / "extending.md").read_text()
    return next(text for _, text in BLOCK.findall(page) if text.startswith(f"# {name}\n"))


def shaft_rate(t, speed, current, load):
    return (0.1 * current - 1e-4 * speed * np.abs(speed) - load) / 0.02


def test_a_documented_plant_has_a_disturbance_at_an_input_that_it_names(tmp_path, monkeypatch):
    """A PI loop of the page's shaft, integrated by SciPy from sample to sample, with the load torque from 2 s on."""
    (tmp_path / "shaft.py").write_text(documented("shaft.py"))
    (tmp_path / "shaft.toml").write_text(documented("shaft.toml"))
    monkeypatch.syspath_prepend(tmp_path)
    numbers = {"plant.drag": 1e-4, "disturbance.0.value": 0.8, "sensor": {"measures": ["y_dot"]}, "draws": 1}
    try:
        study = dj.Study.load(tmp_path / "shaft.toml").override(numbers)
        assert study.loop.input_names == ("load",)
        flight = dj.simulate(study)
    finally:
        sys.modules.pop("shaft", None)
    speed = integral = 0.0
    speeds = []
    for k in range(400):
        speeds.append(speed)
        error = speed - 20.0
        current = integral - error
        integral -= 0.01 * 2.0 * error
        load = 0.8 if k >= 200 else 0.0
        speed = solve_ivp(shaft_rate, (0.0, 0.01), [speed], args=(current, load), rtol=1e-10, atol=1e-10).y[0, -1]
    np.testing.assert_allclose(flight["y"].squeeze(), speeds, atol=1e-6)
