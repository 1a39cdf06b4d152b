"""What of FMUs is refused, by name, and the consent before one runs."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.allowed import LOADED
from dssc_jax.engine.batching import values_of_draws
from dssc_jax.engine.evaluation import GradientEvaluator
from dssc_jax.flight_code.folder import FlightFolder
from tests import fmus
from tests.fmu_loops import (
    DRAWS,
    OWN_PID,
    OWN_PLANT,
    controller_of,
    loop_of,
    plant_of,
    results,
)
from tests.mutations import document

fmpy = pytest.importorskip("fmpy")

# Refusals


WRONG = {
    "version": ("must have FMI 2.0 or 3.0, it has 1.0", {"version": "1.0"}),
    "platform": (r"must have a library for linux64, it has win64", {"platform": "win64"}),
    "exchange": ("must be for co-simulation.*it is for model exchange only", {"interface": "ModelExchange"}),
    "once": ("says canBeInstantiatedOnlyOncePerProcess", {"attributes": 'canBeInstantiatedOnlyOncePerProcess="true"'}),
    "tool": ("needs the tool that made it", {"attributes": 'needsExecutionTool="true"'}),
    "static": (
        "keeps numbers outside of its instances",
        {"statics": "static double kept;", "step": "kept += h; r[2] = kept + r[0]; return 0;"},
    ),
    "start": ("cannot be started: fmi2ExitInitializationMode fails with status 3", {"start": "return 3;"}),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_fmu_is_refused(place, name):
    message, changes = WRONG[name]
    source = fmus.renamed(fmus.MASS, f"wrong_{name}", **changes)
    if name == "version":
        file = fmus.built(place, replace(source, version="2.0"), text=lambda text: text.replace('"2.0"', '"1.0"'))
    else:
        if name == "exchange":
            source = replace(source, attributes="")
        file = fmus.built(place, source)
    with pytest.raises(ConfigError, match=f"'.*wrong_{name}.fmu' {message}"):
        dj.allow_native(file)


def test_what_is_no_fmu_is_refused(place, mass):
    (place / "empty.fmu").write_bytes(b"PK\x03\x04nothing")
    with pytest.raises(ConfigError, match=r"'.*empty.fmu' is no FMU that can be read"):
        dj.allow_native(place / "empty.fmu")


PLANT_ERRORS = [
    ({"y": "z"}, r"plant.y: '.*mass.fmu' has no variable 'z'; did you mean 'x'|valid names are"),
    ({"y": "u"}, r"plant.y: 'u' must be an output, it has the causality input; the outputs of .* are power, v, x"),
    ({"command": "x"}, "plant.command: 'x' must be an input, it has the causality output"),
    ({"command": 3}, "plant.command: must be the name of a variable"),
    ({"disturbance": "u"}, "plant.disturbance: 'u' is already connected to command"),
    ({"outputs": {"p": "pover"}}, "plant.outputs.p: .* has no variable 'pover'; did you mean 'power'"),
    ({"outputs": "power"}, "plant.outputs: must be a table"),
    ({"parameters": {"drags": 1.0}}, "plant.parameters.drags: .* has no such parameter; did you mean 'drag'"),
    ({"parameters": {"u": 1.0}}, "plant.parameters.u: 'u' is connected to command already"),
    ({"parameters": {"x": 1.0}}, "plant.parameters.x: must be a parameter, an input or an exact initial value"),
    ({"parameters": {"drag": -1.0}}, r"plant.parameters.drag: .*must be >= 0.01, got -1"),
    ({"parameters": {"drag": "big"}}, "plant.parameters.drag: "),
    ({"colour": 1.0}, "plant.colour: unknown name"),
]


@pytest.mark.parametrize(("changes", "message"), PLANT_ERRORS)
def test_a_wrong_plant_is_refused(mass, changes, message):
    with pytest.raises(ConfigError, match=message):
        loop_of(plant_of(mass, **changes), OWN_PID)


CONTROLLER_ERRORS = [
    ({"inputs": {"y": "y", "reference": "r"}}, "controller.inputs.reference: is no signal of a controller"),
    ({"inputs": {}}, "controller.inputs: is required"),
    ({"command": "integral_part"}, "controller.command: .* has no variable 'integral_part'; did you mean 'integral'"),
]


@pytest.mark.parametrize(("changes", "message"), CONTROLLER_ERRORS)
def test_a_wrong_controller_is_refused(pid, changes, message):
    with pytest.raises(ConfigError, match=message):
        loop_of(OWN_PLANT, controller_of(pid, **changes))


def test_a_variable_that_is_no_real_number_is_refused(place):
    variables = (*fmus.MASS.variables, fmus.Variable("mode", "parameter", 0.0, kind="Integer"))
    file = fmus.built(place, fmus.renamed(fmus.MASS, "mode", variables=variables))
    with pytest.raises(
        ConfigError, match=r"parameters.mode: 'mode' of '.*' is of type Integer; must be one real number"
    ):
        loop_of(plant_of(file, parameters={"mode": 1.0}), OWN_PID)


def test_a_quoted_name_is_told_its_form(mass):
    with pytest.raises(ConfigError, match=r"must be written body_gain for the FMU's variable 'body.gain'"):
        loop_of(plant_of(mass, parameters={"body.gain": 1.0}), OWN_PID)


def test_what_needs_more_than_steps_is_refused_by_name(study, mass):
    for function in (dj.lane, dj.stepper):
        with pytest.raises(ConfigError, match=r"plant: keeps its state outside of JAX .*`run` or `simulate`"):
            function(study)
    with pytest.raises(ConfigError, match="is an FMU, which has no derivative"):
        dj.loop_margins(study)
    with pytest.raises(ConfigError, match="is native code already"):
        FlightFolder(study)
    steep = GradientEvaluator(study, {}, 8, names=["controller.parameters.k_p"])
    with pytest.raises(ConfigError, match=r"plant: is native code .* no derivative passes"):
        steep(np.zeros(1, int), {name: np.ones(1) for name in study.laws})
    with pytest.raises(ConfigError, match=r"loop.precision: must be 64, the precision of FMUs"):
        results(study.override({"loop.precision": 32}), values_of_draws(study, slice(0, DRAWS)))


def test_searches_do_without_derivatives(study):
    assert dj.falsify(study, budget=48).simulations >= 32
    tune = {"objective": {"error_rms": 1.0}, "draws": 4, "validation": 4, "steps": 2}
    ranges = {"controller.parameters.k_i": [0.5, 4.0]}
    tuned = dj.tune(dj.Study.from_table({**study.table, "tune": {**tune, "parameters": ranges}}))
    assert tuned.facts.method == "differential_evolution"


def test_without_fmpy(mass, monkeypatch):
    digest = dj.allow_native(mass).sha256
    monkeypatch.delitem(LOADED, digest)
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(ConfigError, match=r"an FMU needs FMPy: pip install 'dssc_jax\[fmu\]'"):
        dj.allow_native(mass)


# Consent


def test_nothing_is_loaded_without_consent(place, mass, pid, monkeypatch, capsys):
    monkeypatch.chdir(place)
    plant, controller = plant_of(mass, file="mass.fmu"), controller_of(pid, file="pid.fmu")
    digests = [plant.pop("sha256"), controller.pop("sha256")]
    table = {**loop_of(plant_of(mass), controller_of(pid)).table, "plant": plant, "controller": controller}
    (place / "gated.toml").write_bytes(document(table))
    for digest in digests:
        monkeypatch.delitem(LOADED, digest)
    assert guarded(["run", "gated.toml"]) == 2
    assert "'mass.fmu' is native code that was not loaded (SHA-256 " in capsys.readouterr().err
    assert guarded(["run", "gated.toml", "--allow-native", "--out", "gated", "--json"]) == 0
    told = capsys.readouterr().err
    for name, digest in zip(("mass.fmu", "pid.fmu"), digests, strict=True):
        assert f"this study runs native code {name}, SHA-256 {digest}" in told
    code = json.loads((place / "gated" / "manifest.json").read_text())["code"]
    assert code["mass.fmu"] == {"file": str(mass), "sha256": digests[0]}
    for digest in digests:
        monkeypatch.delitem(LOADED, digest)
    stored = dj.load("gated")
    assert "plant.parameters.drag" in stored.study.numbers
    assert guarded(["replay", "gated", "--draw", "1"]) == 2
    assert guarded(["replay", "gated", "--draw", "1", "--allow-native"]) == 0


def test_kinds_are_not_mixed_up(mass, study):
    table = {"kind": "library", "file": str(mass), "sha256": dj.allow_native(mass).sha256}
    with pytest.raises(ConfigError, match='is an FMU; set kind = "fmu"'):
        loop_of(OWN_PLANT, table)
    assert guarded(["library", str(mass).replace(".fmu", ".so")]) == 2
