"""Noise correlated in time: covariances written out, autoregressions, and Monte Carlo of the estimated noise."""

import numpy as np
import pytest
from scipy import linalg, signal

from dssc_jax.statistics.correlated_noise import (
    WHITE,
    Drift,
    FirstOrder,
    SecondOrder,
    correlation_time,
    fit_noise,
    independent_samples,
    weighted_products,
)
from dssc_jax.statistics.noise_posterior import NoiseSearch

NOISES = (
    FirstOrder(0.7, 0.5),
    FirstOrder(1.0 - 1e-6, 30.0),
    SecondOrder(0.7, 0.5, 0.3),
    SecondOrder(0.99, 2.0, 0.9),
    SecondOrder(1.0 - 1e-6, 20.0, 0.98),
    Drift(0.7, 0.5, 9.0),
    Drift(0.99, 0.01, 9.0),
    Drift(0.3, 9.0, 9.0),
)


def irregular_times(count=60):
    return np.cumsum(np.random.default_rng(1).uniform(0.01, 0.3, count))


def slopes(times):
    return np.stack([np.ones_like(times), times, np.sin(3.0 * times)], axis=1)


def covariance(noise, times):
    if isinstance(noise, Drift):  # it starts one median gap before the first reading
        times = times - times[0] + np.median(np.diff(times))
        correlated = noise.covariance(times[:, None], times[None])
    else:
        correlated = noise.correlation(times[:, None] - times[None])
    return noise.share * correlated + (1.0 - noise.share) * np.eye(len(times))


@pytest.mark.parametrize("noise", NOISES)
def test_products_are_those_of_the_covariance_written_out(noise):
    times = irregular_times()
    columns = np.random.default_rng(2).normal(size=(60, 3))
    products, determinant = weighted_products(noise, times, columns)
    dense = covariance(noise, times)
    np.testing.assert_allclose(products, columns.T @ np.linalg.solve(dense, columns), rtol=1e-6)
    assert determinant == pytest.approx(np.linalg.slogdet(dense)[1], abs=1e-6)


def test_correlation_of_the_second_order_is_that_of_its_states():
    """x'' + 2 zeta x'/T + x/T^2 = white noise: the stationary covariance by Lyapunov's equation, moved by expm."""
    noise = SecondOrder(0.5, 0.4, 0.3)
    system = np.array([[0.0, 1.0], [-1.0 / 0.16, -0.6 / 0.4]])
    still = linalg.solve_continuous_lyapunov(system, -np.diag([0.0, 1.0]))
    for lag in (0.0, 0.1, 0.7, 3.0):
        moved = (linalg.expm(system * lag) @ still)[0, 0] / still[0, 0]
        assert float(noise.correlation(np.array(lag))) == pytest.approx(moved, abs=1e-12)


@pytest.mark.parametrize("time", [0.05, 0.6, 5.0])
def test_the_covariance_of_a_drift_is_that_of_its_states(time):
    """p' = v/T, T v' = -v + white noise from 0 on: Lyapunov's equation in time, and its mean over the span."""
    noise = Drift(0.5, time, 6.0)
    system = np.array([[0.0, 1.0 / time], [0.0, -1.0 / time]])
    driven = np.diag([0.0, 2.0 / time])

    pull = np.kron(system, np.eye(2)) + np.kron(np.eye(2), system)  # P' = A P + P A' + Q, as a vector
    whole = np.block([[pull, driven.reshape(4, 1)], [np.zeros((1, 5))]])

    def state_covariance(at):
        return linalg.expm(whole * at)[:4, 4].reshape(2, 2)

    grid = np.linspace(0.0, 6.0, 601)
    mean = np.trapezoid([state_covariance(at)[0, 0] for at in grid], grid) / 6.0
    for early, late in ((0.3, 0.3), (0.3, 2.0), (4.0, 4.5), (6.0, 6.0)):
        expected = (linalg.expm(system * (late - early)) @ state_covariance(early))[0, 0] / mean
        assert float(noise.covariance(early, late)) == pytest.approx(expected, rel=1e-4)
        assert float(noise.covariance(late, early)) == pytest.approx(expected, rel=1e-4)


def test_equal_gaps_give_an_autoregression():
    """Prais and Winsten: the first row scaled, the others less a share of the row before them."""
    share, gap = 1.0 - 1e-9, 0.1
    columns = np.random.default_rng(3).normal(size=(200, 3))
    pole = np.exp(-gap / 0.4)
    rows = np.concatenate([columns[:1] * np.sqrt(1.0 - pole**2), columns[1:] - pole * columns[:-1]])
    products, _ = weighted_products(FirstOrder(share, 0.4), gap * np.arange(200), columns)
    np.testing.assert_allclose(products, rows.T @ rows / (1.0 - pole**2), rtol=1e-6, atol=1e-6)


def test_white_noise_gives_plain_least_squares():
    times = irregular_times()
    random = np.random.default_rng(4)
    columns = np.column_stack([random.normal(size=60), slopes(times)])
    found = fit_noise(WHITE, times, columns)
    change, square, *_ = np.linalg.lstsq(columns[:, 1:], columns[:, 0], rcond=None)
    assert found.variance == pytest.approx(float(square[0]) / (60 - 3 - 2), rel=1e-12)
    np.testing.assert_allclose(np.linalg.solve(found.information, found.gradient), change, rtol=1e-9)
    products = columns[:, 1:].T @ columns[:, 1:]
    np.testing.assert_allclose(found.information, products / found.variance, rtol=1e-12)


def test_a_number_that_does_not_show_changes_nothing():
    times = irregular_times()
    columns = np.column_stack([np.random.default_rng(5).normal(size=60), slopes(times)])
    noise = FirstOrder(0.5, 0.3)
    whole = fit_noise(noise, times, np.column_stack([columns, np.zeros(60)]))
    assert whole.variance == pytest.approx(fit_noise(noise, times, columns).variance, rel=1e-9)


def test_correlation_times_and_independent_samples():
    assert correlation_time(WHITE) == 0.0
    assert correlation_time(FirstOrder(0.5, 0.4)) == pytest.approx(0.4, rel=1e-2)
    times = 0.1 * np.arange(500)
    assert independent_samples(WHITE, times) == 500.0
    noise = FirstOrder(0.9, 1.0)
    squares = np.sum(covariance(noise, times) ** 2)
    assert independent_samples(noise, times, limit=500) == pytest.approx(500.0**2 / squares, rel=1e-9)
    assert independent_samples(noise, times, limit=100) == pytest.approx(500.0**2 / squares, rel=0.05)
    walk = Drift(0.9, 0.01, 50.0)
    assert correlation_time(walk) == pytest.approx((1.0 - np.exp(-2.0)) * 50.0, rel=1e-2)  # of a random walk
    dense = covariance(walk, times)
    assert independent_samples(walk, times, limit=500) == pytest.approx(
        np.trace(dense) ** 2 / np.sum(dense**2), rel=1e-9
    )


def averaged_score(posterior):
    """The mean move of the numbers from 0 over all noises, in its standard deviations."""
    inverses = [(each.weight, np.linalg.inv(each.fit.information), each.fit) for each in posterior.candidates]
    mean = sum(weight * inverse @ found.gradient for weight, inverse, found in inverses)
    square = sum(
        weight * (np.diag(inverse) + (inverse @ found.gradient - mean) ** 2) for weight, inverse, found in inverses
    )
    return mean / np.sqrt(square)


@pytest.mark.parametrize("every", [1, 10])
def test_the_posterior_covers_the_truth(every):
    """Lines fitted to correlated noise of known covariance, dense and sparse: errors in their standard deviations."""
    times = 0.02 * np.arange(500)[::every]
    columns = slopes(times)
    pole = np.exp(-0.02 / 0.5)
    random = np.random.default_rng(6)
    scores = []
    for _ in range(24):
        drift = signal.lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], random.normal(size=900))[400:]
        noise = (drift + random.normal(size=500))[::every]
        posterior = NoiseSearch(times, np.column_stack([noise, columns]), 0.0).posterior()
        assert sum(candidate.weight for candidate in posterior.candidates) == pytest.approx(1.0)
        scores.append(averaged_score(posterior))
    assert np.abs(np.mean(np.square(scores), axis=0) - 1.0).max() < 0.87  # three standard deviations of chi^2_24/24


def test_the_posterior_covers_the_truth_of_a_drift():
    """A random walk that adds 8 % of the white noise in a sample hardly shows, and moves lines more than that does."""
    times = 0.04 * np.arange(250)
    columns = slopes(times)
    random = np.random.default_rng(7)
    scores = []
    drifts = 0
    for _ in range(12):
        noise = np.cumsum(0.08 * random.normal(size=250)) + random.normal(size=250)
        posterior = NoiseSearch(times, np.column_stack([noise, columns]), 0.0).posterior()
        drifts += isinstance(posterior.likeliest, Drift)
        scores.append(averaged_score(posterior))
    assert drifts >= 5
    assert np.mean(np.square(scores)) < 2.5  # without a drift among the kinds it is 4.6


def test_a_residual_of_rounding_is_white():
    times = irregular_times()
    columns = np.column_stack([1e-12 * np.sin(times), slopes(times)])
    posterior = NoiseSearch(times, columns, 1e-18).posterior()
    assert posterior.likeliest == WHITE
    assert posterior.white == 1.0
    assert len(posterior.candidates) == 1
    assert posterior.fit.variance == pytest.approx(1e-18, rel=0.1)


def test_white_noise_is_told_from_correlated_noise():
    times = 0.02 * np.arange(400)
    random = np.random.default_rng(7)
    white = NoiseSearch(times, np.column_stack([random.normal(size=400), slopes(times)]), 0.0).posterior()
    assert white.likeliest == WHITE
    assert white.white > 0.4
    drift = signal.lfilter([1.0], [1.0, -0.95], random.normal(size=400))
    found = NoiseSearch(times, np.column_stack([drift, slopes(times)]), 0.0).posterior()
    assert found.white < 1e-6
    assert 0.15 < correlation_time(found.likeliest) < 0.9  # 0.39 s
