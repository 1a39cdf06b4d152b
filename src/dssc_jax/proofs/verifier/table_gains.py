"""The gains of Table 1's functions, which depend on sigma and e, enclosed over a region: the verifier's own (28), (29).

The region is cut into pieces of r = |sigma|^(1/2) and |e|. A piece is cut again where its enclosure exceeds what the
gains at points span by more than a small share.
"""

from typing import Any

import numpy as np

from dssc_jax.proofs.verifier.balls import Balls, enclosing, require_premise
from dssc_jax.proofs.verifier.intervals import Intervals, exactly, square_root

TABLE_ROOM = 0.02  # largest excess over the gains at points, in widths of what they span
TABLE_ROUNDING = 2.0**-36  # and in sizes of the gain
FIRST_CUTS = 6  # of r and of |e|
MOST_CELLS = 100_000


def table_gains(problem: dict[str, Any], sigma: float, e: float, least: float, least_e: float) -> Balls:
    """Balls of the gains for |sigma| from ``least`` to a bound, and |e| from ``least_e`` to one.

    They are the same at (-sigma, -e). Both signs are taken at e = 0, where sgn e jumps; with sgn 0 = 0 the gains lie
    between.

    Args:
        problem: The certificate's problem, with Table 1's functions.
        sigma: Bound of |sigma| [m/s].
        e: Bound of |e| [m].
        least: Least |sigma| [m/s].
        least_e: Least |e| [m].
    """
    r, sign, x = first_cells(square_root(least, sigma), (least_e, e))
    spans: dict[str, tuple[float, float]] = {}
    result: dict[str, tuple[float, float]] = {}
    left = MOST_CELLS
    while sign.size:
        left -= sign.size
        for name, at in gains_of(problem, r.middle(), sign, x.middle()).items():
            spans[name] = spanned(spans.get(name), float(np.min(at.low)), float(np.max(at.high)))
        pieces, again = gains_of(problem, r, sign, x), np.zeros(sign.shape, bool)
        for name, at in pieces.items():
            lowest, highest = spans[name]
            room = TABLE_ROOM * (highest - lowest) + TABLE_ROUNDING * max(abs(lowest), abs(highest))
            again |= ~((at.low >= lowest - room) & (at.high <= highest + room))
        if left <= 0:
            again[:] = False
        if not again.all():
            for name, at in pieces.items():
                kept = at.selected(~again)
                result[name] = spanned(result.get(name), float(np.min(kept.low)), float(np.max(kept.high)))
        r, sign, x = quartered(r, sign, x, again)
    positive = all(result[name][0] > 0.0 for name in ("k_p", "k_i"))
    require_premise(positive, "P2: the functions are not positive in the region")
    finite = bool(np.all(np.isfinite(list(result.values()))))
    require_premise(finite, "P2: the functions cannot be enclosed in the region")
    return {name: enclosing(*ends) for name, ends in result.items()}


def first_cells(roots: tuple[float, float], errors: tuple[float, float]) -> tuple[Intervals, np.ndarray, Intervals]:
    """Cells of a region: r = |sigma|^(1/2), the sign of sigma e, and |e|."""
    r, x = (np.linspace(*ends, FIRST_CUTS + 1) for ends in (roots, errors))
    signs = np.array([-1.0, 1.0])
    low = np.meshgrid(r[:-1], x[:-1], signs, indexing="ij")
    high = np.meshgrid(r[1:], x[1:], signs, indexing="ij")
    return Intervals(low[0].ravel(), high[0].ravel()), low[2].ravel(), Intervals(low[1].ravel(), high[1].ravel())


def quartered(
    r: Intervals, sign: np.ndarray, x: Intervals, where: np.ndarray
) -> tuple[Intervals, np.ndarray, Intervals]:
    """The four quarters of each selected cell."""
    halves = [(half, other) for half in r.selected(where).halves() for other in x.selected(where).halves()]
    r, x = (concatenated([pair[i] for pair in halves]) for i in (0, 1))
    return r, np.tile(sign[where], len(halves)), x


def spanned(ends: tuple[float, float] | None, low: float, high: float) -> tuple[float, float]:
    """The smallest interval with both; NaN if one has it."""
    return (low, high) if ends is None else (float(np.minimum(ends[0], low)), float(np.maximum(ends[1], high)))


def concatenated(parts: list[Intervals]) -> Intervals:
    """All intervals of some arrays."""
    return Intervals(np.concatenate([each.low for each in parts]), np.concatenate([each.high for each in parts]))


def gains_of(problem: dict[str, Any], r: Intervals, sign: np.ndarray, e: Intervals) -> dict[str, Intervals]:
    """The gains with r = |sigma|^(1/2), the sign of sigma e, and e = |e|.

    Terms are written so that each r in them acts in the same direction, where they can be. In the conservative form
    K_I is phi_2/sigma; ``mean`` is phi_1/sigma, ``k_e`` the size of d phi_1/d e, ``by_e`` that over |sigma|,
    and ``tau_av`` is needed by itself.
    """
    own = {name: exactly(value) for name, value in problem["functions"].items() if name != "kind"}
    two, t, sides = exactly(2.0), exactly(problem["sample_time"]), Intervals(sign, sign)
    rd, size = r + own["delta"], r * r
    shrinks = exactly(1.0) - own["delta"] / rd
    ratio = own["phi_a"] / rd + own["phi_b"]
    first = own["phi_a"] * r * shrinks + own["phi_b"] * size  # phi_1
    slope = own["phi_a"] * (exactly(1.0) / rd + own["delta"] / (rd * rd)) / two + own["phi_b"]
    kappa = own["kappa_a"] * size + own["kappa_b"] * e + own["kappa_c"]
    kappa1 = kappa * kappa + own["kappa_d"]
    kappa2 = two * own["epsilon"] * kappa1 + own["gamma"]
    proportional = two * kappa * own["kappa_a"] * first + kappa1 * slope
    by_e = two * kappa * own["kappa_b"] * (sides * size - exactly(problem["l0"]) * e)
    pole = ratio * (by_e + kappa2 * slope) / proportional  # 1/tau_m
    conservative = problem["form"] == "conservative"  # where by_e belongs to phi_1, not to phi_2
    integral = ratio * kappa2 * slope if conservative else ratio * (by_e + kappa2 * slope)
    if "k_o" in own:
        averages, filtered = exactly(1.0) / (own["k_o"] * proportional), exactly(1.0) / own["k_o"]
        by_pole = integral / (own["k_o"] * proportional)
    else:
        averages, filtered, by_pole = own["tau_av"], own["tau_av"] * proportional, own["tau_av"] * integral
    nominal = problem["nominal"]
    nothing = np.zeros(sign.shape)
    term = pole / exactly(nominal[1]) if nominal and nominal[2] else Intervals(nothing, nothing)
    gains = {"k_p": proportional, "k_i": integral, "k_n": term, "slide_i": t * integral + by_pole}
    if not conservative:
        return gains | {"slide_p": proportional + filtered / t}
    whole = {"mean": kappa1 * ratio, "tau_av": averages}
    if problem["functions"]["kappa_b"]:
        bends = two * kappa * own["kappa_b"]  # the size of d kappa_1/d e
        whole |= {"k_e": bends * first, "by_e": bends * ratio}
    return gains | {name: Intervals(each.low + nothing, each.high + nothing) for name, each in whole.items()}
