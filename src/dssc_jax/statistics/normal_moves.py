"""The worst failure probability when the scores of the draws are moved or widened, whatever set of draws fails.

The scores of a draw have the standard normal law. Let the true law of the scores be N(d, I), at distance s = |d|. Of
all sets of probability p, the one whose probability grows most is the half space in direction d (Neyman and Pearson):
it grows to Phi(Phi^-1(p) + s). If the true law is N(0, k^2 I) in n numbers with k >= 1, the set that grows most is the
outside of a ball. These bounds hold whatever set of draws fails and are attained by these sets.

A law with a smaller distance, or with widths between 1 and k, is what noise leaves of the law with the distance s or
the width k, so that its worst case is smaller.

References:
    J. Neyman, E. S. Pearson, Philosophical Transactions A 231 (1933) 289-337.
    J. Cohen, E. Rosenfeld, Z. Kolter, Proceedings of Machine Learning Research 97 (2019) 1310-1320: the bound for
    moved normal laws.
"""

import math

from scipy import special

from dssc_jax.statistics.divergence_balls import require_probability


def worst_when_moved(p: float, distance: float) -> float:
    """Phi(Phi^-1(p) + s): the largest probability of a set of probability p once the scores are moved by s.

    Args:
        p: Probability of the set, in [0, 1].
        distance: s, the Euclidean length of the move; negative: the smallest probability.
    """
    require_probability(p=p)
    return float(special.ndtr(special.ndtri(p) + distance))


def largest_distance(p: float, limit: float) -> float:
    """The distance up to which no set of probability p can become more probable than the limit.

    Args:
        p: Probability of the set, in [0, 1].
        limit: In (0, 1).

    Returns:
        0 if p is above the limit; infinity if p is 0.

    Example:
        >>> round(largest_distance(0.01, 0.05), 4)
        0.6815
    """
    require_probability(p=p)
    return max(0.0, float(special.ndtri(limit) - special.ndtri(p)))


def worst_when_widened(p: float, width: float, numbers: int) -> float:
    """The largest probability of a set of probability p once the widths of all scores are multiplied.

    Args:
        p: Probability of the set, in [0, 1].
        width: k >= 1, the largest relative width of each score.
        numbers: n >= 1, number of scores that are widened.

    Raises:
        ValueError: The width is below 1.
    """
    require_probability(p=p)
    if not width >= 1.0:
        raise ValueError(f"width must be at least 1, got {width!r}")
    half = 0.5 * numbers
    return float(special.gammaincc(half, special.gammainccinv(half, p) / width**2))


def largest_width(p: float, limit: float, numbers: int) -> float:
    """The relative width of all scores up to which no set of probability p becomes more probable than the limit.

    Returns:
        1 if p is above the limit; infinity if p is 0.
    """
    require_probability(p=p)
    half = 0.5 * numbers
    ratio = special.gammainccinv(half, p) / special.gammainccinv(half, limit)
    return max(1.0, math.sqrt(float(ratio)))
