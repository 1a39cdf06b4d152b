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
        products: Mean products of a reading and the p before it, the latest first, shape (1 + p, 1 + p).
        first_products: The same for each of the first p readings and all before it, shapes (1, 1) to (p, p).
    """

    times: np.ndarray
    simulated: np.ndarray
    products: np.ndarray
    first_products: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, times: np.ndarray, simulated: np.ndarray) -> "NoiseShape | None":
        """The shape of simulations of any size, shape (m, n); None if they are 0 or not finite."""
        mean_square = float(np.mean(simulated**2))
        if not math.isfinite(mean_square) or mean_square == 0.0:
            return None
        scaled = simulated / math.sqrt(mean_square)
        lags = min(MOST_LAGS, len(times) // READINGS_PER_LAG)
        first_products = tuple(mean_products(scaled[:, : 2 * order + 1], order) for order in range(lags))
        return cls(times, scaled, mean_products(scaled, lags), first_products)

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


class Prediction(NamedTuple):
    """The prediction of a reading from those before it.

    Args:
        weights: Weights of the q readings before it, the latest first, shape (q,).
        variance: Variance of the error.
    """

    weights: np.ndarray
    variance: float

    def errors(self, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Errors of some rows of columns, in standard deviations; shape (r, m).

        Args:
            columns: The columns, shape (n, m).
            rows: Positions of the rows, shape (r,).
        """
        errors = columns[rows]
        for lag, weight in enumerate(self.weights, start=1):
            errors -= weight * columns[rows - lag]
        return errors / math.sqrt(self.variance)


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
        whitened = np.empty_like(columns)
        log_det = 0.0
        lags = len(self.shape.first_products)
        for row in range(lags):
            prediction = self.prediction(self.shape.first_products[row])
            whitened[row] = prediction.errors(columns, np.array([row]))[0]
            log_det += math.log(prediction.variance)
        orders = prediction_orders(times, lags)
        orders[:lags] = -1
        for order in range(lags + 1):
            rows = np.flatnonzero(orders == order)
            if len(rows) > 0:
                prediction = self.prediction(self.shape.products[: order + 1, : order + 1])
                whitened[rows] = prediction.errors(columns, rows)
                log_det += len(rows) * math.log(prediction.variance)
        return whitened.T @ whitened, log_det

    def prediction(self, products: np.ndarray) -> Prediction:
        """The prediction of a reading of this noise from the q before it.

        Args:
            products: Mean products of the correlated part, shape (1 + q, 1 + q).
        """
        whole = self.share * products + (1.0 - self.share + REGULAR) * np.eye(len(products))
        weights = np.linalg.solve(whole[1:, 1:], whole[1:, 0])
        return Prediction(weights, float(whole[0, 0] - whole[0, 1:] @ weights))

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
