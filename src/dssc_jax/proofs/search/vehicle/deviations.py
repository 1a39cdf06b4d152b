"""How far the functions of a channel's controller are from straight lines, in floating point.

phi_1, phi_2 and n = sigma/(k_n tau_m), the phi_3 of the nominal control's term 1/tau_m, become k_1 sigma, k_2 sigma and
k_3 sigma. What remains are omega_u = phi_1 + n - (k_1 + k_3) sigma and omega_q = phi_2 - k_2 sigma = s_q omega_u +
omega_r, where the share s_q makes omega_r small.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from dssc_jax.proofs.problem import ProofProblem
from dssc_jax.proofs.search.gains import GainPoints, gain_points
from dssc_jax.proofs.vehicle_problem import ChannelProblem, VehicleProblem

DISTANCE_ROOM = 1.01
"""Factor that widens a distance, for the verifier's enclosure."""
RATIO_ROOM = 1.001
"""Factor that widens a distance over |sigma|, for the verifier's enclosure."""
SHARED_ROOM = 1.03
"""Factor that widens the distance of omega_r besides, where the share is not 0, for the verifier's enclosure."""
SMALLEST_REGION = 1e-9
"""Smallest bound of |sigma| for a region."""
Slopes = tuple[float, float, float, float]
"""Slopes k_1, k_2 and k_3 of the straight lines in place of a channel's functions, and the share s_q."""


@dataclass(frozen=True)
class ChannelDeviations:
    """Bounds of how far a channel's functions are from straight lines over a region of |sigma|.

    phi_1(sigma) deviates from k_1 sigma. The sum q, which integrates phi_2, deviates by omega_r from that of k_2 sigma,
    and the command by omega_u. All that drives q is omega_q = omega_r + s_q omega_u.

    Args:
        slopes: Slopes k_1, k_2, k_3 of the lines, and the share s_q of the command's deviation that drives q.
        distance: D_1, D_2 and D_b: the largest |phi_1 - k_1 sigma|, |omega_r| and |omega_u|.
        ratio: d_1, d_2 and d_b: the largest values of the same over |sigma|.
        steepest: The largest K_P and K_I [1/s] in the region, and the largest 1 + tau_av/T_s.
    """

    slopes: Slopes
    distance: tuple[float, float, float]
    ratio: tuple[float, float, float]
    steepest: tuple[float, float, float]

    def of_command(self, sigma: float) -> float:
        """Bound of |omega_u|, what the command deviates by, for |sigma| up to ``sigma``: min(D_b, d_b |sigma|)."""
        _, _, distance_b = self.distance
        _, _, ratio_b = self.ratio
        return min(distance_b, ratio_b * sigma)

    def of_integral(self, sigma: float) -> float:
        """Bound of |omega_r|, what the sum q deviates by, for |sigma| up to ``sigma``: min(D_2, d_2 |sigma|)."""
        _, distance_2, _ = self.distance
        _, ratio_2, _ = self.ratio
        return min(distance_2, ratio_2 * sigma)

    def of_start(self, start: str, start_sigma: float, sample_time: float) -> float:
        """Bound of how far q_(-1), the sum before the first sample, is from that of straight lines.

        By the start of the predictor, q_(-1) is 0 for ``zero``, which is exact, -phi_1(sigma_0) for ``matched``, and
        -phi_1(sigma_0) - T_s/2 phi_2(sigma_0) for ``midpoint``, whose last term deviates by T_s/2 omega_q.

        Args:
            start: Start of the predictor.
            start_sigma: Sigma_0, bound of |sigma| at t = 0.
            sample_time: T_s [s].
        """
        if start == "zero":
            return 0.0
        distance_1, _, _ = self.distance
        ratio_1, _, _ = self.ratio
        deviation = min(distance_1, ratio_1 * start_sigma)
        if start == "midpoint":
            *_, share = self.slopes
            omega_q = self.of_integral(start_sigma) + abs(share) * self.of_command(start_sigma)
            deviation += 0.5 * sample_time * omega_q
        return deviation


def law_problem(problem: VehicleProblem, channel: ChannelProblem) -> ProofProblem:
    """The problem of a single axis with a channel's controller, by which the gains of its functions are evaluated.

    The gains do not depend on the plant, which is a double integrator without disturbance here.
    """
    return ProofProblem(
        sample_time=problem.sample_time,
        l0=channel.l0,
        form="conservative",
        functions=channel.functions,
        rho=channel.rho,
        nominal=channel.nominal,
        k_p=(1.0, 1.0),
        a_p=(0.0, 0.0),
        zero_a=(),
        zero_c=(),
        numerator=(),
        denominator=(),
        mu=(0.0, 0.0),
        delay=0.0,
        sensor_lag=0.0,
        level=0.0,
        slope=0.0,
        reference=(0.0, 0.0, 0.0),
        initial=((0.0, 0.0), (0.0, 0.0)),
        start=channel.start,
    )


def points_of(problem: VehicleProblem, name: str, sigma: float) -> GainPoints:
    """The gains of a channel's functions at points with |sigma| up to ``sigma``; they do not depend on e."""
    return gain_points(law_problem(problem, problem.channels[name]), max(sigma, SMALLEST_REGION), e=0.0)


def best_slopes(points: GainPoints, *, joint: bool) -> Slopes:
    """The slopes of the straight lines nearest to phi_1 + n and to phi_2, and the share s_q with the smallest omega_r.

    Only the sum k_1 + k_3 matters to omega_u. k_3 is the mean of n/sigma, and k_1 is the rest of the sum.

    Args:
        points: The gains of the functions at points.
        joint: Whether omega_q takes a share of omega_u; else s_q = 0.
    """
    size = np.abs(points.sigma)
    phi_2_ratios = points.columns["k_i"]  # phi_2/sigma
    n_ratios = points.columns["k_n"]  # n/sigma
    command_ratios = points.columns["mean"] + n_ratios  # (phi_1 + n)/sigma
    command_slope = nearest_slope(size, command_ratios)  # k_1 + k_3
    k_2 = nearest_slope(size, phi_2_ratios)
    k_3 = float(np.mean(n_ratios))
    share = nearest_share(size, phi_2_ratios - k_2, command_ratios - command_slope) if joint else 0.0
    return command_slope - k_3, k_2, k_3, share


def nearest_share(size: np.ndarray, integral: np.ndarray, command: np.ndarray) -> float:
    """The share s_q with the smallest largest |omega_q - s_q omega_u|, which is convex in s_q.

    Args:
        size: |sigma| at points, shape (points,).
        integral: omega_q/sigma there, shape (points,).
        command: omega_u/sigma there, shape (points,).
    """
    largest_command = distance_of(size, command, 0.0)
    largest_integral = distance_of(size, integral, 0.0)
    if largest_command == 0.0 or largest_integral == 0.0:
        return 0.0
    limit = 2.0 * largest_integral / largest_command  # beyond it the difference exceeds omega_q
    return lowest(lambda share: distance_of(size, integral - share * command, 0.0), -limit, limit)


def nearest_slope(size: np.ndarray, ratios: np.ndarray) -> float:
    """The slope k of the straight line with the least largest |f - k sigma| from a function f, which is convex in k.

    Args:
        size: |sigma| at points, shape (points,).
        ratios: f/sigma there, shape (points,).
    """
    low = float(ratios.min())
    high = float(ratios.max())
    if not low < high:
        return low
    return lowest(lambda slope: distance_of(size, ratios, slope), low, high)


def lowest(height: Callable[[float], float], low: float, high: float) -> float:
    """The number between two ends at which a convex function is smallest, by Brent's method."""
    minimum = minimize_scalar(height, bounds=(low, high), method="bounded")
    return float(minimum.x)


def distance_of(size: np.ndarray, ratios: np.ndarray, slope: float) -> float:
    """The largest |f - slope sigma| at points with |sigma| = ``size`` and f/sigma = ``ratios``, widened a little."""
    return DISTANCE_ROOM * float(np.max(np.abs(ratios - slope) * size))


def deviations_of(points: GainPoints, slopes: Slopes) -> ChannelDeviations:
    """Bounds of how far a channel's functions are from straight lines with given slopes, over a region of |sigma|.

    Args:
        points: The gains of the functions at points of the region.
        slopes: Slopes k_1, k_2, k_3 of the lines, and the share s_q.
    """
    k_1, k_2, k_3, share = slopes
    columns = points.columns
    size = np.abs(points.sigma)
    command = columns["mean"] + columns["k_n"]  # (phi_1 + n)/sigma
    integral = columns["k_i"] - share * command  # (phi_2 - s_q (phi_1 + n))/sigma
    integral_slope = k_2 - share * (k_1 + k_3)
    distance_1 = distance_of(size, columns["mean"], k_1)
    distance_2 = distance_of(size, integral, integral_slope) * (SHARED_ROOM if share else 1.0)
    distance_b = distance_of(size, command, k_1 + k_3)
    k_p = float(np.max(columns["k_p"]))
    return ChannelDeviations(
        slopes=slopes,
        distance=(distance_1, distance_2, distance_b),
        ratio=(
            largest_ratio(columns["mean"], k_1),
            largest_ratio(integral, integral_slope),
            largest_ratio(command, k_1 + k_3),
        ),
        steepest=(k_p, float(np.max(columns["k_i"])), float(np.max(columns["slide_p"])) / k_p),
    )


def largest_ratio(ratios: np.ndarray, slope: float) -> float:
    """The largest |f/sigma - slope| at points with f/sigma = ``ratios``, widened a little."""
    return RATIO_ROOM * float(np.max(np.abs(ratios - slope)))
