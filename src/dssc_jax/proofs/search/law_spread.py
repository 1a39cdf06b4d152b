"""Bounds of the control law's deviation from a linear law in a region of sigma and e, in floating point.

There are three ways to bound the deviation. With the state v, the gains K_P, K_I, K_N deviate from those of the middle
loop. With q = v - phi_1, the functions phi_1, phi_2 and n = sigma/(k_n tau_m) deviate from straight lines. This
deviation is bounded by a multiple of |sigma|, which is smaller near sigma = 0, or by a constant, which is smaller over
a wide region. In the implicit form the increment of v differs from the change of phi_1, so that R(sigma) is added.
docs/proofs.md has the inequalities.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.proofs.problem import Interval, ProofProblem, middle
from dssc_jax.proofs.search.gains import (
    GAIN_NAMES,
    KNOWN_INTEGRALS,
    MARGIN,
    GainPoints,
    Hull,
    gain_hull,
    gain_points,
    increment_errors,
    with_room,
)
from dssc_jax.proofs.search.sampled_loop import functions_of

SLOPE_STEPS = 40
"""Steps of the search for the slope of a straight line; each cuts the slope's interval by a third."""
ROOT_CELLS = 40
"""Number of cells of |sigma|^(1/2) for ratios of slopes."""
ERROR_CELLS = 10
"""Number of cells of |e| for ratios of slopes."""
RATIO_ROOM = 1.05
"""Factor that widens the excess of a ratio of slopes over 1, so that the verifier's enclosure fits in."""
SLOPE_ROUNDING = 1e-12
"""Widening of a largest distance from a straight line for rounding, as a share of the line's largest value."""


class StageRegion(NamedTuple):
    """A region in which the gains of the law are taken: bounds at the samples.

    Args:
        sigma: Bound of |sigma| [m/s].
        e: Bound of |e| [m].
        change: Bound of |sigma - s|, the change of sigma in a sample [m/s].
    """

    sigma: float
    e: float
    change: float


class Deviation(NamedTuple):
    """A bound of a term's deviation from its linear form: ``change`` |sigma - s| + ``sigma`` |sigma| + ``constant``.

    s is sigma at the sample before. ``constant`` is in the unit of the term [m/s]; the other two have no unit.
    """

    change: float
    sigma: float
    constant: float


class LawSpread(NamedTuple):
    """The control law in a region: the gains of a linear middle loop, and bounds of the law's deviations from it.

    Args:
        is_integrated: Whether the coordinate is q = v - phi_1; otherwise it is v.
        gains: Interval of each gain, by its name in :data:`GAIN_NAMES`; the middle loop has the middle of each. With
            the coordinate q, phi_1/sigma replaces K_P.
        integral: Bound of omega_v, the deviation of the increment of v or q in a sample.
        command: Bound of omega_u, the deviation of the command apart from that of its v or q.
        slide: Bound of the deviation of the equivalent control u_eq; in the conservative form without the part that
            :func:`slide_hull` bounds.
        slide_e: Factor by which a change of e in a sample adds to u_eq [m/s per m].
    """

    is_integrated: bool
    gains: Hull
    integral: Deviation
    command: Deviation
    slide: Deviation
    slide_e: float


def law_spreads(problem: ProofProblem, region: StageRegion) -> list[LawSpread]:
    """Describe the control law in a region, once for each way to bound its deviation from a linear law.

    The implicit form always has the way by its gains, with the coordinate v. If the integral phi_1 is known, it also
    has the two ways with q. The conservative form has these two ways only.

    Args:
        problem: The loop, with its sampled form and functions.
        region: Bounds of |sigma|, |e| and the change of sigma in a sample; the change must not be 0.
    """
    points = gain_points(problem, region.sigma, region.e)
    hull = {name: with_room(column) for name, column in points.columns.items()}
    half_width = {name: 0.5 * (high - low) for name, (low, high) in hull.items()}
    is_implicit = problem.form == "implicit"
    spreads = [gain_spread(problem, hull, half_width)] if is_implicit else []
    if is_implicit and problem.functions["kind"] not in KNOWN_INTEGRALS:
        return spreads
    size = np.abs(points.sigma)
    errors = increment_errors(problem, size, region.change) if is_implicit else np.zeros(size.size)
    change_ratio = (1.0 + MARGIN) * float(errors.max()) / region.change
    by_ratio = ratio_spread(problem, hull, half_width, change_ratio)
    return [*spreads, by_ratio, function_spread(points, by_ratio, half_width, problem.sample_time, errors)]


def gain_spread(problem: ProofProblem, hull: Hull, half_width: dict[str, float]) -> LawSpread:
    """The law in v+ = v + K_P (sigma - s) + T_s K_I sigma, with the gains within their intervals.

    The middle loop has the middle of each interval, so a gain deviates from it by at most half of the width.

    Args:
        problem: The loop with its sample time T_s.
        hull: Interval of each gain in the region, by name.
        half_width: Half of each interval's width, by name.
    """
    return LawSpread(
        is_integrated=False,
        gains={name: hull[name] for name in GAIN_NAMES},
        integral=Deviation(change=half_width["k_p"], sigma=problem.sample_time * half_width["k_i"], constant=0.0),
        command=Deviation(change=0.0, sigma=half_width["k_n"], constant=0.0),
        slide=Deviation(change=half_width["slide_p"], sigma=half_width["slide_i"], constant=0.0),
        slide_e=0.0,
    )


def ratio_spread(problem: ProofProblem, hull: Hull, half_width: dict[str, float], change_ratio: float) -> LawSpread:
    """The law in q+ = q + T_s phi_2, with phi_1/sigma, phi_2/sigma and K_N within their intervals.

    The middle loop has the middle of each interval, so a ratio deviates from it by at most half of the width.

    Args:
        problem: The loop with its sample time T_s and the form of its law.
        hull: Interval of each gain in the region, by name.
        half_width: Half of each interval's width, by name.
        change_ratio: R(0)/C, the factor of |sigma - s| in the deviation of q's increment; 0 in the conservative form.
    """
    is_implicit = problem.form == "implicit"
    slide_change = half_width["slide_p"] if is_implicit else 0.0  # slide_hull bounds it in the conservative form
    return LawSpread(
        is_integrated=True,
        gains={name: hull["mean" if name == "k_p" else name] for name in GAIN_NAMES},
        integral=Deviation(change=change_ratio, sigma=problem.sample_time * half_width["k_i"], constant=0.0),
        command=Deviation(change=0.0, sigma=half_width["mean"] + half_width["k_n"], constant=0.0),
        slide=Deviation(change=slide_change, sigma=half_width["mean"] + half_width["slide_i"], constant=0.0),
        slide_e=0.0 if is_implicit else hull["slide_e"][1],
    )


def function_spread(
    points: GainPoints, by_ratio: LawSpread, half_width: dict[str, float], sample_time: float, errors: np.ndarray
) -> LawSpread:
    """The law in q, where phi_1, phi_2 and n deviate by a constant from the straight lines nearest to them.

    Args:
        points: Gains at points of the region.
        by_ratio: The law whose deviations are bounded in |sigma|, from :func:`ratio_spread`.
        half_width: Half of the width of each gain's interval.
        sample_time: T_s [s].
        errors: R(sigma) by :func:`~dssc_jax.proofs.search.gains.increment_errors`, 0 in the conservative form;
            shape (points,).
    """
    size = np.abs(points.sigma)
    phi_1_ratios = points.columns["mean"]  # phi_1/sigma
    phi_2_ratios = points.columns["k_i"]
    n_ratios = points.columns["k_n"]
    k_1 = nearest_slope(size, phi_1_ratios)
    k_2 = nearest_slope(size, phi_2_ratios)
    k_3 = nearest_slope(size, n_ratios)
    phi_1_distance = largest_distance(size, phi_1_ratios, k_1)
    phi_2_distance = largest_distance(size, phi_2_ratios, k_2, errors / sample_time)  # plus R/T_s
    command_distance = largest_distance(size, phi_1_ratios + n_ratios, k_1 + k_3)  # of phi_1 + n
    return LawSpread(
        is_integrated=True,
        gains=by_ratio.gains | {"k_p": (k_1, k_1), "k_i": (k_2, k_2), "k_n": (k_3, k_3)},
        integral=Deviation(change=0.0, sigma=0.0, constant=sample_time * phi_2_distance),
        command=Deviation(change=0.0, sigma=0.0, constant=command_distance),
        slide=Deviation(by_ratio.slide.change, sigma=half_width["slide_i"], constant=phi_1_distance),
        slide_e=by_ratio.slide_e,
    )


def largest_distance(size: np.ndarray, ratio: np.ndarray, slope: float, offset: np.ndarray | float = 0.0) -> float:
    """The largest |f(sigma) - slope sigma| + offset over some points, widened for the verifier's enclosure.

    Args:
        size: |sigma| at the points, shape (points,).
        ratio: f(sigma)/sigma at the points, shape (points,).
        slope: Slope of the straight line.
        offset: Number that is added to the distance, the same at all points or shape (points,).
    """
    distance = float(np.max(np.abs(ratio - slope) * size + offset))
    rounding = SLOPE_ROUNDING * abs(slope) * float(size.max())
    return (1.0 + MARGIN) * distance + rounding


def nearest_slope(size: np.ndarray, ratio: np.ndarray) -> float:
    """The slope of the straight line through 0 with the least largest distance from a function f(sigma).

    The largest distance is convex in the slope, so that a ternary search over an interval of slopes finds the least.

    Args:
        size: |sigma| at some points, shape (points,).
        ratio: f(sigma)/sigma at the points, shape (points,).
    """
    low = float(ratio.min())
    high = float(ratio.max())
    for _ in range(SLOPE_STEPS):
        lower_slope = low + (high - low) / 3.0
        upper_slope = high - (high - low) / 3.0
        distance_of_lower = np.max(np.abs(ratio - lower_slope) * size)
        distance_of_upper = np.max(np.abs(ratio - upper_slope) * size)
        if distance_of_lower <= distance_of_upper:
            high = upper_slope
        else:
            low = lower_slope
    return 0.5 * (low + high)


def middle_gains(spread: LawSpread) -> list[float]:
    """The gains of the middle loop in the order of :data:`GAIN_NAMES`, as a certificate holds them."""
    return [middle(spread.gains[name]) for name in GAIN_NAMES]


def slide_hull(problem: ProofProblem, region: StageRegion, error_change: float) -> Interval:
    """The interval of K_P (1 + tau_av/T_s), the gain of sigma - s in the equivalent control; it has no unit.

    In the conservative form K_P is a mean over the sample, whereas tau_av is the value at the sample's end. With a
    constant k_o, tau_av = 1/(k_o g) with the slope g of phi_1. So tau_av K_P is 1/k_o times a ratio of slopes at points
    within one sample, which varies less than the product of the extremes. The narrower interval is returned.

    Args:
        problem: The loop and its uncertain numbers.
        region: The region, with a bound of the change of sigma in a sample.
        error_change: Bound of the change of e in a sample [m].
    """
    hull = gain_hull(problem, region.sigma, region.e)
    by_extremes = hull["slide_p"]
    functions = problem.functions
    if problem.form == "implicit" or "k_o" not in functions or functions["kind"] == "constant":
        return by_extremes
    ratio = slope_ratio(problem, region, error_change)
    averaging_gain = 1.0 / (functions["k_o"] * problem.sample_time)  # tau_av K_P/T_s where the slopes agree
    k_p_low, k_p_high = hull["k_p"]
    by_ratio = (k_p_low + averaging_gain / ratio, k_p_high + averaging_gain * ratio)
    return min(by_extremes, by_ratio, key=width)


def width(interval: Interval) -> float:
    """The distance of the two ends of an interval."""
    low, high = interval
    return high - low


def slope_ratio(problem: ProofProblem, region: StageRegion, error_change: float) -> float:
    """The largest ratio of the slopes d phi_1/d sigma at two points that the loop can pass within one sample.

    The slopes at the corners of each cell of a grid of |sigma| and |e| are compared with those of all cells that the
    loop can reach from it within one sample.

    Args:
        problem: The loop and its uncertain numbers.
        region: The region, with a bound of the change of sigma in a sample.
        error_change: Bound of the change of e in a sample [m].
    """
    sigma, e, change = region
    size = sigma * np.linspace(0.0, 1.0, ROOT_CELLS + 1) ** 2
    errors = e * np.linspace(0.0, 1.0, ERROR_CELLS + 1)
    with jax.enable_x64(True):
        s, x = jnp.meshgrid(jnp.asarray(size), jnp.asarray(errors), indexing="ij")
        k_o, tau_av, _ = functions_of(problem).at(s, x, jnp.float64(problem.l0))
        slope = np.broadcast_to(np.asarray(1.0 / (k_o * tau_av)), s.shape)  # K_P
    error_reach = int(np.ceil(error_change * ERROR_CELLS / e)) if e > 0.0 else 0  # cells that e crosses in a sample
    largest_ratio = 1.0
    for i in range(ROOT_CELLS):
        begin = max(int(np.searchsorted(size, size[i] - change, side="right")) - 1, 0)
        end = min(int(np.searchsorted(size, size[i + 1] + change)), ROOT_CELLS)
        for j in range(ERROR_CELLS):
            nearby_slopes = slope[begin : end + 1, max(j - error_reach, 0) : j + 2 + error_reach]
            largest_ratio = max(largest_ratio, float(nearby_slopes.max() / nearby_slopes.min()))
    return 1.0 + RATIO_ROOM * (largest_ratio - 1.0)
