"""Logarithms of the densities of laws, for importance weights; minus infinity outside of a law's support.

The definitions of the laws are in :mod:`dssc_jax.study.law_kinds`. Each function takes values x of any shape, then the
arguments of a law in the order of the study file. The result has the shape of x.
"""

import numpy as np
import scipy

LOG_ROOT_TWO_PI = 0.5 * float(np.log(2.0 * np.pi))


def uniform(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """Log density of the uniform law on [low, high]."""
    return np.where((x >= low) & (x <= high), -np.log(high - low), -np.inf)


def loguniform(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """Log density of a number in [low, high] whose logarithm is uniform; low > 0."""
    inside = (x >= low) & (x <= high)
    return np.where(inside, -np.log(np.where(inside, x, 1.0)) - np.log(np.log(high / low)), -np.inf)


def normal(x: np.ndarray, mean: float, std: float) -> np.ndarray:
    """Log density of the normal law with a mean and a standard deviation."""
    return -0.5 * ((x - mean) / std) ** 2 - np.log(std) - LOG_ROOT_TWO_PI


def truncated_normal(x: np.ndarray, mean: float, std: float, low: float, high: float) -> np.ndarray:
    """Log density of the normal law with a mean and a standard deviation, truncated to [low, high].

    The probability of an interval above the mean is computed from the mirrored interval in the lower tail, where no
    digits cancel.
    """
    lower = (low - mean) / std
    upper = (high - mean) / std
    if lower > 0.0:
        lower, upper = -upper, -lower
    mass = scipy.special.ndtr(upper) - scipy.special.ndtr(lower)
    return np.where((x >= low) & (x <= high), normal(x, mean, std) - np.log(mass), -np.inf)


def lognormal(x: np.ndarray, mean: float, std: float) -> np.ndarray:
    """Log density of a number whose logarithm is normal; mean and std are those of the logarithm."""
    logarithm = np.log(np.where(x > 0.0, x, 1.0))
    return np.where(x > 0.0, normal(logarithm, mean, std) - logarithm, -np.inf)


def beta(x: np.ndarray, a: float, b: float, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    """Log density of the beta law with shape parameters a and b on [low, high]."""
    inside = (x >= low) & (x <= high)
    share = np.where(inside, (x - low) / (high - low), 0.5)  # any value outside, where it is not used
    logarithm = scipy.special.xlogy(a - 1.0, share) + scipy.special.xlog1py(b - 1.0, -share)
    return np.where(inside, logarithm - scipy.special.betaln(a, b) - np.log(high - low), -np.inf)


def triangular(x: np.ndarray, low: float, mode: float, high: float) -> np.ndarray:
    """Log density of the triangular law on [low, high] with its peak at the mode."""
    rising = np.divide(x - low, mode - low, out=np.ones_like(x), where=(low <= x) & (x < mode))
    falling = np.divide(high - x, high - mode, out=np.ones_like(x), where=(mode < x) & (x <= high))
    height = np.minimum(rising, falling)
    inside = (x >= low) & (x <= high) & (height > 0.0)
    return np.where(inside, np.log(np.where(inside, height, 1.0)) + np.log(2.0 / (high - low)), -np.inf)
