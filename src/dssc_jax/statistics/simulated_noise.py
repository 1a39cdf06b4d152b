"""Noise whose correlated part has the shape that simulations show, as an autoregression of the readings.

Simulations give the correlated part at the times of the readings. Earlier readings predict each reading by least
squares over all simulations and times. The errors of these predictions are uncorrelated, so they whiten the noise. At
the beginning and behind a gap fewer readings predict.

References:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), sections 3.2 and 13.4.
"""

import math
from typing import NamedTuple

import numpy as np

MOST_LAGS = 40  # readings that predict the next reading
READINGS_PER_LAG = 8  # least number of readings for each reading that predicts
LONG_GAP = 1.5  # median gaps, from which the prediction begins anew
REGULAR = 1e-12  # share of the variance that keeps the normal equations of a smooth noise regular


class NoiseShape(NamedTuple):
    """What simulations show of the correlated part of a noise: products that predict a reading from earlier readings.

    A mean product is the mean over the simulations of the product of two readings. In a matrix of mean products, row
    and column j belong to the reading j places before the predicted reading. Rows and columns of readings that are not
    used are 0.

    Args:
        times: Times of the readings, rising [s], shape (n,).
        simulated: Simulations of the correlated part, scaled to a mean square of 1, shape (m, n).
        first_products: Mean products for each of the first p readings, which all earlier readings predict, shape (p, 1
            + p, 1 + p).
        later_products: Mean products for a later reading that the 0 to p latest readings predict, shape (1 + p, 1 + p,
            1 + p).
    """

    times: np.ndarray
    simulated: np.ndarray
    first_products: np.ndarray
    later_products: np.ndarray

    @classmethod
    def of(cls, times: np.ndarray, simulated: np.ndarray) -> "NoiseShape | None":
        """What simulations show; None if they are 0 or not finite.

        Args:
            times: Times of the readings, rising [s], shape (n,).
            simulated: Simulations of the correlated part, of any size, shape (m, n).
        """
        mean_square = float(np.mean(simulated**2))
        if not math.isfinite(mean_square) or mean_square == 0.0:
            return None
        scaled = simulated / math.sqrt(mean_square)
        lags = min(MOST_LAGS, len(times) // READINGS_PER_LAG)
        first_products = np.zeros((lags, lags + 1, lags + 1))
        for order in range(lags):  # number of readings that predict
            width = order + 1
            around_reading = scaled[:, : 2 * order + 1]  # as many readings after it as before
            first_products[order, :width, :width] = mean_products(around_reading, order)
        products = mean_products(scaled, lags)
        later_products = np.zeros((lags + 1, lags + 1, lags + 1))
        for order in range(lags + 1):
            width = order + 1
            later_products[order, :width, :width] = products[:width, :width]
        return cls(times, scaled, first_products, later_products)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the simulations at all times, shape (n, n)."""
        return self.simulated.T @ self.simulated / len(self.simulated)

    @property
    def correlation_time(self) -> float:
        """Smallest lag back from the last reading at which the correlation falls to 1/e [s]."""
        final_values = self.simulated[:, -1]
        sizes = np.sqrt(np.sum(self.simulated**2, axis=0) * np.sum(final_values**2))
        has_decayed = final_values @ self.simulated <= math.exp(-1.0) * sizes
        has_decayed[0] = True  # at the latest
        latest = np.flatnonzero(has_decayed)[-1]
        return float(self.times[-1] - self.times[latest])


class SimulatedNoise(NamedTuple):
    """Noise of unit variance, the sum of white noise and a correlated part that simulations show.

    Args:
        share: Share c of the variance in the correlated part, in [0, 1).
        shape: What simulations show of the correlated part.
    """

    share: float
    shape: NoiseShape

    def weighted_products(self, times: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, float]:
        """Products C' S^-1 C of columns C, weighted by the inverse of the noise's covariance S, and log det S.

        Each row of C is replaced by its error of prediction from earlier rows, scaled to the variance 1. The products
        of these whitened rows are the weighted products.

        Args:
            times: Times of observation [s], shape (n,): the times of the simulations, or a part of them.
            columns: Matrix C, shape (n, m).

        Returns:
            The products, shape (m, m), and log det S, the sum of the logarithms of the errors' variances.
        """
        lags = len(self.shape.first_products)
        orders = prediction_orders(times, lags)
        whitened = np.empty_like(columns)
        weights, variances = self.error_weights(self.shape.first_products)
        for row in range(lags):
            latest_first = columns[: row + 1][::-1]
            whitened[row] = weights[row, : row + 1] @ latest_first
        log_det = float(np.sum(np.log(variances)))
        later_orders = np.unique(orders[lags:])
        weights, variances = self.error_weights(self.shape.later_products[later_orders])
        for order, weight, variance in zip(later_orders, weights, variances, strict=True):
            rows = lags + np.flatnonzero(orders[lags:] == order)
            windows = np.lib.stride_tricks.sliding_window_view(columns, order + 1, axis=0)[rows - order]
            oldest_first = weight[: order + 1][::-1]
            whitened[rows] = windows @ oldest_first
            log_det += len(rows) * math.log(variance)
        return whitened.T @ whitened, log_det

    def error_weights(self, products: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights with which readings add up to the error of a prediction from earlier readings, scaled to variance 1.

        Args:
            products: Mean products of the correlated part, a matrix for each prediction, shape (k, 1 + p, 1 + p).

        Returns:
            - Weights of the predicted reading and the readings before it, the latest first, shape (k, 1 + p).
            - Variances of the errors before they are scaled, shape (k,).
        """
        covariance = self.share * products + (1.0 - self.share + REGULAR) * np.eye(products.shape[-1])
        coupling = covariance[:, 1:, 0]  # of the predicted reading with the others
        coefficients = np.linalg.solve(covariance[:, 1:, 1:], coupling[:, :, None])[:, :, 0]
        variances = covariance[:, 0, 0] - np.sum(coupling * coefficients, axis=1)
        weights = np.concatenate([np.ones((len(products), 1)), -coefficients], axis=1)
        return weights / np.sqrt(variances)[:, None], variances

    @property
    def independent_samples(self) -> float:
        """Effective sample size: the number of independent samples that determine the variance as precisely as these n.

        With the covariance S it is (tr S)^2/tr(S^2). S is estimated from few simulations, so the squares of its
        sampling errors make tr(S^2) too large; they are subtracted.
        """
        covariance = self.share * self.shape.covariance
        sampling_squares = float(np.trace(covariance)) ** 2 / len(self.shape.simulated)
        covariance[np.diag_indices_from(covariance)] += 1.0 - self.share
        squared_trace = float(np.trace(covariance)) ** 2
        count = float(len(covariance))
        squares = max(float(np.sum(covariance**2)) - sampling_squares, squared_trace / count)
        return min(max(squared_trace / squares, 1.0), count)


def mean_products(simulated: np.ndarray, lags: int) -> np.ndarray:
    """Mean products of a reading and the p readings before it, the latest first, shape (1 + p, 1 + p).

    The mean is taken over all simulations and all times.

    Args:
        simulated: The simulations, shape (m, n).
        lags: Number p of earlier readings.
    """
    windows = np.lib.stride_tricks.sliding_window_view(simulated, lags + 1, axis=1)
    latest_first = windows[..., ::-1].reshape(-1, lags + 1)
    return latest_first.T @ latest_first / len(latest_first)


def prediction_orders(times: np.ndarray, lags: int) -> np.ndarray:
    """Number of earlier readings that predict each reading, shape (n,).

    These are the readings since the beginning or the latest long gap, but at most ``lags``.

    Args:
        times: Times of the readings, rising [s], shape (n,).
        lags: Largest number of earlier readings.
    """
    gaps = np.diff(times)
    begins = np.concatenate([[True], gaps > LONG_GAP * np.median(gaps)])
    positions = np.arange(len(times))
    latest_begin = np.maximum.accumulate(np.where(begins, positions, 0))
    return np.minimum(positions - latest_begin, lags)
