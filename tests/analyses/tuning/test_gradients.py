"""Forward-mode derivatives through the whole loop: against central differences, and finite where roots have cusps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.tuning.gradients import check_gradients, compare_derivatives
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.problem import Problem
from dssc_jax.core.signals import Measurement, ReferencePoint
from dssc_jax.engine import evaluation
from dssc_jax.engine.batching import lane_of_study
from dssc_jax.engine.evaluation import Derivative, Evaluator, GradientEvaluator
from dssc_jax.engine.plain import plain_options
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.study.components import parse_component
from tests.analyses.tuning.cases import SMALL
from tests.test_protocols import FUNCTIONS


def test_a_thousand_random_points():
    """Done-when: 95 % of 1,000 random points, away from kinks, to 1e-4 relative."""
    found = check_gradients(Problem(Plan.of(dj.Study.from_table(SMALL))), 1000)
    assert found.points == 1000
    assert found.compared == 1000 * 2 * 2  # metrics, coordinates
    assert found.agreeing > 0.95
    assert found.useful > 0.8
    assert found.predictive > 0.95
    assert found.finite


def test_wrong_derivatives_and_kinks_are_told_apart():
    x = np.linspace(-1.0, 1.0, 2001)  # one of them is 0
    slope = np.sign(x)
    smooth = compare_derivatives(slope, np.abs(x), slope, slope)
    assert (smooth.shares["kinks"], smooth.shares["agreeing"], smooth.worst()) == (0.0, 1.0, [])
    wrong = compare_derivatives(np.where(x > 0.9, 1.01, 1.001) * slope, np.abs(x), slope, slope)
    assert wrong.shares["agreeing"] == pytest.approx(1 / 2001)
    assert all(x[place] > 0.9 for place in wrong.worst())
    kink = compare_derivatives(slope, np.abs(x), np.where(x == 0.0, 1.0, slope), np.where(x == 0.0, -1.0, slope))
    assert kink.shares["kinks"] == pytest.approx(1 / 2001)
    assert kink.shares["agreeing"] == 1.0
    assert not compare_derivatives(np.array([np.nan]), np.ones(1), np.ones(1), np.ones(1)).shares["finite"]


@pytest.mark.parametrize("kind", FUNCTIONS)
def test_no_nan_at_the_origin(kind):
    """sigma = 0, e = 0, sigma_hat = 0 and u_av = 0, where |.|^(1/2), |.| and the clip have their corners."""
    table = {"kind": "dssc", "l0": 0.5, "rho": 2.0}
    part = parse_component({**table, "functions": {"kind": kind, **FUNCTIONS[kind]}}, CONTROLLERS, "controller")
    reference = ReferencePoint(0.0, 0.0, 0.0)

    def two_samples(gains, y, y_dot):
        state = part.model.init(gains, Measurement(y, y_dot), reference)
        for _ in range(2):
            state, command, info = part.model.step(gains, state, Measurement(y, y_dot), reference, 0.01)
        return state, command, info

    gains = jax.tree.map(jnp.asarray, part.params)
    slopes = jax.jacfwd(two_samples, argnums=(0, 1, 2))(gains, jnp.zeros(()), jnp.zeros(()))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


NUMBERS = ["controller.l0", "controller.functions.kappa1"]
ENDS = dict.fromkeys(NUMBERS, (1.0, 1.0))


def eight(evaluator):
    """Results of eight lanes."""
    return evaluator(np.arange(8), evaluator.values_of_draws(slice(0, 8)) | {name: np.ones(8) for name in NUMBERS})


def test_no_nan_in_a_loop_at_rest():
    """Nothing moves: every metric is 0, and so is every derivative."""
    rest = dj.Study.from_table(SMALL).override({"plant.initial": [0.0, 0.0], "disturbance.value": 0.0})
    results = eight(GradientEvaluator(rest, ENDS, 8, names=NUMBERS))
    for metric in ("error_rms", "command_tv"):
        assert np.all(results[metric] == 0.0)
        for name in NUMBERS:
            assert np.all(results[Derivative(metric, name)] == 0.0)


def test_the_derivatives_change_nothing_else():
    study = dj.Study.from_table(SMALL)
    with_them = eight(GradientEvaluator(study, ENDS, 8, names=NUMBERS))
    for name, values in eight(Evaluator(study, ENDS, 8)).items():
        assert np.allclose(with_them[name], values, rtol=1e-10, atol=0.0, equal_nan=True), name


def test_a_draw_that_ends_early_leaves_the_others_their_derivatives():
    """They share a tile: half of them overflow, and time goes on for the rest."""
    study = dj.Study.from_table(SMALL).override({"plant.a_p": {"choice": [1.0, -400.0]}, "loop.duration": 4.0})
    results = eight(GradientEvaluator(study, ENDS, 8, names=NUMBERS))
    ended = np.isfinite(results["failed_at"])
    assert 0 < np.count_nonzero(ended) < 8
    for name in NUMBERS:
        slopes = results[Derivative("error_rms", name)][~ended]
        assert np.all(np.isfinite(slopes) & (slopes != 0.0))


def bytes_of_reverse_mode(study):
    """Bytes that the compiled program of eight lanes takes beside its results."""
    numbers = dict.fromkeys([*study.laws, *NUMBERS], jax.ShapeDtypeStruct((8,), float))
    program = jax.jit(jax.vmap(evaluation.reverse_mode(study, NUMBERS)))
    compiled = program.lower(numbers, jax.ShapeDtypeStruct((8,), np.uint32)).compile(plain_options())
    return compiled.memory_analysis().temp_size_in_bytes


def test_reverse_mode_agrees_and_its_memory_is_bounded(monkeypatch):
    """16 times the samples cost 4 times the memory; without checkpoints 16 times."""
    short, long = (dj.Study.from_table(SMALL).override({"loop.duration": duration}) for duration in (3.0, 48.0))
    forward = eight(GradientEvaluator(long, ENDS, 8, names=NUMBERS))
    backward = eight(GradientEvaluator(long, ENDS, 8, names=NUMBERS, reverse=True))
    assert set(backward) == set(forward)
    for name, values in forward.items():
        assert np.allclose(backward[name], values, rtol=1e-9, atol=1e-12, equal_nan=True), name
    room = bytes_of_reverse_mode(long)
    assert room < 5.0 * bytes_of_reverse_mode(short)
    monkeypatch.setattr(evaluation, "lane_of_study", lambda study, axis_name, segment: lane_of_study(study, axis_name))
    assert bytes_of_reverse_mode(long) > 20.0 * room


@pytest.mark.parametrize(("change", "low", "high"), [({}, 0.6, 0.9), ({"tune.smoothing": 0.1}, 0.95, 1.0)])
def test_a_width_makes_derivatives_of_a_chattering_loop_tell(change, low, high):
    """Explicit Euler chatters: exact derivatives between two switchings say little of a step that moves them."""
    chattering = dj.Study.from_table(SMALL).override({"controller.discretisation": "explicit", **change})
    found = check_gradients(Problem(Plan.of(chattering)), 100)
    assert low < found.predictive <= high
    assert found.finite
    assert set(found.kinked["command_tv"]) == set(SMALL["tune"]["parameters"])
