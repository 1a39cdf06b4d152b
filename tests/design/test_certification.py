"""What the theorem says of a study: bounds from its laws, a mark for each point of its sweep."""

from dataclasses import replace

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.design import Bounds, Free, synthesise
from dssc_jax.design.certification import mark, reach
from dssc_jax.design.loop_bounds import design_of

BOUNDS = Bounds(0.9, 1.1, 1.0, alpha_d3=0.1 * np.pi / 3, alpha_d=0.1)
FREE = Free(0.5, 0.1, 0.3, 0.5, 2.0, 0.1, 6.0)


def table(**changes):
    p = synthesise(BOUNDS, FREE)
    functions = {("epsilon" if name == "eps" else name): value for name, value in p._asdict().items() if name != "l0"}
    base = {
        "name": "t",
        "draws": 8,
        "loop": {"duration": 1.0, "sample_time": 0.001},
        "plant": {"kind": "normal_form", "k_p": {"uniform": [0.9, 1.1]}, "a_p": {"uniform": [-1.0, 0.5]}},
        "controller": {"kind": "dssc", "l0": 0.5, "rho": 50.0, "functions": {"kind": "vgsta", "k_o": 1.0, **functions}},
        "disturbance": {"kind": "sine", "amplitude": 0.1, "period": 6.0},
    }
    return base | changes


def test_the_bounds_are_read_off_the_study():
    parameters, bounds = design_of(dj.Study.from_table(table()))
    assert parameters == synthesise(BOUNDS, FREE)
    for name in Bounds._fields:
        assert getattr(bounds, name) == getattr(BOUNDS, name) or np.isclose(
            getattr(bounds, name), getattr(BOUNDS, name)
        )


def test_reference_and_nominal_control_enter():
    study = dj.Study.from_table(
        table(
            reference={"kind": "sine", "amplitude": 2.0, "period": 4.0, "offset": 1.0},
            controller=table()["controller"] | {"nominal": {"a": 1.0, "k": 2.0, "predictor_term": False}},
        )
    )
    _, bounds = design_of(study)
    rate = np.pi / 2
    assert bounds.y_m == pytest.approx(3.0)
    assert [bounds.y_m_dot, bounds.y_m_ddot, bounds.y_m_dddot] == pytest.approx([2 * rate, 2 * rate**2, 2 * rate**3])
    assert bounds.c_e2 == pytest.approx(0.5 * 0.5 / 2)
    assert bounds.c_sigma == pytest.approx(0.5 / 2)
    assert bounds.u_m_dot == pytest.approx((2 * rate**2 + 2 * rate**3) / 2)


def test_a_sweep_is_marked_point_by_point():
    """phi_b below and above its least value, k_p at and beyond the design's interval."""
    study = dj.Study.from_table(table(sweep={"controller.functions.phi_b": [2.0, 8.0], "plant.k_p": [0.5, 0.9, 1.1]}))
    assert mark(study).certified.tolist() == [[False, False, False], [False, True, True]]
    result = dj.run(study)
    assert result.with_theorem().dataset["certified"].dims == ("controller.functions.phi_b", "plant.k_p")
    assert [point["certified"] for point in result.summary()["points"]] == [False] * 4 + [True] * 2


def test_a_point_without_sweep():
    study = dj.Study.from_table(table())
    assert mark(study).certified.shape == ()
    assert dj.run(study).summary()["points"][0]["certified"] is True


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"controller": {"kind": "pi", "l0": 0.5, "k_p": 1.0, "k_i": 1.0}}, "Table 1"),
        ({"disturbance": {"kind": "filtered_noise", "std": 0.1, "correlation_time": 1.0}}, "derivative"),
        (
            {
                "controller": table()["controller"]
                | {"functions": table()["controller"]["functions"] | {"phi_b": {"uniform": [6.0, 9.0]}}}
            },
            "uncertain",
        ),
    ],
)
def test_where_the_theorem_does_not_speak(changes, reason):
    found = mark(dj.Study.from_table(table(**changes)))
    assert found.certified is None
    assert reason in found.reason
    assert dj.run(dj.Study.from_table(table(**changes))).summary()["points"][0]["certified"] is None


def test_bounds_of_a_spline_are_kept_by_every_spline():
    """Knots at the ends of their laws, in any order of signs."""
    knots = [{"uniform": [-0.2, 0.1]}, {"uniform": [0.0, 0.3]}, 0.1]
    spline = {"kind": "spline", "knots": knots, "interval": 0.5}
    _, bounds = design_of(dj.Study.from_table(table(disturbance=spline)))
    assert bounds.alpha_d == 0.3
    assert bounds.alpha_d3 == pytest.approx((0.2 + 0.3) / 0.5)


def test_an_uncertain_nominal_control_counts_at_its_worst():
    """The mark of a law is that of both its ends together."""
    controller = table()["controller"]

    def marked(a):
        nominal = {"a": a, "k": 1.0, "predictor_term": False}
        return mark(dj.Study.from_table(table(controller=controller | {"nominal": nominal}))).certified.item()

    assert marked(0.5)
    assert not marked(1000.0)
    assert not marked({"uniform": [0.5, 1000.0]})
    assert marked({"uniform": [0.45, 0.55]})


def test_a_design_without_kappa_a_is_not_certified():
    """The bound of 1/tau_m in the nominal control divides by it."""
    controller = table()["controller"]
    functions = controller["functions"] | {"kappa_a": 0.0}
    study = dj.Study.from_table(
        table(controller=controller | {"functions": functions, "nominal": {"a": 1.0, "k": 1.0}})
    )
    assert mark(study).certified.item() is False


def test_a_users_own_plant_is_not_taken_for_the_class():
    from dssc_jax.models.plants.normal_form import NORMAL_FORM

    study = dj.Study.from_table(table())
    plant = NORMAL_FORM._replace(project=lambda params, state: state)
    own_plant = replace(study, loop=replace(study.loop, plant=plant))
    assert "class (5)-(8)" in mark(own_plant).reason


@pytest.mark.parametrize("amplitude", [{"normal": [0.0, 0.1]}, {"lognormal": [-3.0, 0.1]}])
def test_an_unbounded_disturbance_is_not_certified(amplitude):
    study = dj.Study.from_table(table(disturbance={"kind": "sine", "amplitude": amplitude, "period": 6.0}))
    assert mark(study).certified.item() is False


def test_an_unbounded_law_is_not_certified():
    study = dj.Study.from_table(table(plant={"kind": "normal_form", "a_p": {"normal": [0.0, 0.1]}}))
    assert mark(study).certified.item() is False


LAG = {"kind": "lag", "order": 2, "mu": 0.01}


@pytest.mark.parametrize(
    ("name", "values"),
    [("plant.k_p", (1.0, 0.2)), ("controller.functions.phi_b", (30.0, 1.0)), ("controller.l0", (0.5, 3.0))],
)
def test_the_certificate_reaches_as_far_as_the_marks_do(name, values):
    """Beside the value where it ends the theorem's own marks differ."""
    study = dj.Study.from_table(table(unmodelled=LAG))
    grid = np.linspace(*values, 9)
    found = reach(study, name, grid)
    assert found.value is not None
    assert min(values) < found.value < max(values)
    uncertified = found.value + (values[1] - values[0]) / 8 / 32**2
    ends = sorted([found.value, uncertified])
    marks = mark(study.override({"sweep": {name: ends}})).certified.tolist()
    assert marks == [end == found.value for end in ends]
    assert f"as far as {name}" in found.text


def test_a_walk_that_is_certified_as_a_whole_or_not_at_all():
    study = dj.Study.from_table(table())
    assert reach(study, "plant.k_p", np.linspace(0.9, 1.1, 5)).value == 1.1
    nowhere = reach(study, "plant.k_p", np.linspace(0.5, 0.1, 5))
    assert nowhere.value is None
    assert "does not certify the loop at plant.k_p = 0.5" in nowhere.text


def test_of_unmodelled_dynamics_the_theorem_knows_their_absence_only():
    study = dj.Study.from_table(table(unmodelled=LAG))
    assert reach(study, "unmodelled.mu", np.geomspace(1e-6, 1.0, 5)) == (
        0.0,
        "Theorem 1 certifies only the loop without unmodelled dynamics; it covers no unmodelled.mu > 0",
    )
    limited = study.override({"unmodelled": {"kind": "rate_limit", "rate": 10.0}})
    assert reach(limited, "unmodelled.rate", np.array([10.0, 0.1])) == (
        None,
        "Theorem 1 certifies only the loop without unmodelled dynamics; it covers no finite unmodelled.rate",
    )
    weak = study.override({"controller.functions.phi_b": 2.0})
    assert reach(weak, "unmodelled.mu", np.array([0.01, 1.0])).value is None
    assert "not even without" in reach(weak, "unmodelled.mu", np.array([0.01, 1.0])).text


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("loop.sample_time", "continuous time"),
        ("sensor.position_std", "as they are"),
        ("controller.rho", "for granted"),
    ],
)
def test_numbers_of_which_the_theorem_says_nothing(name, reason):
    found = reach(dj.Study.from_table(table()), name, np.array([0.1, 1.0]))
    assert found.value is None
    assert "does not cover" in found.text
    assert reason in found.text


def test_other_controllers_have_no_certificate():
    study = dj.Study.from_table(table(controller={"kind": "pi", "l0": 0.5, "k_p": 1.0, "k_i": 1.0}, unmodelled=LAG))
    for name in ("plant.k_p", "unmodelled.mu"):
        assert reach(study, name, np.array([1.0, 2.0])) == (
            None,
            "Theorem 1 does not apply: the controller is not DSSC with functions.kind = 'vgsta', those of Table 1",
        )


def test_how_much_wider_the_laws_may_be():
    """k_p within 1 +- 0.1 is certified from 0.896 on, hence 1.04 times as wide; a law without ends never is."""
    study = dj.Study.from_table(table())
    edge = reach(study, "plant.k_p", np.linspace(1.0, 0.2, 17)).value
    found = reach(study, "spread", np.linspace(0.0, 20.0, 21))  # wider than ten times is no law of k_p any more
    assert found.value == pytest.approx((1.0 - edge) / 0.1, abs=0.01)
    endless = study.override({"plant.a_p": {"normal": [0.0, 0.1]}})
    assert reach(endless, "spread", np.linspace(0.0, 2.0, 3)).value is None
