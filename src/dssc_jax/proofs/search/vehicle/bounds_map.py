"""The map F from bounds Y of a vehicle's signals to the bounds F(Y) that follow from Y, in floating point.

Bounds of the signals bound the remainders, the differences of the vehicle from its linear channels. In the channels,
straight lines replace the functions phi_1, phi_2 and n of the control laws. F(Y) is the sum of the channels' responses
to the remainders, to the functions' deviations from straight lines, to the constant and to the start.
docs/vehicle_proofs.md has the formulas, with phi_3 in place of n.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.search.impulse_responses import spectral_radius
from dssc_jax.proofs.search.vehicle.attitude import Signals
from dssc_jax.proofs.search.vehicle.channels import (
    GRAVITY,
    Damping,
    LinearChannel,
    StraightLines,
    planar_channel,
    sampled_channel,
    vertical_channel,
    yaw_channel,
)
from dssc_jax.proofs.search.vehicle.deviations import ChannelDeviations, deviations_of, points_of
from dssc_jax.proofs.search.vehicle.nominal import Nominal
from dssc_jax.proofs.search.vehicle.remainders import Couplings, remainders_of
from dssc_jax.proofs.search.vehicle.responses import ChannelResponse, axis_factors
from dssc_jax.proofs.search.vehicle.rotors import Rotors
from dssc_jax.proofs.search.vehicle.slopes import signal_slopes
from dssc_jax.proofs.vehicle_problem import CHANNELS, VehicleProblem


@dataclass(frozen=True)
class LinearVehicle:
    """The linear channels of a vehicle and their responses, from which the map F follows.

    Args:
        problem: The vehicle.
        damping: Damping by drag.
        lines: The straight lines of each channel, which replace its controller's functions.
        responses: Responses of each channel.
        nominal: The nominal flight, from which the vehicle's deviation is bounded. None: the vehicle hovers.
    """

    problem: VehicleProblem
    damping: Damping
    lines: dict[str, StraightLines]
    responses: dict[str, ChannelResponse]
    nominal: Nominal | None

    def deviations(self, totals: Signals) -> dict[str, ChannelDeviations]:
        """Bound the deviations of phi_1, phi_2 and n of each channel from straight lines, while |sigma| is bounded.

        Args:
            totals: Bounds of the vehicle's signals, by channel, of which only ``sigma`` is used.

        Returns:
            Bounds of the deviations, by channel.
        """
        deviations = {}
        for name in CHANNELS:
            gains = points_of(self.problem, name, totals[name]["sigma"])  # at points with |sigma| up to its bound
            deviations[name] = deviations_of(gains, self.lines[name])
        return deviations


def linear_channels(problem: VehicleProblem, damping: Damping) -> dict[str, LinearChannel]:
    """Make the linear channels ``x`` (and y), ``z`` and ``psi``, with a given damping by drag."""
    return {
        "x": planar_channel(problem, damping.plane),
        "z": vertical_channel(problem, damping.vertical),
        "psi": yaw_channel(problem),
    }


def input_sizes(
    response: ChannelResponse, deviations: ChannelDeviations, sigma: float, remainders: dict[str, float]
) -> np.ndarray:
    """Bound a channel's inputs omega_u, omega_r and remainders, in this order, shape (inputs,).

    Args:
        response: Responses of the channel, which state the order of the remainders.
        deviations: Bounds of the functions' deviations from straight lines.
        sigma: Bound of |sigma| [m/s; rad/s in psi].
        remainders: Bounds of the channel's remainders, by name.
    """
    omega_u = deviations.of_command(sigma)
    omega_r = deviations.of_integral(sigma)
    return np.array([omega_u, omega_r, *(remainders[key] for key in response.remainders)])


def with_slopes(
    problem: VehicleProblem, response: ChannelResponse, point_bounds: np.ndarray, slopes: dict[str, float]
) -> dict[str, float]:
    """Bound a channel's signals at all times, by name, from bounds at four points of a sample.

    Every time is within T_s/8 of one of the points, so T_s/8 times the slope is added.

    Args:
        problem: The vehicle.
        response: Responses of the channel.
        point_bounds: Bounds at the points of a sample, shape (points, signals).
        slopes: Bounds of the signals' slopes within a sample, by name.
    """
    largest = point_bounds.max(axis=0)
    eighth = problem.sample_time / 8.0
    return {key: float(largest[i]) + eighth * slopes[key] for i, key in enumerate(response.names)}


def bounds_at_points(
    problem: VehicleProblem, name: str, response: ChannelResponse, deviations: ChannelDeviations, sizes: np.ndarray
) -> np.ndarray:
    """Bound a channel's signals at the points of a sample, shape (points, signals).

    A bound is the sum of the responses to omega_u and omega_r, to the remainders, to the constant |o| <= k g and to the
    start.

    Args:
        problem: The vehicle.
        name: Name of the channel.
        response: Responses of the channel.
        deviations: Bounds of the functions' deviations from straight lines, for the start's q_(-1).
        sizes: Bounds of the inputs omega_u, omega_r and the remainders, shape (inputs,).
    """
    channel = problem.channels[name]
    factors = axis_factors(name, response)  # h
    bound = factors * (response.gains[..., :2] @ sizes[:2]) + response.gains[..., 2:] @ sizes[2:]
    bound = bound + problem.thrust_deviation * GRAVITY * response.constant + response.start_offset
    by_start = response.starts[..., :2] @ np.array(channel.initial)  # E_0 and V_0
    start_deviation = deviations.of_start(channel.start, problem.first_sigma(name), problem.sample_time)  # of q_(-1)
    return bound + by_start + factors * start_deviation * response.starts[..., 2]


class ImpliedBounds(NamedTuple):
    """The bounds that follow from bounds Y of the signals.

    Args:
        bounds: F(Y), bounds of the signals.
        remainders: Bounds of the remainders, by channel and name.
        rotors: Bounds of the rotors.
    """

    bounds: Signals
    remainders: Signals
    rotors: Rotors


def apply_map(vehicle: LinearVehicle, deviations: dict[str, ChannelDeviations], y: Signals) -> ImpliedBounds:
    """Apply the map F to bounds of the signals.

    Args:
        vehicle: The linear channels and their responses.
        deviations: Bounds of the functions' deviations from straight lines, by channel.
        y: Y, bounds of the signals, or of their deviation from the nominal flight.

    Raises:
        OutOfRange: The vehicle may leave the range of the theorem.
    """
    problem = vehicle.problem
    totals, couplings = vehicle_totals(vehicle.nominal, y)
    remainders = remainders_of(problem, totals, vehicle.damping, couplings=couplings)
    slopes = signal_slopes(problem, y, remainders.channels, vehicle.damping)
    implied: Signals = {}
    for name in CHANNELS:
        response = vehicle.responses[name]
        sizes = input_sizes(response, deviations[name], totals[name]["sigma"], remainders.channels[name])
        point_bounds = bounds_at_points(problem, name, response, deviations[name], sizes)
        implied[name] = with_slopes(problem, response, point_bounds, slopes[name])
    return ImpliedBounds(implied, remainders.channels, remainders.rotors)


def slides(
    problem: VehicleProblem, deviations: dict[str, ChannelDeviations], totals: Signals, remainders: Signals
) -> bool:
    """Whether the equivalent control of every channel stays within rho (V5).

    Args:
        problem: The vehicle.
        deviations: Bounds of the functions' deviations from straight lines, and the largest gains, by channel.
        totals: Bounds of the vehicle's signals.
        remainders: Bounds of the remainders.
    """
    t = problem.sample_time
    for name, channel in problem.channels.items():
        k_p, k_i, equivalent_factor = deviations[name].largest_gains
        phi_1_distance = deviations[name].distance.phi_1  # D_1
        force = remainders[name]["torque" if name == "psi" else "force"]
        if name == "z":
            force += problem.thrust_deviation * GRAVITY  # |o| <= k g
        sigma_dot = totals[name]["bend"] + force  # S'
        integral_rate = k_i * totals[name]["sigma"]
        level = max(totals[name]["u_av"] + phi_1_distance, 0.5 * t * integral_rate)  # V_a
        if level + t * equivalent_factor * (k_p * sigma_dot + integral_rate) > channel.rho:
            return False
        if channel.start == "zero" and equivalent_factor * (k_p + t * k_i) * problem.first_sigma(name) > channel.rho:
            return False
    return True


def vehicle_totals(nominal: Nominal | None, y: Signals) -> tuple[Signals, Couplings | None]:
    """Bound the vehicle's own signals by N + Y, and a moving vehicle's distances from the motion its reference needs.

    Args:
        nominal: The nominal flight, whose signals are at most N; None: the vehicle hovers, and has no couplings.
        y: Y, bounds of the vehicle's deviation from the nominal flight.
    """
    if nominal is None:
        return y, None
    return nominal.totals(y), nominal.couplings(y)


def is_stable(problem: VehicleProblem, linear: dict[str, LinearChannel], lines: dict[str, StraightLines]) -> bool:
    """Whether all sampled channels are stable, with straight lines in place of the controllers' functions."""
    steps = [sampled_channel(problem, problem.channels[name], linear[name], lines[name]) for name in CHANNELS]
    return all(spectral_radius(step.a) < 1.0 for step in steps)
