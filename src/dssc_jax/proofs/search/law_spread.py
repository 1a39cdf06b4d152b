"""Deviations of the control law from a linear one in a region of sigma and e, in floating point.

With the coordinate v the gains deviate from those of the middle loop. With q = v - phi_1 the functions phi_1, phi_2
and the nominal control's n do: either by the spread of their ratios to sigma, or by the largest distance from straight
lines. The first is smaller near sigma = 0, where it vanishes with sigma; the second over a wide region. The increment
of v in the implicit form is not quite that of phi_1, which adds to what deviates.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.proofs.problem import Interval, ProofProblem
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
from dssc_jax.proofs.search.sampled_loop import functions_of, middle

SLOPE_STEPS = 40
"""Steps of the search for a slope; each cuts the interval by a third."""
ROOT_CELLS = 40
ERROR_CELLS = 10
"""Cells of |sigma|^(1/2) and of |e| for ratios of slopes, fewer than the verifier's."""
RATIO_ROOM = 1.05
"""Widening of a ratio of slopes."""
SLOPE_ROUNDING = 1e-12
"""Widening of a largest distance, in sizes of the function."""


class StageRegion(NamedTuple):
    """Bounds at the samples that make a region.

    Args:
        sigma: Bound of |sigma| [m/s].
        e: Bound of |e| [m].
        change: Bound of |sigma - s|, the change of sigma in a sample [m/s].
    """

    sigma: float
    e: float
    change: float


class Deviation(NamedTuple):
    """The coefficients of a bound ``change`` |sigma - s| + ``sigma`` |sigma| + ``constant`` of a term's deviation."""

    change: float
    sigma: float
    constant: float


class LawSpread(NamedTuple):
    """The control law in a region: the gains of a linear middle loop, and how far the law deviates from it.

    Args:
        is_integrated: Whether the coordinate is q = v - phi_1; otherwise it is v.
        gains: Interval of each gain, by its name in :data:`GAIN_NAMES`. With the coordinate q, phi_1/sigma stands in
            place of K_P.
        integral: Deviation of the increment of the coordinate in a sample.
        command: Deviation of the command besides.
        slide: Deviation of the equivalent control; in the conservative form without the part that :func:`slide_hull`
            bounds.
        slide_e: Factor of the change of e in a sample, which e adds to the equivalent control.
    """

    is_integrated: bool
    gains: Hull
    integral: Deviation
    command: Deviation
    slide: Deviation
    slide_e: float


def law_spreads(problem: ProofProblem, region: StageRegion) -> list[LawSpread]:
    """The control law in a region, once for each way in which its deviations can be bounded.

    These ways are gains that deviate (implicit form only), ratios phi/sigma that deviate, and distances from straight
    lines. In the implicit form the last two need functions whose integral phi_1 is known.
    """
    points = gain_points(problem, region.sigma, region.e)
    hull = {name: with_room(column) for name, column in points.columns.items()}
    half_width = {name: 0.5 * (high - low) for name, (low, high) in hull.items()}
    t = problem.sample_time
    implicit = problem.form == "implicit"
    by_gains = []
    if implicit:
        by_gains.append(
            LawSpread(
                is_integrated=False,
                gains={name: hull[name] for name in GAIN_NAMES},
                integral=Deviation(half_width["k_p"], t * half_width["k_i"], 0.0),
                command=Deviation(0.0, half_width["k_n"], 0.0),
                slide=Deviation(half_width["slide_p"], half_width["slide_i"], 0.0),
                slide_e=0.0,
            )
        )
        if problem.functions["kind"] not in KNOWN_INTEGRALS:
            return by_gains
    size = np.abs(points.sigma)
    errors = increment_errors(problem, size, region.change) if implicit else np.zeros(size.size)
    change_ratio = (1.0 + MARGIN) * float(errors.max()) / region.change
    by_ratio = LawSpread(
        is_integrated=True,
        gains={name: hull["mean" if name == "k_p" else name] for name in GAIN_NAMES},
        integral=Deviation(change_ratio, t * half_width["k_i"], 0.0),
        command=Deviation(0.0, half_width["mean"] + half_width["k_n"], 0.0),
        slide=Deviation(half_width["slide_p"] if implicit else 0.0, half_width["mean"] + half_width["slide_i"], 0.0),
        slide_e=0.0 if implicit else hull["slide_e"][1],
    )
    return [*by_gains, by_ratio, function_spread(points, by_ratio, half_width, t, errors)]


def function_spread(
    points: GainPoints, by_ratio: LawSpread, half_width: dict[str, float], t: float, errors: np.ndarray
) -> LawSpread:
    """The control law in a region, with the functions' distances from the straight lines that are nearest to them.

    Args:
        points: Gains at points of the region.
        by_ratio: The law whose deviations are those of the ratios phi/sigma.
        half_width: Half widths of the gains' intervals.
        t: T_s [s].
        errors: Bound, at each point, of what the increment of v deviates by from that of phi_1.
    """
    size = np.abs(points.sigma)
    columns = points.columns
    slopes = {name: nearest_slope(size, columns[name]) for name in ("mean", "k_i", "k_n")}
    ratio_of_command = columns["mean"] + columns["k_n"]
    mean_distance = largest_distance(size, columns["mean"], slopes["mean"])
    integral_distance = largest_distance(size, columns["k_i"], slopes["k_i"], errors / t)
    command_distance = largest_distance(size, ratio_of_command, slopes["mean"] + slopes["k_n"])
    gains = by_ratio.gains | {name: (slopes[of], slopes[of]) for name, of in SLOPES.items()}
    return LawSpread(
        is_integrated=True,
        gains=gains,
        integral=Deviation(0.0, 0.0, t * integral_distance),
        command=Deviation(0.0, 0.0, command_distance),
        slide=Deviation(by_ratio.slide.change, half_width["slide_i"], mean_distance),
        slide_e=by_ratio.slide_e,
    )


SLOPES = {"k_p": "mean", "k_i": "k_i", "k_n": "k_n"}
"""The gain of the middle loop that each slope becomes."""


def largest_distance(size: np.ndarray, ratio: np.ndarray, slope: float, offset: np.ndarray | float = 0.0) -> float:
    """The largest |ratio - slope| |sigma| + offset over points with |sigma| = ``size``, a little widened."""
    distance = float(np.max(np.abs(ratio - slope) * size + offset))
    rounding = SLOPE_ROUNDING * abs(slope) * float(size.max())
    return (1.0 + MARGIN) * distance + rounding


def nearest_slope(size: np.ndarray, ratio: np.ndarray) -> float:
    """The slope of the straight line through 0 that is nearest to the function ratio sigma.

    The largest distance is convex in the slope, so that cutting thirds off an interval finds it.

    Args:
        size: |sigma| at points.
        ratio: The function over sigma there.
    """
    low = float(ratio.min())
    high = float(ratio.max())
    for _ in range(SLOPE_STEPS):
        lower_slope = low + (high - low) / 3.0
        upper_slope = high - (high - low) / 3.0
        if np.max(np.abs(ratio - lower_slope) * size) <= np.max(np.abs(ratio - upper_slope) * size):
            high = upper_slope
        else:
            low = lower_slope
    return 0.5 * (low + high)


def middle_gains(spread: LawSpread) -> list[float]:
    """The gains of the middle loop in the order of :data:`GAIN_NAMES`, as a certificate holds them."""
    return [middle(spread.gains[name]) for name in GAIN_NAMES]


def slide_hull(problem: ProofProblem, region: tuple[float, float], change: float, error_change: float) -> Interval:
    """The interval of the gain of sigma - s in the equivalent control.

    With a constant k_o, tau_av K_P is 1/k_o times a ratio of slopes of phi_1 at points within a sample, which varies
    less than its factors.

    Args:
        problem: The problem.
        region: Bounds of |sigma| [m/s] and |e| [m].
        change: Bound of the change of sigma in a sample [m/s].
        error_change: Bound of the change of e in a sample [m].
    """
    hull = gain_hull(problem, *region)
    functions = problem.functions
    if problem.form == "implicit" or "k_o" not in functions or functions["kind"] == "constant":
        return hull["slide_p"]
    ratio = slope_ratio(problem, region, change, error_change)
    averaged_gain = 1.0 / (functions["k_o"] * problem.sample_time)
    low = hull["k_p"][0] + averaged_gain / ratio
    high = hull["k_p"][1] + averaged_gain * ratio
    widest = hull["slide_p"]
    return (low, high) if high - low < widest[1] - widest[0] else widest


def slope_ratio(problem: ProofProblem, region: tuple[float, float], change: float, error_change: float) -> float:
    """The largest ratio of the slopes d phi_1/d sigma at two points within a sample, on a grid of cells.

    Args:
        problem: The problem.
        region: Bounds of |sigma| [m/s] and |e| [m].
        change: Bound of the change of sigma in a sample [m/s].
        error_change: Bound of the change of e in a sample [m].
    """
    sigma, e = region
    size = sigma * np.linspace(0.0, 1.0, ROOT_CELLS + 1) ** 2
    errors = e * np.linspace(0.0, 1.0, ERROR_CELLS + 1)
    with jax.enable_x64(True):
        s, x = jnp.meshgrid(jnp.asarray(size), jnp.asarray(errors), indexing="ij")
        k_o, tau_av, _ = functions_of(problem).at(s, x, jnp.float64(problem.l0))
        slope = np.broadcast_to(np.asarray(1.0 / (k_o * tau_av)), s.shape)
    cells = int(np.ceil(error_change * ERROR_CELLS / e)) if e > 0.0 else 0
    largest_ratio = 1.0
    for i in range(ROOT_CELLS):
        begin = max(int(np.searchsorted(size, size[i] - change, side="right")) - 1, 0)
        end = min(int(np.searchsorted(size, size[i + 1] + change)), ROOT_CELLS)
        for j in range(ERROR_CELLS):
            nearby_slopes = slope[begin : end + 1, max(j - cells, 0) : j + 2 + cells]
            largest_ratio = max(largest_ratio, float(nearby_slopes.max() / nearby_slopes.min()))
    return 1.0 + RATIO_ROOM * (largest_ratio - 1.0)
