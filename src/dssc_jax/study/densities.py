"""Logarithms of the densities of laws, for importance weights; minus infinity outside of a law's support.

Each takes a law's arguments, as a study file gives them, and values, of which it has the shape.
"""

import numpy as np
import scipy

Arguments = tuple[float, ...]

LOG_ROOT_TWO_PI = 0.5 * float(np.log(2.0 * np.pi))


def uniform(a: Arguments, x: np.ndarray) -> np.ndarray:
    """On [lo, hi]."""
    low, high = a
    return np.where((x >= low) & (x <= high), -np.log(high - low), -np.inf)


def loguniform(a: Arguments, x: np.ndarray) -> np.ndarray:
    """On [lo, hi], with a uniform logarithm."""
    low, high = a
    inside = (x >= low) & (x <= high)
    return np.where(inside, -np.log(np.where(inside, x, 1.0)) - np.log(np.log(high / low)), -np.inf)


def normal(a: Arguments, x: np.ndarray) -> np.ndarray:
    """With mean and standard deviation."""
    mean, std = a
    return -0.5 * ((x - mean) / std) ** 2 - np.log(std) - LOG_ROOT_TWO_PI


def truncated_normal(a: Arguments, x: np.ndarray) -> np.ndarray:
    """Normal (mean a[0], deviation a[1]) truncated to [a[2], a[3]]; above the mean its mass is of the upper tail."""
    mean, std, low, high = a
    lower = (low - mean) / std
    upper = (high - mean) / std
    if lower > 0.0:
        lower, upper = -upper, -lower
    mass = scipy.special.ndtr(upper) - scipy.special.ndtr(lower)
    return np.where((x >= low) & (x <= high), normal((mean, std), x) - np.log(mass), -np.inf)


def lognormal(a: Arguments, x: np.ndarray) -> np.ndarray:
    """With mean and standard deviation of the logarithm."""
    logarithm = np.log(np.where(x > 0.0, x, 1.0))
    return np.where(x > 0.0, normal(a, logarithm) - logarithm, -np.inf)


def beta(a: Arguments, x: np.ndarray) -> np.ndarray:
    """Beta on [lo, hi], by default [0, 1]."""
    low, high = a[2:] or (0.0, 1.0)
    inside = (x >= low) & (x <= high)
    share = np.where(inside, (x - low) / (high - low), 0.5)
    logarithm = scipy.special.xlogy(a[0] - 1.0, share) + scipy.special.xlog1py(a[1] - 1.0, -share)
    return np.where(inside, logarithm - scipy.special.betaln(a[0], a[1]) - np.log(high - low), -np.inf)


def triangular(a: Arguments, x: np.ndarray) -> np.ndarray:
    """On [lo, hi] with its peak at the mode."""
    low, mode, high = a
    rising = np.divide(x - low, mode - low, out=np.ones_like(x), where=(low <= x) & (x < mode))
    falling = np.divide(high - x, high - mode, out=np.ones_like(x), where=(mode < x) & (x <= high))
    height = np.minimum(rising, falling)
    inside = (x >= low) & (x <= high) & (height > 0.0)
    return np.where(inside, np.log(np.where(inside, height, 1.0)) + np.log(2.0 / (high - low)), -np.inf)
