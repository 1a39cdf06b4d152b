"""Bounds of the deviations of a channel's functions from straight lines, in floating point.

The lines k_1 sigma, k_2 sigma and k_3 sigma replace phi_1, phi_2 and n = sigma/(k_n tau_m), which comes from the
nominal control's term 1/tau_m and which docs/vehicle_proofs.md calls phi_3. The deviations are omega_u = phi_1 + n -
(k_1 + k_3) sigma and omega_q = phi_2 - k_2 sigma = s_q omega_u + omega_r, where the share s_q makes omega_r small.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from dssc_jax.proofs.problem import ProofProblem
from dssc_jax.proofs.search.gains import GainPoints, gain_points
from dssc_jax.proofs.search.vehicle.channels import StraightLines
from dssc_jax.proofs.vehicle_problem import ChannelProblem, VehicleProblem

DISTANCE_ROOM = 1.01
"""Factor that widens a distance, for the verifier's enclosure."""
RATIO_ROOM = 1.001
"""Factor that widens a distance over |sigma|, for the verifier's enclosure."""
SHARED_ROOM = 1.03
"""Further factor that widens the bound of omega_r if the share is not 0, for the verifier's enclosure."""
SMALLEST_REGION = 1e-9
"""Smallest bound of |sigma| for a region."""


class DeviationBounds(NamedTuple):
    """Bounds of |phi_1 - k_1 sigma|, |omega_r| and |omega_u|, or of these three over |sigma|."""

    phi_1: float
    omega_r: float
    omega_u: float


class LargestGains(NamedTuple):
    """The largest gains of a channel's controller in a region.

    Args:
        k_p: K_P.
        k_i: K_I [1/s].
        equivalent_factor: 1 + tau_av/T_s, the factor of the gains in the equivalent control u_eq.
    """

    k_p: float
    k_i: float
    equivalent_factor: float


@dataclass(frozen=True)
class ChannelDeviations:
    """Bounds of the deviations of a channel's functions from straight lines over a region of |sigma|.

    omega_u is the deviation of the command. The sum q, which integrates phi_2, has the deviation omega_q = s_q omega_u
    + omega_r, of which omega_r is bounded here.

    Args:
        lines: The straight lines, and the share s_q of the command's deviation in that of q.
        distance: D_1, D_2 and D_b, the largest deviations.
        ratio: d_1, d_2 and d_b, the largest deviations over |sigma|.
        largest_gains: The largest gains in the region.
    """

    lines: StraightLines
    distance: DeviationBounds
    ratio: DeviationBounds
    largest_gains: LargestGains

    def of_command(self, sigma: float) -> float:
        """Bound of |omega_u|, the command's deviation, for |sigma| up to ``sigma``: min(D_b, d_b |sigma|)."""
        return min(self.distance.omega_u, self.ratio.omega_u * sigma)

    def of_integral(self, sigma: float) -> float:
        """Bound of |omega_r|, the own deviation of the sum q, for |sigma| up to ``sigma``: min(D_2, d_2 |sigma|)."""
        return min(self.distance.omega_r, self.ratio.omega_r * sigma)

    def of_start(self, start: str, start_sigma: float, sample_time: float) -> float:
        """Bound of the deviation of q_(-1), the sum before the first sample, from its value with straight lines.

        q_(-1) is 0 for the start ``zero``, which is exact, and -phi_1(sigma_0) for ``matched``. For ``midpoint`` it is
        -phi_1(sigma_0) - T_s/2 phi_2(sigma_0), whose last term deviates by T_s/2 omega_q.

        Args:
            start: Start of the predictor: ``zero``, ``matched`` or ``midpoint``.
            start_sigma: Sigma_0, bound of |sigma| at t = 0.
            sample_time: T_s [s].
        """
        if start == "zero":
            return 0.0
        deviation = min(self.distance.phi_1, self.ratio.phi_1 * start_sigma)
        if start == "midpoint":
            omega_q = self.of_integral(start_sigma) + abs(self.lines.share) * self.of_command(start_sigma)
            deviation += 0.5 * sample_time * omega_q
        return deviation


def law_problem(problem: VehicleProblem, channel: ChannelProblem) -> ProofProblem:
    """Make a problem of a single axis with a channel's controller, for which the gains of the functions are evaluated.

    The gains do not depend on the plant, so a double integrator without disturbance stands for it.
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
    """Evaluate the gains of a channel's functions, which do not depend on e, at points of a region of |sigma|.

    Args:
        problem: The vehicle.
        name: Name of the channel.
        sigma: Largest |sigma| [m/s; rad/s in psi]; below ``SMALLEST_REGION`` the latter is used.
    """
    return gain_points(law_problem(problem, problem.channels[name]), max(sigma, SMALLEST_REGION), e=0.0)


def best_lines(points: GainPoints, *, joint: bool) -> StraightLines:
    """Find the straight lines nearest to phi_1 + n and to phi_2, and the share s_q with the smallest omega_r.

    omega_u depends on the sum k_1 + k_3 only. k_3 is the mean of n/sigma, and k_1 the sum less k_3.

    Args:
        points: The gains of the functions at points.
        joint: Whether s_q is chosen; else s_q = 0.
    """
    size = np.abs(points.sigma)
    phi_2_ratios = points.columns["k_i"]  # phi_2/sigma
    n_ratios = points.columns["k_n"]  # n/sigma
    command_ratios = points.columns["mean"] + n_ratios  # (phi_1 + n)/sigma
    command_slope = nearest_slope(size, command_ratios)  # k_1 + k_3
    k_2 = nearest_slope(size, phi_2_ratios)
    k_3 = float(np.mean(n_ratios))
    share = nearest_share(size, phi_2_ratios - k_2, command_ratios - command_slope) if joint else 0.0
    return StraightLines(k_1=command_slope - k_3, k_2=k_2, k_3=k_3, share=share)


def nearest_share(size: np.ndarray, omega_q_ratios: np.ndarray, omega_u_ratios: np.ndarray) -> float:
    """Find the share s_q for which the largest |omega_q - s_q omega_u|, a convex function of s_q, is smallest.

    Args:
        size: |sigma| at points, shape (points,).
        omega_q_ratios: omega_q/sigma at the points, shape (points,).
        omega_u_ratios: omega_u/sigma at the points, shape (points,).

    Returns:
        s_q; 0 if omega_q or omega_u vanishes at all points.
    """
    largest_omega_u = largest_distance(size, omega_u_ratios, 0.0)
    largest_omega_q = largest_distance(size, omega_q_ratios, 0.0)
    if largest_omega_u == 0.0 or largest_omega_q == 0.0:
        return 0.0
    limit = 2.0 * largest_omega_q / largest_omega_u  # a larger |s_q| is worse than s_q = 0

    def distance_with(share: float) -> float:
        """The largest |omega_q - share omega_u| at the points."""
        return largest_distance(size, omega_q_ratios - share * omega_u_ratios, 0.0)

    return minimiser(distance_with, -limit, limit)


def nearest_slope(size: np.ndarray, ratios: np.ndarray) -> float:
    """Find the slope k for which the largest |f - k sigma|, a convex function of k, is smallest, for a function f.

    Args:
        size: |sigma| at points, shape (points,).
        ratios: f/sigma at the points, shape (points,).
    """
    low = float(ratios.min())
    high = float(ratios.max())
    if not low < high:
        return low
    return minimiser(lambda slope: largest_distance(size, ratios, slope), low, high)


def minimiser(function: Callable[[float], float], low: float, high: float) -> float:
    """Find the number between two ends at which a convex function is smallest, by Brent's method."""
    minimum = minimize_scalar(function, bounds=(low, high), method="bounded")
    return float(minimum.x)


def largest_distance(size: np.ndarray, ratios: np.ndarray, slope: float) -> float:
    """The largest |f - slope sigma| over some points, widened by ``DISTANCE_ROOM``.

    Args:
        size: |sigma| at the points, shape (points,).
        ratios: f/sigma at the points, shape (points,).
        slope: Slope of the straight line.
    """
    return DISTANCE_ROOM * float(np.max(np.abs(ratios - slope) * size))


def deviations_of(points: GainPoints, lines: StraightLines) -> ChannelDeviations:
    """Estimate, from points, bounds of the functions' deviations from straight lines over a region of |sigma|.

    The verifier checks the estimates.

    Args:
        points: The gains of the functions at points of the region.
        lines: The straight lines, and the share s_q.
    """
    columns = points.columns
    size = np.abs(points.sigma)
    phi_1_ratios = columns["mean"]
    command_ratios = phi_1_ratios + columns["k_n"]  # (phi_1 + n)/sigma
    integral_ratios = columns["k_i"] - lines.share * command_ratios  # (phi_2 - s_q (phi_1 + n))/sigma
    command_slope = lines.k_1 + lines.k_3
    integral_slope = lines.k_2 - lines.share * command_slope
    integral_room = SHARED_ROOM if lines.share else 1.0
    k_p = float(np.max(columns["k_p"]))
    return ChannelDeviations(
        lines=lines,
        distance=DeviationBounds(
            phi_1=largest_distance(size, phi_1_ratios, lines.k_1),
            omega_r=largest_distance(size, integral_ratios, integral_slope) * integral_room,
            omega_u=largest_distance(size, command_ratios, command_slope),
        ),
        ratio=DeviationBounds(
            phi_1=largest_ratio(phi_1_ratios, lines.k_1),
            omega_r=largest_ratio(integral_ratios, integral_slope),
            omega_u=largest_ratio(command_ratios, command_slope),
        ),
        largest_gains=LargestGains(
            k_p=k_p,
            k_i=float(np.max(columns["k_i"])),
            equivalent_factor=float(np.max(columns["slide_p"])) / k_p,
        ),
    )


def largest_ratio(ratios: np.ndarray, slope: float) -> float:
    """The largest |f/sigma - slope| over points with f/sigma = ``ratios``, widened by ``RATIO_ROOM``."""
    return RATIO_ROOM * float(np.max(np.abs(ratios - slope)))
