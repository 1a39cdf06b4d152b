"""The gains of Table 1's functions, which depend on sigma and e, enclosed over a region: the verifier's own (28), (29).

The region is cut into cells of r = |sigma|^(1/2) and |e|. A cell is quartered if its enclosure exceeds the interval
that the gains at points span by more than a small share of that interval.
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
        root: |sigma|^(1/2).
        sign: The sign of sigma e.
        e: |e|.
    """

    root: Intervals
    sign: np.ndarray
    e: Intervals

    def middles(self) -> "Cells":
        """A point in the middle of each cell."""
        return Cells(self.root.middle(), self.sign, self.e.middle())

    def quarters_of(self, mask: np.ndarray) -> "Cells":
        """The four quarters of each cell where a mask is true."""
        low_root, high_root = self.root.selected(mask).halves()
        low_e, high_e = self.e.selected(mask).halves()
        return Cells(
            root=concatenate([low_root, low_root, high_root, high_root]),
            sign=np.tile(self.sign[mask], 4),
            e=concatenate([low_e, high_e, low_e, high_e]),
        )


def first_cells(roots: tuple[float, float], errors: tuple[float, float]) -> Cells:
    """The cells into which a region is first cut: a grid of ``FIRST_CUTS`` by ``FIRST_CUTS`` for each sign.

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
    """The smallest interval that contains some intervals and an earlier one; an end is NaN if one of theirs is.

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

    ``k_p`` to ``slide_i`` are those of :mod:`dssc_jax.proofs.verifier.gain_enclosures`; in the conservative form K_I is
    phi_2/sigma. ``slide_p`` is there in the implicit form only. In the conservative form ``mean`` is phi_1/sigma,
    ``tau_av`` the filter's time constant [s], ``k_e`` = |d phi_1/d e| and ``by_e`` = |d phi_1/d e|/|sigma|. Terms are
    written so that each r in them acts in the same direction, where they can be.
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
    # a constant tau_av is one interval for all cells
    return gains | {name: Intervals(gain.low + zeros, gain.high + zeros) for name, gain in conservative_gains.items()}
