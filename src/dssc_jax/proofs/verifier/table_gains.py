"""The gains of Table 1's functions, which depend on sigma and e, enclosed over a region: the verifier's own (28), (29).

The region is cut into pieces of r = |sigma|^(1/2) and |e|. A piece is cut again where its enclosure exceeds what the
gains at points span by more than a small share.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.verifier.balls import Balls, interval_ball, require_premise
from dssc_jax.proofs.verifier.certificate import Problem
from dssc_jax.proofs.verifier.intervals import Intervals, exactly, square_root

TABLE_ROOM = 0.02  # largest excess over the gains at points, in widths of what they span
TABLE_ROUNDING = 2.0**-36  # and in sizes of the gain
FIRST_CUTS = 6  # of r and of |e|
MOST_CELLS = 100_000


class Cells(NamedTuple):
    """Cells of a region of sigma and e. The gains are the same at (-sigma, -e), so that the sign of sigma e suffices.

    Args:
        root: |sigma|^(1/2).
        sign: The sign of sigma e.
        e: |e|.
    """

    root: Intervals
    sign: np.ndarray
    e: Intervals

    def middles(self) -> "Cells":
        """A point of each cell, for what the gains reach there."""
        return Cells(self.root.middle(), self.sign, self.e.middle())

    def quarters_of(self, mask: np.ndarray) -> "Cells":
        """The four quarters of each cell that a mask selects."""
        quarters = list(product(self.root.selected(mask).halves(), self.e.selected(mask).halves()))
        roots, errors = zip(*quarters, strict=True)
        return Cells(concatenate(roots), np.tile(self.sign[mask], len(quarters)), concatenate(errors))


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
    """Balls of the gains of Table 1's functions over a region, by name.

    They are the same at (-sigma, -e). At e = 0, where sgn e jumps, both signs are taken; with sgn 0 = 0 the gains lie
    between.

    Args:
        problem: The certificate's problem.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m].
        sigma_from: Smallest |sigma| [m/s].
        e_from: Smallest |e| [m].
    """
    cells = first_cells(square_root(sigma_from, sigma), (e_from, e))
    spans: dict[str, tuple[float, float]] = {}
    result: dict[str, tuple[float, float]] = {}
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
            too_wide |= ~((gain.low >= lowest - room) & (gain.high <= highest + room))
        if remaining <= 0:
            too_wide[:] = False
        if not too_wide.all():
            for name, gain in gains.items():
                result[name] = hull_with(result.get(name), gain.selected(~too_wide))
        cells = cells.quarters_of(too_wide)
    positive = all(result[name][0] > 0.0 for name in ("k_p", "k_i"))
    require_premise(positive, "P2: the functions are not positive in the region")
    finite = bool(np.all(np.isfinite(list(result.values()))))
    require_premise(finite, "P2: the functions cannot be enclosed in the region")
    return {name: interval_ball(*ends) for name, ends in result.items()}


def hull_with(ends: tuple[float, float] | None, intervals: Intervals) -> tuple[float, float]:
    """Extend an interval, or None, to hold some intervals; an end is NaN if one of theirs is."""
    low = float(np.min(intervals.low))
    high = float(np.max(intervals.high))
    if ends is None:
        return low, high
    return float(np.minimum(ends[0], low)), float(np.maximum(ends[1], high))


def concatenate(parts: Sequence[Intervals]) -> Intervals:
    """Join arrays of intervals."""
    return Intervals(np.concatenate([part.low for part in parts]), np.concatenate([part.high for part in parts]))


def gains_of(problem: Problem, cells: Cells) -> dict[str, Intervals]:
    """Intervals of the gains of Table 1's functions in cells, by name.

    Terms are written so that each r in them acts in the same direction, where they can be. In the conservative form
    K_I is phi_2/sigma; ``mean`` is phi_1/sigma, ``k_e`` the size of d phi_1/d e, ``by_e`` that over |sigma|,
    and ``tau_av`` is needed by itself.
    """
    c = {name: exactly(float(value)) for name, value in problem["functions"].items() if name != "kind"}
    r, sign, e = cells
    two = exactly(2.0)
    t = exactly(problem["sample_time"])
    sign_interval = Intervals(sign, sign)
    rd = r + c["delta"]
    size = r * r
    shrinks = exactly(1.0) - c["delta"] / rd
    ratio = c["phi_a"] / rd + c["phi_b"]
    phi_1 = c["phi_a"] * r * shrinks + c["phi_b"] * size
    slope = c["phi_a"] * (exactly(1.0) / rd + c["delta"] / (rd * rd)) / two + c["phi_b"]
    kappa = c["kappa_a"] * size + c["kappa_b"] * e + c["kappa_c"]
    kappa1 = kappa * kappa + c["kappa_d"]
    kappa2 = two * c["epsilon"] * kappa1 + c["gamma"]
    proportional = two * kappa * c["kappa_a"] * phi_1 + kappa1 * slope
    by_e = two * kappa * c["kappa_b"] * (sign_interval * size - exactly(problem["l0"]) * e)
    pole = ratio * (by_e + kappa2 * slope) / proportional  # 1/tau_m
    conservative = problem["form"] == "conservative"  # where by_e belongs to phi_1, not to phi_2
    integral = ratio * kappa2 * slope if conservative else ratio * (by_e + kappa2 * slope)
    if "k_o" in c:
        tau_av = exactly(1.0) / (c["k_o"] * proportional)
        filtered_gain = exactly(1.0) / c["k_o"]
        by_pole = integral / (c["k_o"] * proportional)
    else:
        tau_av = c["tau_av"]
        filtered_gain = tau_av * proportional
        by_pole = tau_av * integral
    nominal = problem["nominal"]
    zeros = np.zeros(sign.shape)
    term = pole / exactly(nominal[1]) if nominal and nominal[2] else Intervals(zeros, zeros)
    gains = {"k_p": proportional, "k_i": integral, "k_n": term, "slide_i": t * integral + by_pole}
    if not conservative:
        return gains | {"slide_p": proportional + filtered_gain / t}
    conservative_gains = {"mean": kappa1 * ratio, "tau_av": tau_av}
    if problem["functions"]["kappa_b"]:
        bends = two * kappa * c["kappa_b"]  # the size of d kappa_1/d e
        conservative_gains |= {"k_e": bends * phi_1, "by_e": bends * ratio}
    return gains | {name: Intervals(gain.low + zeros, gain.high + zeros) for name, gain in conservative_gains.items()}
