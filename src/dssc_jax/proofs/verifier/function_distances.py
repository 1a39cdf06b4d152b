"""The verifier's bounds of the distances of phi_1, phi_2 and phi_1 + n from straight lines over a region.

The three distances are |phi_1 - k_1 sigma|, |phi_2 - k_2 sigma| and |phi_1 + n - (k_1 + k_n) sigma|, where n =
sigma/(k_n tau_m) is the part of the nominal control from its term 1/tau_m. For a vehicle, a share s_q of the third
difference is subtracted from the second. Each piece of the region is enclosed. A piece is halved if its enclosure
exceeds the largest distance at points by more than a small share.
"""

import math
from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import NamedTuple

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, Rejected, maximum, require_premise, total
from dssc_jax.proofs.verifier.certificate import Problem
from dssc_jax.proofs.verifier.gain_enclosures import SizeInterval, gains_at, halves_of, middle_of
from dssc_jax.proofs.verifier.intervals import Intervals, exactly, square_root
from dssc_jax.proofs.verifier.table_gains import Cells, first_cells, gains_of

DISTANCE_ROOM = 0.02
"""Largest excess of a bound over the distances at points, as a share of them, unless the caller asks for less."""
SHARED_ROOM = 0.02
"""The same excess for the second distance if its share s_q is not 0."""
DISTANCE_ROUNDING = 2.0**-42
"""Excess that rounding needs besides, as a share of the straight line's largest value."""
MOST_PIECES = 6000
"""Number of pieces of |sigma| after which no further piece is cut."""
MOST_CELLS = 200_000
"""Number of cells of |sigma| and |e| after which no further cell is cut."""
DISTANCES = {"phi_1": ("mean",), "phi_2": ("k_i",), "both": ("mean", "k_n")}
"""The three distances by name, each with its gains: |sum of the gains less sum of their slopes| times |sigma|."""


class StraightLines(NamedTuple):
    """The straight lines whose distances from the functions are bounded.

    Args:
        slopes: k_1 (``mean``), k_2 (``k_i``) and k_n, exact numbers.
        share: s_q, the share of the third difference that is subtracted from the second; 0 for Table 1's functions.
        change: C, a bound of |sigma - s| [m/s] in the implicit form, where :func:`increment_error` over T_s is added to
            the distance of phi_2. None: the conservative form, which has no such error.
    """

    slopes: Balls
    share: float = 0.0
    change: float | None = None


def function_distances(
    problem: Problem,
    sigma: float,
    e: float,
    lines: StraightLines,
    room: float = DISTANCE_ROOM,
    sigma_from: float = 0.0,
) -> Balls:
    """Upper bounds over a region of the functions' distances from straight lines, by the names in ``DISTANCES``.

    Args:
        problem: The certificate's problem.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m]; only Table 1's functions depend on e.
        lines: The straight lines. Unless their share is 0, ``SHARED_ROOM`` replaces ``room`` for the second distance.
        room: Largest excess of a bound over the distances at points, as a share of them. Table 1's functions use
            ``DISTANCE_ROOM`` instead.
        sigma_from: Smallest |sigma| [m/s]; must be 0 for Table 1's functions.

    Raises:
        Rejected: Some piece of the region cannot be enclosed.
    """
    if problem["functions"]["kind"] == "vgsta":
        return distances_in_cells(problem, sigma, e, lines.slopes)
    rooms = dict.fromkeys(DISTANCES, room)
    if lines.share:
        rooms["phi_2"] = SHARED_ROOM
    rounding = {name: rounding_room(names, lines.slopes) * sigma for name, names in DISTANCES.items()}
    rounding["phi_2"] += abs(lines.share) * rounding["both"]
    reached = largest_at_points(problem, [sigma], lines)
    bounds = dict.fromkeys(DISTANCES, arb(0))
    pieces = [(sigma_from, sigma)]
    remaining = MOST_PIECES
    while pieces:
        middles = [middle_of(piece) for piece in pieces]  # the pieces' ends are sigma, or middles of earlier pieces
        for name, distance in largest_at_points(problem, middles, lines).items():
            reached[name] = maximum(reached[name], distance)
        limits = {name: reached[name] * (1 + rooms[name]) + rounding[name] for name in DISTANCES}
        remaining -= len(pieces)
        wide_pieces = []
        for piece in pieces:
            distances = distances_if_enclosed(problem, piece, lines)
            require_premise(bool(distances) or remaining > 0, "P2: the functions cannot be enclosed in the region")
            is_close = all(distance.upper() <= limits[name] for name, distance in distances.items())
            if not distances or (remaining > 0 and not is_close):
                wide_pieces.append(piece)
                continue
            for name, distance in distances.items():
                bounds[name] = maximum(bounds[name], distance.upper())
        pieces = [half for piece in wide_pieces for half in halves_of(piece)]
    return bounds


def largest_at_points(problem: Problem, points: Sequence[float], lines: StraightLines) -> Balls:
    """Lower bounds of the largest distances over the whole region, from their values at some points, by name.

    Args:
        problem: The certificate's problem, with functions of sigma alone.
        points: Values of |sigma| [m/s].
        lines: The straight lines.
    """
    largest = dict.fromkeys(DISTANCES, arb(0))
    for point in points:
        for name, distance in distances_at(problem, (point, point), lines).items():
            largest[name] = maximum(largest[name], distance.lower())
    return largest


def distances_if_enclosed(problem: Problem, size: SizeInterval, lines: StraightLines) -> Balls:
    """The distances of :func:`distances_at`; empty if the interval of |sigma| is so wide that a function may be 0."""
    try:
        return distances_at(problem, size, lines)
    except Rejected:
        return {}


def distances_at(problem: Problem, size: SizeInterval, lines: StraightLines) -> Balls:
    """Balls whose upper ends bound the distances from straight lines for |sigma| in an interval, by name.

    If the interval is a point, the balls contain the distances, so that their lower ends are bounds, too.

    Args:
        problem: The certificate's problem, with functions of sigma alone.
        size: Interval of |sigma| [m/s].
        lines: The straight lines.
    """
    smallest, largest = size
    gains = gains_at(problem, size)
    differences = {}
    for name, names in DISTANCES.items():
        differences[name] = total([gains[gain] - lines.slopes[gain] for gain in names])
    differences["phi_2"] = differences["phi_2"] - arb(lines.share) * differences["both"]
    distances = {name: abs(difference) * arb(largest) for name, difference in differences.items()}
    if lines.change is not None:
        r = increment_error(problem, smallest, lines.change)
        distances["phi_2"] = distances["phi_2"] + r / arb(problem["sample_time"])
    return distances


def increment_error(problem: Problem, low: float, change: float) -> arb:
    """R, a bound of the difference of the implicit form's increment of v from the change of phi_1 in a sample [m/s].

    R bounds |K_P(sigma) (sigma - s) - phi_1(sigma) + phi_1(s)| for |sigma| >= low and |sigma - s| <= C. The functions
    have k_o tau_av = alpha (|sigma|^(1/2) + beta), so K_P falls with |sigma| and is convex in it; docs/proofs.md has
    the derivation.

    Args:
        problem: The certificate's problem.
        low: Smallest |sigma| [m/s].
        change: C, the largest change of sigma in a sample [m/s].
    """
    if low < change:  # R = K_P(0) C - phi_1(C)
        return gains_at(problem, (0.0, 0.0))["k_p"] * arb(change) - phi_1(problem, change)
    nearest = max(0.0, math.nextafter(low - change, -math.inf))  # |sigma| - C, rounded down
    slope = gains_at(problem, (low, low))["k_p"]
    return phi_1(problem, low) - phi_1(problem, nearest) - slope * arb(change)


def phi_1(problem: Problem, sigma: float) -> arb:
    """phi_1 [m/s] at one sigma >= 0, as a ball, for functions of sigma alone."""
    return gains_at(problem, (sigma, sigma))["mean"] * arb(sigma)


def distances_in_cells(problem: Problem, sigma: float, e: float, slopes: Balls) -> Balls:
    """Upper bounds of the distances for Table 1's functions, which depend on sigma and e, by name.

    The intervals are computed in float64 and rounded outwards.

    Args:
        problem: The certificate's problem.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m].
        slopes: The slopes k_1 (``mean``), k_2 (``k_i``) and k_n, exact numbers.
    """
    exact_slopes = {name: exactly(float(slopes[name])) for name in ("mean", "k_i", "k_n")}
    rounding = {name: rounding_room(names, slopes) * sigma for name, names in DISTANCES.items()}
    reached = dict.fromkeys(DISTANCES, 0.0)  # at points, lower bounds
    bounds = dict.fromkeys(DISTANCES, 0.0)
    cells = first_cells(square_root(0.0, sigma), (0.0, e))
    remaining = MOST_CELLS
    while cells.sign.size:
        remaining -= cells.sign.size
        for name, interval in cell_distances(problem, cells.middles(), exact_slopes).items():
            reached[name] = max(reached[name], float(np.max(interval.low)))
        too_wide = np.zeros(cells.sign.shape, bool)
        distances = cell_distances(problem, cells, exact_slopes)
        for name, interval in distances.items():
            is_close = interval.high <= reached[name] * (1.0 + DISTANCE_ROOM) + rounding[name]
            too_wide |= ~is_close  # also where the end is NaN
        if remaining <= 0:
            too_wide[:] = False
        for name, interval in distances.items():
            accepted = interval.high[~too_wide]
            bounds[name] = float(np.maximum(bounds[name], np.max(accepted, initial=0.0)))  # NaN if one of them is
        cells = cells.quarters_of(too_wide)
    is_finite = bool(np.all(np.isfinite(list(bounds.values()))))
    require_premise(is_finite, "P2: the functions cannot be enclosed in the region")
    return {name: arb(value) for name, value in bounds.items()}


def cell_distances(problem: Problem, cells: Cells, slopes: dict[str, Intervals]) -> dict[str, Intervals]:
    """Intervals of the distances of Table 1's functions from straight lines, in each cell, by name.

    Args:
        problem: The certificate's problem.
        cells: Cells of |sigma|^(1/2), the sign of sigma e, and |e|.
        slopes: The slopes k_1 (``mean``), k_2 (``k_i``) and k_n.
    """
    gains = gains_of(problem, cells)
    differences = {name: gains[name] - slope for name, slope in slopes.items()}
    size = cells.root * cells.root  # |sigma|
    distances = {}
    for name, names in DISTANCES.items():
        difference = reduce(add, [differences[gain] for gain in names])
        distances[name] = magnitude(difference * size)
    return distances


def magnitude(values: Intervals) -> Intervals:
    """Intervals of |x| for x in intervals."""
    low = np.abs(values.low)
    high = np.abs(values.high)
    contains_zero = (values.low <= 0.0) & (values.high >= 0.0)
    return Intervals(np.where(contains_zero, 0.0, np.minimum(low, high)), np.maximum(low, high))


def rounding_room(names: tuple[str, ...], slopes: Balls) -> float:
    """The excess over |sigma| that rounding alone may cause in a distance's bound: a share of the slopes' magnitudes.

    Args:
        names: The gains of the distance, a value of :data:`DISTANCES`.
        slopes: Slope of each gain's straight line.
    """
    return DISTANCE_ROUNDING * sum(abs(float(slopes[name])) for name in names) + 1e-280
