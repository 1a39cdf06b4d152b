"""Bounds of gains of the closed loop on a cell, from a set that encloses the frequency response G there.

A cell is a part of the box of uncertain numbers with an interval of angles theta = omega T_s. With S = 1 + G and
T = -G, a bound of a gain is a bound of a margin: of S, of T and of (S - T)/2 = G + 1/2, whose inverse is the disk
margin.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.loop_margins.structured import balancing_log_scales, best_log_scales, scaled_norms

DIRECTIONS = 64  # directions in which the extent of a polygon is computed
VERTICES = 4  # coordinates of which all combinations of ends are tried; for the others norms are added
ROUNDING = 1e-9  # share by which every bound is enlarged, more than the errors of rounding
FEEDTHROUGHS = {"sensitivity_peak": 1.0, "complementary_peak": 0.0, "disk": 0.5}
"""What is added to G: S = 1 + G, T = -G, (S - T)/2 = G + 1/2."""
GAINS = (*FEEDTHROUGHS, "delay")
"""The gains of a loop that is broken in one channel; ``delay`` is abs(T) theta, whose inverse bounds a delay in T_s."""


class Enclosure(NamedTuple):
    """Sets that contain the response G = centre + sum of u_i linear_i + R on n cells, for all u_i in [-1, 1].

    Args:
        centre: The response in the middle of each cell, shape (n, channels, channels).
        linear: Its linear part along each side and, last, the angle; shape (n, sides + 1, channels, channels).
        remainder: The bound of abs(R), entry by entry, shape (n, channels, channels).
        end: Last angle omega T_s of each cell, shape (n,).
    """

    centre: np.ndarray
    linear: np.ndarray
    remainder: np.ndarray
    end: np.ndarray


class Readout(NamedTuple):
    """What is read from the response of a broken loop: the gains that are bounded, and how.

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
    """The weights of the only channel of a loop that is broken in one channel: all 1, shape (n, 1).

    Args:
        responses: The responses, shape (n, 1, 1), of which only n matters.
    """
    return np.ones(responses.shape[:2])


def single_gains(enclosure: Enclosure, goals: np.ndarray) -> np.ndarray:
    """Bounds of the :data:`GAINS` on each cell, shape (n, gains), for a loop that is broken in one channel.

    Args:
        enclosure: The sets that contain the response.
        goals: Not used; all bounds are as sharp as they can be.
    """
    centre = enclosure.centre[:, 0, 0]
    linear = enclosure.linear[:, :, 0, 0]
    radius = enclosure.remainder[:, 0, 0]
    bounds = {}
    for name, feedthrough in FEEDTHROUGHS.items():
        bounds[name] = (1.0 + ROUNDING) * (magnitude_bound(centre + feedthrough, linear) + radius)
    bounds["delay"] = bounds["complementary_peak"] * enclosure.end
    return np.stack([bounds[name] for name in GAINS], axis=1)


def magnitude_bound(centre: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """A bound of abs(centre + sum of u_i generators_i) over all u_i in [-1, 1], shape (n,).

    These numbers form a polygon in the complex plane, whose extent is computed in :data:`DIRECTIONS` directions. The
    direction of any point differs from the nearest of these by at most half the angle between two of them. The division
    by the cosine of this half angle makes the result a bound.

    Args:
        centre: Complex numbers, shape (n,).
        generators: Complex numbers, shape (n, k).
    """
    turns = np.exp(-2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)  # each turns its direction onto the real axis
    reach = np.real(centre[:, None] * turns)
    for generator in generators.T:
        reach += np.abs(np.real(generator[:, None] * turns))
    return reach.max(axis=1) / np.cos(np.pi / DIRECTIONS)


def joint_scales(responses: np.ndarray) -> np.ndarray:
    """Diagonals of the matrices D that balance the responses D G D^-1, shape (n, channels); 1 if G is not finite.

    Args:
        responses: G, shape (n, channels, channels).
    """
    is_finite = np.all(np.isfinite(responses), axis=(1, 2))
    return np.exp(balancing_log_scales(np.where(is_finite[:, None, None], responses, 0.0)))


def joint_gains(enclosure: Enclosure, goals: np.ndarray) -> np.ndarray:
    """A bound of the structured singular value of M = G + I/2 on each cell, shape (n, 1); infinite if M is not finite.

    The largest singular value of D M D^-1 is a bound for every positive diagonal D; one D is used on all of a cell. The
    first D to try balances the largest sizes that the entries of M have on the cell. If even the middle of the cell has
    a bound above the goal with this D, the D that is best for the middle is tried, too. Otherwise halving the cell can
    reach the goal without another D.

    Args:
        enclosure: The sets that contain the response G.
        goals: The bound that is good enough, shape (1,).
    """
    middle = enclosure.centre + 0.5 * np.eye(enclosure.centre.shape[-1])
    sizes = np.abs(middle) + np.abs(enclosure.linear).sum(axis=1) + enclosure.remainder
    bounds = np.full(len(middle), np.inf)
    rows = np.flatnonzero(np.all(np.isfinite(sizes), axis=(1, 2)))
    if not rows.size:
        return bounds[:, None]
    balancing_logs = balancing_log_scales(sizes[rows])
    bounds[rows] = scaled_bounds(middle[rows], enclosure.linear[rows], enclosure.remainder[rows], balancing_logs)
    middle_norms, _ = scaled_norms(middle[rows], balancing_logs)
    above = rows[middle_norms > goals[0]]
    if above.size:
        best_logs = best_log_scales(middle[above])
        sharper = scaled_bounds(middle[above], enclosure.linear[above], enclosure.remainder[above], best_logs)
        bounds[above] = np.minimum(bounds[above], sharper)
    return (1.0 + ROUNDING) * bounds[:, None]


def scaled_bounds(middle: np.ndarray, linear: np.ndarray, remainder: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Bounds of the largest singular value of D M D^-1 on each cell, shape (n,); infinite where D overflows.

    M = middle + sum of u_i linear_i + R with u_i in [-1, 1] and abs(R) <= remainder.

    Args:
        middle: M in the middle of each cell, shape (n, channels, channels).
        linear: The linear part of M, shape (n, sides + 1, channels, channels).
        remainder: The bound of abs(R), entry by entry, shape (n, channels, channels).
        logs: Natural logarithm of the diagonal of D, shape (n, channels).
    """
    ratios = np.exp(logs[:, :, None] - logs[:, None, :])  # entry i, j of D M D^-1 is M_ij times D_i/D_j
    middle = middle * ratios
    linear = linear * ratios[:, None]
    remainder = remainder * ratios
    is_finite = np.all(np.isfinite(linear), axis=(1, 2, 3))
    is_finite &= np.all(np.isfinite(middle), axis=(1, 2)) & np.all(np.isfinite(remainder), axis=(1, 2))
    bounds = np.full(len(middle), np.inf)
    linear_bounds = norm_over_box(middle[is_finite], linear[is_finite])
    bounds[is_finite] = linear_bounds + largest_singular_values(remainder[is_finite])
    return bounds


def norm_over_box(centre: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """A bound of the largest singular value of centre + sum of u_i generators_i over all u_i in [-1, 1], shape (n,).

    The largest singular value is convex in u, so its maximum over the box lies at a vertex. For the :data:`VERTICES`
    largest generators all vertices are tried. For all other generators their norms are added.

    Args:
        centre: The matrices in the middle, shape (n, m, m).
        generators: The matrices that the coordinates u_i multiply, shape (n, k, m, m).
    """
    norms = largest_singular_values(generators)
    order = np.argsort(-norms, axis=1)  # the largest first
    sorted_generators = np.take_along_axis(generators, order[:, :, None, None], 1)
    sorted_norms = np.take_along_axis(norms, order, 1)
    tried_generators = sorted_generators[:, :VERTICES]
    added_norms = sorted_norms[:, VERTICES:].sum(axis=1)
    largest = np.zeros(len(centre))
    for signs in itertools.product((-1.0, 1.0), repeat=tried_generators.shape[1]):
        vertex = centre + np.einsum("k,nkij->nij", np.array(signs), tried_generators)
        largest = np.maximum(largest, largest_singular_values(vertex))
    return largest + added_norms


def largest_singular_values(matrices: np.ndarray) -> np.ndarray:
    """Largest singular values of matrices of shape (..., m, m), shape (...)."""
    return np.linalg.svd(matrices, compute_uv=False)[..., 0]


SINGLE_READOUT = Readout(1, len(GAINS), unscaled, single_gains)
"""The gains of a loop that is broken in one channel."""


def joint_readout(channels: int) -> Readout:
    """The readout for all commands at once: its one gain is the structured singular value of G + I/2.

    The gain is the inverse of the disk margin.
    """
    return Readout(channels, 1, joint_scales, joint_gains)
