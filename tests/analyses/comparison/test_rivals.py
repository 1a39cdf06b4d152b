"""The gains that correspond (Table 2)."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.comparison import controller_table, switching_kinds
from dssc_jax.analyses.comparison.tuning import gain_ranges
from dssc_jax.core.registry import single
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.study.tables import merge_tables

FUNCTIONS = {
    "square_root": {"kappa_o": 20.0, "kappa_m": 2.0, "delta_o": 0.5, "delta_m": 0.5, "tau_av": 0.02},
    "approx_sta_1": {"kappa1": 5.0, "kappa2": 2.5, "delta": 0.5, "tau_av": 0.02},
    "approx_sta_2": {"kappa1": 5.0, "kappa2": 2.5, "delta": 0.5, "tau_av": 0.02},
    "sta": {"kappa1": 5.0, "kappa2": 2.5, "tau_av": 0.02},
    "field": {"k_o": 10.0, "kappa1": 5.0, "kappa2": 1.25, "delta": 0.02},
}


def study_with(functions, **controller):
    return dj.Study.from_table(
        {
            "name": "rivals",
            "loop": {"duration": 2.0, "sample_time": 0.01},
            "plant": {"kind": "normal_form", "initial": [0.5, 0.0]},
            "controller": {"kind": "dssc", "l0": 1.0, "rho": 3.0, "functions": functions, **controller},
        }
    )


@pytest.mark.parametrize("kind", FUNCTIONS)
def test_super_twisting_gains(kind):
    """Every row stands for the same STA: kappa_1 = 5, kappa_2 = 2.5 in Table 2's normalisation."""
    study = study_with({"kind": kind, **FUNCTIONS[kind]})
    sta = controller_table(study, "sta")
    assert (sta["kappa1"], sta["kappa2"]) == pytest.approx((5.0, 2.5), rel=1e-12)
    vgsta = controller_table(study, "vgsta")
    assert (vgsta["kappa_d"], vgsta["gamma"]) == pytest.approx((5.0, 2.5), rel=1e-12)
    assert vgsta["delta"] == pytest.approx(0.0 if kind == "sta" else 0.5)


def test_delta_of_the_field_functions():
    """k_o tau_av = 2 (r + delta)/kappa1 with the delta of Table 2: here delta k_o kappa1/2."""
    study = study_with({"kind": "field", **FUNCTIONS["field"]})
    functions = study.template.controller[0].functions
    delta = controller_table(study, "vgsta")["delta"]
    for sigma in (0.0, 0.3, 4.0):
        at = functions.at(sigma, 0.0, 1.0)
        assert float(at.k_o * at.tau_av) == pytest.approx(2.0 * (np.sqrt(sigma) + delta) / 5.0, rel=1e-6)


def test_ssc_and_pi_do_the_same_in_sliding():
    """SSC synthesises PI up to an integration constant, which the matched start makes 0 here: e is the same."""
    study = study_with({"kind": "square_root", **FUNCTIONS["square_root"]}, predictor_start="matched")
    study = study.override({"plant.initial": [0.0, 0.0], "disturbance": {"kind": "step", "value": 0.5}})
    error = {
        name: dj.simulate(study.override({"controller": controller_table(study, name)}))["e"].values
        for name in ("ssc", "pi", "dssc")
    }
    assert np.abs(error["ssc"]).max() > 1e-3
    assert np.abs(error["ssc"] - error["pi"]).max() < 1e-12
    assert np.abs(error["ssc"] - error["dssc"]).max() > 1e-4


def test_forms_limits_and_own_tables():
    own = {
        "sta": {"kind": "sta", "l0": 2.0, "kappa1": 1.0, "kappa2": 1.0},
        "gentle": {"functions": {"kappa1": 1.0}},
    }
    study = study_with({"kind": "approx_sta_2", **FUNCTIONS["approx_sta_2"]}, nominal={"a": 1.0, "k": 2.0})
    assert controller_table(study, "sta_proper")["discretisation"] == "proper"
    assert controller_table(study, "sta_limited")["limit"] == 3.0
    assert controller_table(study, "smc")["gain"] == 3.0
    assert controller_table(study, "smc")["k_n"] == 2.0
    assert controller_table(study, "dssc_explicit")["functions"] == study.config.controller["functions"]
    study = study.override({"compare": own})
    assert controller_table(study, "sta") == own["sta"]
    gentle = controller_table(study, "gentle")
    assert gentle["functions"]["kappa1"] == 1.0
    assert gentle["functions"]["kappa2"] == 2.5


@pytest.mark.parametrize("name", ["sta_limited", "smc"])
def test_a_rho_that_is_no_constant_gives_no_limit(name):
    """The message of ``sta_limited`` did not say which controller it was about."""
    bound = {"kind": "norm_bound", "k_p_max": 1.2, "a_p_max": 1.0, "delta_rho": 0.1}
    study = study_with({"kind": "approx_sta_2", **FUNCTIONS["approx_sta_2"]}, rho=bound)
    with pytest.raises(dj.ConfigError, match=rf"compare.{name}: rho is no constant"):
        controller_table(study, name)


def test_a_table_without_kind_takes_its_name_as_the_kind():
    """It was merged into the study's controller, so that ``[compare.pi]`` of a PID's study was a PID."""
    gains = {"l0": 1.5, "k_p": 2.5, "k_i": 1.0}
    study = study_with({"kind": "square_root", **FUNCTIONS["square_root"]})
    pid = study.override({"controller": {"kind": "pid", "k_p": 6.0, "k_i": 2.0, "k_d": 3.0}})
    pid = pid.override({"compare": {"pi": gains, "gentle": {"k_p": 3.0}, "sta": {"tune": {"kappa1": [1.0, 2.0]}}}})
    assert controller_table(pid, "pi") == {"kind": "pi", **gains}
    assert controller_table(pid, "gentle") == {**pid.config.controller, "k_p": 3.0}
    with pytest.raises(dj.ConfigError, match=r"cannot be derived from 'pid'; give \[compare.sta\]"):
        controller_table(pid, "sta")


def test_a_table_without_kind_changes_what_its_name_denotes():
    study = study_with({"kind": "approx_sta_2", **FUNCTIONS["approx_sta_2"]})
    tables = {"sta_proper": {"kappa1": 1.0}, "sta_limited": {"limit": 1.0}, "dssc": {"rho": 2.0}, "smc": {}}
    changed = study.override({"compare": tables})
    for name, table in tables.items():
        assert controller_table(changed, name) == controller_table(study, name) | table
    pid = study.override({"controller": {"kind": "pid", "k_p": 6.0}, "compare": {"sta_limited": {"kappa1": 1.0}}})
    with pytest.raises(dj.ConfigError, match=r"compare.sta_limited.limit: is required and missing"):
        controller_table(pid, "sta_limited")


def test_a_common_change_of_another_kind_is_for_all_channels():
    study = dj.Study.load("studies/paper_case1.toml")
    changed = study.override({"compare": {"sta": {"kappa1": 0.5, "z": {"kappa1": 0.7}}}})
    table = controller_table(changed, "sta")
    assert [table[channel]["kappa1"] for channel in ("x", "y", "z", "psi")] == [0.5, 0.5, 0.7, 0.5]
    assert table["x"]["kappa2"] == controller_table(study, "sta")["x"]["kappa2"]


def test_channels_have_gains_of_their_own():
    study = dj.Study.load("studies/paper_case1.toml")
    table = controller_table(study, "sta_limited")
    assert table["x"]["limit"] == 1.5
    assert table["z"]["limit"] == 0.5
    assert table["x"]["kappa1"] == pytest.approx(2.0 / (110.651 * 0.03))
    assert table["psi"]["kappa1"] == pytest.approx(2.0 / (55.3255 * 0.06))
    assert len(study.override({"controller": table}).loop.controller) == 4


def test_controllers_of_the_channels_need_no_common_kind():
    study = dj.Study.load("studies/paper_case1.toml")
    channels = study.loop.channels
    common = {name: value for name, value in study.config.controller.items() if name not in channels}
    parts = {name: merge_tables(common, study.config.controller.get(name, {})) for name in channels}
    faster = {"x": {"l0": 0.9}}
    study = study.override({"controller": parts, "compare": {"faster": faster}})
    assert controller_table(study, "faster") == merge_tables(parts, faster)
    assert controller_table(study, "dssc") == parts
    assert controller_table(study, "sta")["x"]["kappa1"] == pytest.approx(2.0 / (110.651 * 0.03))
    with pytest.raises(dj.ConfigError, match="cannot be derived from 'dssc'"):
        controller_table(study, "pid")


@pytest.mark.parametrize(
    ("changes", "name", "rule"),
    [
        ({}, "stx", "there is no such controller; did you mean 'sta"),
        ({}, "sta_conservative", "there is no such controller"),
        ({}, "pi_limited", "'pi' has no limit"),
        (
            {"controller.functions": {"kind": "constant", "k_o": 1.0, "tau_av": 1.0, "tau_m": 1.0}},
            "sta",
            "give \\[comp",
        ),
        ({"controller.functions.kappa1": {"uniform": [1.0, 2.0]}}, "pi", "a rival's gains are numbers"),
        ({"controller.rho": {"kind": "norm_bound", "k_p_max": 1, "a_p_max": 1, "delta_rho": 1}}, "smc", "no constant"),
        ({"controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 1.0}}, "sta", "cannot be derived from 'pi'"),
    ],
)
def test_what_does_not_follow(changes, name, rule):
    study = study_with({"kind": "approx_sta_2", **FUNCTIONS["approx_sta_2"]}).override(changes)
    with pytest.raises(dj.ConfigError, match=rule):
        controller_table(study, name)


def test_tunable_gains_stand_on_the_controller():
    study = study_with({"kind": "field", **FUNCTIONS["field"]})
    assert list(gain_ranges(study, {})) == ["controller.functions.kappa1", "controller.functions.kappa2"]
    study = study.override({"controller": controller_table(study, "sta")})
    assert list(gain_ranges(study, {})) == ["controller.kappa1", "controller.kappa2"]


def test_switching_kinds_are_those_with_a_describing_function():
    assert switching_kinds() == ["sta", "smc"]


def test_a_controller_that_declares_nothing_is_refused_by_name(monkeypatch):
    """Its kind may contain an underscore, as its sampled forms and ``limited`` do."""
    bare = CONTROLLERS["sta"].default_member._replace(tunable=(), from_dssc=None, limit="", describing=None)
    monkeypatch.setitem(CONTROLLERS, "bare_law", single(bare, "a controller that declares nothing"))
    study = study_with({"kind": "approx_sta_2", **FUNCTIONS["approx_sta_2"]})
    assert "bare_law" not in switching_kinds()
    with pytest.raises(dj.ConfigError, match=r"cannot be derived from 'dssc'; give \[compare.bare_law\]"):
        controller_table(study, "bare_law")
    own = study.override({"controller": {"kind": "bare_law", "l0": 1.0, "kappa1": 1.0, "kappa2": 1.0}})
    assert gain_ranges(own, {}) == {}
    with pytest.raises(dj.ConfigError, match="'bare_law' has no limit; these have one: sta, vgsta"):
        controller_table(own, "bare_law_limited")


def test_a_correlation_with_a_gain_that_a_rival_lacks_says_what_to_do():
    study = dj.Study.from_table(
        {
            "name": "tied",
            "draws": 8,
            "loop": {"duration": 1.0, "sample_time": 0.02},
            "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "initial": [1.0, 0.0]},
            "controller": {"kind": "state_feedback", "k_1": {"uniform": [3.0, 5.0]}, "k_2": 2.0},
            "correlation": {"plant.k_p, controller.k_1": 0.9},
            "compare": {"pid": {"k_p": 5.0, "k_d": 3.0, "filter": 0.05}},
            "requirement": [{"metric": "error_max", "max": 2.0}],
        }
    )
    names = ["state_feedback", "pid"]
    message = (
        r"^compare\.pid: has no uncertain number controller\.k_1, which .*take this pair out.*--set correlation={}"
    )
    with pytest.raises(dj.ConfigError, match=message):
        dj.compare(study, names)
    free = dj.compare(study.override({"correlation": {}}), names)
    assert set(free.summary()["controllers"]) == set(names)
    with pytest.raises(dj.ConfigError, match=r"compare\.pid: .*unknown"):  # another fault is still told
        dj.compare(study.override({"compare.pid.k_x": 1.0}), names)
