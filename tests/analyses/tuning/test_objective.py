"""Aggregates against their definitions, and their gradients against differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dssc_jax as dj
from dssc_jax.analyses.tuning.objective import Goal, draw_weights, missed_bounds
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.evaluation import Derivative

COSTS = st.lists(st.floats(0.0, 100.0), min_size=2, max_size=40).map(np.asarray)


@settings(max_examples=50, deadline=None)
@given(COSTS, st.sampled_from(["mean", "cvar", "worst"]), st.floats(0.05, 0.99))
def test_weights_are_weights(costs, aggregate, level):
    found = draw_weights(costs, aggregate, level)
    assert found.sum() == pytest.approx(1.0)
    assert np.all(found >= 0.0)
    assert np.mean(costs) - 1e-9 <= found @ costs <= np.max(costs) + 1e-9


@settings(max_examples=50, deadline=None)
@given(COSTS, st.floats(0.05, 0.99))
def test_cvar_is_its_variational_form(costs, level):
    """CVaR = min over c of c + E max(X - c, 0)/(1 - level), which is attained at one of the draws."""
    form = min(c + np.mean(np.maximum(costs - c, 0.0)) / (1.0 - level) for c in costs)
    assert draw_weights(costs, "cvar", level) @ costs == pytest.approx(form, rel=1e-9, abs=1e-9)


def lanes(x, requirements):
    """Two metrics of six draws as functions of one number, with their derivatives."""
    slope, offset = np.array([1.0, 2.0, -1.0, 0.5, 3.0, 0.0]), np.arange(6.0)
    a, b = offset + slope * x + x**2, 2.0 + offset - x
    results = {"a": a, "b": b, Derivative("a", "x"): slope + 2.0 * x, Derivative("b", "x"): np.full(6, -1.0)}
    for r in requirements:
        results[r.name] = r.slack(results[r.measure.name])
        sign = -1.0 if r.maximum is not None else 1.0
        results[Derivative(r.name, "x")] = sign * results[Derivative(r.measure.name, "x")]
    return results | {"outcome": np.full(6, int(Outcome.OK))}


@pytest.mark.parametrize("aggregate", ["mean", "cvar"])
def test_gradients_of_the_aggregate(aggregate):
    from dssc_jax.closed_loop.metrics.requirements import Requirement
    from dssc_jax.closed_loop.metrics.streaming import Measure, Window

    required = (Requirement(Measure("a", "error_rms", Window()), maximum=4.0),)
    goal = Goal({"a": 1.0, "b": 0.5}, aggregate, 0.6, {"b": 3.0}, required)
    at = goal.merit(lanes(0.3, required), ["x"])
    above, below = (goal.merit(lanes(0.3 + h, required), ["x"]) for h in (1e-6, -1e-6))
    assert at.gradient["x"] == pytest.approx((above.objective - below.objective) / 2e-6, rel=1e-6)
    for name in ("b", "requirements"):
        assert at.slopes[name]["x"] == pytest.approx((above.excess[name] - below.excess[name]) / 2e-6, rel=1e-6)
    assert at.excess["requirements"] > 0.0
    assert at.violation == max(at.excess.values())


def test_a_draw_that_ended_early_is_never_averaged_in():
    results = lanes(0.3, ())
    results["outcome"][2] = Outcome.NON_FINITE
    results["a"][2] = np.nan
    goal = Goal({"a": 1.0}, "cvar", 0.9, {}, ())
    assert goal.merit(results, ["x"]).violation == np.inf
    assert goal.value(goal.cost(results)) == np.inf


def test_the_soft_worst_is_near_the_worst():
    costs = np.random.default_rng(0).normal(size=200)
    assert 0.9 * costs.max() < draw_weights(costs, "worst", 0.95) @ costs <= costs.max()


def test_public_names():
    assert dj.tune.__name__ == "tune"
    assert dj.Tuned.__name__ == "Tuned"


def test_what_is_missed_is_named_with_its_size():
    study = dj.Study.from_table(
        {
            "name": "missed",
            "draws": 4,
            "loop": {"duration": 1.0, "sample_time": 0.1},
            "plant": {"kind": "normal_form"},
            "controller": {"kind": "pid", "k_p": 1.0},
            "requirement": [{"metric": "error_max", "max": 0.5}, {"metric": "settling_time", "max": 0.5}],
        }
    )
    error, settling = study.requirements
    results = {
        "outcome": np.array([0, 16, 16, 1]),
        error.name: np.array([0.1, -0.2, -0.3, -np.inf]),
        settling.name: np.array([0.1, 0.2, -np.inf, -np.inf]),
        "command_tv": np.array([1.0, 2.0, 3.0, np.nan]),
        "error_max": np.array([0.4, 0.7, 0.8, np.nan]),
    }
    goal = Goal({"error_max": 1.0}, "mean", 0.95, {"command_tv": 1.5}, study.requirements)
    missed = missed_bounds(goal, results, {"command_tv": "m/s"})
    assert [(bound.text, bound.draws, bound.unit) for bound in missed] == [
        ("runs to its end", 1, ""),
        ("error_max <= 0.5 m", 2, "m"),
        ("settling_time <= 0.5 s", 1, "s"),
        ("mean command_tv <= 1.5", None, "m/s"),
    ]
    np.testing.assert_allclose([bound.excess for bound in missed], [np.inf, 0.3, np.inf, 0.5])
    completed = {name: column[:3] for name, column in results.items()}
    merit = goal.merit(completed, ())
    assert np.isfinite(merit.violation)  # a draw that never settles leaves a direction to the search
    assert merit.violation > 0.0
