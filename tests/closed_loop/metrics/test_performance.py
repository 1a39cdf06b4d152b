"""Measures on request, against the same numbers from the stored trajectory; and a user's own."""

import re
import sys
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.closed_loop.metrics.accumulation import final_values, initial_accumulators, update_accumulators
from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.closed_loop.metrics.performance import PERFORMANCE
from dssc_jax.closed_loop.metrics.streaming import METRICS, Measure, Scope, Window
from dssc_jax.results.schema import variables
from dssc_jax.study.available_metrics import PACKAGE_METRICS

OWN = """
import jax.numpy as jnp
from dssc_jax.closed_loop.metrics.streaming import Metric, final_value, peak_update
change = peak_update(lambda s: s.u - s.u_previous)
JERK = Metric("m/s", "largest change of the command in a sample", change, final_value)
WORD = "no metric"
error_rms = Metric("m", "a name that is taken", peak_update(lambda s: s.e), final_value)
"""


@pytest.fixture
def custom(tmp_path, monkeypatch):
    (tmp_path / "own_metrics.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("own_metrics", None)


def test_only_where_named(case_2):
    assert not set(PERFORMANCE) & {measure.kind for measure in case_2.measures}
    assert not set(PERFORMANCE) & set(METRICS)


def test_streaming_equals_stored(case_2):
    sensor = {"kind": "noisy", "velocity_std": 0.01}
    study = case_2.override({"sensor": sensor, "metrics": {"after": 10.0, "names": ["error_rms", *PERFORMANCE]}})
    run = dj.simulate(study)
    inside = run["t"].values >= 10.0 - 1e-9
    e, u, energy, sigma, t = (run[name].values[inside] for name in ("e", "u", "u_total", "sigma", "t"))
    slow = [u[0]]
    for value in u[1:]:
        slow.append(slow[-1] + (1.0 - np.exp(-2.0 * np.pi * 0.05)) * (value - slow[-1]))
    fast = np.sum((u - slow) ** 2)
    noise = (run["sigma_measured"] - run["sigma"]).values[inside]
    gain = 1.0 / (run["k_o"] * run["tau_av"]).values[inside]
    desired_rate = np.pi * np.cos(np.pi * t / 20.0)  # of 20 sin(2 pi t/40)
    expected = {
        "error_rate_max": np.abs(run["y_dot"].values[inside] - desired_rate).max(),
        "iae": 0.005 * np.abs(e).sum(),
        "itae": 0.005 * ((t - 10.0) * np.abs(e)).sum(),
        "overshoot": max(0.0, (-np.sign(e[0]) * e).max()),
        "steady_state_error": abs(e.mean()),
        "command_energy": 0.005 * (u**2).sum(),
        "chattering_index": fast / (fast + len(u) * np.var(slow)),
        "noise_amplification": np.sqrt(fast / np.sum(noise**2)),
        "noise_drift": abs(np.sum(gain[1:] * np.diff(noise))) / (0.005 * len(u)),
        "total_command_tv": np.abs(np.diff(energy)).sum(),
        "growth_rate": np.polyfit(t, np.log(np.abs(sigma)), 1)[0],
    }
    assert set(expected) == {name for name, metric in PERFORMANCE.items() if metric.scope is Scope.CHANNEL}
    assert expected["overshoot"] > 0.0
    for name, value in expected.items():
        assert run.attrs[name] == pytest.approx(value, rel=1e-8), name


def test_a_constant_command_does_not_chatter(case_2):
    constant = {
        "plant.initial": [0.0, 0.0],
        "reference": {"kind": "zero"},
        "disturbance": {"kind": "none"},
        "metrics": {"names": list(PERFORMANCE)},
    }
    attrs = dj.simulate(case_2.override(constant)).attrs
    assert {attrs[name] for name in PERFORMANCE if name in attrs and name != "growth_rate"} == {0.0}


class Attitude(NamedTuple):
    phi: float
    theta: float


def test_peak_attitude_is_that_of_the_window():
    measures = tuple(Measure(name, name, Window(0.2), None, PERFORMANCE[name]) for name in ("roll_max", "pitch_max"))
    accumulators = initial_accumulators(measures)
    for k, (phi, theta) in enumerate([(0.9, -0.9), (0.8, 0.7), (-0.3, 0.1), (0.2, -0.4)]):
        instant = Instant(0.1 * k, 0.1, (), Attitude(phi, theta))
        accumulators = update_accumulators(measures, accumulators, instant, jnp.asarray(k), 0.1)
    found = final_values(measures, accumulators, 4, 0.1)
    assert {name: float(value) for name, value in found.items()} == {"roll_max": 0.3, "pitch_max": 0.4}


class Rotors(NamedTuple):
    rotor: tuple[float, ...]


def test_rotor_thrusts_are_those_of_all_rotors_in_the_window():
    names = ("rotor_thrust_max", "rotor_thrust_min")
    measures = tuple(Measure(name, name, Window(0.1), None, PERFORMANCE[name]) for name in names)
    accumulators = initial_accumulators(measures)
    for k, thrusts in enumerate([(90.0, 1.0, 5.0), (20.0, 30.0, 25.0), (28.0, 24.0, 31.0)]):
        instant = Instant(0.1 * k, 0.1, (), Rotors(thrusts))
        accumulators = update_accumulators(measures, accumulators, instant, jnp.asarray(k), 0.1)
    found = final_values(measures, accumulators, 3, 0.1)
    assert {name: float(value) for name, value in found.items()} == {"rotor_thrust_max": 31.0, "rotor_thrust_min": 20.0}


def test_metrics_of_an_angle_are_in_radians():
    """Whatever says a metric's unit: results, requirements, reports."""
    named = {"metrics.names": ["error_rms", "iae", "itae", "command_energy", "tilt_max", "chattering_index"]}
    uav = dj.Study.load(Path(__file__).parents[3] / "studies" / "paper_case1.toml")
    study = uav.override({**named, "requirement": [{"metric": "error_max_psi", "max": 0.1}]})
    units = {name: variable.attributes["units"] for name, variable in variables(study).items() if name != "outcome"}
    of_length = {"error_rms": "m", "iae": "m s", "itae": "m s^2", "command_energy": "m^2/s"}
    for kind, unit in of_length.items():
        assert (units[f"{kind}_x"], units[f"{kind}_psi"]) == (unit, "rad" + unit.removeprefix("m"))
    assert units["chattering_index_psi"] == "1"
    assert units["tilt_max"] == units["error_max_psi"] == units["slack_error_max_psi"] == "rad"
    assert study.requirements[0].text == "error_max_psi <= 0.1 rad"


def test_chattering_is_the_share_above_the_cutoff():
    """A relay at 1 ms chatters at 500 Hz, and the implicit one not at all."""
    table = {
        "name": "relay",
        "loop": {"duration": 2.0, "sample_time": 1e-3},
        "plant": {"kind": "normal_form", "initial": [0.01234, 0.0]},
        "controller": {"kind": "smc", "l0": 1.0, "gain": 1.0},
        "metrics": {"after": 1.0, "names": ["chattering_index"]},
    }
    found = {}
    for form in ("implicit", "explicit"):
        table["controller"]["discretisation"] = form
        found[form] = dj.simulate(dj.Study.from_table(table)).attrs["chattering_index"]
    assert found["explicit"] > 0.95
    assert found["implicit"] < 1e-3


def test_own_metric(case_2, custom, tmp_path):
    study = case_2.override(
        {
            "metrics": {"names": ["own_metrics:JERK"]},
            "requirement": [{"metric": "own_metrics:JERK", "after": 30.0, "max": 1e-3}],
            "loop.duration": 40.0,
        }
    )
    run = dj.simulate(study)
    steps = np.abs(np.diff(run["u"].values))
    assert run.attrs["JERK"] == pytest.approx(steps.max(), rel=1e-12)
    result = dj.run(study)
    assert result.summary()["requirements"] == ["JERK after 30 s <= 0.001 m/s"]
    result.save(tmp_path / "r")
    assert dj.load(tmp_path / "r").dataset["JERK"].attrs["long_name"] == "largest change of the command in a sample"


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("own_metrics:WORD", "must be a Metric, got str"),
        ("own_metrics:NONE", "cannot import"),
        ("no_such_module:X", "cannot import"),
        ("own_metrics:error_rms", "another metric of the name 'error_rms'"),
        ("chattering_indx", "did you mean 'chattering_index'"),
    ],
)
def test_bad_names(case_2, custom, name, rule):
    for changes in ({"metrics": {"names": [name]}}, {"requirement": [{"metric": name, "max": 1.0}]}):
        with pytest.raises(dj.ConfigError, match=rule):
            case_2.override(changes)


def test_the_page_has_every_metric_with_its_unit():
    page = (Path(__file__).parents[3] / "docs" / "metrics.md").read_text()
    metrics, heading, _ = page.partition("\n## Margins\n")
    assert heading
    rows = re.findall(r"^\| `(\w+)` \|.*\| (\S.*) \|$", metrics, re.MULTILINE)
    assert dict(rows) == {name: metric.unit for name, metric in PACKAGE_METRICS.items()}
    assert [name for name, _ in rows] == list(PACKAGE_METRICS)
