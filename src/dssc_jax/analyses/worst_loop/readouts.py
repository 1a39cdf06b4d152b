"""Bounds of gains of the closed loop on a cell, from a set that encloses the frequency response there."""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.loop_margins.structured import balancing_scales, best_scales, scaled_norms

DIRECTIONS = 64  # directions in which the extent of a polygon is computed
VERTICES = 4  # numbers of which all combinations of ends are tried; for the others norms are added
ROUNDING = 1e-9  # share by which every bound is enlarged
FEEDTHROUGHS = {"sensitivity_peak": 1.0, "complementary_peak": 0.0, "disk": 0.5}
"""What is added to G: S = 1 + G, T = -G, (S - T)/2 = G + 1/2."""
GAINS = (*FEEDTHROUGHS, "delay")
"""The gains of one broken loop; that of ``delay`` is abs(T) theta."""


class Enclosure(NamedTuple):
    """Sets that contain the response on n cells: G = centre + sum of u_i linear_i + R, u_i in [-1, 1], abs(R) <= r.

    Args:
        centre: The response in the middle of each cell, shape (n, channels, channels).
        linear: Its linear part along each side and the angle, shape (n, sides + 1, channels, channels).
        remainder: The bound r of abs(R), entry by entry, shape (n, channels, channels).
        end: Last angle of each cell, shape (n,).
    """

    centre: np.ndarray
    linear: np.ndarray
    remainder: np.ndarray
    end: np.ndarray


class Readout(NamedTuple):
    """The gains of a broken loop that are bounded, and how.

    Args:
        channels: Number of channels in which the loop is broken.
        size: Number of gains.
        scales: (responses, shape (n, channels, channels)) -> positive weights of the channels, shape (n, channels).
        gains: (enclosure, goals) -> an upper bound of each gain on each cell, shape (n, size). A bound below its goal
            need not be sharp.
    """

    channels: int
    size: int
    scales: Callable[[np.ndarray], np.ndarray]
    gains: Callable[[Enclosure, np.ndarray], np.ndarray]


def unscaled(responses: np.ndarray) -> np.ndarray:
    """Weights of 1, for a loop that is broken in one channel, from responses of shape (n, 1, 1)."""
    return np.ones(responses.shape[:2])


def single_gains(enclosure: Enclosure, goals: np.ndarray) -> np.ndarray:
    """Bounds of the :data:`GAINS` of a loop that is broken in one channel on each cell, shape (n, gains)."""
    centre = enclosure.centre[:, 0, 0]
    linear = enclosure.linear[:, :, 0, 0]
    disk = enclosure.remainder[:, 0, 0]
    gains = []
    for feedthrough in FEEDTHROUGHS.values():
        gains.append((1.0 + ROUNDING) * (magnitude_bound(centre + feedthrough, linear) + disk))
    gains.append(gains[1] * enclosure.end)
    return np.stack(gains, axis=1)


def magnitude_bound(centre: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """A bound of abs(centre + sum of u_i generators_i) over u_i in [-1, 1], shape (n,).

    Args:
        centre: Complex numbers, shape (n,).
        generators: Complex numbers, shape (n, k).
    """
    turns = np.exp(-2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
    reach = np.real(centre[:, None] * turns)
    for generator in generators.T:
        reach += np.abs(np.real(generator[:, None] * turns))
    return reach.max(axis=1) / np.cos(np.pi / DIRECTIONS)


def joint_scales(responses: np.ndarray) -> np.ndarray:
    """Diagonals of D that balance the responses, shape (n, channels); 1 where a response is not finite.

    Args:
        responses: Shape (n, channels, channels).
    """
    finite = np.all(np.isfinite(responses), axis=(1, 2))
    return np.exp(balancing_scales(np.where(finite[:, None, None], responses, 0.0)))


def joint_gains(enclosure: Enclosure, goals: np.ndarray) -> np.ndarray:
    """A bound of the structured singular value of G + I/2 on each cell, shape (n, 1), by one D for each cell.

    Every positive D gives a bound. The first D balances the largest sizes of the entries on the cell. If its bound in
    the middle of the cell is above the goal already, the best D for the middle is tried, too. Otherwise a smaller cell
    is enough.
    """
    middle = enclosure.centre + 0.5 * np.eye(enclosure.centre.shape[-1])
    sizes = np.abs(middle) + np.abs(enclosure.linear).sum(axis=1) + enclosure.remainder
    gains = np.full(len(middle), np.inf)
    rows = np.flatnonzero(np.all(np.isfinite(sizes), axis=(1, 2)))
    if not rows.size:
        return gains[:, None]
    logs = balancing_scales(sizes[rows])
    gains[rows] = scaled_bounds(middle[rows], enclosure.linear[rows], enclosure.remainder[rows], logs)
    above_goal = rows[scaled_norms(middle[rows], logs)[0] > goals[0]]
    if above_goal.size:
        best = best_scales(middle[above_goal])
        sharper = scaled_bounds(middle[above_goal], enclosure.linear[above_goal], enclosure.remainder[above_goal], best)
        gains[above_goal] = np.minimum(gains[above_goal], sharper)
    return (1.0 + ROUNDING) * gains[:, None]


def scaled_bounds(middle: np.ndarray, linear: np.ndarray, remainder: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Bounds of the largest singular value of D M D^-1 on each cell, shape (n,); infinite where they overflow.

    Args:
        middle: M in the middle of each cell, shape (n, channels, channels).
        linear: The linear part of M, shape (n, sides + 1, channels, channels).
        remainder: A bound of the remainder of M, shape (n, channels, channels).
        logs: log D, shape (n, channels).
    """
    ratios = np.exp(logs[:, :, None] - logs[:, None, :])
    scaled_parts = [middle * ratios, linear * ratios[:, None], remainder * ratios]
    finite = np.all(np.isfinite(scaled_parts[1]), axis=(1, 2, 3))
    for part in (scaled_parts[0], scaled_parts[2]):
        finite &= np.all(np.isfinite(part), axis=(1, 2))
    bounds = np.full(len(middle), np.inf)
    centre, generators, remainders = (part[finite] for part in scaled_parts)
    bounds[finite] = norm_over_box(centre, generators) + largest_singular_values(remainders)
    return bounds


def norm_over_box(centre: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """A bound of the largest singular value of centre + sum of u_i generators_i over u_i in [-1, 1], shape (n,).

    The singular value is convex in u, so its maximum over a box lies at a vertex. All vertices are tried for the
    largest generators. For the others norms are added.

    Args:
        centre: Shape (n, m, m).
        generators: Shape (n, k, m, m).
    """
    sizes = largest_singular_values(generators)
    order = np.argsort(-sizes, axis=1)
    sorted_generators = np.take_along_axis(generators, order[:, :, None, None], 1)
    remaining_norms = np.take_along_axis(sizes, order, 1)[:, VERTICES:].sum(axis=1)
    leading_generators = sorted_generators[:, :VERTICES]
    largest = np.zeros(len(centre))
    for signs in itertools.product((-1.0, 1.0), repeat=leading_generators.shape[1]):
        vertex = centre + np.einsum("k,nkij->nij", np.array(signs), leading_generators)
        largest = np.maximum(largest, largest_singular_values(vertex))
    return largest + remaining_norms


def largest_singular_values(matrices: np.ndarray) -> np.ndarray:
    """Largest singular values of matrices of shape (..., m, m), shape (...)."""
    return np.linalg.svd(matrices, compute_uv=False)[..., 0]


SINGLE_READOUT = Readout(1, len(GAINS), unscaled, single_gains)
"""The gains of a loop that is broken in one channel."""


def joint_readout(channels: int) -> Readout:
    """The gain of all commands at once: the structured singular value of G + I/2, the inverse of the disk margin."""
    return Readout(channels, 1, joint_scales, joint_gains)
