"""Distances of a channel's functions from straight lines, in floating point."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from dssc_jax.proofs.problem import ProofProblem
from dssc_jax.proofs.search.gains import GainPoints, gain_points
from dssc_jax.proofs.vehicle_problem import ChannelProblem, VehicleProblem

DISTANCE_ROOM = 1.01
"""Widening of a distance, for the verifier's enclosure."""
RATIO_ROOM = 1.001
"""Widening of a distance over |sigma|, for the verifier's enclosure."""
SHARED_ROOM = 1.03
"""Widening of the rest of omega_q, for the verifier's enclosure."""
SMALLEST_REGION = 1e-9
Slopes = tuple[float, float, float, float]
"""k_1, k_2 and k_n of the straight lines in place of a channel's functions, and the share of omega_u in omega_q."""


@dataclass(frozen=True)
class ChannelDeviations:
    """Bounds of what a channel's functions deviate by from straight lines over a region of |sigma|.

    Args:
        slopes: Slopes k_1, k_2, k_n of the lines, and the share of omega_u in omega_q.
        distance: Largest distances of phi_1, of phi_2 without its share, and of phi_1 + n.
        ratio: The largest ratios of these distances to |sigma|.
        steepest: Largest K_P and K_I, and 1 + tau_av/T_s.
    """

    slopes: Slopes
    distance: tuple[float, float, float]
    ratio: tuple[float, float, float]
    steepest: tuple[float, float, float]

    def of_command(self, sigma: float) -> float:
        """Bound of |omega_u|, what the command deviates by, for |sigma| up to a bound."""
        return min(self.distance[2], self.ratio[2] * sigma)

    def of_integral(self, sigma: float) -> float:
        """Bound of what omega_q has besides its share of omega_u, for |sigma| up to a bound."""
        return min(self.distance[1], self.ratio[1] * sigma)

    def of_start(self, start: str, start_sigma: float, sample_time: float) -> float:
        """Bound of what the first sum q deviates by.

        Args:
            start: Start of the predictor; ``midpoint`` takes half a sample of the integral, with all of omega_q.
            start_sigma: Bound of |sigma| at t = 0.
            sample_time: T_s [s].
        """
        if start == "zero":
            return 0.0
        deviation = min(self.distance[0], self.ratio[0] * start_sigma)
        if start == "midpoint":
            integral = self.of_integral(start_sigma) + abs(self.slopes[3]) * self.of_command(start_sigma)
            deviation += 0.5 * sample_time * integral
        return deviation


def law_problem(problem: VehicleProblem, channel: ChannelProblem) -> ProofProblem:
    """The problem of one axis with a channel's controller, for the functions that evaluate its gains.

    All that does not concern the controller is neutral.
    """
    return ProofProblem(
        sample_time=problem.sample_time, l0=channel.l0, form="conservative", functions=channel.functions,
        rho=channel.rho, nominal=channel.nominal, k_p=(1.0, 1.0), a_p=(0.0, 0.0), zero_a=(), zero_c=(), numerator=(),
        denominator=(), mu=(0.0, 0.0), delay=0.0, sensor_lag=0.0, level=0.0, slope=0.0, reference=(0.0, 0.0, 0.0),
        initial=((0.0, 0.0), (0.0, 0.0)), start=channel.start,
    )  # fmt: skip


def points_of(problem: VehicleProblem, name: str, sigma: float) -> GainPoints:
    """The gains of a channel's functions at points with |sigma| up to a bound."""
    return gain_points(law_problem(problem, problem.channels[name]), max(sigma, SMALLEST_REGION), 0.0)


def best_slopes(points: GainPoints, *, joint: bool) -> Slopes:
    """The slopes of the straight lines that are nearest to phi_1 + n and to phi_2.

    That of n is its mean, and phi_1 has what is left of the first.

    Args:
        points: The gains of the functions at points.
        joint: Whether omega_q has the share of omega_u with which the remaining part is smallest; else the share is 0.
    """
    sigma_sizes = np.abs(points.sigma)
    columns = points.columns
    command_slope = nearest_slope(sigma_sizes, columns["mean"] + columns["k_n"])
    pole = float(np.mean(columns["k_n"]))
    integral_slope = nearest_slope(sigma_sizes, columns["k_i"])
    share = 0.0
    if joint:
        command_ratios = columns["mean"] + columns["k_n"] - command_slope
        share = nearest_share(sigma_sizes, columns["k_i"] - integral_slope, command_ratios)
    return command_slope - pole, integral_slope, pole, share


def nearest_share(sigma_sizes: np.ndarray, integral: np.ndarray, command: np.ndarray) -> float:
    """The factor by which the command's deviation is nearest to the integral's, both as ratios to sigma at points."""
    largest = distance_of(sigma_sizes, command, 0.0)
    if largest == 0.0:
        return 0.0
    high = 2.0 * distance_of(sigma_sizes, integral, 0.0) / largest
    if high == 0.0:
        return 0.0
    return lowest(lambda share: distance_of(sigma_sizes, integral - share * command, 0.0), -high, high)


def nearest_slope(sigma_sizes: np.ndarray, ratios: np.ndarray) -> float:
    """The slope k of the straight line that is nearest to a function f: the largest |f - k sigma| is convex in k.

    Args:
        sigma_sizes: |sigma| at points.
        ratios: f/sigma there.
    """
    low, high = float(ratios.min()), float(ratios.max())
    if not low < high:
        return low
    return lowest(lambda slope: distance_of(sigma_sizes, ratios, slope), low, high)


def lowest(height: Callable[[float], float], low: float, high: float) -> float:
    """The number between two ends at which a convex function is smallest."""
    minimum = minimize_scalar(height, bounds=(low, high), method="bounded")
    return float(minimum.x)


def distance_of(sigma_sizes: np.ndarray, ratios: np.ndarray, slope: float) -> float:
    """The largest |f - slope sigma|, from |sigma| and the ratios f/sigma at points, widened for the verifier."""
    return DISTANCE_ROOM * float(np.max(np.abs(ratios - slope) * sigma_sizes))


def deviations_of(points: GainPoints, slopes: Slopes) -> ChannelDeviations:
    """Bounds of what functions deviate by from straight lines with these slopes, from their gains at points."""
    sigma_sizes = np.abs(points.sigma)
    columns = points.columns
    scale = columns["mean"] + columns["k_n"]
    all_ratios = (columns["mean"], columns["k_i"] - slopes[3] * scale, scale)
    straight = (slopes[0], slopes[1] - slopes[3] * (slopes[0] + slopes[2]), slopes[0] + slopes[2])
    distance_1, distance_2, distance_b = (
        distance_of(sigma_sizes, ratios, slope) for ratios, slope in zip(all_ratios, straight, strict=True)
    )
    distance_2 *= SHARED_ROOM if slopes[3] else 1.0
    share_1, share_2, share_b = (
        RATIO_ROOM * float(np.max(np.abs(ratios - slope))) for ratios, slope in zip(all_ratios, straight, strict=True)
    )
    steepest = float(np.max(columns["k_p"]))
    reach = float(np.max(columns["slide_p"])) / steepest
    return ChannelDeviations(
        slopes,
        (distance_1, distance_2, distance_b),
        (share_1, share_2, share_b),
        (steepest, float(np.max(columns["k_i"])), reach),
    )
