"""Bounds of the change of phi_1's slope within a sample, which the sliding condition (P5) needs.

In the conservative form with a constant k_o, tau_av = 1/(k_o g), where g is the slope d phi_1/d sigma at the end of a
sample. K_P is the mean of g over the sample. So tau_av K_P is 1/k_o times a ratio of slopes at points close together.
"""

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, maximum, require_premise
from dssc_jax.proofs.verifier.certificate import Problem, Stage
from dssc_jax.proofs.verifier.gain_enclosures import constants_of, functions_at
from dssc_jax.proofs.verifier.intervals import Intervals, outwards
from dssc_jax.proofs.verifier.table_gains import Cells, gains_of

ROOT_CELLS = 64
"""Number of cells of |sigma|^(1/2) in which the end of a sample may lie."""
ERROR_CELLS = 16
"""Number of cells of |e| in which the end of a sample may lie."""


def slide_gain(problem: Problem, stage: Stage, gains: Balls, change: arb, error_change: arb) -> arb:
    """Ball of K_P (1 + tau_av/T_s), the gain of sigma - s in the equivalent control.

    It is ``slide_p`` of the gains. In the conservative form with a constant k_o a second ball is computed, since
    tau_av K_P = (ratio of slopes)/k_o varies less than its two factors allow; the smaller ball of both is returned.

    Args:
        problem: The certificate's problem.
        stage: A stage, whose region holds sigma and e.
        gains: Balls of the gains in this region.
        change: Bound of the change of sigma in a sample [m/s].
        error_change: Bound of the change of e in a sample [m].
    """
    kind = problem["functions"]["kind"]
    constants = constants_of(problem)
    if problem["form"] == "implicit" or "k_o" not in constants or kind == "constant":
        return gains["slide_p"]
    sigma_change = float(change.upper())
    if kind == "vgsta":
        ratio = ratio_by_sigma_and_e(problem, stage["sigma"], stage["e"], sigma_change, float(error_change.upper()))
    else:
        ratio = ratio_by_sigma(problem, stage["sigma"], sigma_change)
    ratios = (1 / ratio).union(ratio)  # g at one point over g at another, in either order
    gain = gains["k_p"] + ratios / (constants["k_o"] * arb(problem["sample_time"]))
    return gain if gain.rad() < gains["slide_p"].rad() else gains["slide_p"]


def ratio_by_sigma(problem: Problem, sigma: float, change: float) -> arb:
    """The largest ratio of the slopes g = d phi_1/d sigma at two points within a sample, for functions of sigma alone.

    Each cell of |sigma| is widened by the change of sigma in a sample. There k_o tau_av = 1/g is enclosed, and the
    ratio of the ends of its ball bounds that of the slopes.

    Args:
        problem: The certificate's problem.
        sigma: Bound of |sigma| [m/s].
        change: Bound of the change of sigma in a sample [m/s].
    """
    ends = (np.sqrt(sigma) * np.arange(ROOT_CELLS + 1) / ROOT_CELLS) ** 2
    ends[-1] = sigma
    constants = constants_of(problem)
    largest = arb(1)
    for low, high in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        begin = float(np.nextafter(low - change, -np.inf))
        end = float(np.nextafter(high + change, np.inf))
        k_o_tau_av, _ = functions_at(problem, constants, (max(0.0, begin), min(sigma, end)))
        largest = maximum(largest, (k_o_tau_av.upper() / k_o_tau_av.lower()).upper())
    return largest


def ratio_by_sigma_and_e(problem: Problem, sigma: float, e: float, change: float, error_change: float) -> arb:
    """The largest ratio of the slopes g = d phi_1/d sigma at two points within a sample, for Table 1's functions.

    These functions depend on sigma and e. Each cell is widened by the changes of sigma and e in a sample, and g is
    enclosed there in float64, rounded outwards.

    Args:
        problem: The certificate's problem.
        sigma: Bound of |sigma| [m/s].
        e: Bound of |e| [m].
        change: Bound of the change of sigma in a sample [m/s].
        error_change: Bound of the change of e in a sample [m].
    """
    size = sigma * (np.arange(ROOT_CELLS + 1) / ROOT_CELLS) ** 2
    errors = e * np.arange(ERROR_CELLS + 1) / ERROR_CELLS
    size[-1] = sigma
    errors[-1] = e
    size_low, error_low = np.meshgrid(size[:-1], errors[:-1], indexing="ij")
    size_high, error_high = np.meshgrid(size[1:], errors[1:], indexing="ij")
    sizes = outwards(size_low.ravel() - change, size_high.ravel() + change)
    root = outwards(np.sqrt(np.maximum(sizes.low, 0.0)), np.sqrt(np.minimum(sizes.high, sigma)))
    error_intervals = outwards(error_low.ravel() - error_change, error_high.ravel() + error_change)
    cells = Cells(
        Intervals(np.maximum(root.low, 0.0), root.high),
        np.ones(root.low.size),  # the sign of sigma e, on which the slope does not depend
        Intervals(np.maximum(error_intervals.low, 0.0), np.minimum(error_intervals.high, e)),
    )
    slope = gains_of(problem, cells)["k_p"]
    require_premise(bool(np.all(slope.low > 0.0)), "P2: the functions are not positive in the region")
    ratio = slope / slope  # of intervals: the largest slope over the smallest
    return arb(float(np.max(ratio.high)))
