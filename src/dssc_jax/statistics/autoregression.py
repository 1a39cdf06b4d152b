"""Coloured residuals: an autoregressive model of them, and the filter that makes them white.

References:
    G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (1978) 461-464.
    H. Akaike, "A new look at the statistical model identification", IEEE Trans. Automatic Control 19 (1974) 716-723.
    D. Cochrane, G. H. Orcutt, "Application of least squares regression to relationships
        containing autocorrelated error terms",
        J. American Statistical Association 44 (1949) 32-61.
"""

import math

import numpy as np
from scipy.signal import lfilter

HIGHEST_ORDER = 12


def lagged(series: np.ndarray, order: int) -> np.ndarray:
    """The series and its ``order`` delayed copies without the first samples, shape (order + 1, n - order, ...)."""
    count = len(series) - order
    return np.stack([series[order - lag : order - lag + count] for lag in range(order + 1)])


def ar_coefficients(residual: np.ndarray, highest: int = HIGHEST_ORDER) -> np.ndarray:
    """Coefficients a of e[t] = a[0] e[t-1] + a[1] e[t-2] + ... + white noise, by least squares.

    A residual is white, of order 0, if Schwarz's criterion prefers this to every other order. Otherwise the order has
    the least Akaike's criterion, because too low an order makes intervals too narrow. All orders are compared on the
    same samples.

    Args:
        residual: The residual, NaN where it is missing, shape (n,).
        highest: The highest order to try.
    """
    highest = min(highest, len(residual) // 10)
    rows = lagged(residual, highest).T
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) <= 2 * highest + 2:
        return np.zeros(0)
    products = rows.T @ rows / len(rows)
    estimates, misfits = [], []
    for order in range(highest + 1):
        lags = slice(1, order + 1)
        estimates.append(np.linalg.lstsq(products[lags, lags], products[lags, 0], rcond=None)[0])
        square = float(products[0, 0] - estimates[-1] @ products[lags, 0])
        misfits.append(len(rows) * math.log(max(square, 1e-300)))
    orders = np.arange(highest + 1)
    if np.argmin(misfits + math.log(len(rows)) * orders) == 0:
        return estimates[0]
    return estimates[int(np.argmin(misfits + 2.0 * orders))]


def ar_process(filtering: np.ndarray, shocks: np.ndarray) -> np.ndarray:
    """The process that ``filtering`` makes of white noise, shape (n,)."""
    return np.asarray(lfilter([1.0], np.concatenate([[1.0], -filtering]), shocks))


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
