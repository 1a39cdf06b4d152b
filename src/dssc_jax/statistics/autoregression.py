"""Coloured residuals: an autoregressive model of them, and the filter that makes them white.

References:
    G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (1978) 461-464.
    D. Cochrane, G. H. Orcutt, "Application of least squares regression", J. American Statistical Association (1949).
"""

import math

import numpy as np

HIGHEST_ORDER = 12


def lagged(series: np.ndarray, order: int) -> np.ndarray:
    """The series and its ``order`` delayed copies without the first samples, shape (order + 1, n - order, ...)."""
    count = len(series) - order
    return np.stack([series[order - lag : order - lag + count] for lag in range(order + 1)])


def coefficients(residual: np.ndarray, highest: int = HIGHEST_ORDER) -> np.ndarray:
    """Coefficients a of e[t] = a[0] e[t-1] + a[1] e[t-2] + ... + white noise, by least squares.

    The order is that with the least Bayesian information criterion; all orders are compared on the same samples.

    Args:
        residual: The residual, NaN where it is missing, shape (n,).
        highest: The highest order to try.
    """
    highest = min(highest, len(residual) // 10)
    rows = lagged(residual, highest).T
    rows = rows[np.isfinite(rows).all(axis=1)]
    best, least = np.zeros(0), math.inf
    if len(rows) <= 2 * highest + 2:
        return best
    products = rows.T @ rows / len(rows)
    for order in range(highest + 1):
        lags = slice(1, order + 1)
        found = np.linalg.lstsq(products[lags, lags], products[lags, 0], rcond=None)[0]
        square = float(products[0, 0] - found @ products[lags, 0])
        criterion = len(rows) * math.log(max(square, 1e-300)) + order * math.log(len(rows))
        if criterion < least:
            best, least = found, criterion
    return best


def whitened(series: np.ndarray, filtering: np.ndarray) -> np.ndarray:
    """What is left of a series after its own prediction by ``filtering``; NaN where a needed sample is missing.

    Args:
        series: Samples in the first dimension, shape (n, ...).
        filtering: Coefficients of the prediction, shape (order,).

    Returns:
        Shape (n - order, ...).

    Example:
        >>> whitened(np.array([1.0, 0.5, 0.25]), np.array([0.5]))
        array([0., 0.])
    """
    rows = lagged(series, len(filtering))
    return np.tensordot(np.concatenate([[1.0], -filtering]), rows, axes=1)
