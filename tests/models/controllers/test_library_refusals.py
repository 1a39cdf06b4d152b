"""Libraries and studies that are refused, by name, and what searches do without derivatives."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.exact_rates import rate_warning
from dssc_jax.engine.evaluation import GradientEvaluator
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.flight_code.template_files import template_text
from tests.models.controllers.libraries import built, table


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "const real error = ",
            "static real kept; kept += 1; const real error = kept + ",
            "outside of its",
        ),
        (
            "const real error = ",
            "static real kept; kept += measurement.y > 100.0; const real error = kept + ",
            "outside of its",
        ),
        ("DSSC_JAX_LIBRARY_OF(&my_description);", "", "exports no dssc_jax_controllers"),
        ("my, T_S, my_parameter", "my, 0.0, my_parameter", "the sample time must be positive"),
        ('my, k_d, "u s/y"', 'my, k_p, "u s/y"', "has a number 'k_p' in its controller my"),
        (
            "    real y_dot; /* its",
            "    real current; real y_dot; /* its",
            "3 numbers in its",
        ),
        ("    real k_d;", "    float k_d;", "must have one type"),
        (
            "    controller->state.filtered = 0;\n    controller->started = false;",
            "(void)controller;",
            "repeated after reset",
        ),
        (
            "    controller->started = false;",
            "    controller->started = false;\n    my_init(controller);",
            "parameter k_p",
        ),
        (
            "command->u_n = 0;",
            "command->u_n = telemetry == NULL;",
            "other commands where it gets NULL for its telemetry",
        ),
        ("u_p = command->u + command->u_n", "u_p = 0.5 * command->u", r"whose u_p is not u \+ u_n: .* flight it gives"),
    ],
)
def test_a_wrong_library_is_refused(place, old, new, message):
    text = template_text("library.c")
    assert old in text
    name = f"wrong_{abs(hash(new))}"
    with pytest.raises(ConfigError, match=message):
        dj.allow_native(built(place, name, text.replace(old, new)))


def test_what_is_no_library_is_refused(place):
    (place / "text.so").write_text("no shared object")
    with pytest.raises(ConfigError, match=r"'.*text.so' cannot be loaded"):
        dj.allow_native(place / "text.so")
    with pytest.raises(ConfigError, match="cannot be read"):
        dj.allow_native(place / "none.so")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"loop.sample_time": 0.02}, "loop.sample_time: must be 0.01 s, a constant of the controller my"),
        ({"controller.k_q": 1.0}, "controller.k_q: unknown name; did you mean 'k_p'"),
        ({"controller.k_p": -1.0}, "controller.k_p: proportional gain"),
        ({"controller.name": "mine"}, "controller.name: '.*' has no controller 'mine'; valid names are my"),
    ],
)
def test_a_wrong_study_is_refused(study, changes, message):
    with pytest.raises(ConfigError, match=message):
        study.override(changes)


def test_a_library_of_doubles_needs_a_loop_of_doubles(study, tmp_path):
    with pytest.raises(ConfigError, match="must be 64, the precision of the controller my"):
        dj.run(study.override({"loop.precision": 32}), tmp_path / "narrow")


def test_derivatives_are_refused_by_name(study):
    steep = GradientEvaluator(study, {}, 8, names=["controller.k_p"])
    with pytest.raises(ConfigError, match=r"is native code .* no derivative passes"):
        steep(np.zeros(1, int), {name: np.ones(1) for name in study.laws})
    with pytest.raises(ConfigError, match="is native code, which has no derivative"):
        dj.loop_margins(study)
    with pytest.raises(ConfigError, match="is native code already"):
        FlightFolder(study)


def test_searches_do_without_derivatives(study):
    found = dj.falsify(study, budget=64)
    assert found.simulations >= 48
    tune = {"objective": {"error_rms": 1.0}, "draws": 8, "validation": 8, "steps": 2}
    ranges = {"controller.k_p": [1.0, 8.0], "controller.k_d": [1.0, 8.0]}
    content = {**study.table, "tune": {**tune, "parameters": ranges}}
    content["controller"] = {**content["controller"], "k_p": 2.0}
    tuned = dj.tune(dj.Study.from_table(content))
    assert tuned.facts.method == "differential_evolution"


def test_a_library_is_asked_whether_it_takes_the_rate(template):
    """It is called in the loop's precision, outside of any loop; y' of a lag contains the disturbance."""
    lag = {"kind": "state_space", "a": [[-1.0]], "b": [1.0], "c": [1.0]}
    file = table(template, sha256=dj.allow_native(template).sha256)
    content = {**file, "plant": lag, "disturbance": {"kind": "step", "value": 0.1, "at": 0.5}}
    assert "an exact y' shows it at once" in str(rate_warning(dj.Study.from_table(content)))
