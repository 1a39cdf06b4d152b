"""Design files: given, synthesised and optimised parameters; errors in one line; what is written reads back."""

import json
import tomllib

import pytest

from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.design import check
from dssc_jax.design.feasibility import Criterion
from dssc_jax.design.files import design_toml, load_design, parse_design

BOUNDS = {"k_min": 0.9, "k_max": 1.1, "a_max": 1.0, "alpha_d3": 0.1}
FREE = {"l0": 0.5, "phi_a": 0.1, "eps": 0.3, "delta": 0.5, "eps_1": 2.0, "eps_2": 0.1, "eps_3": 6.0}
MODULATION = {"k_o": 100.0, "delta_rho": 1.0, "sigma_tilde": 0.5}


def test_free_parameters_are_synthesised():
    found = parse_design({"bounds": BOUNDS, "free": FREE}, "d")
    assert found.parameters.phi_b == pytest.approx(0.5 / 0.3 + 6.0)
    assert check(found.parameters, found.bounds).certified


def test_what_free_leaves_open_is_optimised():
    found = parse_design({"bounds": BOUNDS, "free": {"l0": 0.7}, "goal": {"criterion": "gain", "residual": 0.2}}, "d")
    assert found.parameters.l0 == 0.7
    assert found.goal.criterion is Criterion.GAIN
    assert check(found.parameters, found.bounds).guarantee.e == pytest.approx(0.2, rel=1e-3)


def test_bounds_alone_make_a_design_where_that_is_asked():
    """For the smallest residual; for the fastest decay where nothing drives the loop."""
    driven = parse_design({"bounds": BOUNDS}, "d", complete=False)
    assert driven.goal.criterion is Criterion.RESIDUAL
    calm = parse_design({"bounds": BOUNDS | {"alpha_d3": 0.0}}, "d", complete=False)
    assert calm.goal.criterion is Criterion.DECAY_RATE
    for found in (driven, calm):
        certificate = check(found.parameters, found.bounds)
        assert certificate.certified
        assert certificate.practice.sample_time_origin >= 1e-3 * (1 - 1e-9)


def test_modulation_follows_from_the_guarantee():
    found = parse_design({"bounds": BOUNDS | {"alpha_d": 0.5}, "free": FREE, "modulation": MODULATION}, "d")
    practice = check(found.parameters, found.bounds).practice
    assert found.modulation.needed_rho(practice) == pytest.approx(practice.u_av + (practice.drift + 1.0) / 100.0)
    assert found.modulation.first_sliding == 0.5


def test_what_is_written_reads_back():
    table = {
        "bounds": BOUNDS | {"zero_dynamics": {"a": [2.0, 1.5], "c": [0.1, 0.2]}, "y_m_dot": 0.1},
        "free": FREE,
        "modulation": MODULATION,
    }
    found = parse_design(table, "d")
    for name in ("d", 'a "quoted" C:\\name', "two\nlines\x7f"):
        reread = parse_design(tomllib.loads(design_toml(found._replace(name=name))), "other")
        assert reread._replace(free=found.free) == found._replace(name=name)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "needs [bounds] and one of"),
        ({"free": FREE}, "bounds: is required and missing"),
        (
            {"bounds": BOUNDS | {"k_min": 0.0}, "free": FREE},
            "bounds.k_min: lower bound of k_p (A0.a) [1/s] must be > 0",
        ),
        ({"bounds": BOUNDS | {"k_min": 2.0}, "free": FREE}, "bounds.k_min: must be <= k_max = 1.1, got 2"),
        ({"bounds": BOUNDS | {"k_mid": 2.0}, "free": FREE}, "bounds.k_mid: unknown name; did you mean 'k_min'?"),
        ({"bounds": BOUNDS | {"a_max": float("nan")}, "free": FREE}, "bounds.a_max: must be a finite number"),
        (
            {"bounds": BOUNDS | {"zero_dynamics": {"a": [-1.0], "c": [1.0]}}, "free": FREE},
            "bounds.zero_dynamics.a: A_eta must be Hurwitz",
        ),
        (
            {"bounds": BOUNDS | {"zero_dynamics": {"a": [1.0, 2.0], "c": [1.0]}}, "free": FREE},
            "bounds.zero_dynamics: a and c must have the same length",
        ),
        ({"bounds": BOUNDS, "free": FREE | {"eps_1": -1.0}}, "free.eps_1: eps_1"),
        ({"bounds": BOUNDS, "free": {"l0": 1.0}}, "free.phi_a: is required and missing"),
        ({"bounds": BOUNDS, "free": FREE, "parameters": {}}, "free: cannot be combined with [parameters]"),
        ({"bounds": BOUNDS, "free": FREE, "recipe": "best"}, "recipe: must be strict or printed"),
        (
            {"bounds": BOUNDS, "goal": {"criterion": "gains"}},
            "goal.criterion: unknown criterion 'gains'; did you mean 'gain'",
        ),
        ({"bounds": BOUNDS, "goal": {"residual": -1.0}}, "goal.residual: "),
        ({"bounds": BOUNDS, "goal": {"vary": {"l0": [2.0, 1.0]}}}, "goal.vary.l0: must be [low, high]"),
        ({"bounds": BOUNDS, "free": FREE, "goal": {"residual": 1e-9}}, "goal: no design in the ranges has residual <="),
        ({"bounds": BOUNDS, "goal": {}, "recipe": "printed"}, "recipe: has no meaning where"),
        ({"bounds": BOUNDS, "free": FREE, "goal": {"vary": {"l0": [0.1, 1.0]}}}, "goal.vary.l0: is fixed by [free]"),
        (
            {"bounds": BOUNDS, "goal": {"criterion": "gain", "residual": 1e-12}},
            "goal: no design in the ranges has residual <= 1e-12 m",
        ),
        ({"bounds": BOUNDS, "free": FREE, "modulation": {"k_o": 0.0, "delta_rho": 1.0}}, "modulation.k_o: "),
        ({"bounds": BOUNDS, "free": FREE, "extra": 1}, "extra: unknown name"),
        (
            {"bounds": BOUNDS | {"k_min": 1e-20}, "free": FREE},
            "free: makes with these bounds gamma, which must be a plain",
        ),
        ({"bounds": BOUNDS, "free": FREE | {"l0": 1e31}}, "free.l0: must be a plain number below 1e+30, got 1e+31"),
        ({"bounds": BOUNDS, "free": FREE | {"l0": "x"}}, "(error pole l_0 [1/s]), got 'x'"),
        (
            {"bounds": BOUNDS | {"zero_dynamics": {"a": [1e-40], "c": [1.0]}}, "free": FREE},
            "bounds.zero_dynamics.a: must be 0 or at least 1e-30",
        ),
    ],
)
def test_bad_files(table, message):
    with pytest.raises(ConfigError) as caught:
        parse_design(table, "d")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_commands(tmp_path, capsys):
    """Design writes what check certifies; JSON is one object; LaTeX is a table; exit 1 without a certificate."""
    bounds, out = tmp_path / "bounds.toml", tmp_path / "design.toml"
    bounds.write_text("[bounds]\nk_min = 0.9\nk_max = 1.1\na_max = 1.0\nalpha_d3 = 0.1\n")
    assert guarded(["design", str(bounds), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["certified"]
    assert {"name", "equation", "slack", "state", "printed_slack"} <= told["inequalities"][0].keys()
    assert told["edges"] == ["l0 = 5 is the upper end of what was sought, 0.05 to 5"]
    assert guarded(["check", str(out), "--json", "--latex"]) == 2
    assert "--latex: cannot be combined with --json" in capsys.readouterr().err
    assert guarded(["check", str(out)]) == 0
    assert "with a rho that keeps sliding" in capsys.readouterr().out
    assert guarded(["check", str(out), "--latex"]) == 0
    assert capsys.readouterr().out.count("\\begin{tabular}") == 5
    text = out.read_text()
    phi_b = load_design(out).parameters.phi_b
    out.write_text(text.replace(f"phi_b = {phi_b!r}", "phi_b = 9.6", 1))
    assert guarded(["check", str(out), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["guarantee"]["e"] is None
    assert told["limits"] is None
    assert guarded(["check", str(out)]) == 1
    assert "small gain needs phi_b >" in capsys.readouterr().out
