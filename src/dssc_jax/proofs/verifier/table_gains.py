"""Enclosures, over a region, of the gains of Table 1's functions of sigma and e: the verifier's own (28), (29).

The region is cut into cells of r = |sigma|^(1/2) and |e|. A cell is quartered if its enclosure of a gain exceeds the
interval that the gain spans at points by more than a small share of that interval's width.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.verifier.balls import Balls, interval_ball, require_premise
from dssc_jax.proofs.verifier.certificate import Problem
from dssc_jax.proofs.verifier.intervals import Intervals, exactly, square_root

TABLE_ROOM = 0.02
"""Largest excess of an enclosure over the interval of a gain at points, as a share of the interval's width."""
TABLE_ROUNDING = 2.0**-36
"""Excess that rounding needs besides, as a share of the gain."""
FIRST_CUTS = 6
"""Number of cells of r, and of |e|, in the first grid."""
MOST_CELLS = 100_000
"""Number of cells after which no further cell is cut."""


class Cells(NamedTuple):
    """Cells of a region of sigma and e.

    The gains at (-sigma, -e) are those at (sigma, e), so the sign of the product sigma e suffices.

    Args:
        root: Intervals of |sigma|^(1/2), shape (cells,).
        sign: The sign of sigma e, -1 or 1, shape (cells,).
        e: Intervals of |e| [m], shape (cells,).
    """

    root: Intervals
    sign: np.ndarray
    e: Intervals

    def middles(self) -> "Cells":
        """The points in the middle of all cells, as cells without width."""
        return Cells(self.root.middle(), self.sign, self.e.middle())

    def quarters_of(self, mask: np.ndarray) -> "Cells":
        """The four quarters of every cell that a mask selects, shape (4 selected cells,)."""
        low_root, high_root = self.root.selected(mask).halves()
        low_e, high_e = self.e.selected(mask).halves()
        return Cells(
            root=concatenate([low_root, low_root, high_root, high_root]),
            sign=np.tile(self.sign[mask], 4),
            e=concatenate([low_e, high_e, low_e, high_e]),
        )


def first_cells(roots: tuple[float, float], errors: tuple[float, float]) -> Cells:
    """Cut a region into its first cells: a grid of ``FIRST_CUTS`` by ``FIRST_CUTS`` for each sign of sigma e.

    Args:
        roots: Interval of |sigma|^(1/2).
        errors: Interval of |e| [m].
    """
    root_ends = np.linspace(*roots, FIRST_CUTS + 1)
    error_ends = np.linspace(*errors, FIRST_CUTS + 1)
    signs = np.array([-1.0, 1.0])
    root_low, error_low, sign = np.meshgrid(root_ends[:-1], error_ends[:-1], signs, indexing="ij")
    root_high, error_high, _ = np.meshgrid(root_ends[1:], error_ends[1:], signs, indexing="ij")
    root = Intervals(root_low.ravel(), root_high.ravel())
    return Cells(root, sign.ravel(), Intervals(error_low.ravel(), error_high.ravel()))


def table_gains(problem: Problem, sigma: float, e: float, sigma_from: float, e_from: float) -> Balls:
    """Balls of the gains of Table 1's functions over a region, by the names of :func:`gains_of`.

    At e = 0, where sgn e jumps, both signs of sigma e are taken; the gains with sgn 0 = 0 lie between.

    Args:
        problem: The certificate's problem.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m].
        sigma_from: Smallest |sigma| [m/s].
        e_from: Smallest |e| [m].

    Raises:
        Rejected: The functions cannot be enclosed in the region, or may not be positive there.
    """
    cells = first_cells(square_root(sigma_from, sigma), (e_from, e))
    spans: dict[str, tuple[float, float]] = {}  # of each gain at points
    enclosures: dict[str, tuple[float, float]] = {}
    remaining = MOST_CELLS
    while cells.sign.size:
        remaining -= cells.sign.size
        for name, gain in gains_of(problem, cells.middles()).items():
            spans[name] = hull_with(spans.get(name), gain)
        gains = gains_of(problem, cells)
        too_wide = np.zeros(cells.sign.shape, bool)
        for name, gain in gains.items():
            lowest, highest = spans[name]
            room = TABLE_ROOM * (highest - lowest) + TABLE_ROUNDING * max(abs(lowest), abs(highest))
            is_close = (gain.low >= lowest - room) & (gain.high <= highest + room)
            too_wide |= ~is_close  # also where an end is NaN
        if remaining <= 0:
            too_wide[:] = False
        if not too_wide.all():
            for name, gain in gains.items():
                enclosures[name] = hull_with(enclosures.get(name), gain.selected(~too_wide))
        cells = cells.quarters_of(too_wide)
    is_positive = all(low > 0.0 for low, _ in (enclosures["k_p"], enclosures["k_i"]))
    require_premise(is_positive, "P2: the functions are not positive in the region")
    is_finite = bool(np.all(np.isfinite(list(enclosures.values()))))
    require_premise(is_finite, "P2: the functions cannot be enclosed in the region")
    return {name: interval_ball(*ends) for name, ends in enclosures.items()}


def hull_with(ends: tuple[float, float] | None, intervals: Intervals) -> tuple[float, float]:
    """The smallest interval that contains some intervals and an earlier one; a NaN among their ends stays a NaN.

    Args:
        ends: The earlier interval; None: there is none.
        intervals: The intervals, at least one.
    """
    lowest = float(np.min(intervals.low))
    highest = float(np.max(intervals.high))
    if ends is None:
        return lowest, highest
    low, high = ends
    return float(np.minimum(low, lowest)), float(np.maximum(high, highest))


def concatenate(parts: Sequence[Intervals]) -> Intervals:
    """Join arrays of intervals into one, end to end."""
    return Intervals(np.concatenate([part.low for part in parts]), np.concatenate([part.high for part in parts]))


def gains_of(problem: Problem, cells: Cells) -> dict[str, Intervals]:
    """Intervals of the gains of Table 1's functions in each cell, by name.

    :mod:`dssc_jax.proofs.verifier.gain_enclosures` defines ``k_p``, ``k_i``, ``k_n`` and ``slide_i``; in the
    conservative form K_I is phi_2/sigma. The implicit form adds ``slide_p``. The conservative form adds ``mean`` =
    phi_1/sigma, the filter's time constant ``tau_av`` [s] and, if kappa_b > 0, ``k_e`` = |d phi_1/d e| and ``by_e`` =
    |d phi_1/d e|/|sigma|. Where possible, a formula is written so that all its terms rise, or all fall, with r: its
    interval is then narrower.

    Args:
        problem: The certificate's problem, with Table 1's functions.
        cells: The cells of |sigma|^(1/2), the sign of sigma e, and |e|.
    """
    c = {name: exactly(float(value)) for name, value in problem["functions"].items() if name != "kind"}
    r, sign, e = cells
    two = exactly(2.0)
    t = exactly(problem["sample_time"])
    sign_interval = Intervals(sign, sign)
    rd = r + c["delta"]
    size = r * r  # |sigma|
    shrinks = exactly(1.0) - c["delta"] / rd  # r/(r + delta)
    ratio = c["phi_a"] / rd + c["phi_b"]  # phi/sigma, where phi is the function of sigma alone in phi_1 = kappa_1 phi
    phi = c["phi_a"] * r * shrinks + c["phi_b"] * size  # |phi|
    slope = c["phi_a"] * (exactly(1.0) / rd + c["delta"] / (rd * rd)) / two + c["phi_b"]  # d phi/d sigma
    kappa = c["kappa_a"] * size + c["kappa_b"] * e + c["kappa_c"]
    kappa1 = kappa * kappa + c["kappa_d"]
    kappa2 = two * c["epsilon"] * kappa1 + c["gamma"]
    proportional = two * kappa * c["kappa_a"] * phi + kappa1 * slope  # K_P = d phi_1/d sigma
    by_e_rate = two * kappa * c["kappa_b"] * (sign_interval * size - exactly(problem["l0"]) * e)  # (d kappa_1/d e) e'
    inverse_tau_m = ratio * (by_e_rate + kappa2 * slope) / proportional
    is_conservative = problem["form"] == "conservative"  # there the change through e belongs to phi_1, not to phi_2
    integral = ratio * kappa2 * slope if is_conservative else ratio * (by_e_rate + kappa2 * slope)  # K_I
    if "k_o" in c:
        tau_av = exactly(1.0) / (c["k_o"] * proportional)
        averaging_gain = exactly(1.0) / c["k_o"]  # tau_av K_P
        averaged_integral = integral / (c["k_o"] * proportional)  # tau_av K_I
    else:
        tau_av = c["tau_av"]
        averaging_gain = tau_av * proportional
        averaged_integral = tau_av * integral
    zeros = np.zeros(sign.shape)
    gains = {
        "k_p": proportional,
        "k_i": integral,
        "k_n": Intervals(zeros, zeros),
        "slide_i": t * integral + averaged_integral,
    }
    if problem["nominal"]:
        _, k_n, has_predictor_term = problem["nominal"]
        if has_predictor_term:
            gains["k_n"] = inverse_tau_m / exactly(k_n)
    if not is_conservative:
        return gains | {"slide_p": proportional + averaging_gain / t}
    conservative_gains = {"mean": kappa1 * ratio, "tau_av": tau_av}
    if problem["functions"]["kappa_b"]:
        kappa1_by_e = two * kappa * c["kappa_b"]  # |d kappa_1/d e|
        conservative_gains |= {"k_e": kappa1_by_e * phi, "by_e": kappa1_by_e * ratio}
    # a constant tau_av is one interval for all cells; adding zeros gives it the shape (cells,)
    return gains | {name: Intervals(gain.low + zeros, gain.high + zeros) for name, gain in conservative_gains.items()}
