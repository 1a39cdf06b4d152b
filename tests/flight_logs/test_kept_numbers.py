"""The laws of a fit's estimates where other numbers keep theirs."""

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit import fit_log, marginal_information
from tests.flight_logs.test_fit import linear, log_of, output


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
