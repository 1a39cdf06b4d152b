"""Study files: every kind of bad input is one line with file, path, rule and value."""

import copy
import textwrap
from pathlib import Path

import numpy as np
import pytest
from jax.tree_util import keystr, tree_flatten_with_path

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.study.laws import Law
from dssc_jax.study.library import available_studies, find_study
from dssc_jax.study.tables import set_dotted
from tests.conftest import CASE_2, UNCERTAIN

NORM_BOUND = {
    "kind": "norm_bound",
    "k_p_max": 1.2,
    "a_p_max": 1.0,
    "delta_rho": 0.1,
    "zero_dynamics": {"a": [1.0], "c": [0.2]},
}
BAD = {
    "window without a sample": (
        {"requirement": [{"metric": "error_max", "after": 79.999, "max": 1.0}]},
        "requirement.0.after: must be <= the time of the last sample 79.995 s, got 79.999",
    ),
    "duration that is no whole number of samples": ({"loop.sample_time": 0.3}, "loop: duration must be a whole number"),
    "bounded twice on one side": (
        {"requirement": [{"metric": "error_max", "max": 1.0}, {"metric": "error_max", "max": 2.0}]},
        "requirement.1: 'error_max' is bounded on this side already",
    ),
    "swept out of the Hurwitz region": (
        {"plant.zero_dynamics": {"a": [1.0], "c": [0.2]}, "sweep.plant.zero_dynamics.a.0": [1.0, -4.0]},
        "sweep: plant.zero_dynamics.a: A_eta must be Hurwitz",
    ),
    "sweep of what is used up before tracing": (
        {"controller.rho": NORM_BOUND, "sweep.controller.rho.zero_dynamics.c.0": [0.1, 0.2]},
        "the norm observer is designed from plain numbers",
    ),
    "too many lanes": ({"draws": 10**7, "sweep.plant.k_p": {"linspace": [1, 2, 1000]}}, "draws times sweep points"),
    "too long an integer": ({"plant.k_p": 10**400}, "plant.k_p: must be a finite number"),
    "what is no plant": ({"plant.kind": "math:pi"}, "'math:pi' must be a Plant, got float"),
    "wind without wings": (
        {"wind": {"kind": "constant", "x": 1.0, "y": 0.0, "z": 0.0}},
        "wind.kind: the plant 'normal_form' does not fly",
    ),
    "half a sample of delay": (
        {"sensor": {"kind": "noisy", "delay_samples": 0.5}},
        "sensor.delay_samples: must be a whole number",
    ),
    "misspelt top-level name": ({"drawz": 3}, r"drawz: unknown name; did you mean 'draws'\?"),
    "misspelt field": ({"plant.kp": 1.0}, r"plant.kp: unknown name; did you mean 'k_p'\?"),
    "misspelt nested field": (
        {"controller.functions.tau_aw": 1.0},
        r"functions.tau_aw: unknown name; did you mean 'tau_av'",
    ),
    "misspelt kind": ({"controller.kind": "dscc"}, r"controller.kind: unknown kind 'dscc'; did you mean 'dssc'"),
    "misspelt functions": ({"controller.functions.kind": "square_rot"}, "did you mean 'square_root'"),
    "misspelt option": ({"controller.discretisation": "implicid"}, "did you mean 'implicit'"),
    "option of another controller": (
        {"controller.discretisation": "proper"},
        "must be one of implicit, conservative, explicit",
    ),
    "misspelt loop field": ({"loop.substep": 2}, "loop.substep: unknown name; did you mean 'substeps'"),
    "wrong type": ({"draws": "many"}, "draws: .*got 'many'"),
    "float where an integer belongs": ({"draws": 2.5}, "draws: .*got 2.5"),
    "bool where a number belongs": ({"plant.k_p": True}, "plant.k_p: must be a finite number"),
    "string where a number belongs": ({"plant.k_p": "big"}, "plant.k_p: must be a finite number"),
    "nan": ({"plant.k_p": float("nan")}, "plant.k_p: must be a finite number"),
    "number where a table belongs": ({"plant": 3}, "plant: .*dictionary"),
    "negative time constant": ({"controller.functions.tau_av": -0.1}, r"tau_av: .*must be > 0, got -0.1"),
    "zero time constant": ({"controller.functions.tau_av": 0.0}, r"tau_av: .*must be > 0, got 0.0"),
    "negative input gain": ({"plant.k_p": -1.0}, r"plant.k_p: high-frequency gain k_p \[y/\(s\^2 u\)\] must be > 0"),
    "negative rho": ({"controller.rho": -1.0}, r"controller.rho.rho: .*must be > 0"),
    "sample time above duration": (
        {"loop.sample_time": 100.0},
        "loop: sample_time must be <= duration = 80 s, got 100",
    ),
    "no sample time": ({"loop.sample_time": 0.0}, "loop.sample_time: .*greater than 0"),
    "no draws": ({"draws": 0}, "draws: .*greater than or equal to 1, got 0"),
    "no substeps": ({"loop.substeps": 0}, "loop.substeps: .*got 0"),
    "unknown integrator": ({"loop.integrator": "rk5"}, "loop.integrator: 'rk5' is none of"),
    "unknown precision": ({"loop.precision": 16}, "loop.precision: '16' is none of"),
    "unknown sampling": ({"sampling": "halton"}, "sampling: 'halton' is none of"),
    "law upside down": ({"plant.k_p": {"uniform": [1.2, 0.8]}}, "plant.k_p: uniform .*lo must be below hi"),
    "law beyond the interval": ({"plant.k_p": {"uniform": [-0.2, 0.8]}}, "must be > 0, got uniform"),
    "unbounded law of a positive number": ({"plant.k_p": {"normal": [1, 0.1]}}, r"support is \[-inf, inf\]"),
    "unknown law": ({"plant.k_p": {"uniformly": [1, 2]}}, "'uniformly' is not a law; did you mean 'uniform'"),
    "not Hurwitz": ({"plant.zero_dynamics": {"a": [-1.0], "c": [0.2]}}, "zero_dynamics.a: A_eta must be Hurwitz"),
    "Hurwitz for some draws only": (
        {"plant.zero_dynamics": {"a": [{"uniform": [-0.1, 1.0]}], "c": [0.2]}},
        "plant.zero_dynamics.a: A_eta must be Hurwitz",
    ),
    "lengths of the zero dynamics": ({"plant.zero_dynamics": {"a": [1.0], "c": [1.0, 2.0]}}, "same length"),
    "initial state too long": ({"plant.initial": [1.0, 2.0, 3.0]}, "plant.initial: needs x1, x2"),
    "initial state too short": ({"plant.initial": [1.0]}, "plant.initial: needs x1, x2"),
    "both k_o and tau_av": (
        {"controller.functions": {"kind": "sta", "kappa1": 1.0, "kappa2": 1.0, "k_o": 1.0, "tau_av": 1.0}},
        "controller.functions: give one of k_o and tau_av.*got both",
    ),
    "neither k_o nor tau_av": (
        {"controller.functions": {"kind": "sta", "kappa1": 1.0, "kappa2": 1.0}},
        "got neither",
    ),
    "ssc with varying functions": ({"controller.kind": "ssc"}, "controller.functions.kind: ssc has constant functions"),
    "missing gain": ({"controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0}}, "controller.k_i: is required and missing"),
    "missing slot": ({"controller": {"kind": "dssc", "l0": 1.0, "rho": 1.0}}, "controller.functions: is required"),
    "missing kind": ({"plant": {"k_p": 1.0}}, "plant.kind: is required and missing; valid names are .*normal_form"),
    "unknown metric": (
        {"requirement": [{"metric": "eror_rms", "max": 1.0}]},
        "unknown metric 'eror_rms'; did you mean 'error_rms'",
    ),
    "metric that the controller lacks": (
        {
            "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 1.0},
            "requirement": [{"metric": "sampling_ratio", "max": 1.0}],
        },
        "'sampling_ratio' needs integral_gain, tau_m, which this loop does not have",
    ),
    "nothing measured": (
        {"metrics.names": [], "requirement": []},
        "names none, and nothing is required",
    ),
    "requirement without bound": (
        {"requirement": [{"metric": "error_rms"}]},
        "requirement.0: needs exactly one of max",
    ),
    "requirement after the end": (
        {"requirement": [{"metric": "error_rms", "after": 80.0, "max": 1.0}]},
        "requirement.0.after: must be <= the time of the last sample",
    ),
    "requirement that ends later than the flight": (
        {"requirement": [{"metric": "error_rms", "until": 80.001, "max": 1.0}]},
        "requirement.0.until: must be <= the duration 80 s, got 80.001; leave it out for a window up to the end",
    ),
    "metrics that end later than the flight": ({"metrics.until": 90.0}, "metrics.until: must be <= the duration 80 s"),
    "metrics after the end": ({"metrics.after": 90.0}, "metrics.after: must be <= the time of the last sample"),
    "number of a part that has none": (
        {"unmodelled": {"kind": "none"}, "sweep.unmodelled.mu": [0.1]},
        "the study's unmodelled is of the kind 'none', which has no numbers; for 'lag' set unmodelled.kind = 'lag'",
    ),
    "one requirement as a table": (
        {"requirement": {"metric": "error_rms", "max": 1.0}},
        r"requirement: is a list of tables: write \[\[requirement\]\] instead of \[requirement\]",
    ),
    "unknown swept parameter": (
        {"sweep.plant.kp": [1.0]},
        r"sweep.plant.kp: unknown parameter; did you mean 'plant.k_p'",
    ),
    "swept value out of range": ({"sweep.plant.k_p": [1.0, -1.0]}, "sweep.plant.k_p: .*must be > 0, got -1.0"),
    "swept clock": ({"sweep.loop.sample_time": [0.1]}, "sweep.loop.sample_time: the clock is fixed"),
    "axis upside down": ({"sweep.plant.k_p": {"linspace": [2, 1, 5]}}, "sweep.plant.k_p: linspace needs lo < hi"),
    "log axis through zero": ({"sweep.plant.k_p": {"logspace": [0, 1, 5]}}, "logspace needs 0 < lo"),
    "axis of one value with two ends": (
        {"sweep.plant.k_p": {"logspace": [1, 2, 1]}},
        r"sweep.plant.k_p: logspace with count = 1 needs lo = hi, or a count of 2 or more",
    ),
    "axis without count": ({"sweep.plant.k_p": {"linspace": [1, 2]}}, "linspace takes"),
    "misspelt spacing": ({"sweep.plant.k_p": {"linspce": [1, 2, 3]}}, "did you mean 'linspace'"),
    "empty axis": ({"sweep.plant.k_p": []}, "list of finite numbers"),
    "unknown plotted metric": ({"plot.metric": "error_rmz"}, "plot.metric: unknown metric 'error_rmz'; did you mean"),
    "name that is a path": ({"name": "../x"}, "name: .*got '../x'"),
    "module that is not there": ({"plant.kind": "no_such_module:PLANT"}, "plant.kind: cannot import"),
    "order of the lag": (
        {"unmodelled": {"kind": "lag", "order": 3, "mu": 0.1}},
        "unmodelled.order: must be one of 1, 2, got 3",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case):
    changes, message = BAD[case]
    table = copy.deepcopy(CASE_2)
    for name, value in changes.items():
        set_dotted(table, name, value)
    with pytest.raises(ConfigError, match=message) as caught:
        dj.Study.from_table(table, "file.toml")
    text = str(caught.value)
    assert text.startswith("file.toml: ")
    assert "\n" not in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"name = ", "is not valid TOML"),
        (b"\xff\xfe\x00", "is not UTF-8"),
        (b"x = " + b"[" * 100_000, "is nested too deeply"),
        (b"", "name: is required and missing"),
    ],
    ids=["broken", "encoding", "nesting", "empty"],
)
def test_bad_files(tmp_path, text, message):
    path = tmp_path / "study.toml"
    path.write_bytes(text)
    with pytest.raises(ConfigError, match=message) as caught:
        dj.Study.load(path)
    assert str(path) in str(caught.value)


def test_absent_file(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        dj.Study.load(tmp_path / "none.toml")


def test_a_window_may_end_with_the_flight(case_2):
    window = {"metric": "error_rms", "until": case_2.loop.steps * case_2.loop.sample_time, "max": 1.0}
    (required,) = case_2.override({"requirement": [window], "envelope": []}).requirements
    assert required.measure.window.until == pytest.approx(80.0)


def test_override_leads_nowhere(case_2):
    with pytest.raises(ConfigError, match="leads nowhere"):
        case_2.override({"draws.deep.er": 1.0})


def test_override_changes_the_hash_and_leaves_the_study(case_2):
    other = case_2.override({"controller.functions.tau_av": 0.05, "plant.initial.0": 1.0})
    assert other.hash != case_2.hash
    assert case_2.table == CASE_2
    assert other.leaves()["controller.functions.tau_av"] == 0.05
    assert other.leaves()["plant.initial.0"] == 1.0


def test_laws_and_axes(uncertain):
    assert set(uncertain.laws) == {
        "plant.k_p",
        "plant.a_p",
        "plant.zero_dynamics.a.1",
        "controller.rho",
        "unmodelled.mu",
    }
    assert uncertain.axes["controller.functions.tau_av"] == (0.02, 0.05, 0.1)
    swept = uncertain.override({"sweep": {"unmodelled.mu": {"logspace": [1e-3, 1e-1, 3]}}})
    assert "unmodelled.mu" not in swept.laws
    np.testing.assert_allclose(swept.axes["unmodelled.mu"], [1e-3, 1e-2, 1e-1])


def test_sweep_by_the_short_name_of_rho(case_2):
    result = dj.run(case_2.override({"sweep": {"controller.rho": [0.5, 1.5]}, "loop.duration": 50.0}))
    assert result.dataset["command_max"].values[0, 0] == pytest.approx(0.5)


def test_table_1_parameters_survive_the_file(tmp_path):
    """Every shipped study loads."""
    assert {"mu_robustness", "residual_scaling"} <= set(available_studies())
    for path in available_studies().values():
        dj.Study.load(path)


def test_every_number_lies_at_its_paths_in_the_template():
    """A law or a swept value at a path that does not exist would have no effect."""
    for path in available_studies().values():
        study = dj.Study.load(path)
        leaves = {keystr(place, simple=True, separator=".") for place, _ in tree_flatten_with_path(study.template)[0]}
        for number in study.numbers.values():
            if number.quantity.law:
                assert set(number.paths) <= leaves, (path.stem, number.name)


OWN = """
from typing import Annotated, NamedTuple
import jax.numpy as jnp
from dssc_jax.core.signals import Command, Measurement
from dssc_jax.core.contracts import Controller, Plant
from dssc_jax.core.quantities import Quantity

class Gains(NamedTuple):
    l0: Annotated[float, Quantity("1/s", "error pole", above=0.0)]
    k: Annotated[float, Quantity("1/s", "gain", above=0.0)]

class Info(NamedTuple):
    force: float

def step(gains, state, measurement, reference, dt):
    u = -gains.k * (measurement.y - reference.y) - gains.l0 * measurement.y_dot
    return state, Command(u, 0.0), Info(u)

CONTROLLER = Controller(Gains, lambda gains, measurement, reference: (), step)

class Pendulum(NamedTuple):
    k_p: Annotated[float, Quantity("1/s", "gain", above=0.0)] = 1.0

class State(NamedTuple):
    angle: float
    rate: float

def derivative(params, state, drive, t):
    push = params.k_p * (drive.command + drive.disturbance)
    return State(state.rate, push - jnp.sin(state.angle))

PLANT = Plant(
    Pendulum,
    init=lambda params: State(0.5, 0.0),
    derivative=derivative,
    measure=lambda params, s, drive: Measurement(s.angle, s.rate),
    input_gain=lambda params: params.k_p,
    velocities=("rate",),
)
"""


def test_a_plant_that_measures_without_its_input_is_refused(tmp_path, monkeypatch):
    """As plants of an earlier version did: in one line, before anything is traced."""
    (tmp_path / "old_models.py").write_text(
        textwrap.dedent(OWN).replace("lambda params, s, drive:", "lambda params, s:")
    )
    monkeypatch.syspath_prepend(tmp_path)
    table = {
        "name": "own",
        "loop": {"duration": 1.0, "sample_time": 0.01},
        "plant": {"kind": "old_models:PLANT"},
        "controller": {"kind": "pi", "l0": 2.0, "k_p": 3.0, "k_i": 0.0},
    }
    with pytest.raises(ConfigError, match=r"measure must take three arguments, \(params, state, input\)"):
        dj.Study.from_table(table)


def test_own_plant_and_controller_by_dotted_name(tmp_path, monkeypatch):
    (tmp_path / "my_models.py").write_text(textwrap.dedent(OWN))
    monkeypatch.syspath_prepend(tmp_path)
    table = {
        "name": "own",
        "draws": 16,
        "loop": {"duration": 20.0, "sample_time": 0.01, "integrator": "euler"},
        "plant": {"kind": "my_models:PLANT", "k_p": {"uniform": [0.5, 2.0]}},
        "controller": {"kind": "my_models:CONTROLLER", "l0": 2.0, "k": 3.0},
        "requirement": [{"metric": "error_max", "after": 15.0, "max": 1e-3}],
        "sweep": {"controller.k": [0.5, 3.0]},
    }
    result = dj.run(dj.Study.from_table(table))
    assert result.summary()["points"][1]["failures"] == 0
    assert "force" in dj.simulate(dj.Study.from_table(table), 3)
    with pytest.raises(ConfigError, match=r"gain .*must be > 0"):
        dj.Study.from_table(table | {"controller": {"kind": "my_models:CONTROLLER", "l0": 2.0, "k": -3.0}})


def test_a_number_that_channels_share_is_one_number_with_a_place_in_each():
    study = dj.Study.load(find_study("uav_robustness")).override(
        {"controller.x.l0": 2.5}
    )  # the study itself has z and psi
    everywhere, own = study.numbers["controller.l0"], study.numbers["controller.x.l0"]
    assert everywhere.paths == tuple(f"controller.{i}.l0" for i in (1, 2, 3))
    assert own.paths == ("controller.0.l0",)
    assert study.numbers["controller.z.rho"].paths == ("controller.2.rho.rho",)
    params = study.params({"controller.l0": 9.0, "controller.z.rho": 8.0})
    assert [gains.l0 for gains in params.controller] == [2.5, 9.0, 9.0, 9.0]
    assert [gains.rho.rho for gains in params.controller] == [1.5, 1.5, 8.0, 0.15]


def test_numbers_are_what_a_study_can_give(uncertain):
    """What a model fills in by itself, as the norm observer, is no number of the study; what the table gives is one."""
    study = uncertain.override({"controller.rho": {**NORM_BOUND, "kind": "norm_bound"}, "sweep": {}})
    assert study.numbers["controller.rho.zero_dynamics.a.0"].value == 1.0
    assert "controller.rho.observer_rate" not in study.leaves()
    assert study.template.controller[0].rho.observer_rate > 0.0
    assert study.numbers["controller.functions.tau_av"].quantity.unit == "s"
    assert list(study.laws) == [name for name, number in study.numbers.items() if isinstance(number.value, Law)]


def test_uncertain_table_is_valid():
    assert dj.Study.from_table(UNCERTAIN).requirements[0].text == "error_max after 2 s <= 1.6 m"


def test_override_leaves_the_tables_that_it_is_given():
    functions = {"kind": "constant", "k_o": 5.0, "tau_av": 0.05, "tau_m": 0.5}
    study = dj.Study.load(find_study("mu_robustness"))
    changes = {"controller.functions": functions, "controller.functions.tau_m": 0.02}
    assert study.override(changes).leaves()["controller.functions.tau_m"] == 0.02
    assert functions["tau_m"] == 0.5


def test_a_folder_of_a_study_s_name_hides_no_study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "motor").mkdir()
    assert find_study("motor") == available_studies()["motor"]
    assert find_study("./motor/") == Path("motor")  # a path is taken as it is
