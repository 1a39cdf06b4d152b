"""What the order statistics of independent draws say of any law: quantiles and tolerance limits."""

import numpy as np
from scipy import special

from dssc_jax.statistics.proportions import CONFIDENCE


def binomial_quantile(level: float, draws: int, probability: float) -> int:
    """The smallest k at which the distribution function of Bin(draws, probability) reaches ``level``."""
    k = max(0, int(np.ceil(special.bdtrik(level, draws, probability))))
    while k > 0 and special.bdtr(k - 1, draws, probability) >= level:
        k -= 1
    while k < draws and special.bdtr(k, draws, probability) < level:
        k += 1
    return k


def quantile_interval(values: np.ndarray, level: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Two order statistics that enclose a quantile of any law, whatever its shape.

    [X_(r), X_(s)] with P(Bin(n, p) < r) <= a/2 and P(Bin(n, p) >= s) <= a/2; an end is infinite where n draws are too
    few for it.

    Args:
        values: Independent, identically distributed draws, shape (n,); a draw without a value (NaN) counts as +inf.
        level: p of the quantile, in (0, 1).
        confidence: Coverage, in (0, 1); the true one is at least that.

    Returns:
        Lower and upper end.

    Raises:
        ValueError: no values, or a level or confidence outside (0, 1).

    Example:
        >>> quantile_interval(np.arange(1.0, 101.0), 0.5)
        (40.0, 61.0)

    Reference:
        H. A. David, H. N. Nagaraja, Order Statistics, 3rd ed. (2003), section 7.1.
    """
    if len(values) == 0 or not 0.0 < level < 1.0 or not 0.0 < confidence < 1.0:
        raise ValueError(f"needs values, level and confidence in (0, 1), got {len(values)}, {level}, {confidence}")
    ranked = np.sort(np.where(np.isnan(values), np.inf, values))
    tail = 0.5 * (1.0 - confidence)
    low = binomial_quantile(tail, len(ranked), level)
    high = binomial_quantile(1.0 - tail, len(ranked), level) + 1
    return (
        float(ranked[low - 1]) if low > 0 else -np.inf,
        float(ranked[high - 1]) if high <= len(ranked) else np.inf,
    )
