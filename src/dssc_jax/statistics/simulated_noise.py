"""Noise whose correlated part has the shape that simulations show, as an autoregression of the readings.

Simulations give the correlated part at the times of the readings. Each reading is predicted from those before it by
least squares over all simulations and times. The errors of these predictions are uncorrelated, so they whiten the
noise. At the beginning and behind a gap fewer readings predict.

References:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), sections 3.2 and 13.4.
"""

import math
from typing import NamedTuple

import numpy as np

MOST_LAGS = 40  # readings that predict the next one
READINGS_PER_LAG = 8  # least number of readings for each of them
LONG_GAP = 1.5  # median gaps, from which the prediction begins anew
REGULAR = 1e-12  # share of the variance that keeps the normal equations of a smooth noise regular


class NoiseShape(NamedTuple):
    """What simulations show of the correlated part of a noise.

    Args:
        times: Times of the readings, rising [s], shape (n,).
        simulated: Simulations of the correlated part, scaled to a mean square of 1, shape (m, n).
        first_products: Mean products of each of the first p readings and those before it, the latest first, and 0 for
            those before the first one, shape (p, 1 + p, 1 + p).
        later_products: Mean products of a later reading and the 0 to p before it, filled with 0, shape
            (1 + p, 1 + p, 1 + p).
    """

    times: np.ndarray
    simulated: np.ndarray
    first_products: np.ndarray
    later_products: np.ndarray

    @classmethod
    def of(cls, times: np.ndarray, simulated: np.ndarray) -> "NoiseShape | None":
        """The shape of simulations of any size, shape (m, n); None if they are 0 or not finite."""
        mean_square = float(np.mean(simulated**2))
        if not math.isfinite(mean_square) or mean_square == 0.0:
            return None
        scaled = simulated / math.sqrt(mean_square)
        lags = min(MOST_LAGS, len(times) // READINGS_PER_LAG)
        first_products = np.zeros((lags, lags + 1, lags + 1))
        for order in range(lags):
            first_products[order, : order + 1, : order + 1] = mean_products(scaled[:, : 2 * order + 1], order)
        products = mean_products(scaled, lags)
        later_products = np.zeros((lags + 1, lags + 1, lags + 1))
        for order in range(lags + 1):
            later_products[order, : order + 1, : order + 1] = products[: order + 1, : order + 1]
        return cls(times, scaled, first_products, later_products)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the simulations at all times, shape (n, n)."""
        return self.simulated.T @ self.simulated / len(self.simulated)

    @property
    def correlation_time(self) -> float:
        """Smallest lag back from the last reading at which the correlation falls to 1/e [s]."""
        last = self.simulated[:, -1]
        sizes = np.sqrt(np.sum(self.simulated**2, axis=0) * np.sum(last**2))
        has_decayed = last @ self.simulated <= math.exp(-1.0) * sizes
        has_decayed[0] = True
        return float(self.times[-1] - self.times[np.flatnonzero(has_decayed)[-1]])


class SimulatedNoise(NamedTuple):
    """Noise whose correlated part has a simulated shape.

    Args:
        share: Share c of the variance in the correlated part, in [0, 1).
        shape: Its shape.
    """

    share: float
    shape: NoiseShape

    def weighted_products(self, times: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, float]:
        """Products C' S^-1 C of columns C, weighted by the covariance S of the noise, and log det S.

        Args:
            times: Times of observation [s], shape (n,): those of the simulations, or a part of them.
            columns: Matrix C, shape (n, m).
        """
        lags = len(self.shape.first_products)
        orders = prediction_orders(times, lags)
        whitened = np.empty_like(columns)
        log_det = 0.0
        weights, variances = self.predictions(self.shape.first_products)
        for row in range(lags):
            whitened[row] = weights[row, : row + 1] @ columns[row::-1]
        log_det += float(np.sum(np.log(variances)))
        later_orders = np.unique(orders[lags:])
        weights, variances = self.predictions(self.shape.later_products[later_orders])
        for order, weight, variance in zip(later_orders, weights, variances, strict=True):
            rows = lags + np.flatnonzero(orders[lags:] == order)
            windows = np.lib.stride_tricks.sliding_window_view(columns, order + 1, axis=0)[rows - order]
            whitened[rows] = windows @ weight[order::-1]
            log_det += len(rows) * math.log(variance)
        return whitened.T @ whitened, log_det

    def predictions(self, products: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predictions of readings from those before them.

        Args:
            products: Mean products of the correlated part, one matrix for each prediction, shape (k, 1 + p, 1 + p).

        Returns:
            - Weights of a reading and those before it, the latest first, in the error of its prediction, which they
              scale to a variance of 1; shape (k, 1 + p).
            - Variances of the errors, shape (k,).
        """
        covariance = self.share * products + (1.0 - self.share + REGULAR) * np.eye(products.shape[-1])
        coupling = covariance[:, 1:, 0]
        predicting = np.linalg.solve(covariance[:, 1:, 1:], coupling[:, :, None])[:, :, 0]
        variances = covariance[:, 0, 0] - np.sum(coupling * predicting, axis=1)
        weights = np.concatenate([np.ones((len(products), 1)), -predicting], axis=1)
        return weights / np.sqrt(variances)[:, None], variances

    @property
    def independent_samples(self) -> float:
        """Effective sample size: independent samples that would give the variance as precisely as these n.

        The squares of the sampled covariances are less those of the sampling itself.
        """
        covariance = self.share * self.shape.covariance
        sampling = float(np.trace(covariance)) ** 2 / len(self.shape.simulated)
        covariance[np.diag_indices_from(covariance)] += 1.0 - self.share
        square = float(np.trace(covariance)) ** 2
        count = float(len(covariance))
        return min(max(square / max(float(np.sum(covariance**2)) - sampling, square / count), 1.0), count)


def mean_products(simulated: np.ndarray, lags: int) -> np.ndarray:
    """Mean products of a reading and the p before it, over simulations of shape (m, n); shape (1 + p, 1 + p)."""
    windows = np.lib.stride_tricks.sliding_window_view(simulated, lags + 1, axis=1)
    rows = windows[..., ::-1].reshape(-1, lags + 1)
    return rows.T @ rows / len(rows)


def prediction_orders(times: np.ndarray, lags: int) -> np.ndarray:
    """How many readings predict each one, shape (n,): those since the beginning or a long gap, but at most ``lags``."""
    gaps = np.diff(times)
    begins = np.concatenate([[True], gaps > LONG_GAP * np.median(gaps)])
    positions = np.arange(len(times))
    first = np.maximum.accumulate(np.where(begins, positions, 0))
    return np.minimum(positions - first, lags)
