"""Formulas of signal temporal logic: grammar, robustness against the definitions, derivatives, times, refusals."""

import jax
import numpy as np
import pytest

import dssc_jax as dj
from benchmarks.formulas.random_formulas import T_S, random_formula, random_signals, reach, robustness, text_of
from benchmarks.formulas.streamed import lane_of, parsed
from dssc_jax import lanes
from dssc_jax.closed_loop.metrics.formulas import memory_size
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.plain import plain_options
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.passes.liveness import operation_counts

SCALES = np.array([1.0, 0.5, -2.0])  # powers of two: their products are exact, contracted or not
STEPS = 30


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def test_random_formulas_have_the_robustness_of_the_definitions_by_both_programs():
    rng = np.random.default_rng(41)
    operators = set()
    for _ in range(12):
        formula = random_formula(rng, 4, 16)
        signals = random_signals(rng, STEPS)
        assert reach(formula) < STEPS
        lane = lane_of(parsed(text_of(formula), T_S, STEPS), signals)
        values, _ = lanes.compile(lane, 1.0, strict=True)(SCALES)
        plain, _ = jax.jit(jax.vmap(lane), compiler_options=plain_options())(SCALES)
        scaled = [{name: scale * column for name, column in signals.items()} for scale in SCALES]
        expected = [robustness(formula, columns, 0) for columns in scaled]
        np.testing.assert_array_equal(values, plain)
        np.testing.assert_allclose(values, expected, rtol=1e-14, atol=1e-14)
        operators |= set(str(formula).replace("(", "").replace("'", "").split(", "))
    assert operators >= {"not", "and", "or", "implies", "always", "eventually", "until"}


def certain_after(text, e, u=None):
    """Number of samples after which the truth of a formula of one flight is certain, and its robustness."""
    signals = {"e": np.asarray(e, float), "u": np.zeros(len(e)) if u is None else np.asarray(u, float)}
    value, samples = lane_of(parsed(text, 1.0, len(e)), signals)(1.0)
    return int(samples), float(value)


def test_when_a_violation_is_certain():
    e = [0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0]
    assert certain_after("always[0,9] e < 2", e) == (4, -2.0)  # at the sample itself
    assert certain_after("always[4,9] e < 2", e) == (8, -2.0)
    assert certain_after("eventually[0,6] e > 3.5", e) == (7, -0.5)  # where its interval ends
    assert certain_after("eventually[0,6] e > 2", e) == (4, 1.0)
    assert certain_after("not eventually[0,9] e > 2", e) == (4, -2.0)
    assert certain_after("always[0,5] eventually[0,2] e > 1", e) == (3, -1.0)  # nothing at 0, 1 and 2
    assert certain_after("always[0,9] e < 2 and eventually[0,1] e > 1", e) == (2, -2.0)  # the part that breaks first
    assert certain_after("always[0,9] e < 2 or eventually[0,1] e > 1", e) == (4, -1.0)  # the part that breaks last
    assert certain_after("e < 1 until[0,9] u > 0.5", e) == (4, -0.5)
    assert certain_after("e < 5 until[0,5] u > 0.5", e) == (6, -0.5)
    assert certain_after("e > 1", e) == (1, -1.0)


def test_memory_is_that_of_the_windows_within_other_operators():
    """At most two numbers for each sample of an interval, and none for outermost operators; however long the flight."""
    steps = 10**6
    assert memory_size(parsed("always[5,20] abs(e) < 0.1 and eventually e < 0", 0.01, steps)) == 0
    nested = parsed("eventually[0,3] always[0,2] abs(e) < 0.05", 0.01, steps)
    assert memory_size(nested) == 200
    assert memory_size(parsed("always (e < 1 until[1,2] u > 0)", 0.01, steps)) <= 2 * 100 + 100 + 101


def test_delay_lines_are_memory_in_machine_code():
    """Four hundred numbers that a loop carries are an array, which costs no operation for each of them."""
    counts = []
    for seconds in (1.0, 4.0):
        formula = parsed(f"eventually[0,3] always[0,{seconds}] abs(e) < 0.05", 0.01, 1000)
        lane = lane_of(formula, random_signals(np.random.default_rng(1), 1000))
        program = CompiledLanes(lane, jax.ShapeDtypeStruct((), np.float64), strict=True).traced.program
        counts.append(operation_counts(program))
    assert counts[1]["read"] == counts[0]["read"] + 2
    assert sum(counts[1].values()) < 1.5 * sum(counts[0].values()) < 400


@pytest.mark.parametrize("width", [0.0, 0.05])
def test_derivatives_are_finite_and_those_of_the_smooth_robustness(width):
    rng = np.random.default_rng(5)
    text = "always[0,20] (abs(e) < 3 or eventually[0,2] e < 0.5) and not (u > 3 until[1,6] abs(e - e) > 0)"
    signals = random_signals(rng, 40)
    signals["e"][7:12] = signals["e"][6]  # ties
    lane = lane_of(parsed(text, 1.0, 40), signals, width)

    def value(scale):
        return lane(scale)[0]

    exact = lane_of(parsed(text, 1.0, 40), signals)
    for scale in (1.0, 0.3, 0.0):
        forward = jax.jvp(value, (scale,), (1.0,))
        reverse = jax.grad(value)(scale)
        assert np.isfinite(forward[1])
        assert np.isfinite(reverse)
        assert forward[0] == exact(scale)[0]
        np.testing.assert_allclose(forward[1], reverse, rtol=1e-12)
    (compiled,) = lanes.compile(lambda s: (jax.jvp(value, (s,), (1.0,))[1],), 1.0)(np.array([0.3]))
    np.testing.assert_allclose(compiled, jax.jvp(value, (0.3,), (1.0,))[1], rtol=1e-10)


def test_the_smooth_robustness_is_that_of_logarithms_of_sums():
    """For ``always``, its derivative is the mean of the samples' derivatives with the weights of a softmin."""
    e = np.array([0.5, 0.9, 0.85, 0.2])
    width = 0.1
    lane = lane_of(parsed("always e < 1", 1.0, 4), {"e": e, "u": e}, width)
    weights = np.exp(-(1.0 - e) / width)
    np.testing.assert_allclose(jax.grad(lambda s: lane(s)[0])(1.0), -weights @ e / weights.sum(), rtol=1e-12)


def study(*formulas, **tables):
    return dj.Study.from_table(
        {
            "name": "formulas",
            "draws": 16,
            "parameters": {"bound": 0.1, "free": {"uniform": [0.1, 0.2]}},
            "loop": {"duration": 4.0, "sample_time": 0.02},
            "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "initial": [1.0, 0.0]},
            "controller": {"kind": "pid", "k_p": 6.0, "k_i": 2.0, "k_d": 3.0},
            "requirement": [{"formula": formula} for formula in formulas],
            **tables,
        }
    )


def test_a_run_judges_the_formula_and_tells_what_fails_first():
    late = "always[3,3.5] abs(e) < bound/20"
    result = dj.run(study(late, "abs(e) < 2 until[0,3] always[0,0.5] abs(e) < 0.25*bound", "eventually e < -0.05"))
    data = result.dataset
    e = np.stack([dj.simulate(result.study, draw=i).e.values for i in range(16)])
    np.testing.assert_allclose(data.slack_formula_1, (0.005 - np.abs(e[:, 150:176])).min(1), rtol=1e-9, atol=1e-12)
    windows = np.stack([np.abs(e[:, k : k + 26]).max(1) for k in range(151)])
    np.testing.assert_allclose(data.slack_formula_2, (0.025 - windows).max(0), rtol=1e-9, atol=1e-12)
    (point,) = result.summary()["points"]
    assert [row["name"] for row in point["requirements"]] == ["formula_1", "formula_2", "formula_3"]
    assert point["requirements"][0]["text"] == f"formula_1: {late}"
    violated = np.abs(e[:, 150:176]) > 0.005
    first = np.where(violated.any(1), 3.0 + 0.02 * violated.argmax(1), np.nan)
    np.testing.assert_allclose(data.violated_at_formula_1, first)
    times = np.stack([data[f"violated_at_formula_{i}"].values for i in (1, 2, 3)])
    counted = [row["first"] for row in point["requirements"]]
    failed = np.isfinite(times).any(0)
    earliest = np.nanargmin(times[:, failed], axis=0)
    assert counted == [int((earliest == i).sum()) for i in range(3)]
    assert sum(counted) == point["failures"] > 0


def test_strict_machine_code_has_the_bits_of_plain_xla_on_the_loop_with_a_formula():
    from dssc_jax.engine.batching import Engine, evaluate, values_of_draws
    from dssc_jax.engine.reference import plain_results

    nested = study("always[0,1] eventually[0,1] abs(e) < 0.5")
    values = values_of_draws(nested, slice(0, 16))
    strict = evaluate(Engine(nested, 16, kernel="strict"), values, np.arange(16))
    plain = plain_results(nested, values, np.arange(16))
    np.testing.assert_allclose(strict["formula_1"], plain["formula_1"], rtol=1e-12)


REFUSED = {
    "always[0,5] abs(e) < 1": "needs 5 s of flight, and the last sample is at 3.98 s",
    "always[0,1] eventually e < 1": "an operator within another one needs an interval",
    "always[0.001,0.002] e < 1": "holds no sample: T_s is 0.02 s",
    "always[2,1] e < 1": "needs 0 <= begin <= end",
    "always[0,1] ee < 1": "'ee' is neither a signal nor a parameter",
    "always[0,1] e < free": "depends on the law of parameters.free",
    "always[0,1] e == 1": "equality of real numbers has no robustness",
    "always[0,1] bound < 1": "compares no signal",
    "always[0,1] (e < 1": "expected ')'",
    "always[0,1] e < 1 e": "is no expression",
    "e < 1 and": "expected an expression, got 'the end'",
    "e < 1 # 2": "'#' is not admissible in a formula",
    "not not not not not " * 8 + "e < 1": "nested too deeply",
    "always e < abs()": "abs takes one argument",
    "": "expected an expression",
}


@pytest.mark.parametrize("text", REFUSED)
def test_a_formula_that_is_not_one_is_refused(text):
    with pytest.raises(ConfigError) as caught:
        study(text)
    assert REFUSED[text] in str(caught.value)
    assert "requirement.0.formula" in str(caught.value)


def test_precedence_and_words():
    e = np.linspace(-1.0, 1.0, 5)
    for text, same in (
        ("always[0,4] e < 2 and e < -0.5 or u > 1", "((always[0,4] (e < 2)) and (e < -0.5)) or (u > 1)"),
        ("e < 0 -> u > 0 -> e > 0", "(e < 0) implies ((u > 0) implies (e > 0))"),
        ("-1.5 < e < 2*(e + 1.5)", "(-1.5 < e) and (e < 2*(e + 1.5))"),
        ("not e < 0 until[0,2] u < 1 and e < 0", "((not (e < 0)) until[0,2] (u < 1)) and (e < 0)"),
        ("always[0.1,1.9] e < 0", "always[1,1] e < 0"),
    ):
        values = [certain_after(formula, e, np.cos(e)) for formula in (text, same)]
        assert values[0] == values[1]


def test_an_interval_up_to_the_last_sample_and_one_beyond():
    """The flight's samples end one before its duration; the robustness is that of the trajectory's own samples."""
    table = {
        "name": "end",
        "draws": 2,
        "loop": {"duration": 4.0, "sample_time": 0.02},
        "plant": {"kind": "normal_form", "k_p": {"uniform": [0.5, 1.5]}, "initial": [1.0, 0.0]},
        "controller": {"kind": "pid", "k_p": 1.0, "k_d": 0.1},
    }
    study = dj.Study.from_table(table | {"requirement": [{"formula": "always[2,3.98] abs(e) < 1"}]})
    errors = np.abs(dj.simulate(study, draw=1)["e"].values)
    assert len(errors) == 200
    found = dj.run(study, check=False).dataset["slack_formula_1"].values[1]
    assert found == pytest.approx(1.0 - errors[100:].max(), abs=1e-12)
    with pytest.raises(ConfigError, match=r"by 0\.02 s, or set loop\.duration = 4\.02"):
        dj.Study.from_table(table | {"requirement": [{"formula": "always[2,4] abs(e) < 1"}]})
