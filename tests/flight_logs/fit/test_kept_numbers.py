"""The laws of a fit's estimates where other numbers keep theirs."""

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.fit import fit_log, marginal_information
from dssc_jax.flight_logs.fit.least_squares import FitProblem, NormalEquations
from dssc_jax.flight_logs.fit.log_sampling import sampled_log
from dssc_jax.flight_logs.fit.minima import Minimum, distinct_minima
from dssc_jax.flight_logs.fit.refusals import NotIdentifiable
from dssc_jax.flight_logs.fit.unidentified import UnidentifiedNumbers
from tests.flight_logs.fit.test_fit import linear, log_of, output


def test_information_on_fitted_numbers_is_that_of_the_joint_law():
    """The covariance of the fitted numbers is the block of that of all, in which kept numbers have their laws."""
    random = np.random.default_rng(4)
    root = random.normal(size=(6, 3))
    information = root.T @ root + np.diag([0.0, 1.0, 0.0])
    marginal = marginal_information(information, np.array([0, 2]))
    assert np.allclose(np.linalg.inv(marginal), np.linalg.inv(information)[np.ix_([0, 2], [0, 2])])
    assert np.allclose(marginal_information(information, np.arange(3)), information)


def test_where_one_factor_of_a_product_keeps_its_law_the_other_covers_the_truth():
    """12 flights that show the product g h alone, at a level at which too few hits have a probability below 1e-4."""
    changes = {"g": {"uniform": [0.6, 1.4]}, "h": {"uniform": [0.7, 1.3]}}
    plant = {"kind": "normal_form", "k_p": "=g*h", "a_p": {"normal": [1.0, 0.2]}, "initial": [0.5, 0.0]}
    study = linear(parameters=changes, plant=plant)
    random = np.random.default_rng(5)
    predictions = {}
    hits = []
    for _ in range(12):
        truth = {"parameters.g": random.uniform(0.6, 1.4), "parameters.h": random.uniform(0.7, 1.3)}
        u = np.repeat(random.normal(size=40), 10)
        product = truth["parameters.g"] * truth["parameters.h"]
        y = output(product, 1.0, u) + 0.01 * random.normal(size=400)
        fitted = fit_log(study, log_of(y, u), predictions=predictions)
        kept = fitted.unidentified.keys() & truth.keys()
        assert kept  # a large product leaves each factor as wide as the law of the other one: then both are kept
        for name in truth.keys() - kept:
            low, high = fitted.law(name).quantile(np.array([0.05, 0.95]))
            hits.append(low <= truth[name] <= high)
    assert len(hits) >= 8
    assert stats.binom.cdf(sum(hits), len(hits), 0.9) > 1e-4


def test_a_number_is_kept_in_place_of_another_before_both_are():
    unidentified = UnidentifiedNumbers()
    kept = []
    for name in ("a", "b", "a", "c"):
        unidentified.add(name, NotIdentifiable("open", name, 2.0))
        kept.append("".join(sorted(unidentified.kept)))
    assert kept == ["a", "b", "ab", "bc"]
    assert unidentified.kept_widths == {"b": 2.0, "c": 2.0}


def test_a_number_that_another_minimum_depends_on_is_fitted_again_once():
    unidentified = UnidentifiedNumbers()
    assert unidentified.update_insensitive({"a": 3.0})
    assert not unidentified.update_insensitive({"a": 2.0})
    assert unidentified.kept_widths == {"a": 3.0}
    assert unidentified.update_insensitive({})
    assert not unidentified.kept
    assert unidentified.update_insensitive({"a": 5.0})
    assert not unidentified.update_insensitive({})
    assert unidentified.kept_widths == {"a": 5.0}


def test_a_minimum_inside_the_laws_comes_before_one_outside_that_is_hardly_better():
    study = linear()
    u = np.zeros(400)
    problem = FitProblem(study, ("plant.k_p", "plant.a_p"), None, sampled_log(study, log_of(output(1.0, 1.0, u), u)))
    equations = NormalEquations(100.0, np.zeros(2), np.eye(2))
    inside = Minimum(np.array([1.0, 0.0]), equations, 1)
    outside = Minimum(np.array([30.0, 0.0]), equations._replace(cost=90.0), 1)
    assert distinct_minima(problem, [outside, inside])[0] is inside
    clear = Minimum(np.array([30.0, 0.0]), equations._replace(cost=0.0), 1)
    much_worse = inside._replace(equations=equations._replace(cost=5000.0))
    assert distinct_minima(problem, [much_worse, clear])[0] is clear
    assert problem.is_far_outside(outside.x)
    assert not problem.is_far_outside(inside.x)
