"""Worst probability of a set of scores when their normal law is moved or widened, over all sets of a given probability.

The scores of a draw have the standard normal law, and the set contains the scores of the failing draws. Let the true
law of the scores be N(d, I), at the distance s = |d|. Of all sets of probability p, the half space in direction d gains
most (Neyman and Pearson): its probability becomes Phi(Phi^-1(p) + s). If the true law is N(0, k^2 I) in n numbers with
k >= 1, the outside of a ball gains most. So the bounds hold for any set, and these sets attain them.

A smaller distance, or widths between 1 and k, cannot be worse. The same rescaling with added noise turns N(0, I) into
itself and the law with s or k into the milder law, and no processing makes two laws easier to tell apart.

References:
    J. Neyman, E. S. Pearson, Philosophical Transactions A 231 (1933) 289-337.
    J. Cohen, E. Rosenfeld, Z. Kolter, Proceedings of Machine Learning Research 97 (2019) 1310-1320: the bound for
    moved normal laws.
"""

import math

from scipy import special

from dssc_jax.statistics.divergence_balls import require_probability


def worst_when_moved(p: float, distance: float) -> float:
    """Largest probability Phi(Phi^-1(p) + s) of a set once the mean of the scores is moved by s.

    Args:
        p: Probability of the set before the move, in [0, 1].
        distance: Euclidean length s of the move; if negative, the result is the smallest probability for the length -s.
    """
    require_probability(p=p)
    return float(special.ndtr(special.ndtri(p) + distance))


def largest_distance(p: float, limit: float) -> float:
    """Largest distance of a move under which the probability of a set cannot exceed a limit.

    The function is the inverse of :func:`worst_when_moved`.

    Args:
        p: Probability of the set before the move, in [0, 1].
        limit: Largest probability allowed, in (0, 1).

    Returns:
        The distance; 0 if p is above the limit; infinity if p is 0.

    Example:
        >>> round(largest_distance(0.01, 0.05), 4)
        0.6815
    """
    require_probability(p=p)
    return max(0.0, float(special.ndtri(limit) - special.ndtri(p)))


def worst_when_widened(p: float, width: float, numbers: int) -> float:
    """Largest probability of a set once the width of each score is multiplied by at most k.

    The worst set lies outside a ball of the scores. The ball is chosen so that the outside has the probability p before
    the widening.

    Args:
        p: Probability of the set before the widening, in [0, 1].
        width: Largest relative width k, >= 1.
        numbers: Number n of widened scores, >= 1.

    Raises:
        ValueError: The width is below 1.
    """
    require_probability(p=p)
    if not width >= 1.0:
        raise ValueError(f"width must be at least 1, got {width!r}")
    half = 0.5 * numbers  # half the squared radius of the ball has a gamma law of this shape
    half_square = special.gammainccinv(half, p)
    return float(special.gammaincc(half, half_square / width**2))


def largest_width(p: float, limit: float, numbers: int) -> float:
    """Largest relative width of the scores at which the probability of a set cannot exceed a limit.

    The function is the inverse of :func:`worst_when_widened`.

    Args:
        p: Probability of the set before the widening, in [0, 1].
        limit: Largest probability allowed, in (0, 1).
        numbers: Number n of widened scores, >= 1.

    Returns:
        The width; 1 if p is above the limit; infinity if p is 0.
    """
    require_probability(p=p)
    half = 0.5 * numbers
    squared_width = special.gammainccinv(half, p) / special.gammainccinv(half, limit)
    return max(1.0, math.sqrt(float(squared_width)))
