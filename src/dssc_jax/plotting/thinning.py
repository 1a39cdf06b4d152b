"""Reduce long curves to few points, without details that a figure cannot show."""

import numpy as np

PIXEL_COLUMNS = 600  # about two a millimetre of a printed figure


def thinned(x: np.ndarray, y: np.ndarray, columns: int = PIXEL_COLUMNS) -> tuple[np.ndarray, np.ndarray]:
    """Reduce a curve to the lowest and the highest point of each column of a picture, so that no peak is lost.

    Args:
        x: Increasing, shape (n,).
        y: Values, shape (n,); NaN leaves a gap.
        columns: Number of groups of neighbouring points into which the curve is cut.

    Returns:
        At most ``2 columns`` points in their order; the curve itself if it has no more.

    Example:
        >>> thinned(np.arange(9), np.array([0, 0, 0, 0, 7, 0, 0, -1, 0]), 2)[1]
        array([ 0,  7,  0, -1])
    """
    if len(x) <= 2 * columns:
        return x, y
    extreme_indices: list[int] = []
    for group in np.array_split(np.arange(len(x)), columns):
        inside = y[group]
        if np.isnan(inside).all():
            extreme_indices.append(int(group[0]))
            continue
        extremes = {int(group[np.nanargmin(inside)]), int(group[np.nanargmax(inside)])}
        extreme_indices += sorted(extremes)
    return x[extreme_indices], y[extreme_indices]


def envelope(
    x: np.ndarray, low: np.ndarray, high: np.ndarray, columns: int = PIXEL_COLUMNS
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reduce a band to its outermost values in each column of a picture.

    Args:
        x: Increasing, shape (n,).
        low: Lower edge of the band, shape (n,).
        high: Upper edge of the band, shape (n,).
        columns: Number of groups of neighbouring points into which the band is cut.

    Returns:
        x, lower and upper edge at ``columns + 1`` points; the band itself if it has at most ``2 columns``.
    """
    if len(x) <= 2 * columns:
        return x, low, high
    first_points = len(x) * np.arange(columns) // columns  # of the groups
    ends = np.append(first_points, len(x) - 1)
    lowest = np.minimum.reduceat(low, first_points)
    highest = np.maximum.reduceat(high, first_points)
    return x[ends], np.append(lowest, lowest[-1]), np.append(highest, highest[-1])


def spaced_indices(count: int, limit: int = PIXEL_COLUMNS) -> np.ndarray:
    """Evenly spaced indices from 0 to ``count - 1``, both included.

    Args:
        count: Number of points to choose from.
        limit: Largest number of indices.
    """
    indices = np.linspace(0, count - 1, min(count, limit))
    return np.unique(indices.round().astype(int))
