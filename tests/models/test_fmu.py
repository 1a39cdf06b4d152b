"""FMUs as plant and controller: the loop of the package's own models, for every draw; refusals by name."""

import ctypes
import json
import struct
import sys
from dataclasses import replace

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.fmu_library import built_library
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native import fmu_instances
from dssc_jax.core.native.allowed import LOADED
from dssc_jax.core.native.fmu_instances import FmuPorts, Instances, require_no_faults
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.batching import Engine, drawn, evaluate
from dssc_jax.engine.evaluation import GradientEvaluator
from dssc_jax.flight_code.folder import FlightFolder
from tests import fmus
from tests.flight_code.compiling import require
from tests.mutations import document

fmpy = pytest.importorskip("fmpy")

DRAWS = 24
EQUAL = 1e-12
"""Relative difference of a loop with an FMU from that without: a few roundings, for products are contracted or not."""

NAMES = {
    "plant.parameters.body_gain": "plant.k_p",
    "plant.parameters.drag": "plant.a_p",
    "plant.parameters.x0": "plant.initial.0",
    "controller.parameters.k_p": "controller.k_p",
}
LAWS = {"gain": {"uniform": [0.8, 1.2]}, "drag": {"uniform": [0.5, 1.5]}, "x0": {"uniform": [0.5, 1.0]}}
K_P = {"uniform": [4.0, 8.0]}
OWN_PLANT = {"kind": "normal_form", "k_p": LAWS["gain"], "a_p": LAWS["drag"], "initial": [LAWS["x0"], 0.0]}
OWN_PID = {"kind": "pid", "k_p": K_P, "k_i": 2.0, "k_d": 3.0, "filter": 0.02}
METRICS = ("error_rms", "error_max", "command_max", "command_tv")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    require("cc")
    return tmp_path_factory.mktemp("fmus")


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def version(request):
    return request.param


def plant_of(mass, **changes):
    parameters = {"body_gain": LAWS["gain"], "drag": LAWS["drag"], "x0": LAWS["x0"]}
    table = {"kind": "fmu", "file": str(mass), "command": "u", "y": "x", "y_dot": "v", "outputs": {"power": "power"}}
    return {**table, "sha256": dj.allow_native(mass).sha256, "parameters": parameters, **changes}


def controller_of(pid, **changes):
    parameters = {"k_p": K_P, "k_i": 2.0, "k_d": 3.0, "filter": 0.02}
    table = {"kind": "fmu", "file": str(pid), "command": "command", "inputs": {"y": "y", "y_ref": "r"}}
    return {**table, "sha256": dj.allow_native(pid).sha256, "parameters": parameters, **changes}


def loop_of(plant, controller, **changes):
    table = {
        "name": "fmu",
        "seed": 3,
        "draws": DRAWS,
        "loop": {"duration": 3.0, "sample_time": 0.01},
        "plant": plant,
        "controller": controller,
        "reference": {"kind": "sine", "amplitude": 1.0, "period": 4.0},
        "disturbance": {"kind": "step", "value": 0.5, "at": 2.0},
        "metrics": {"names": list(METRICS)},
        "requirement": [{"metric": "error_rms", "after": 1.0, "max": 0.55}],
    }
    return dj.Study.from_table({**table, **changes})


@pytest.fixture(scope="module")
def mass(place):
    return fmus.built(place, fmus.MASS)


@pytest.fixture(scope="module")
def pid(place):
    return fmus.built(place, fmus.PID)


@pytest.fixture(scope="module")
def study(mass, pid):
    """Both parts in FMUs."""
    return loop_of(plant_of(mass), controller_of(pid, outputs={"integral": "integral"}))


@pytest.fixture(scope="module")
def values(study):
    return drawn(study, slice(0, DRAWS))


def results(study, values, order=None, lanes=DRAWS, **options):
    """Metrics and outcome of each draw, computed in some order."""
    order = np.arange(DRAWS) if order is None else order
    engine = Engine(study, lanes, **options)
    found = evaluate(engine, {name: column[order] for name, column in values.items()}, order)
    back = np.argsort(order)
    return {name: column[back] for name, column in found.items()}


def own_results(plant, controller, values, **changes):
    """The same draws with the package's own models."""
    study = loop_of(plant, controller, **changes)
    return results(study, {NAMES[name]: column for name, column in values.items() if NAMES[name] in study.laws})


def assert_same(found, expected):
    for name in METRICS:
        np.testing.assert_allclose(found[name], expected[name], rtol=EQUAL)
    assert np.array_equal(found["outcome"], expected["outcome"])


def assert_same_verdicts(found, expected):
    assert_same(found, expected)
    assert len(set(found["outcome"].tolist())) > 1  # some draws fail, others do not


# The same numbers


def test_a_loop_of_fmus_is_that_of_the_own_models(place, version):
    source = {"version": version}
    file = fmus.built(place, fmus.renamed(fmus.MASS, "mass" + version[0], **source))
    controller = fmus.built(place, fmus.renamed(fmus.PID, "pid" + version[0], **source))
    study = loop_of(plant_of(file), controller_of(controller))
    found = drawn(study, slice(0, DRAWS))
    assert_same_verdicts(results(study, found), own_results(OWN_PLANT, OWN_PID, found))


@pytest.mark.parametrize("part", ["plant", "controller"])
def test_each_part_alone(part, study, mass, pid, values):
    plant = plant_of(mass) if part == "plant" else OWN_PLANT
    controller = controller_of(pid) if part == "controller" else OWN_PID
    mixed = loop_of(plant, controller)
    named = {name if name in mixed.laws else NAMES[name]: column for name, column in values.items()}
    assert_same(results(mixed, named), own_results(OWN_PLANT, OWN_PID, values))


def test_neither_order_nor_blocks_nor_threads_matter(study, values):
    expected = results(study, values, devices=1)
    mixed = np.random.default_rng(1).permutation(DRAWS)
    for found in (results(study, values, mixed, lanes=5, devices=2), results(study, values, lanes=7)):
        for name, column in expected.items():
            assert np.array_equal(found[name], column, equal_nan=True), name


def test_plain_xla_and_the_stored_run_agree(study, tmp_path, monkeypatch):
    ours = dj.run(study, tmp_path / "lanes")
    monkeypatch.setenv("DSSC_JAX_KERNEL", "scan")
    theirs = dj.run(study, tmp_path / "scan")
    for name in METRICS:
        np.testing.assert_allclose(ours.dataset[name], theirs.dataset[name], rtol=EQUAL)
    assert dj.verify(ours).verdict == "agrees"
    assert dj.replay(ours, 3).attrs["agreement"] == "agrees"


def test_draws_without_any_law_have_instances_of_their_own(mass, pid):
    """Nothing differs between the draws but the noise; a shared instance would mix them."""
    plant = plant_of(mass, parameters={"x0": 0.5, "drag": 1.0, "body_gain": 1.0})
    controller = controller_of(pid, parameters={"k_p": 5.0, "k_i": 2.0, "k_d": 3.0, "filter": 0.02})
    noise = {"kind": "noisy", "position_std": 0.01}
    study = loop_of(plant, controller, sensor=noise)
    own = loop_of({**OWN_PLANT, "k_p": 1.0, "a_p": 1.0, "initial": [0.5, 0.0]}, {**OWN_PID, "k_p": 5.0}, sensor=noise)
    found = results(study, {})
    expected = results(own, {})
    assert len(np.unique(found["error_rms"])) == DRAWS
    for name in METRICS:
        np.testing.assert_allclose(found[name], expected[name], rtol=EQUAL)
    plain = results(study, {}, kernel="scan")
    np.testing.assert_allclose(plain["error_rms"], found["error_rms"], rtol=EQUAL)


def test_a_generated_controller_flies_as_an_fmu(place):
    """The FMU that this package writes is the controller again, with the gains of each draw."""
    gains = {"kind": "pid", "k_p": K_P, "k_i": 2.0, "k_d": 3.0, "filter": 0.02, "low": -4.0, "high": 4.0}
    original = loop_of(OWN_PLANT, gains)
    unit = FlightFolder(original).fmu()
    library, reason = built_library(unit)
    if library is None:
        pytest.skip(f"no library: {reason}")
    file = place / "generated.fmu"
    file.write_bytes(unit.archive(library))
    inputs = {"y": "measurement.y", "y_dot": "measurement.y_dot", "y_ref": "reference.y"}
    inputs |= {"y_ref_dot": "reference.y_dot", "y_ref_ddot": "reference.y_ddot"}
    table = {"kind": "fmu", "file": str(file), "sha256": dj.allow_native(file).sha256, "inputs": inputs}
    study = loop_of(OWN_PLANT, {**table, "command": "command.u_p", "parameters": {"controller_k_p": K_P}})
    numbers = drawn(original, slice(0, DRAWS))
    expected = results(original, numbers)
    moved = {name.replace("controller.k_p", "controller.parameters.controller_k_p"): x for name, x in numbers.items()}
    assert_same(results(study, moved), expected)
    assert expected["command_max"].max() == 4.0  # at its limit


# Other programs


def test_fmpy_simulates_the_same_flight(study, mass):
    """FMPy's own master, driven by the commands of a trajectory."""
    flight = dj.simulate(study, draw=2)
    start = {"body.gain": "body_gain", "drag": "drag", "x0": "x0"}
    start = {name: float(flight.attrs[f"plant.parameters.{number}"]) for name, number in start.items()}
    time = flight["t"].values
    disturbance = np.where(time >= 2.0 - 1e-9, 0.5, 0.0)
    columns = np.rec.fromarrays([time, flight["u_total"].values + disturbance], names=["time", "u"])
    found = fmpy.simulate_fmu(
        str(mass),
        start_values=start,
        input=columns,
        output=["x", "v"],
        output_interval=0.01,
        stop_time=float(time[-1]),
        use_event_mode=False,
    )
    np.testing.assert_allclose(found["x"], flight["y"].values, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found["v"], flight["y_dot"].values, rtol=1e-9, atol=1e-12)


def test_numpy_computes_the_same_flight(study):
    """A loop of its own: a matrix exponential by its series for the mass, and the PID's equations."""
    flight = dj.simulate(study, draw=5)
    number = {name.rpartition(".")[2]: flight.attrs[name] for name in study.laws}
    k_p, drag, gain = number["k_p"], number["drag"], number["body_gain"]
    system = np.array([[0.0, 1.0, 0.0], [0.0, -drag, gain], [0.0, 0.0, 0.0]]) * 0.01
    held, term = np.eye(3), np.eye(3)
    for order in range(1, 20):
        term = term @ system / order
        held = held + term
    x, sums, slope, last = np.array([number["x0"], 0.0]), 0.0, 0.0, -number["x0"]
    for k, t in enumerate(flight["t"].values):
        error = np.sin(2.0 * np.pi * t / 4.0) - x[0]
        slope = (0.02 * slope + 3.0 * (-x[0] - last)) / 0.03
        last = -x[0]
        u = k_p * error + sums + slope
        assert flight["u"][k] == pytest.approx(u, rel=1e-9, abs=1e-10)
        assert flight["integral"][k] == pytest.approx(sums, rel=1e-9, abs=1e-10)
        sums += 0.01 * 2.0 * error
        x = (held @ np.array([*x, u + (0.5 if k >= 200 else 0.0)]))[:2]


def test_units_and_meanings_are_those_of_the_fmu(study):
    flight = dj.simulate(study, draw=0)
    assert flight["y"].attrs["units"] == "m"
    assert flight["u"].attrs["units"] == "N"
    assert flight["power"].attrs["long_name"] == "power"
    assert study.quantities["plant.parameters.drag"].interval == ">= 0.01"
    assert np.ptp(flight["power"].values) > 0.0


# Steps of other lengths


def test_substeps_and_a_lag(mass):
    """The mean of a lag over each step reaches the FMU; more steps come nearer to the exact solution."""
    lag = {"kind": "lag", "mu": 0.05}
    pid = {**OWN_PID, "k_p": 5.0, "k_d": 2.0}
    plain = {"reference": {"kind": "zero"}, "disturbance": {"kind": "none"}, "unmodelled": lag}
    exact = dj.simulate(loop_of({**OWN_PLANT, "k_p": 1.0, "a_p": 1.0, "initial": [0.5, 0.0]}, pid, **plain))["y"].values
    gaps = []
    for substeps in (1, 2, 4):
        plant = plant_of(mass, parameters={"x0": 0.5, "body_gain": 1.0, "drag": 1.0})
        loop = {"duration": 3.0, "sample_time": 0.01, "substeps": substeps}
        gaps.append(np.max(np.abs(dj.simulate(loop_of(plant, pid, **plain, loop=loop))["y"].values - exact)))
    assert gaps[0] < 1e-4
    assert gaps[1] < 0.3 * gaps[0]  # of second order
    assert gaps[2] < 0.3 * gaps[1]
    assert not dj.integration_error(loop_of(plant, pid, **plain)).exact
    constant = {"disturbance": {"kind": "constant", "value": 0.1}, "reference": {"kind": "zero"}}
    assert dj.integration_error(loop_of(plant, pid, **constant)).exact


def test_without_a_rate_the_difference_quotient_is_taken(mass):
    table = plant_of(mass)
    del table["y_dot"]
    flight = dj.simulate(loop_of(table, OWN_PID), draw=1)
    y, y_dot = flight["y"].values, flight["y_dot"].values
    np.testing.assert_allclose(y_dot[1:], np.diff(y) / 0.01, rtol=1e-9, atol=1e-12)
    assert y_dot[0] == 0.0


def test_disturbances_have_inputs_of_their_own(mass, values):
    """At the FMU's own input d the disturbance acts as if it were added to the command; so does a named input."""
    expected = own_results(OWN_PLANT, OWN_PID, values)
    named = {name if name.startswith("plant") else NAMES[name]: column for name, column in values.items()}
    beside = loop_of(plant_of(mass, disturbance="d"), OWN_PID)
    assert_same(results(beside, named), expected)
    step = {"kind": "step", "value": 0.5, "at": 2.0, "input": "gust"}
    gust = loop_of(plant_of(mass, inputs={"gust": "d"}), OWN_PID, disturbance=[step])
    assert_same(results(gust, named), expected)


# Failures


def test_a_step_that_fails_ends_its_draw_alone(mass, tmp_path):
    plant = plant_of(mass)
    plant["parameters"]["fails_at"] = {"choice": [0.0, 1.5]}
    study = loop_of(plant, OWN_PID)
    result = dj.run(study, tmp_path / "fails")
    failing = result.dataset["plant.parameters.fails_at"].values > 0.0
    assert 0 < failing.sum() < DRAWS
    outcome = result.dataset["outcome"].values
    assert np.all(outcome[failing] == Outcome.NON_FINITE)
    assert np.all(outcome[~failing] != Outcome.NON_FINITE)
    np.testing.assert_allclose(result.dataset["failed_at"].values[failing], 1.51)
    assert dj.verify(result).verdict == "agrees"  # by the plain program, in which ended draws stay where they are


def test_a_draw_that_cannot_start_has_diverged(place):
    start = "if (r[4] > 1.0) return 3; " + fmus.MASS.start
    file = fmus.built(place, fmus.renamed(fmus.MASS, "fussy", start=start))
    plant = plant_of(file, parameters={"drag": {"uniform": [0.5, 1.5]}})
    study = loop_of(plant, OWN_PID)
    numbers = drawn(study, slice(0, DRAWS))
    found = results(study, numbers)
    heavy = numbers["plant.parameters.drag"] > 1.0
    assert 0 < heavy.sum() < DRAWS
    assert np.array_equal(found["outcome"] == Outcome.NON_FINITE, heavy)


def test_an_unstable_loop_ends_as_one_that_diverges(mass, pid):
    """The FMU gets no input that is not finite, and is freed."""
    study = loop_of(plant_of(mass), controller_of(pid, parameters={"k_p": 1e7}))
    assert set(results(study, drawn(study, slice(0, DRAWS)))["outcome"].tolist()) == {Outcome.NON_FINITE}


def memory_of(head, numbers):
    """Memory of a call: two words, then real numbers."""
    return ctypes.create_string_buffer(struct.pack(f"=II{len(numbers)}d", *head, *numbers), 8 + 8 * len(numbers))


def test_steps_are_made_once_and_in_order(mass, monkeypatch):
    """A lane that asks otherwise gets NaN, and the run says so."""
    fmu = dj.allow_native(mass)
    instances = Instances(FmuPorts(fmu, (), (0,), (2, 3)))

    def step(handle, made):
        memory = memory_of((handle, made), [0.1, 1.0, 0.0, 0.0])
        instances.step(ctypes.addressof(memory))
        return struct.unpack("=II4d", memory.raw)

    def start():
        memory = memory_of((7, 3), [0.0, 0.0, 0.0])
        instances.start(ctypes.addressof(memory))
        return struct.unpack("=II", memory.raw[:8])

    (handle, made) = start()
    assert made == 0
    first = step(handle, 0)
    assert first[:2] == (handle, 1)
    assert first[4] == pytest.approx(np.exp(-0.1) - 0.9, rel=1e-12)
    assert np.isnan(step(handle, 0)[4])  # as of a draw that has ended
    require_no_faults()
    second = step(handle, 1)
    assert second[1] == 2
    assert np.isnan(step(handle, 0)[4])
    with pytest.raises(ConfigError, match="was asked for step 0 after 2; steps must be made in order"):
        require_no_faults()
    monkeypatch.setattr(fmu_instances, "MOST_INSTANCES", 1)
    start()
    assert np.isnan(step(handle, 2)[4])
    with pytest.raises(ConfigError, match="has more than 1 draws at once"):
        require_no_faults()


def test_instances_are_freed(mass, values):
    study = loop_of(plant_of(mass), OWN_PID)
    instances = fmu_instances.instances_of(study.loop.plant.begin.__self__.functions.ports)
    named = {name if name.startswith("plant") else NAMES[name]: column for name, column in values.items()}
    kept = []
    for _ in range(3):
        results(study, named, devices=1)
        kept.append(len(instances._running))
    assert kept[0] == kept[1] == kept[2]


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
        results(study.override({"loop.precision": 32}), drawn(study, slice(0, DRAWS)))


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
