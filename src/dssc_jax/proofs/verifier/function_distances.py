"""How far the functions phi_1 and phi_2 are from straight lines, enclosed: the verifier's own.

Over a region of |sigma| and |e| these are bounds of |phi_1 - k_1 sigma|, |phi_2 - k_2 sigma| and |phi_1 + n - (k_1 +
k_n) sigma|, where n is what the nominal control takes through its term 1/tau_m. A multiple of the third difference may
be taken from the second. The region is cut where the enclosure of a piece exceeds what is reached at points by more
than a small share.
"""

import math

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, Rejected, maximum, require_premise, total
from dssc_jax.proofs.verifier.certificate import Problem
from dssc_jax.proofs.verifier.gain_enclosures import gains_at, middle_of
from dssc_jax.proofs.verifier.intervals import Intervals, exactly, square_root
from dssc_jax.proofs.verifier.table_gains import Cells, first_cells, gains_of

DISTANCE_ROOM = 0.02
"""Largest excess over the distances at points, as a share of them, unless the caller asks for less."""
SHARED_ROOM = 0.02
"""Largest excess, as a share of the distances at points, for phi_2 less its share of the command."""
DISTANCE_ROUNDING = 2.0**-42
"""Largest excess that rounding needs, in sizes of the function."""
MOST_PIECES = 6000
MOST_CELLS = 200_000
DISTANCES = {"phi_1": ("mean",), "phi_2": ("k_i",), "both": ("mean", "k_n")}
"""The gains of whose sum each is the distance, times |sigma|."""


def function_distances(
    problem: Problem,
    sigma: float,
    e: float,
    centre: Balls,
    room: float = DISTANCE_ROOM,
    sigma_from: float = 0.0,
    share: float = 0.0,
    change: float | None = None,
) -> Balls:
    """Upper bounds of the distances from straight lines over a region, by name: ``phi_1``, ``phi_2`` and ``both``.

    Args:
        problem: The certificate's problem.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m]; of Table 1's functions only.
        centre: The slopes k_1 (``mean``), k_2 (``k_i``) and k_n, exact numbers.
        room: The largest excess over the distances at points, as a share of them; ``DISTANCE_ROOM`` for Table 1's.
        sigma_from: Smallest |sigma| [m/s]; 0 for Table 1's.
        share: Multiple of the third difference that is taken from the second one. Unless it is 0, the second bound
            may exceed the distances at points by ``SHARED_ROOM``. Table 1's functions take none.
        change: In the implicit form, a bound of |sigma - s| [m/s]: the distance of phi_2 then contains
            :func:`increment_error` over T_s. None: the conservative form.
    """
    rooms = dict.fromkeys(DISTANCES, room) | ({"phi_2": SHARED_ROOM} if share else {})
    if problem["functions"]["kind"] == "vgsta":
        return distances_in_cells(problem, sigma, e, centre)
    at_points = dict.fromkeys(DISTANCES, arb(0))
    result = dict.fromkeys(DISTANCES, arb(0))
    least_rooms = {name: rounding_room(names, centre) * sigma for name, names in DISTANCES.items()}
    least_rooms["phi_2"] += abs(share) * least_rooms["both"]
    pieces = [(sigma_from, sigma)]
    remaining = MOST_PIECES
    while pieces:
        for low, high in pieces:
            for point in (middle_of((low, high)), high):
                for name, distance in distances_at(problem, (point, point), centre, share, change).items():
                    at_points[name] = maximum(at_points[name], distance.lower())
        remaining -= len(pieces)
        halves = []
        for low, high in pieces:
            try:
                distances = distances_at(problem, (low, high), centre, share, change)
            except Rejected:  # too wide a ball, since every point was fine
                require_premise(remaining > 0, "P2: the functions cannot be enclosed in the region")
                distances = {}
            is_close = all(
                distance.upper() <= at_points[name] * (1 + rooms[name]) + least_rooms[name]
                for name, distance in distances.items()
            )
            if not distances or (remaining > 0 and not is_close):
                middle = middle_of((low, high))
                halves += [(low, middle), (middle, high)]
                continue
            for name, distance in distances.items():
                result[name] = maximum(result[name], distance.upper())
        pieces = halves
    return result


def distances_at(
    problem: Problem, size: tuple[float, float], centre: Balls, share: float, change: float | None
) -> Balls:
    """Balls of the distances from straight lines for |sigma| in an interval; see :func:`function_distances`."""
    gains = gains_at(problem, size)
    largest = arb(size[1])
    differences = {name: total([gains[gain] - centre[gain] for gain in names]) for name, names in DISTANCES.items()}
    differences["phi_2"] = differences["phi_2"] - arb(share) * differences["both"]
    result = {name: abs(difference) * largest for name, difference in differences.items()}
    if change is not None:
        result["phi_2"] = result["phi_2"] + increment_error(problem, size[0], change) / arb(problem["sample_time"])
    return result


def increment_error(problem: Problem, low: float, change: float) -> arb:
    """Ball of a bound of |K_P(sigma) (sigma - s) - phi_1(sigma) + phi_1(s)| for |sigma| >= low, |sigma - s| <= change.

    For functions with k_o tau_av = alpha (|sigma|^(1/2) + beta), whose K_P falls with |sigma| and is convex in it.
    """
    if low < change:
        return gains_at(problem, (0.0, 0.0))["k_p"] * arb(change) - phi_1(problem, change)
    nearest = max(0.0, math.nextafter(low - change, -math.inf))
    slope = gains_at(problem, (low, low))["k_p"]
    return phi_1(problem, low) - phi_1(problem, nearest) - slope * arb(change)


def phi_1(problem: Problem, sigma: float) -> arb:
    """phi_1 at one sigma >= 0, of functions of sigma alone."""
    return gains_at(problem, (sigma, sigma))["mean"] * arb(sigma)


def distances_in_cells(problem: Problem, sigma: float, e: float, centre: Balls) -> Balls:
    """:func:`function_distances` for Table 1's functions, which depend on e, too; in float64, rounded outwards."""
    slopes = {name: exactly(float(centre[name])) for name in ("mean", "k_i", "k_n")}
    least_rooms = {name: rounding_room(names, centre) * sigma for name, names in DISTANCES.items()}
    at_points = dict.fromkeys(DISTANCES, 0.0)
    result = dict.fromkeys(DISTANCES, 0.0)
    cells = first_cells(square_root(0.0, sigma), (0.0, e))
    remaining = MOST_CELLS
    while cells.sign.size:
        remaining -= cells.sign.size
        for name, interval in cell_distances(problem, cells.middles(), slopes).items():
            at_points[name] = max(at_points[name], float(np.max(interval.low)))
        too_wide = np.zeros(cells.sign.shape, bool)
        distances = cell_distances(problem, cells, slopes)
        for name, interval in distances.items():
            too_wide |= ~(interval.high <= at_points[name] * (1.0 + DISTANCE_ROOM) + least_rooms[name])
        if remaining <= 0:
            too_wide[:] = False
        for name, interval in distances.items():
            accepted = interval.high[~too_wide]
            result[name] = float(np.maximum(result[name], np.max(accepted, initial=0.0)))
        cells = cells.quarters_of(too_wide)
    finite = bool(np.all(np.isfinite(list(result.values()))))
    require_premise(finite, "P2: the functions cannot be enclosed in the region")
    return {name: arb(value) for name, value in result.items()}


def cell_distances(problem: Problem, cells: Cells, slopes: dict[str, Intervals]) -> dict[str, Intervals]:
    """Intervals of the distances of Table 1's functions from straight lines in cells, by name."""
    gains = gains_of(problem, cells)
    size = cells.root * cells.root
    result = {}
    for name, names in DISTANCES.items():
        difference = gains[names[0]] - slopes[names[0]]
        for gain in names[1:]:
            difference = difference + (gains[gain] - slopes[gain])
        result[name] = magnitude(difference * size)
    return result


def magnitude(values: Intervals) -> Intervals:
    """Intervals of |x| for x in intervals."""
    low, high = np.abs(values.low), np.abs(values.high)
    holds_zero = (values.low <= 0.0) & (values.high >= 0.0)
    return Intervals(np.where(holds_zero, 0.0, np.minimum(low, high)), np.maximum(low, high))


def rounding_room(names: tuple[str, ...], centre: Balls) -> float:
    """The excess of a distance that its rounding needs, over |sigma|."""
    return DISTANCE_ROUNDING * sum(abs(float(centre[name])) for name in names) + 1e-280
