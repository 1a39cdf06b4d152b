"""A whole tuning: the verdict is what anyone can run again, limits hold, every iterate is certified."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.tuning.objective import draw_weights
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.problem import Problem
from dssc_jax.design.certification import mark
from tests.analyses.tuning.cases import CERTIFIED, SMALL

PI = {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 1.0}


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(SMALL)


@pytest.fixture(scope="module")
def tuned(study):
    return dj.tune(study)


def cvar(study):
    costs = dj.run(study).dataset["error_rms"].values
    return draw_weights(costs, "cvar", 0.95) @ costs


def test_the_verdict_is_that_of_two_runs(study, tuned):
    """Start and result on the study's own draws, by `run` of both studies."""
    found = tuned.verdict
    assert found.draws == 48
    assert found.objective == pytest.approx((cvar(study), cvar(tuned.tuned_study)), rel=1e-9)
    assert found.reduction > 0.05
    assert found.reduction_interval[0] < found.reduction < found.reduction_interval[1]
    assert found.difference[2] < 0.0


def test_limits_hold_where_the_choice_was_made(tuned):
    assert tuned.facts.feasible
    best = min((r for r in tuned.history if r["validation_violation"] == 0.0), key=lambda r: r["validation"])
    assert tuned.values == pytest.approx({name: best[name] for name in tuned.values}, rel=1e-12)
    assert tuned.met


def test_what_trains_validates_and_decides_is_disjoint(study):
    problem = Problem(Plan.of(study))
    own = np.array(list(dj.run(study).dataset["plant.k_p"].values))
    train, validation = (problem.laws["plant.k_p"][part] for part in (problem.train, problem.validation))
    assert not set(own) & set(train)
    assert not set(own) & set(validation)
    assert not set(train) & set(validation)


def test_mini_batches(study):
    changes = {"tune.batch": 8, "tune.schedule": "constant", "tune.optimiser": "nadam", "tune.limits": {}}
    found = dj.tune(study.override({"tune.steps": 5, **changes}))
    assert found.verdict.reduction > 0.0


@pytest.mark.parametrize("optimiser", ["adam", "sqp"])
def test_the_sign_is_smoothed_less_and_less(study, optimiser, monkeypatch):
    """The program with derivatives ends with the exact loop, which alone validates and judges."""
    widths = []
    with_derivatives = Problem.with_derivatives

    def watched(self, *arguments):
        widths.append(self.width)
        return with_derivatives(self, *arguments)

    monkeypatch.setattr(Problem, "with_derivatives", watched)
    found = dj.tune(study.override({"tune.smoothing": 0.1, "tune.optimiser": optimiser, "tune.steps": 10}))
    assert widths[0] == 0.1
    assert widths[-1] == 0.0
    assert widths == sorted(widths, reverse=True)
    assert found.verdict.reduction > 0.0
    assert "controller.sign_width" not in found.tuned_study.leaves()


def test_quadratic_programming_needs_fewer_steps(study, tuned):
    """On the same draws it ends within the limits with a lower objective than descent, after a third of the steps."""
    found = dj.tune(study.override({"tune.optimiser": "sqp", "tune.steps": 5}))
    assert found.met
    assert len(found.history) <= 6
    assert found.verdict.objective[1] < tuned.verdict.objective[1]


def test_slacks_of_the_theorem_as_constraints():
    """Numbers of Table 1 tuned themselves: every iterate is certified, and the result keeps the slack."""
    origin = Plan.of(dj.Study.from_table(CERTIFIED)).coordinates
    start = {name: float(value[0]) for name, value in origin.numbers(origin.origin[None]).items()}
    roomy = {name: start[name] * 1.3 for name in start if "kappa_" in name}
    free = {name: [0.3 * value, 3.0 * value] for name, value in roomy.items() if name[-1] in "cd"}
    plain = {"certified": False, "free": {}, "parameters": free, "slack": 0.005, "limits": {"sampling_ratio": 0.9}}
    table = {**CERTIFIED["tune"], **plain, "optimiser": "sqp"}
    study = dj.Study.from_table(CERTIFIED).override({**start, **roomy, "loop.sample_time": 0.005, "tune": table})
    found = dj.tune(study)
    assert found.met
    assert mark(found.tuned_study).certified
    assert found.verdict.objective[1] < found.verdict.objective[0]
    with pytest.raises(dj.ConfigError, match="slack: the start is infeasible: slack of kappa_c"):
        dj.tune(study.override({"controller.functions.kappa_c": roomy["controller.functions.kappa_c"] / 1.6}))


def test_certified_iterates(monkeypatch):
    """Every point that is simulated in the search has passed the strict check."""
    visited, checked = [], []
    differentiate = Problem.differentiate
    is_admissible = Problem.is_admissible
    monkeypatch.setattr(
        Problem, "differentiate", lambda self, z, draws: visited.append(z.tobytes()) or differentiate(self, z, draws)
    )
    monkeypatch.setattr(
        Problem, "is_admissible", lambda self, z: is_admissible(self, z) and not checked.append(z.tobytes())
    )
    found = dj.tune(dj.Study.from_table(CERTIFIED))
    origin = found.plan.coordinates.origin.tobytes()
    assert len(checked) >= 10
    assert set(visited) <= {origin, *checked}
    assert mark(found.tuned_study).certified
    assert found.verdict.objective[1] < found.verdict.objective[0]


def test_evolution_where_it_is_asked_for(study):
    found = dj.tune(study.override({"tune.optimiser": "differential_evolution", "tune.steps": 5}))
    assert found.gradients is None
    assert found.facts.method == "differential_evolution"
    assert found.verdict.reduction > 0.0


def test_evolution_where_derivatives_are_useless(study, monkeypatch):
    """A metric that counts is piecewise constant: its derivatives are 0 and differences jump; here they are spoilt."""
    from dssc_jax.analyses.tuning import gradients

    monkeypatch.setattr(gradients, "AGREEMENT", -1.0)
    monkeypatch.setattr(gradients, "DIFFERENCE_NOISE", 0.0)
    found = dj.tune(study.override({"tune.steps": 5}))
    assert found.gradients.useful == 0.0
    assert found.facts.method == "differential_evolution"


def test_counterexamples(study):
    """Eight draws do not show the worst corner: the hunt does, and the next round meets the requirement there."""
    effort = {
        "controller.discretisation": "implicit",
        "tune.objective": {"command_tv": 1.0},
        "tune.aggregate": "mean",
        "tune.limits": {},
    }
    few = {"tune.draws": 8, "tune.validation": 8, "tune.steps": 20}
    hard = study.override({"requirement": [{"metric": "error_max", "after": 2.5, "max": 0.25}], **effort, **few})
    found = dj.tune(hard, robust=True, rounds=4, budget=64)
    slacks = [hunt.worst.slack for hunt in found.facts.counterexamples]
    assert slacks[0] < 0.0 <= slacks[-1]
    assert found.met
    interval = dj.run(found.tuned_study.override({"draws": 2000})).summary()["points"][0]["interval"]
    assert interval[1] < 0.01


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"tune.parameters": {"controller.l1": [1.0, 2.0]}}, "unknown parameter; did you mean 'controller.l0'"),
        ({"tune.parameters": {"controller.kind": [1.0, 2.0]}}, "'dssc', which has no derivative"),
        ({"tune.parameters": {"controller.discretisation": [1.0, 2.0]}}, "no number that may be moved"),
        ({"tune.parameters": {"loop.substeps": [1.0, 2.0]}}, "no number that may be moved"),
        ({"tune.parameters": {"controller.functions.k_o": [1.0, 2.0]}}, "give one of k_o and tau_av"),
        ({"tune.parameters": {"plant.k_p": [0.5, 2.0]}}, "is uncertain: uniform"),
        ({"tune.parameters": {"controller.l0": [2.0, 3.0]}}, "the start is infeasible: the study has 1"),
        ({"tune.parameters": {"controller.l0": [2.0, 1.0]}}, "0 < low < high"),
        ({"tune.parameters": {}}, "names nothing to tune"),
        ({"tune.objective": {"error": 1.0}}, "no metric of this study"),
        ({"tune.objective": {"error_rms": 0.0}}, "a weight other than 0"),
        ({"tune.limits": {"command": 1.0}}, "did you mean 'command_tv'"),
        ({"tune.limits": {"command_tv": 0.0}}, "must be a number > 0, or 'start'"),
        ({"tune.optimiser": "adma"}, "did you mean 'adam'"),
        ({"tune.seed": 5}, "must not be the study's own"),
        ({"sampling": "sobol", "draws": 64}, "a tuning's verdict needs independent draws"),
        ({"tune.batch": 64}, "must be <= draws = 32"),
        ({"tune.batch": 8, "tune.optimiser": "sqp"}, "needs the same draws at every step"),
        ({"tune.slack": 0.1}, "Theorem 1 does not speak of this loop"),
        ({"tune.smoothing": 0.1, "controller.sign_width": 0.1}, "take sign_width out of"),
        ({"tune.smoothing": 0.1, "controller": PI}, "this controller has none"),
        ({"tune.certified": True}, "is fixed by the certified design"),
        ({"tune.certified": True, "tune.parameters": {}}, "free.l0: is required and missing"),
        ({"tune.free": {"eps": 1.0}}, "belongs to certified = true"),
        ({"tune.stpes": 3}, "did you mean 'steps'"),
        (
            {"requirement": [{"metric": "error_rms", "max": 1.0}, {"metric": "error_rms", "min": 2.0}]},
            "nothing can satisfy both",
        ),
        ({"requirement": [{"metric": "command_tv", "min": 0.5}]}, "tune.limits.command_tv: no value of command_tv is"),
        ({"unmodelled": {"kind": "delay", "samples": 1.0}, "tune.parameters": {"unmodelled.memory": [1, 30]}}, "fixed"),
    ],
)
def test_bad_input_is_said_before_compiling(study, change, rule, monkeypatch):
    from dssc_jax.engine.batching import Engine

    monkeypatch.setattr(Engine, "compiled", lambda self, *a: pytest.fail("compiled"))
    with pytest.raises(dj.ConfigError, match=rule):
        dj.tune(study.override(change))


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"controller.nominal.predictor_term": True}, "cannot be certified while tuning"),
        ({"tune.parameters": {"controller.functions.gamma": [0.5, 2.0]}}, "is fixed by the certified design"),
        ({"tune.parameters": {"controller.nominal.a": [0.5, 2.0]}}, "is what the theorem's bounds are made of"),
        ({"tune.slack": 0.1}, "meets the inequalities by construction"),
        ({"disturbance": {"kind": "filtered_noise", "std": 0.1, "correlation_time": 1.0}}, "no known bound"),
        ({"tune.free.eps_9": 1.0}, "did you mean 'eps"),
        ({"tune.free": dict.fromkeys(CERTIFIED["tune"]["free"], 1.0)}, "varies nothing"),
    ],
)
def test_bad_input_of_certified_tuning(change, rule):
    with pytest.raises(dj.ConfigError, match=rule):
        dj.tune(dj.Study.from_table(CERTIFIED).override(change))


def test_a_study_without_a_tuning(study):
    table = {name: value for name, value in SMALL.items() if name != "tune"}
    with pytest.raises(dj.ConfigError, match="tune: is required and missing"):
        dj.tune(dj.Study.from_table(table))
    with pytest.raises(dj.ConfigError, match="nothing is required"):
        dj.tune(study, robust=True)


def test_a_start_whose_draws_end_early(study):
    """Found by the first batch: an integrator of unstable plant and reversed gain overflows."""
    broken = study.override({"plant.a_p": -400.0, "loop.duration": 4.0, "disturbance.at": 1.0})
    with pytest.raises(dj.ConfigError, match="the start is infeasible: 32 training draws end early"):
        dj.tune(broken)
