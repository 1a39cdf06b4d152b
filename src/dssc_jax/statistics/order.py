"""Intervals of quantiles and tolerance limits from order statistics, valid for any law."""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from scipy import special

from dssc_jax.statistics.proportions import CONFIDENCE, require_share


def binomial_quantile(level: float, draws: int, probability: float) -> int:
    """Smallest k at which the distribution function of Bin(draws, probability) reaches ``level``.

    Rounding may put SciPy's inverse off by one, so the distribution function itself corrects the result.

    Args:
        level: Level of the quantile, in (0, 1).
        draws: Number of draws of the binomial law.
        probability: Probability of an event in one draw.
    """
    k = max(0, int(np.ceil(special.bdtrik(level, draws, probability))))  # bdtr: the distribution function
    while k > 0 and special.bdtr(k - 1, draws, probability) >= level:
        k -= 1
    while k < draws and special.bdtr(k, draws, probability) < level:
        k += 1
    return k


def first_integer(condition: Callable[[int], bool], start: int = 1) -> int:
    """Smallest integer from ``start`` on that meets a condition.

    Doubling steps find an integer that meets the condition, and bisection then finds the smallest one.

    Args:
        condition: Whether an integer qualifies. If one does, all larger integers must qualify, too.
        start: First integer to try.
    """
    if condition(start):
        return start
    step = 1
    while not condition(start + step):
        step *= 2
    low = start + step // 2
    high = start + step
    while high - low > 1:
        middle = (low + high) // 2
        if condition(middle):
            high = middle
        else:
            low = middle
    return high


def sorted_draws(values: np.ndarray, missing: float = np.inf) -> np.ndarray:
    """Values in ascending order along the last axis, the axis of the draws.

    Args:
        values: The values, shape (..., n).
        missing: Value that replaces NaN.
    """
    return np.sort(np.where(np.isnan(values), missing, values))


def at_rank(sorted_values: np.ndarray, rank: int) -> np.ndarray:
    """The value at a rank along the last axis, from 1, the smallest; -inf below the range of ranks, inf above it.

    Args:
        sorted_values: Values from :func:`sorted_draws`, shape (..., n).
        rank: Rank; values exist at 1 to n.
    """
    if 1 <= rank <= sorted_values.shape[-1]:
        return sorted_values[..., rank - 1]
    return np.full(sorted_values.shape[:-1], -np.inf if rank < 1 else np.inf)


def upper_quantile(sorted_values: np.ndarray, level: float) -> np.ndarray:
    """Smallest value with at least the share ``level`` of the draws at or below it, along the last axis.

    The quantile is the value of a draw. So a finite value is never averaged with an infinite one.

    Args:
        sorted_values: Values from :func:`sorted_draws`.
        level: Level of the quantile, in [0, 1].
    """
    rank = max(1, math.ceil(level * sorted_values.shape[-1]))
    return at_rank(sorted_values, rank)


def upper_quantiles(values: np.ndarray, levels: Sequence[float], missing: float = np.inf) -> np.ndarray:
    """Quantiles along the last axis at several levels, shape (levels, ...), as :func:`upper_quantile` defines them.

    Args:
        values: The draws, shape (..., n).
        levels: Levels of the quantiles, in [0, 1].
        missing: Replaces NaN.
    """
    sorted_values = sorted_draws(values, missing)
    return np.stack([upper_quantile(sorted_values, level) for level in levels])


@lru_cache
def quantile_ranks(draws: int, level: float, confidence: float = CONFIDENCE) -> tuple[int, int]:
    """Ranks r and s of the draws whose values enclose a quantile of any law with a confidence.

    The number B of draws below the quantile of a continuous law has the law Bin(n, p). The ranks satisfy
    P(B < r) <= a/2 and P(B >= s) <= a/2.

    Args:
        draws: Number n of draws, >= 1.
        level: Level p of the quantile, in (0, 1).
        confidence: Coverage 1 - a, in (0, 1).

    Returns:
        r in 0 .. n and s in 1 .. n + 1; 0 and n + 1 stand for infinite ends.

    Raises:
        ValueError: An argument is out of range.

    Reference:
        H. A. David, H. N. Nagaraja, Order Statistics, 3rd ed. (2003), section 7.1.
    """
    require_share(level=level, confidence=confidence)
    if draws < 1:
        raise ValueError(f"needs at least one draw, got {draws}")
    tail = 0.5 * (1.0 - confidence)
    return binomial_quantile(tail, draws, level), binomial_quantile(1.0 - tail, draws, level) + 1


def quantile_interval(values: np.ndarray, level: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Interval of a quantile of any law, between two order statistics.

    Args:
        values: Independent, identically distributed draws, shape (n,); NaN counts as +inf.
        level: Level p of the quantile, in (0, 1).
        confidence: Nominal coverage, in (0, 1); the actual coverage is at least this.

    Returns:
        Lower and upper end; infinite if n draws are too few.

    Raises:
        ValueError: An argument is out of range.

    Example:
        >>> quantile_interval(np.arange(1.0, 101.0), 0.5)
        (40.0, 61.0)
    """
    low, high = quantile_ranks(len(values), level, confidence)
    sorted_values = sorted_draws(values)
    return float(at_rank(sorted_values, low)), float(at_rank(sorted_values, high))


def wilks_confidence(draws: int, content: float, order: int = 1, sides: int = 1) -> float:
    """Confidence that tolerance limits from order statistics contain at least the share ``content`` of the law.

    A one-sided limit is the k-th largest or the k-th smallest of n draws; two-sided limits are both. The confidence is
    1 - sum_i C(n, i) (1-p)^i p^(n-i), over all i below k times the number of sides.

    Args:
        draws: Number n of draws.
        content: Share p of the law within the limits, in (0, 1).
        order: Order k of the extremes.
        sides: 1 for a lower or an upper limit, 2 for both at once.
    """
    if draws < order * sides:
        return 0.0
    return float(special.bdtrc(order * sides - 1, draws, 1.0 - content))  # P(more draws outside than this number)


def wilks_draws(content: float, confidence: float = CONFIDENCE, order: int = 1, sides: int = 1) -> int:
    """Smallest number of draws whose k-th smallest and largest values are tolerance limits.

    Args:
        content: Share p of the law within the limits, in (0, 1).
        confidence: Confidence level, in (0, 1).
        order: Order k >= 1; a higher order needs more draws and gives a limit that scatters less.
        sides: 1 for a lower or an upper limit, 2 for both at once.

    Raises:
        ValueError: An argument is out of range.

    Example:
        >>> [wilks_draws(0.95, order=k) for k in (1, 2, 3)], wilks_draws(0.95, sides=2)
        ([59, 93, 124], 93)

    Reference:
        S. S. Wilks, Annals of Mathematical Statistics 12 (1941) 91-96.
    """
    require_share(content=content, confidence=confidence)
    if order < 1 or sides not in (1, 2):
        raise ValueError(f"needs order >= 1 and sides 1 or 2, got {order} and {sides}")
    return first_integer(lambda draws: wilks_confidence(draws, content, order, sides) >= confidence)


def wilks_order(draws: int, content: float, confidence: float = CONFIDENCE, sides: int = 1) -> int:
    """Highest order k for which the k-th extremes of n draws are tolerance limits; 0 if n is too small.

    Args:
        draws: Number n of draws.
        content: Share of the law within the limits, in (0, 1).
        confidence: Confidence level, in (0, 1).
        sides: 1 for a lower or an upper limit, 2 for both at once.
    """
    require_share(content=content, confidence=confidence)
    order = binomial_quantile(1.0 - confidence, draws, 1.0 - content) // sides + 1
    while order > 0 and wilks_confidence(draws, content, order, sides) < confidence:
        order -= 1
    return order


def tolerance_limits(
    values: np.ndarray, content: float, confidence: float = CONFIDENCE, side: str = "both"
) -> tuple[float, float]:
    """Tolerance limits that contain at least the share ``content`` of any law with the stated confidence.

    Args:
        values: Independent, identically distributed draws, shape (n,); NaN counts as +inf.
        content: Share of the law, in (0, 1).
        confidence: Confidence level, in (0, 1).
        side: ``lower``, ``upper`` or ``both``; the other end is infinite.

    Returns:
        Lower and upper limit; infinite if n draws are too few.

    Raises:
        ValueError: An argument is out of range.

    Example:
        >>> tolerance_limits(np.arange(1.0, 94.0), 0.95, side="upper")
        (-inf, 92.0)
    """
    if side not in ("lower", "upper", "both"):
        raise ValueError(f"side must be lower, upper or both, got '{side}'")
    order = wilks_order(len(values), content, confidence, sides=2 if side == "both" else 1)
    sorted_values = sorted_draws(values)
    low = -np.inf
    high = np.inf
    if order and side in ("lower", "both"):
        low = float(at_rank(sorted_values, order))
    if order and side in ("upper", "both"):
        high = float(at_rank(sorted_values, len(values) + 1 - order))
    return low, high


def typical_size(values: np.ndarray) -> float:
    """Median magnitude of the finite values, but at least the smallest normal number, so that one can divide by it."""
    finite = np.abs(values[np.isfinite(values)])
    return max(float(np.median(finite)) if finite.size else 0.0, np.finfo(float).tiny)
