"""Gains of the closed loop's response that are bounded on a cell, from a set that encloses the response there."""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.loop_margins.structured import balancing_scales, best_scales, scaled_norms

DIRECTIONS = 64  # in which a polygon's extent is computed
VERTICES = 4  # numbers whose ends are all combined; the norms of the parts of the others are added
ROUNDING = 1e-9  # share by which every bound is enlarged
FEEDTHROUGHS = {"sensitivity_peak": 1.0, "complementary_peak": 0.0, "disk": 0.5}
"""What is added to G: S = 1 + G, T = -G, (S - T)/2 = G + 1/2."""
GAINS = (*FEEDTHROUGHS, "delay")
"""The gains of one broken loop; that of ``delay`` is abs(T) theta."""


class Enclosure(NamedTuple):
    """Sets that contain the response on n cells: G = centre + sum of u_i linear_i + R, u_i in [-1, 1], abs(R) <= r.

    Args:
        centre: Shape (n, channels, channels).
        linear: Shape (n, sides + 1, channels, channels).
        remainder: The bound r of abs(R), entry by entry, shape (n, channels, channels).
        end: Last angle of each cell, shape (n,).
    """

    centre: np.ndarray
    linear: np.ndarray
    remainder: np.ndarray
    end: np.ndarray


class Readout(NamedTuple):
    """The gains that are bounded.

    Args:
        channels: Channels in which the loop is broken.
        size: Number of gains.
        scales: (responses, shape (n, channels, channels)) -> positive weights of the channels, shape (n, channels).
        gains: (enclosure, goals) -> an upper bound of each gain on each cell, shape (n, size). A bound may be looser
            than need be once it is below its goal.
    """

    channels: int
    size: int
    scales: Callable[[np.ndarray], np.ndarray]
    gains: Callable[[Enclosure, np.ndarray], np.ndarray]


def unscaled(responses: np.ndarray) -> np.ndarray:
    """Weights of 1 for one channel."""
    return np.ones(responses.shape[:2])


def single_gains(enclosure: Enclosure, goals: np.ndarray) -> np.ndarray:
    """Bounds of :data:`GAINS` of a loop that is broken in one channel."""
    centre = enclosure.centre[:, 0, 0]
    linear = enclosure.linear[:, :, 0, 0]
    disk = enclosure.remainder[:, 0, 0]
    gains = []
    for feedthrough in FEEDTHROUGHS.values():
        gains.append((1.0 + ROUNDING) * (extent(centre + feedthrough, linear) + disk))
    gains.append(gains[1] * enclosure.end)
    return np.stack(gains, axis=1)


def extent(centre: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """A bound of abs(centre + sum of u_i generators_i), u_i in [-1, 1]; shapes (n,) and (n, k)."""
    turns = np.exp(-2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
    reach = np.real(centre[:, None] * turns)
    for generator in generators.T:
        reach += np.abs(np.real(generator[:, None] * turns))
    return reach.max(axis=1) / np.cos(np.pi / DIRECTIONS)


def joint_scales(responses: np.ndarray) -> np.ndarray:
    """D-scales that balance responses; 1 where they are not finite."""
    finite = np.all(np.isfinite(responses), axis=(1, 2))
    return np.exp(balancing_scales(np.where(finite[:, None, None], responses, 0.0)))


def joint_gains(enclosure: Enclosure, goals: np.ndarray) -> np.ndarray:
    """A bound of the structured singular value of G + I/2 on each cell, shape (n, 1), by one D for each cell.

    Every positive D gives a bound. The first D balances the sizes that the entries may have on the cell. Where it
    misses the goal in the middle already, the best D there is tried too: elsewhere a smaller cell helps.
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
    """Bounds of the largest singular value of D M D^-1 on each cell, shape (n,), from log D of shape (n, channels)."""
    ratios = np.exp(logs[:, :, None] - logs[:, None, :])
    scaled_parts = [middle * ratios, linear * ratios[:, None], remainder * ratios]
    finite = np.all(np.isfinite(scaled_parts[1]), axis=(1, 2, 3))
    for part in (scaled_parts[0], scaled_parts[2]):
        finite &= np.all(np.isfinite(part), axis=(1, 2))
    bounds = np.full(len(middle), np.inf)
    centre, generators, remainders = (part[finite] for part in scaled_parts)
    bounds[finite] = norm_over_box(centre, generators) + norms(remainders)
    return bounds


def norm_over_box(centre: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """A bound of the largest singular value of centre + sum of u_i generators_i, u_i in [-1, 1].

    It is convex in u, so that its maximum over a box lies at a vertex. All vertices of the largest generators are
    looked at; the norms of the others are added.

    Args:
        centre: Shape (n, m, m).
        generators: Shape (n, k, m, m).
    """
    sizes = norms(generators)
    order = np.argsort(-sizes, axis=1)
    sorted_generators = np.take_along_axis(generators, order[:, :, None, None], 1)
    remaining_norms = np.take_along_axis(sizes, order, 1)[:, VERTICES:].sum(axis=1)
    leading_generators = sorted_generators[:, :VERTICES]
    largest = np.zeros(len(centre))
    for signs in itertools.product((-1.0, 1.0), repeat=leading_generators.shape[1]):
        largest = np.maximum(largest, norms(centre + np.einsum("k,nkij->nij", np.array(signs), leading_generators)))
    return largest + remaining_norms


def norms(matrices: np.ndarray) -> np.ndarray:
    """Largest singular values of matrices in the last two axes."""
    return np.linalg.svd(matrices, compute_uv=False)[..., 0]


SINGLE = Readout(1, len(GAINS), unscaled, single_gains)
"""The gains of a loop that is broken in one channel."""


def joint(channels: int) -> Readout:
    """The gain of all commands at once: the structured singular value of G + I/2, whose inverse is the disk margin."""
    return Readout(channels, 1, joint_scales, joint_gains)
