"""How much the slope of phi_1 changes within a sample, enclosed: the sliding condition of a constant k_o needs it.

There tau_av = 1/(k_o g) with g = d phi_1/d sigma belongs to the end of a sample, and K_P is the mean of g over it.
Their product is 1/k_o, times a ratio of slopes at points that are close to one another.
"""

from typing import Any

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, larger, require_premise
from dssc_jax.proofs.verifier.gain_enclosures import functions_at
from dssc_jax.proofs.verifier.intervals import Intervals, outwards
from dssc_jax.proofs.verifier.table_gains import gains_of

ROOT_CELLS, ERROR_CELLS = 64, 16
"""Cells of |sigma|^(1/2) and of |e| in which the end of a sample may lie."""


def slide_gain(problem: dict[str, Any], stage: dict[str, Any], gains: Balls, change: arb, moved: arb) -> arb:
    """Ball of the gain of sigma - s in the equivalent control: K_P (1 + tau_av/T_s).

    Args:
        problem: The certificate's problem.
        stage: The stage with its region.
        gains: Balls of the gains there.
        change: Bound of the change of sigma in a sample.
        moved: Likewise of e.
    """
    own = problem["functions"]
    if problem["form"] == "implicit" or "k_o" not in own or own["kind"] == "constant":
        return gains["slide_p"]
    reach = (stage["sigma"], stage["e"], float(change.upper()), float(moved.upper()))
    ratio = table_ratio(problem, *reach) if own["kind"] == "vgsta" else ratio_by_sigma(problem, reach[0], reach[2])
    within = gains["k_p"] + (1 / ratio).union(ratio) / (arb(own["k_o"]) * arb(problem["sample_time"]))
    return within if within.rad() < gains["slide_p"].rad() else gains["slide_p"]


def ratio_by_sigma(problem: dict[str, Any], sigma: float, change: float) -> arb:
    """The largest ratio of slopes within a sample, of functions of sigma alone."""
    ends = (np.sqrt(sigma) * np.arange(ROOT_CELLS + 1) / ROOT_CELLS) ** 2
    ends[-1] = sigma
    largest = arb(1)
    for low, high in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        first, last = np.nextafter(low - change, -np.inf), np.nextafter(high + change, np.inf)
        product, _ = functions_at(problem, (max(0.0, float(first)), min(sigma, float(last))))
        largest = larger(largest, (product.upper() / product.lower()).upper())
    return largest


def table_ratio(problem: dict[str, Any], sigma: float, e: float, change: float, moved: float) -> arb:
    """The same of Table 1's functions, which depend on e, too; in float64, rounded outwards."""
    size = sigma * (np.arange(ROOT_CELLS + 1) / ROOT_CELLS) ** 2
    errors = e * np.arange(ERROR_CELLS + 1) / ERROR_CELLS
    size[-1], errors[-1] = sigma, e
    low, high = np.meshgrid(size[:-1], errors[:-1], indexing="ij"), np.meshgrid(size[1:], errors[1:], indexing="ij")
    around = outwards(low[0].ravel() - change, high[0].ravel() + change)
    root = outwards(np.sqrt(np.maximum(around.low, 0.0)), np.sqrt(np.minimum(around.high, sigma)))
    near = outwards(low[1].ravel() - moved, high[1].ravel() + moved)
    r = Intervals(np.maximum(root.low, 0.0), root.high)
    x = Intervals(np.maximum(near.low, 0.0), np.minimum(near.high, e))
    slope = gains_of(problem, r, np.ones(r.low.size), x)["k_p"]
    require_premise(bool(np.all(slope.low > 0.0)), "P2: the functions are not positive in the region")
    ratio = slope / slope
    return arb(float(np.max(ratio.high)))
