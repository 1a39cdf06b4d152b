"""Requirements on margins: against python-control, in any block, with derivatives, and where they are refused."""

import re
import tomllib
from pathlib import Path

import control
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq, minimize_scalar

import dssc_jax as dj
from dssc_jax.console.results import show_result
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.evaluation import Derivative, Evaluator, GradientEvaluator
from dssc_jax.engine.linearisation.margin_values import MarginValues
from dssc_jax.engine.plain import PlainBatch
from dssc_jax.engine.sampling import draw
from tests.page_examples import BLOCK

T_S = 0.02
GAINS = {"kind": "pid", "k_p": 6.0, "k_i": 2.0, "k_d": 3.0, "filter": 0.05}
REQUIRED = [
    {"metric": "error_max", "max": 2.0},
    {"margin": "gain", "min": "6 dB"},
    {"margin": "gain_lower", "max": "-6 dB"},
    {"margin": "phase", "min": "35 deg"},
    {"margin": "delay", "min": "100 ms"},
    {"margin": "modulus", "min": 0.5},
    {"margin": "disk", "min": 0.6},
]
TABLE = {
    "name": "required",
    "draws": 40,
    "loop": {"duration": 0.4, "sample_time": T_S},
    "plant": {
        "kind": "normal_form",
        "k_p": {"uniform": [0.5, 2.0]},
        "a_p": {"uniform": [-6.0, 3.0]},
        "initial": [1.0, 0.0],
    },
    "controller": GAINS,
    "requirement": REQUIRED,
}


def study(**changes):
    return dj.Study.from_table(TABLE | changes)


@pytest.fixture(scope="module")
def result():
    return dj.run(study(), check=False)


def held(a, b, t_s):
    """A continuous system with a held input, by the matrix exponential."""
    order = len(a)
    block = np.zeros((order + 1, order + 1))
    block[:order, :order] = a
    block[:order, order] = b
    transition = expm(block * t_s)
    return transition[:order, :order], transition[:order, order:]


def pid_loop(a, b, c, gains, t_s):
    """L(z) of a PID controller and a linear plant, by python-control."""
    z = control.tf([1.0, 0.0], [1.0], t_s)
    lag = gains["filter"]
    law = gains["k_p"] + t_s * gains["k_i"] / (z - 1.0) + gains["k_d"] * (z - 1.0) / ((lag + t_s) * z - lag)
    return control.minreal(law * control.ss2tf(control.ss(*held(a, b, t_s), [c], 0.0, t_s)), verbose=False)


def assert_margins(values, loop, response, t_s):
    """The margins of a draw are those of python-control, refined on a frequency response that is computed directly."""

    def refined(function, omega):
        return brentq(function, 0.999 * omega, min(1.001 * omega, np.pi / t_s), xtol=1e-14 * omega, rtol=1e-15)

    gains, phases, _, phase_at, gain_at, _ = control.stability_margins(loop, returnall=True, method="poly")
    upper = [omega for gain, omega in zip(gains, phase_at, strict=True) if gain > 1.0 + 1e-9 and omega * t_s < 3.14]
    exact = [-1.0 / response(refined(lambda w: response(w).imag, omega)).real for omega in upper]
    nyquist = -1.0 / response(np.pi / t_s).real
    exact += [nyquist] if nyquist > 1.0 else []
    assert values["gain_margin"] == pytest.approx(min(exact, default=np.inf), rel=1e-9)
    crossings = [refined(lambda w: np.log(abs(response(w))), omega) for omega in gain_at]
    left = [abs(np.angle(-response(omega))) for omega in crossings]
    assert min(left) == pytest.approx(np.radians(np.min(np.abs(phases))), rel=1e-3, abs=1e-4)
    assert values["phase_margin"] == pytest.approx(min(left), rel=1e-9)
    grid = np.geomspace(0.01 * min(gain_at), np.pi / t_s, 4000)
    distances = [abs(1.0 + response(w)) for w in grid]
    nearest = grid[int(np.argmin(distances))]
    found = minimize_scalar(
        lambda w: abs(1.0 + response(w)), bounds=(0.99 * nearest, min(1.01 * nearest, np.pi / t_s)), method="bounded",
        options={"xatol": 1e-9 * nearest},
    )  # fmt: skip
    assert values["modulus_margin"] == pytest.approx(found.fun, rel=1e-9)


def response_of(a, b, c, gains, t_s):
    """L at omega, term by term."""
    transition, inputs = held(a, b, t_s)
    lag = gains["filter"]

    def at(omega):
        z = np.exp(1j * omega * t_s)
        law = gains["k_p"] + t_s * gains["k_i"] / (z - 1.0) + gains["k_d"] * (z - 1.0) / ((lag + t_s) * z - lag)
        return complex(law * (c @ np.linalg.solve(z * np.eye(len(a)) - transition, inputs))[0])

    return at


def test_margins_of_all_draws_are_those_of_python_control(result):
    dataset = result.dataset
    seen = 0
    for i in range(dataset.sizes["draw"]):
        values = {name: float(dataset[name][i]) for name in dataset}
        plant = [[0.0, 1.0], [0.0, -values["plant.a_p"]]], [0.0, values["plant.k_p"]], np.array([1.0, 0.0])
        loop = pid_loop(*plant, GAINS, T_S)
        if np.max(np.abs(control.poles(control.feedback(loop, 1)))) >= 1.0:
            # an unstable loop has the margins of the limit of stability
            assert [values[name] for name in ("gain_margin", "gain_lower_margin", "phase_margin")] == [1.0, 1.0, 0.0]
            assert [values[name] for name in ("delay_margin", "disk_margin", "modulus_margin")] == [0.0, 0.0, 0.0]
            continue
        seen += 1
        response = response_of(*plant, GAINS, T_S)
        assert_margins(values, loop, response, T_S)
        omega = control.stability_margins(loop, method="poly")[4]
        near = np.geomspace(0.2 * omega, min(5.0 * omega, np.pi / T_S), 400)
        rough = control.disk_margins(loop, near)[0]
        assert values["disk_margin"] == pytest.approx(rough, rel=1e-2)
        assert values["disk_margin"] <= rough + 1e-9  # the grid of python-control misses the peak
    assert 15 < seen < dataset.sizes["draw"]


def test_a_buck_converter_meets_what_python_control_finds():
    page = (Path(__file__).parents[3] / "docs" / "parameters.md").read_text()
    buck = dj.Study.from_table(tomllib.loads(next(text for _, text in BLOCK.findall(page) if "# buck.toml" in text)))
    wanted = [
        {"margin": "gain", "min": "6 dB"},
        {"margin": "phase", "min": "40 deg"},
        {"margin": "modulus", "min": 0.5},
    ]
    buck = buck.override({"draws": 5, "requirement": wanted, "loop.duration": 1e-3, "metrics": {}})
    numbers = draw(buck, np.arange(5))
    found = MarginValues(buck)(numbers, np.arange(5))
    for i in range(5):
        at = {name: float(column[i]) for name, column in numbers.items()}
        henry, farad, load, coil, volt = (at[f"parameters.{name}"] for name in ("L", "C", "R", "r", "V"))
        gains = {name: float(buck.leaves()[f"controller.{name}"]) for name in ("k_p", "k_i", "k_d", "filter")}
        a = [[-coil / henry, -1.0 / henry], [1.0 / farad, -1.0 / (load * farad)]]
        plant = a, [volt / henry, 0.0], np.array([0.0, 1.0])
        values = {name: float(column[i]) for name, column in found.items()}
        t_s = buck.config.loop.sample_time
        assert_margins(values, pid_loop(*plant, gains, t_s), response_of(*plant, gains, t_s), t_s)


def test_verdicts_follow_and_come_first(result):
    dataset = result.dataset
    short = dataset["phase_margin"].values < np.radians(35.0)
    assert 0 < short.sum() < short.size
    np.testing.assert_array_equal(dataset["slack_phase_margin_min"].values < 0.0, short)
    np.testing.assert_array_equal(dataset["violated_at_phase_margin_min"].values == 0.0, short)
    row = next(r for r in result.summary()["points"][0]["requirements"] if r["name"] == "phase_margin_min")
    assert row["text"] == "phase_margin >= 35 deg"
    assert row["failures"] == short.sum()
    assert dataset["gain_margin"].attrs["units"] == "1"
    assert np.all((dataset["outcome"].values != 0)[short])


def test_margins_depend_on_the_draw_alone(result, tmp_path):
    folder = tmp_path / "blocks"
    dj.run(study(draws=14), folder, block=7, check=False)
    resumed = dj.run(study(), folder, resume=True, check=False).dataset
    assert resumed.sizes["draw"] == result.dataset.sizes["draw"]
    for name in result.dataset:
        np.testing.assert_array_equal(resumed[name].values, result.dataset[name].values)


def test_one_draw_alone_has_the_same_margin(result):
    trajectory = dj.simulate(study(), draw=4)
    assert trajectory.attrs["disk_margin"] == result.dataset["disk_margin"].values[4]


def test_plain_xla_finds_the_same_margins(result, monkeypatch):
    """The loop is linearised by machine code, or by XLA where that is asked for."""
    monkeypatch.setenv("DSSC_JAX_KERNEL", "scan")
    plain = MarginValues(study())
    indices = np.arange(40)
    values = plain(draw(study(), indices), indices)
    assert isinstance(plain.resting.linearise.program.start.__self__, PlainBatch)
    for name, column in values.items():
        np.testing.assert_allclose(column, result.dataset[name].values, rtol=1e-9, err_msg=name)


def test_derivatives_of_slacks_are_those_of_the_margins():
    steep = GradientEvaluator(study(), {"controller.k_p": (6.0, 6.0)}, 8, names=["controller.k_p"])
    indices = np.arange(4)
    values = steep.values_of_draws(slice(0, 4)) | {"controller.k_p": np.full(4, 6.0)}
    found = steep(indices, values)
    ends = [steep.engine.margins(values | {"controller.k_p": np.full(4, k)}, indices) for k in (5.99, 6.01)]
    for margin, sign in {"phase_margin": 1.0, "disk_margin": 1.0, "gain_lower_margin": -1.0}.items():
        expected = (ends[1][margin] - ends[0][margin]) / 0.02
        np.testing.assert_allclose(found[Derivative(margin, "controller.k_p")], expected, rtol=1e-3, atol=1e-9)
        slack = next(r.name for r in study().requirements if r.measure.name == margin)
        np.testing.assert_array_equal(
            found[Derivative(slack, "controller.k_p")], sign * found[Derivative(margin, "controller.k_p")]
        )


@pytest.mark.parametrize(
    ("requirement", "text"),
    [
        ({"margin": "fase", "min": 1.0}, "unknown margin 'fase'; did you mean 'phase'?"),
        ({"margin": "phase", "min": "30 dB"}, "must be a number [rad], or a text of a number and one of rad, deg"),
        ({"margin": "gain", "min": 0.5}, "must be > 1, which loops at the limit of stability have; got 0.5"),
        (
            {"margin": "phase", "min": 30.0},
            'must be <= 3.14159 rad, the largest phase margin there is; got 30; did you mean "30 deg"?',
        ),
        (
            {"margin": "phase", "max": "181 deg"},
            "must be <= 3.14159 rad, the largest phase margin there is; got 181 deg",
        ),
        ({"margin": "phase", "min": 700.0}, "must be <= 3.14159 rad, the largest phase margin there is; got 700"),
        ({"margin": "bandwidth", "min": -1.0}, "must be >= 0 rad/s, as every bandwidth of T is; got -1"),
        ({"margin": "gain_lower", "max": -0.5}, "must be >= 0 1, as every lower gain margin is; got -0.5"),
        ({"margin": "phase", "min": float("nan")}, "finite"),
        ({"margin": "sensitivity", "max": float("nan")}, "finite"),
        ({"margin": "delay", "min": float("inf")}, "finite"),
        ({"margin": "delay", "min": "1e400 s"}, "must be a finite number [s], got inf"),
        ({"margin": "gain"}, "needs exactly one of max and min"),
        (
            {"margin": "gain", "min": 2.0, "after": 1.0},
            "a margin is that of the linearised loop, before the flight; take",
        ),
        ({"margin": "gain", "min": 2.0, "at": "x input"}, "must be one of input, output, rate; got 'x input'"),
        ({"metric": "error_max", "max": "6 dB"}, "only a margin takes a unit"),
        ({"metric": "phase_margin", "min": 1.0}, 'write margin = "phase" in place of the metric'),
    ],
)
def test_what_is_no_requirement_on_a_margin(requirement, text):
    with pytest.raises(ConfigError, match=re.escape(text)):
        study(requirement=[requirement])


def test_who_cannot_judge_a_margin_says_so():
    switching = study(controller={"kind": "smc", "gain": 5.0, "l0": 1.0}, requirement=[{"margin": "gain", "min": 2.0}])
    with pytest.raises(ConfigError, match="'smc' switches at the origin"):
        dj.run(switching)
    with pytest.raises(ConfigError, match="gain_margin is that of the linearised loop"):
        dj.lane(study())


def test_a_first_command_at_its_limit_does_not_hide_the_equilibrium():
    """The plant rests without a command, so limits that bind at first change no margin of a loop that settles."""
    step = {"reference": {"kind": "step", "size": 1.0}, "loop": {"duration": 6.0, "sample_time": T_S}}
    plant = TABLE["plant"] | {"a_p": 1.0, "initial": [0.0, 0.0]}
    required = [{"margin": "gain", "min": "6 dB"}, {"margin": "phase", "min": "35 deg"}]
    changes = step | {"plant": plant, "requirement": required, "draws": 8}
    free = dj.run(study(**changes), check=False).dataset
    limited = dj.run(study(**changes, controller=GAINS | {"low": -1.0, "high": 1.0}), check=False).dataset
    assert np.all(free["gain_margin"] > 1.0)
    for name in ("gain_margin", "phase_margin"):
        np.testing.assert_allclose(limited[name], free[name], rtol=1e-9)


def test_an_unstable_loop_at_its_limit_is_unstable():
    """Newton's method from the first sample and a simulation both stay at the limit."""
    step = {"reference": {"kind": "step", "size": 1.0}, "loop": {"duration": 2.0, "sample_time": T_S}}
    plant = {"kind": "normal_form", "k_p": 1.0, "a_p": {"uniform": [-1.0, 1.0]}, "initial": [0.0, 0.0]}
    gains = {"kind": "pid", "k_p": 6.0, "k_i": {"uniform": [0.0, 40.0]}, "k_d": 3.0, "filter": 0.05}
    required = [{"margin": "gain", "min": "6 dB"}]
    changes = step | {"plant": plant, "requirement": required, "draws": 64}
    free = dj.run(study(**changes, controller=gains), check=False)
    limited = dj.run(study(**changes, controller=gains | {"low": -1.0, "high": 1.0}), check=False)
    counts = [next(found.points())["requirements"][0] for found in (free, limited)]
    assert 0 < counts[0]["unstable"] < 64
    assert [(count["unstable"], count["no_operating_point"]) for count in counts] == [(counts[0]["unstable"], 0)] * 2
    np.testing.assert_allclose(limited.dataset["gain_margin"], free.dataset["gain_margin"], rtol=1e-9)


def without_rest(**changes):
    """Integral action on a plant with a zero at rest has no equilibrium at a step; a zero at 20 makes it unstable."""
    table = {
        "name": "no_rest",
        "draws": 60,
        "parameters": {"zero": {"choice": [0.0, 1.0, 20.0]}},
        "loop": {"duration": 1.0, "sample_time": 0.01},
        "plant": {"kind": "transfer_function", "numerator": [1.0, "=zero"], "denominator": [1.0, 2.0, 1.0]},
        "reference": {"kind": "step", "size": 1.0},
        "controller": {"kind": "pid", "k_p": 3.0, "k_i": 20.0, "low": -5.0, "high": 5.0},
        "requirement": [{"margin": "phase", "min": "20 deg"}, {"metric": "error_max", "max": 3.0}],
    }
    return dj.Study.from_table(table | changes)


def test_draws_without_an_operating_point_are_counted_and_told(tmp_path, capsys):
    result = dj.run(without_rest(), tmp_path / "run", check=False)
    zero = result.dataset["parameters.zero"].values
    phase = result.dataset["phase_margin"].values
    slack = result.dataset["slack_phase_margin_min"].values
    np.testing.assert_array_equal(np.isnan(phase), zero == 0.0)
    np.testing.assert_array_equal(phase == 0.0, zero == 20.0)
    assert np.all(phase[zero == 1.0] > np.radians(20.0))
    np.testing.assert_allclose(slack[zero != 1.0], -np.radians(20.0))
    point = result.summary()["points"][0]
    row = point["requirements"][0]
    assert row["no_operating_point"] == np.count_nonzero(zero == 0.0) > 0
    assert row["unstable"] == np.count_nonzero(zero == 20.0) > 0
    assert row["failures"] == row["no_operating_point"] + row["unstable"]
    assert "unstable" not in point["requirements"][1]
    show_result(result)
    counts = row["unstable"], row["no_operating_point"]
    text = (
        "draws without a margin violate phase_margin >= 20 deg: in {} the loop is unstable, in {} it has no operating"
    )
    assert text.format(*counts) in capsys.readouterr().out


def test_values_are_shown_in_the_unit_of_the_bound():
    required = {rule.measure.name: rule for rule in study().requirements}
    assert required["gain_margin"].shown(10.0) == (pytest.approx(20.0), "dB")
    assert required["phase_margin"].shown(np.pi / 4.0) == (pytest.approx(45.0), "deg")
    assert required["delay_margin"].shown(0.25) == (pytest.approx(250.0), "ms")
    assert required["modulus_margin"].shown(0.25) == (0.25, "1")


@pytest.mark.parametrize("of", [study, without_rest])
def test_who_only_asks_for_failures_gets_those_of_the_whole_evaluation(of):
    asked = of()
    evaluator = Evaluator(asked, {}, 16)
    indices = np.arange(30)
    values = evaluator.values_of_draws(slice(0, 30))
    outcome = evaluator(indices, values)["outcome"]
    np.testing.assert_array_equal(evaluator.fails(indices, values), outcome != 0)
    assert 0 < np.count_nonzero(outcome) < 30
