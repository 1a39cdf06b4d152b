"""The laws of a fit's estimates where other numbers keep theirs."""

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit import covariance_of_unidentified, fit_log, information_by_names
from tests.flight_logs.test_fit import linear, log_of, output


def test_kept_numbers_widen_the_others_as_the_prior_does():
    """The block of the inverse of information plus the kept numbers' prior is the covariance that is told."""
    random = np.random.default_rng(4)
    root = random.normal(size=(6, 3))
    matrix = root.T @ root
    names = ["a", "b", "c"]
    inner = np.linalg.inv(matrix[:2, :2])
    added = covariance_of_unidentified(information_by_names(names, matrix), ["a", "b"], ["c"])
    # without information on c beyond its law, c stays at its prior: drop the part of c that the others leave open
    schur = matrix[2, 2] - matrix[2, :2] @ inner @ matrix[:2, 2]
    prior = np.diag([0.0, 0.0, 1.0 - schur])
    assert np.allclose(inner + added, np.linalg.inv(matrix + prior)[:2, :2])


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
        (kept,) = set(fitted.unidentified) & truth.keys()
        (estimated,) = truth.keys() - {kept}
        low, high = fitted.law(estimated).quantile(np.array([0.05, 0.95]))
        hits.append(low <= truth[estimated] <= high)
    assert stats.binom.cdf(sum(hits), 12, 0.9) > 1e-4
