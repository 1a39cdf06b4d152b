"""How wrong the laws may be, on a loop whose failure is a half space, and with the changed laws in the study file."""

import copy

import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.statistics import clopper_pearson

EDGE = 1.7
"""Standard deviations from the mean of the initial value to the largest error allowed."""

TABLE = {
    "name": "start",
    "seed": 4,
    "draws": 4000,
    "loop": {"duration": 0.5, "sample_time": 0.05},
    "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "initial": [{"normal": [2.0, 0.1]}, 0.0]},
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.5},
    "requirement": [{"metric": "error_max", "max": 2.0 + 0.1 * EDGE}],
}
INITIAL = "plant.initial.0"


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(copy.deepcopy(TABLE))


@pytest.fixture(scope="module")
def result(study):
    return dj.run(study, check=False)


@pytest.fixture(scope="module")
def found(result):
    return dj.laws(result, limit=0.1, within={"kl": 0.02, "total_variation": 0.01}, shift=0.2, widening=1.1, fresh=2000)


def probability(study, law):
    """Failure probability with another law of the initial value, on other draws."""
    changed = dj.run(study.override({"plant.initial": [law, 0.0], "seed": 99, "draws": 20_000}), check=False)
    return float(changed.failed.mean())


def test_the_failure_is_a_half_space(study, result):
    failing = result.dataset[INITIAL].values > 2.0 + 0.1 * EDGE
    np.testing.assert_array_equal(result.failed.values, failing)


def test_radii_follow_from_the_exact_interval(found, result):
    failures = int(result.failed.sum())
    _, high = clopper_pearson(failures, 4000)
    answer = found.answer
    assert answer.failure.failures == failures
    assert answer.failure.interval[1] == pytest.approx(high)
    assert answer.total_variation == pytest.approx(0.1 - high)
    assert answer.kl == pytest.approx(0.1 * np.log(0.1 / high) + 0.9 * np.log(0.9 / (1.0 - high)))
    assert answer.chi_square == pytest.approx((0.1 - high) ** 2 / (high * (1.0 - high)))
    assert answer.estimates.total_variation == pytest.approx(0.1 - failures / 4000)


def test_shift_and_widening_are_those_of_the_half_space(found):
    answer = found.answer
    shift = EDGE - stats.norm.isf(0.1)
    widening = EDGE / stats.norm.isf(0.1)
    assert answer.estimates.mean_shift == pytest.approx(shift, rel=0.1)
    assert 0.7 * shift < answer.mean_shift < shift
    assert answer.estimates.widening == pytest.approx(widening, rel=0.05)
    assert 1.0 < answer.widening < widening
    assert answer.guaranteed.mean_shift < shift
    assert answer.most_important == INITIAL
    alone = answer.by_law[INITIAL]
    assert alone.mean_shift_estimate == pytest.approx(shift, rel=0.1)
    assert alone.towards == "larger"
    assert alone.median == 2.0
    assert alone.shifted_median == pytest.approx(2.0 + 0.1 * alone.mean_shift)
    assert alone.in_worst_shift == pytest.approx(answer.estimates.mean_shift, rel=1e-3)
    assert answer.by_law["plant.k_p"].mean_shift_estimate is None
    assert answer.by_law["plant.k_p"].mean_shift > 1.0


def test_a_study_with_the_changed_law_fails_as_often(study, found):
    """The shift and the width as a user writes them into the study file."""
    estimates = found.answer.estimates
    shifted = probability(study, {"normal": [2.0 + 0.1 * estimates.mean_shift, 0.1]})
    widened = probability(study, {"normal": [2.0, 0.1 * estimates.widening]})
    assert shifted == pytest.approx(0.1, abs=0.01)
    assert widened == pytest.approx(0.1, abs=0.01)
    assert probability(study, {"normal": [2.0 + 0.1 * found.answer.mean_shift, 0.1]}) < 0.1


def test_what_to_measure_next(found, result):
    """Only the initial value decides; failures are its upper tail."""
    answer = found.answer
    assert answer.measure_next == INITIAL
    knowledge = answer.by_law[INITIAL].knowledge
    p = stats.norm.sf(EDGE)
    assert knowledge.parts == 10
    low, high = knowledge.removed_interval
    assert low < p / (1.0 - p) * 9.0 < high  # all failures lie in the last tenth: (10 - 1) p / (1 - p)
    assert knowledge.changes == pytest.approx(0.1)
    assert knowledge.changes_interval[0] <= 0.1 <= knowledge.changes_interval[1]
    failing = result.dataset[INITIAL].values[result.failed.values]
    np.testing.assert_allclose(answer.by_law[INITIAL].failing, np.quantile(failing, [0.05, 0.5, 0.95]), rtol=1e-3)
    low, high = answer.by_law[INITIAL].failing_median_interval
    assert low < 2.0 + 0.1 * stats.norm.isf(0.5 * p) < high
    other = answer.by_law["plant.k_p"].knowledge
    assert other.removed_interval[0] < 0.0 < other.removed_interval[1]


def test_new_draws_agree(found):
    fresh = found.answer.fresh
    assert fresh is not None
    assert fresh.draws == 2000
    assert fresh.simulations >= 2000
    shift = fresh.changes["mean_shift"]
    assert shift.estimate == pytest.approx(EDGE - stats.norm.isf(0.1), rel=0.15)
    assert shift.bound < shift.estimate
    assert shift.interval[1] <= 0.1
    widening = fresh.changes["widening"]
    assert widening.estimate == pytest.approx(EDGE / stats.norm.isf(0.1), rel=0.08)


def test_stated_amounts(found):
    low, high = found.interval
    kl, variation, shift, widening = found.answer.stated
    assert [one.kind for one in found.answer.stated] == ["kl", "total_variation", "mean_shift", "widening"]
    assert kl.interval[0] < low
    assert kl.interval[1] > high
    assert variation.interval == pytest.approx((low - 0.01, high + 0.01))
    for stated, truths in (
        (shift, (stats.norm.sf(EDGE + 0.2), stats.norm.sf(EDGE - 0.2))),
        (widening, (stats.norm.sf(EDGE), stats.norm.sf(EDGE / 1.1))),
    ):
        for interval in (stated.interval, stated.weighted_interval):
            assert interval[0] <= truths[0]
            assert truths[1] <= interval[1]
        assert stated.weighted_interval[1] < stated.interval[1]


def test_of_a_study_and_of_its_result(study, result):
    assert dj.laws(study, limit=0.1).answer.by_law == dj.laws(result, limit=0.1).answer.by_law


def test_a_limit_that_is_exceeded_already(result):
    found = dj.laws(result, limit=0.01)
    answer = found.answer
    assert answer.total_variation == answer.kl == answer.chi_square == answer.mean_shift == 0.0
    assert answer.widening == 1.0
    assert "even under the assumed laws" in found.headline


def test_without_failures_only_guarantees_remain(study):
    found = dj.laws(study.override({"requirement.0.max": 9.0, "draws": 300}), limit=0.05, fresh=64)
    answer = found.answer
    assert answer.failure.failures == 0
    assert answer.mean_shift == answer.guaranteed.mean_shift > 0.0
    assert answer.estimates.mean_shift is None
    assert answer.fresh is None
    assert found.summary()["estimates"]["kl"] is None
    assert found.weights["mean_shift"].reason == "0 failed draws, 20 are needed"


def test_correlated_laws(study):
    """Widenings of correlated laws have no guarantee; their weights still answer."""
    correlated = study.override({"correlation": {f"plant.k_p, {INITIAL}": 0.5}})
    answer = dj.laws(correlated, limit=0.1, widening=1.1).answer
    assert answer.guaranteed.widening is None
    assert answer.stated[0].interval is None
    assert answer.stated[0].weighted_interval is not None
    assert answer.estimates.mean_shift == pytest.approx(EDGE - stats.norm.isf(0.1), rel=0.2)


def test_a_choice_is_not_changed(study):
    chosen = study.override({"plant.k_p": {"choice": [0.9, 1.1]}, "draws": 200})
    assert list(dj.laws(chosen, limit=0.1).answer.by_law) == [INITIAL]
    only = chosen.override({"plant.initial": [2.0, 0.0]})
    with pytest.raises(dj.ConfigError, match="no law can be changed"):
        dj.laws(only)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"limit": 0.0}, "limit: must lie in"),
        ({"limit": 1.0}, "limit: must lie in"),
        ({"within": {"kll": 0.1}}, "did you mean 'kl'"),
        ({"within": {"kl": -0.1}}, "0 or more, got -0.1"),
        ({"shift": -1.0}, "shift: must be finite"),
        ({"widening": 0.9}, "widening: must be finite and 1 or more"),
        ({"fresh": -1}, "fresh: must be 0 or more"),
    ],
)
def test_bad_arguments_are_refused(study, arguments, told):
    with pytest.raises(dj.ConfigError, match=told):
        dj.laws(study, **arguments)


def test_sweeps_and_designs_are_refused(study):
    small = study.override({"draws": 32})
    swept = dj.run(small.override({"sweep": {"controller.k_p": {"linspace": [0.5, 1.0, 2]}}}), check=False)
    with pytest.raises(dj.ConfigError, match=r"has a sweep over controller\.k_p"):
        dj.laws(swept)
    for design in ("sobol", "lhs"):
        with pytest.raises(dj.ConfigError, match="needs independent draws"):
            dj.laws(small.override({"sampling": design}))
