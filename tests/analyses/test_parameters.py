"""Analyses of named numbers: each treats a parameter as it treats the number that somebody wrote out by hand."""

import copy
from typing import Any

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import NotCovered, mark, reach
from dssc_jax.design.ends import ends_of
from dssc_jax.exploration.positions import study_changes
from dssc_jax.exploration.sliders import sliders_of
from dssc_jax.flight_code.controller import sampled_controllers
from dssc_jax.flight_code.recording import recorded_draws
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.reach import proved_up_to
from dssc_jax.study.tables import with_changes

NAMED: dict[str, Any] = {
    "name": "named",
    "seed": 3,
    "draws": 64,
    "loop": {"duration": 2.0, "sample_time": 0.01},
    "parameters": {
        "m": {"uniform": [1.0, 2.0], "unit": "kg", "meaning": "mass"},
        "b": {"uniform": [0.2, 0.6]},
        "T": 0.02,
        "w": {"value": 2.0, "unit": "rad/s", "meaning": "bandwidth"},
    },
    "plant": {"kind": "normal_form", "k_p": "=2/m", "a_p": "=b/m", "initial": [1.0, 0.0]},
    "unmodelled": {"kind": "lag", "mu": "=T"},
    "controller": {"kind": "pid", "l0": 1.0, "k_p": "=w**2", "k_i": 0.5, "k_d": "=1.4*w"},
    "metrics": {"names": ["error_rms", "error_max"], "after": 1.0},
    "requirement": [{"metric": "error_max", "after": 1.0, "max": 0.25}],
}
"""A mass with friction under PID, behind a lag."""

DSSC = {
    "kind": "dssc",
    "l0": 0.7,
    "rho": 4.0,
    "functions": {"kind": "constant", "k_o": 10.0, "tau_av": 0.03, "tau_m": 1.0},
}


def named(**changes: object) -> dj.Study:
    """The study with other values; a dot in a name is written __."""
    return dj.Study.from_table(
        with_changes(NAMED, {name.replace("__", "."): value for name, value in changes.items()}, "")
    )


@pytest.fixture(scope="module")
def study():
    return named()


def test_a_margin_over_a_parameter_is_that_over_its_number(study):
    plain = named(unmodelled__mu=0.02)
    over = {"bounds": (0.01, 1.0), "points": 5, "bisections": 6}
    by_name = dj.margin(study, over="parameters.T", **over)
    by_number = dj.margin(plain, over="unmodelled.mu", **over)
    np.testing.assert_array_equal(by_name.dataset["critical"], by_number.dataset["critical"])
    assert np.isfinite(by_name.dataset["critical"]).any()
    with pytest.raises(ConfigError, match=r"unmodelled.mu: follows from parameters.T by '=T'; take parameters.T"):
        dj.margin(study, over="unmodelled.mu", **over)


def test_a_margin_over_the_spread_knows_what_follows(study):
    with pytest.raises(ConfigError, match=r"plant.a_p must be finite|parameters.m|plant.k_p must be > 0"):
        dj.margin(study, over="spread", bounds=(0.5, 10.0), points=3)
    found = dj.margin(study, over="spread", bounds=(0.5, 1.5), points=3, bisections=2)
    assert set(found.dataset.data_vars) >= {"parameters.m", "parameters.b"}


def test_sensitivity_falsification_rare_events_and_verification_name_parameters(study, tmp_path):
    ranked = dj.sensitivity(study.override({"draws": 256}))
    total = ranked.dataset["total"].sel(output="error_rms")
    assert list(total["factor"].values) == ["parameters.m", "parameters.b"]
    assert float(total.sel(factor="parameters.m")) > 0.5
    worst = dj.falsify(study, budget=60)
    assert set(worst.witness) == {"parameters.m", "parameters.b"}
    assert worst.witness["parameters.m"] == pytest.approx(2.0, abs=1e-3)  # the heaviest mass has the least gain
    result = dj.run(study, tmp_path / "named")
    assert result.study.quantities["parameters.m"].unit == "kg"
    assert dj.verify(result, 8).verdict == "agrees"
    assert dj.replay(result, 2).attrs["parameters.m"] == float(result.dataset["parameters.m"][2])
    text = dj.report.write(result, tmp_path / "named.html").read_text()
    assert "parameters.m" in text
    assert "=2/m" in text


def test_a_plane_and_classical_margins_take_parameters(study):
    plane = dj.region(
        study.override({"draws": 158, "loop.duration": 1.2}),
        over=(dj.RegionAxis("parameters.w", 1.0, 4.0), dj.RegionAxis("parameters.T", 0.01, 0.4)),
        halvings=0,
    )
    assert plane.summary()["simulated_points"] == 81
    found = dj.loop_margins(study.override({"plant.initial": [0.0, 0.0]}))
    plain = dj.loop_margins(named(plant__initial=[0.0, 0.0], controller__k_p=4.0, controller__k_d=2.8))
    np.testing.assert_array_equal(found.dataset["gain_upper"], plain.dataset["gain_upper"])


def test_tuning_moves_a_parameter_and_all_that_follows(study):
    table = {"parameters": {"parameters.w": [0.5, 8.0]}, "objective": {"error_rms": 1.0}}
    table |= {"steps": 6, "draws": 16, "validation": 16, "seed": 9}
    tuned = dj.tune(study.override({"tune": table}))
    w = tuned.numbers["parameters.w"]
    assert w > 2.5
    assert tuned.tuned_study.table["parameters"]["w"] == {"value": w, "unit": "rad/s", "meaning": "bandwidth"}
    assert tuned.tuned_study.template.controller[0].k_p == w**2
    assert tuned.gradients is not None
    assert tuned.gradients.agreeing == 1.0
    bad = table | {"parameters": {"controller.k_p": [1.0, 9.0]}}
    with pytest.raises(ConfigError, match=r"tune.parameters.controller.k_p: follows from parameters.w by '=w\*\*2'"):
        Plan.of(study.override({"tune": bad}))


def test_sliders_move_parameters_and_nothing_that_follows(study):
    sliders = sliders_of(study)
    names = [slider.name for slider in sliders]
    assert names[:4] == ["parameters.m", "parameters.m", "parameters.b", "parameters.b"]
    assert {"parameters.T", "parameters.w"} <= set(names)
    assert not {"plant.k_p", "controller.k_p", "unmodelled.mu"} & set(names)
    (slider,) = (slider for slider in sliders if slider.name == "parameters.w")
    assert slider.unit == "rad/s"
    moved = study.override(study_changes(study, {slider: 3.0}))
    assert moved.template.controller[0].k_p == 9.0
    with pytest.raises(ConfigError, match=r"'controller.k_p' follows from parameters.w"):
        sliders_of(study, ["controller.k_p"])


def test_the_code_of_a_controller_has_the_values_that_follow(study):
    (controller,) = sampled_controllers(study)
    values = {parameter.name: parameter.value for parameter in controller.parameters}
    assert (values["k_p"], values["k_d"], values["k_i"]) == (4.0, 1.4 * 2.0, 0.5)
    plain = named(controller__k_p=4.0, controller__k_d=2.8)
    for one, other in zip(
        recorded_draws(study, [controller], 3, 50),
        recorded_draws(plain, sampled_controllers(plain), 3, 50),
        strict=True,
    ):
        np.testing.assert_array_equal(one.parameters, other.parameters)
        np.testing.assert_allclose(one.rows, other.rows, rtol=1e-12, atol=1e-12)


def test_uncertain_gains_that_follow_differ_between_recorded_draws():
    study = named(parameters__w={"uniform": [1.0, 3.0]})
    (controller,) = sampled_controllers(study)
    place = [parameter.name for parameter in controller.parameters].index("k_p")
    assert controller.parameters[place].uncertain
    assert controller.parameters[place].value == 4.0
    gains = [draw.parameters[place] for draw in recorded_draws(study, [controller], 3, 5)]
    drawn = dj.lane(study).draws(3)[0]["parameters.w"]
    np.testing.assert_allclose(gains, drawn**2, rtol=1e-15)


def test_rivals_keep_the_expressions_that_they_take_over():
    study = named(controller=DSSC | {"l0": "=0.35*w"}, compare={"pid": {"kind": "pid", "l0": 1.0, "k_p": "=w**2"}})
    compared = dj.compare(study, ("dssc", "pid", "pi"))
    assert set(compared.summary()["controllers"]) == {"dssc", "pid", "pi"}


def test_the_ends_of_what_follows_hold_all_its_values(study):
    low, high = ends_of(study)
    assert (low.plant.k_p, high.plant.k_p) == (1.0, 2.0)
    assert (low.plant.a_p, high.plant.a_p) == (0.1, 0.6)
    low, high = ends_of(study.override({"sweep": {"parameters.m": [1.0, 4.0], "parameters.T": [0.1, 0.2, 0.3]}}))
    np.testing.assert_array_equal(low.plant.k_p, [[2.0], [0.5]])
    assert high.plant.k_p is low.plant.k_p
    np.testing.assert_allclose(low.plant.a_p, [[0.2], [0.05]])
    np.testing.assert_allclose(high.plant.a_p, [[0.6], [0.15]])
    np.testing.assert_array_equal(low.unmodelled[0].mu, [[0.1, 0.2, 0.3]])


def certified_pair() -> tuple[dj.Study, dj.Study]:
    """A certified study with parameters, and the same with the intervals written out."""
    plain = dj.Study.load("certified_margin").override({"sweep": {}, "requirement": []})
    k_low, k_high = plain.numbers["plant.k_p"].value.support
    table = copy.deepcopy(plain.table)
    table["parameters"] = {"inverse": {"uniform": [1.0 / k_high, 1.0 / k_low]}}
    table["plant"]["k_p"] = "=1/inverse"
    return dj.Study.from_table(table), plain


def test_theorem_1_takes_the_interval_of_what_follows():
    study, plain = certified_pair()
    low, high = ends_of(study)
    expected = ends_of(plain)
    assert (low.plant.k_p, high.plant.k_p) == pytest.approx(
        (expected.low.plant.k_p, expected.high.plant.k_p), rel=1e-15
    )
    assert mark(plain).certified
    assert mark(study).certified
    beyond = study.override({"parameters.inverse": {"uniform": [0.05, 20.0]}})
    assert mark(beyond).certified is not None
    assert not mark(beyond).certified


def test_theorem_1_follows_no_parameter_of_what_it_does_not_cover():
    study, _ = certified_pair()
    lagged = study.override({"parameters.T": 0.01, "unmodelled": {"kind": "lag", "mu": "=T"}})
    found = reach(lagged, "parameters.T", np.array([0.01, 0.02]))
    assert found.value is None
    assert "Theorem 1 does not cover parameters.T: unmodelled.mu follows from it" in found.text
    assert reach(study, "parameters.inverse", np.array([1.0, 1.01])).value is not None


def test_a_proof_refuses_uncertain_parameters_by_name_and_takes_plain_ones():
    study = named(controller=DSSC)
    with pytest.raises(NotCovered, match=r"parameters.m is uncertain, and plant.k_p, plant.a_p follows from it"):
        problem_of(study)
    with pytest.raises(NotCovered, match=r"parameters.m is uncertain"):
        problem_of(study.override({"sweep": {"parameters.m": [1.0, 1.5]}}))
    plain = problem_of(study.override({"parameters.m": 1.5, "parameters.b": 0.5}))
    written = {"parameters": {}, "plant.k_p": 2 / 1.5, "plant.a_p": 0.5 / 1.5, "unmodelled.mu": 0.02}
    assert plain == problem_of(named(controller=DSSC, **{name.replace(".", "__"): v for name, v in written.items()}))
    assert plain.k_p == (2 / 1.5, 2 / 1.5)
    with pytest.raises(ConfigError, match=r"unmodelled.mu: follows from parameters.T"):
        proved_up_to(study, "unmodelled.mu", (0.01, 0.02))


def test_a_clock_that_follows_is_not_moved_alone():
    study = named(parameters__f=100.0, loop__sample_time="=1/f")
    with pytest.raises(ConfigError, match=r"loop.sample_time: is the expression '=1/f' in this study"):
        dj.margin(study, over="loop.sample_time", bounds=(0.01, 0.02), points=2)
    assert "loop.sample_time" not in [slider.name for slider in sliders_of(study)]


def test_certified_tuning_refuses_parameters_of_what_the_theorem_takes_for_granted():
    study, _ = certified_pair()
    study = study.override({"parameters.g": 3.54, "controller.functions.kappa_c": "=g", "parameters.inverse": 1.0})
    for parameter, text in (("g", "decides controller.functions.kappa_c"), ("inverse", "is what the theorem's bounds")):
        tune = {"objective": {"error_rms": 1.0}, "slack": 0.0, "parameters": {f"parameters.{parameter}": [0.1, 9.0]}}
        with pytest.raises(ConfigError, match=text):
            Plan.of(study.override({"tune": tune}))


def test_the_command_line_takes_expressions_and_refuses_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = """
name = "small"
draws = 4
loop = { duration = 1.0, sample_time = 0.01 }
plant = { kind = "normal_form", k_p = "=1/m", initial = [1.0, 0.0] }
controller = { kind = "pid", k_p = 4.0, k_i = 0.5, k_d = 2.0 }
[parameters]
m = { uniform = [0.8, 1.2], unit = "kg", meaning = "mass" }
spare = 1.0
"""
    (tmp_path / "small.toml").write_text(text)
    assert guarded(["run", "small.toml", "--set", "plant.a_p==0.1/m"]) == 0
    assert "warning: parameters.spare is named by nothing in the study" in capsys.readouterr().err
    assert guarded(["sweep", "small.toml", "--over", "parameters.m=0.5:2:3"]) == 0
    assert "parameters.m  failures" in capsys.readouterr().out
    assert guarded(["run", "small.toml", "--set", "plant.a_p==0.1/n"]) == 2
    errors = capsys.readouterr().err.strip()
    assert "plant.a_p: '=0.1/n' names 'n', which is no parameter" in errors
    assert "\n" not in errors
