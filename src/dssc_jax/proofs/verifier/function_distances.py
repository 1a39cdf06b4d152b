"""How far the functions of the conservative form are from straight lines, enclosed: the verifier's own.

With |sigma| and |e| within a region, bounds of |phi_1 - k_1 sigma|, |phi_2 - k_2 sigma| and |phi_1 + n - (k_1 + k_n)
sigma|, where n is what the nominal control takes through its term 1/tau_m. The region is cut where the enclosure of a
piece exceeds what is reached at points by more than a small share.
"""

from typing import Any

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, Rejected, larger, require_premise
from dssc_jax.proofs.verifier.gain_enclosures import gains_at, middle_of
from dssc_jax.proofs.verifier.intervals import Intervals, exactly, square_root
from dssc_jax.proofs.verifier.table_gains import first_cells, gains_of, quartered

DISTANCE_ROOM = 0.02
"""Largest excess over the distances at points, as a share of them."""
DISTANCE_ROUNDING = 2.0**-42
"""The same, in sizes of the function."""
MOST_PIECES, MOST_CELLS = 6000, 200_000
DISTANCES = {"phi_1": ("mean",), "phi_2": ("k_i",), "both": ("mean", "k_n")}
"""The gains of whose sum each is the distance, times |sigma|."""


def function_distances(problem: dict[str, Any], sigma: float, e: float, centre: Balls) -> Balls:
    """Upper bounds of the distances over a region.

    Args:
        problem: The certificate's problem, in the conservative form.
        sigma: Bound of |sigma| [m/s].
        e: Bound of |e| [m].
        centre: The slopes, ``mean``, ``k_i`` and ``k_n``, exact numbers.
    """
    if problem["functions"]["kind"] == "vgsta":
        return distances_in_cells(problem, sigma, e, centre)
    at_points = dict.fromkeys(DISTANCES, arb(0))
    result = dict.fromkeys(DISTANCES, arb(0))
    least_rooms = {name: rounding_of(names, centre) * sigma for name, names in DISTANCES.items()}
    pieces, left = [(0.0, sigma)], MOST_PIECES
    while pieces:
        for low, high in pieces:
            for point in (middle_of((low, high)), high):
                for name, reached in distances_at(problem, (point, point), centre).items():
                    at_points[name] = larger(at_points[name], reached.lower())
        left -= len(pieces)
        again = []
        for low, high in pieces:
            try:
                reached = distances_at(problem, (low, high), centre)
            except Rejected:  # too wide a ball, since every point was fine
                require_premise(left > 0, "P2: the functions cannot be enclosed in the region")
                reached = {}
            close = all(
                reached[name].upper() <= at_points[name] * (1 + DISTANCE_ROOM) + least_rooms[name] for name in reached
            )
            if not reached or (left > 0 and not close):
                middle = middle_of((low, high))
                again += [(low, middle), (middle, high)]
                continue
            for name, distance in reached.items():
                result[name] = larger(result[name], distance.upper())
        pieces = again
    return result


def distances_at(problem: dict[str, Any], size: tuple[float, float], centre: Balls) -> Balls:
    """Balls of the distances for |sigma| in an interval."""
    gains, largest = gains_at(problem, size), arb(size[1])
    result = {}
    for name, names in DISTANCES.items():
        difference = sum((gains[each] - centre[each] for each in names), arb(0))
        result[name] = abs(difference) * largest
    return result


def distances_in_cells(problem: dict[str, Any], sigma: float, e: float, centre: Balls) -> Balls:
    """The same of Table 1's functions, which depend on e, too; in float64, rounded outwards."""
    slopes = {name: exactly(float(centre[name])) for name in ("mean", "k_i", "k_n")}
    least_rooms = {name: rounding_of(names, centre) * sigma for name, names in DISTANCES.items()}
    at_points, result = dict.fromkeys(DISTANCES, 0.0), dict.fromkeys(DISTANCES, 0.0)
    r, sign, x = first_cells(square_root(0.0, sigma), (0.0, e))
    left = MOST_CELLS
    while sign.size:
        left -= sign.size
        for name, reached in cell_distances(problem, r.middle(), sign, x.middle(), slopes).items():
            at_points[name] = max(at_points[name], float(np.max(reached.low)))
        again = np.zeros(sign.shape, bool)
        whole = cell_distances(problem, r, sign, x, slopes)
        for name, reached in whole.items():
            again |= ~(reached.high <= at_points[name] * (1.0 + DISTANCE_ROOM) + least_rooms[name])
        if left <= 0:
            again[:] = False
        for name, reached in whole.items():
            kept = reached.high[~again]
            result[name] = float(np.maximum(result[name], np.max(kept, initial=0.0)))
        r, sign, x = quartered(r, sign, x, again)
    finite = bool(np.all(np.isfinite(list(result.values()))))
    require_premise(finite, "P2: the functions cannot be enclosed in the region")
    return {name: arb(value) for name, value in result.items()}


def cell_distances(
    problem: dict[str, Any], r: Intervals, sign: np.ndarray, x: Intervals, slopes: dict[str, Intervals]
) -> dict[str, Intervals]:
    """Intervals of the distances in cells."""
    gains, size = gains_of(problem, r, sign, x), r * r
    result = {}
    for name, names in DISTANCES.items():
        difference = gains[names[0]] - slopes[names[0]]
        for each in names[1:]:
            difference = difference + (gains[each] - slopes[each])
        result[name] = magnitude(difference * size)
    return result


def magnitude(values: Intervals) -> Intervals:
    """Intervals of |x|."""
    ends = np.abs(values.low), np.abs(values.high)
    holds_zero = (values.low <= 0.0) & (values.high >= 0.0)
    return Intervals(np.where(holds_zero, 0.0, np.minimum(*ends)), np.maximum(*ends))


def rounding_of(names: tuple[str, ...], centre: Balls) -> float:
    """The room that rounding needs, over |sigma|."""
    return DISTANCE_ROUNDING * sum(abs(float(centre[name])) for name in names) + 1e-280
