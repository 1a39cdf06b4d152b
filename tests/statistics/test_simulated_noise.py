"""Noise of a simulated shape against its dense covariance, for a gust that a plant integrates twice."""

import numpy as np
import pytest
from scipy import linalg

from dssc_jax.statistics.correlated_noise import correlation_time, independent_samples, weighted_products
from dssc_jax.statistics.simulated_noise import NoiseShape, SimulatedNoise, prediction_orders

DT = 0.02  # s
TIME = 1.0  # s, of the gust
GUST = 0.2  # m/s^2
SENSOR = 0.002  # m
COUNT = 300
TIMES = DT * np.arange(COUNT)


def gust_response():
    """Responses of x'' = -x' + u to commands that are held for a sample, shape (n, n)."""
    a, b = np.array([[0.0, 1.0], [0.0, -1.0]]), np.array([[0.0], [1.0]])
    held = linalg.expm(DT * np.block([[a, b], [np.zeros((1, 3))]]))
    impulse = [0.0]
    state = held[:2, 2]
    for _ in range(COUNT - 1):
        impulse.append(state[0])
        state = held[:2, :2] @ state
    return np.tril(linalg.toeplitz(impulse))


@pytest.fixture(scope="module")
def gust():
    """The covariance of the response to the gust, and 256 simulations of it."""
    response = gust_response()
    force = GUST**2 * np.exp(-np.abs(TIMES[:, None] - TIMES) / TIME)
    root = np.linalg.cholesky(force)
    simulated = response @ root @ np.random.default_rng(1).normal(size=(COUNT, 256))
    return response @ force @ response.T, simulated.T


def noise_of(simulated):
    """The noise of the simulations and of the sensor, of unit variance, and its variance."""
    variance = float(np.mean(simulated**2)) + SENSOR**2
    return SimulatedNoise(1.0 - SENSOR**2 / variance, NoiseShape.of(TIMES, simulated)), variance


def test_the_weights_are_those_of_the_dense_covariance(gust):
    covariance, simulated = gust
    dense = covariance + SENSOR**2 * np.eye(COUNT)
    response = gust_response()
    columns = response @ np.column_stack([np.ones(COUNT), np.sin(3.0 * TIMES), np.sign(np.sin(8.0 * TIMES))])
    noise, variance = noise_of(simulated)
    products, log_det = weighted_products(noise, TIMES, columns)
    expected = columns.T @ np.linalg.solve(dense, columns)
    np.testing.assert_allclose(np.diag(products) / variance, np.diag(expected), rtol=0.15)
    assert log_det + COUNT * np.log(variance) == pytest.approx(np.linalg.slogdet(dense)[1], abs=3.0)


def test_whitened_noise_has_unit_variance_in_spite_of_a_gap(gust):
    _, simulated = gust
    kept = np.r_[0:120, 150:COUNT]
    noise, variance = noise_of(simulated)
    random = np.random.default_rng(2)
    readings = simulated[:100, kept].T + SENSOR * random.normal(size=(len(kept), 100))
    squares = np.diag(weighted_products(noise, TIMES[kept], readings)[0]) / variance / len(kept)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1)


def test_a_prediction_begins_anew_behind_a_gap():
    times = np.array([0.0, 1.0, 2.0, 3.0, 8.0, 9.0, 10.0])
    assert prediction_orders(times, 2).tolist() == [0, 1, 2, 2, 0, 1, 2]


def test_its_independent_samples_and_its_time_are_those_of_the_covariance(gust):
    covariance, simulated = gust
    noise, _ = noise_of(simulated)
    expected = np.trace(covariance) ** 2 / np.sum(covariance**2)
    assert independent_samples(noise, TIMES) == pytest.approx(expected, rel=0.2)
    correlations = covariance[-1] / np.sqrt(np.diag(covariance)[-1] * np.maximum(np.diag(covariance), 1e-300))
    expected_time = TIMES[-1] - TIMES[np.flatnonzero(correlations <= np.exp(-1.0))[-1]]
    assert correlation_time(noise) == pytest.approx(expected_time, rel=0.2)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_simulations_without_a_shape_give_none(value):
    assert NoiseShape.of(TIMES, np.full((4, COUNT), value)) is None
