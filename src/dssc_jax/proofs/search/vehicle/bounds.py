"""Bounds of all signals of a vehicle that imply themselves, searched in floating point as fixed points."""

import math
from dataclasses import dataclass

import numpy as np

from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.search.impulse_responses import decay_of, spectral_radius
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.vehicle.attitude import OutOfRange, Signals
from dssc_jax.proofs.search.vehicle.channels import (
    GRAVITY,
    LinearChannel,
    planar_channel,
    sampled_channel,
    vertical_channel,
    yaw_channel,
)
from dssc_jax.proofs.search.vehicle.deviations import (
    ChannelDeviations,
    Slopes,
    best_slopes,
    deviations_of,
    points_of,
)
from dssc_jax.proofs.search.vehicle.nominal import Nominal, nominal_of
from dssc_jax.proofs.search.vehicle.remainders import Couplings, remainders_of
from dssc_jax.proofs.search.vehicle.responses import ChannelResponse, axes_of, channel_response
from dssc_jax.proofs.search.vehicle.rotors import Rotors
from dssc_jax.proofs.search.vehicle.slopes import signal_slopes
from dssc_jax.proofs.search.vehicle.waves import derivative, reference_waves, size
from dssc_jax.proofs.vehicle_problem import CHANNELS, VehicleProblem

INFLATION = 2e-3
"""Excess of a bound in Y over F(Y), as a share, for what the verifier's balls and tails add."""
FAST = ("alpha_dot", "turn", "gamma", "behind")
"""Signals whose responses last a few samples only, so that sums over pieces of a sample are less exact."""
FAST_INFLATION = 1.5e-2
SMALLEST_BOUND = 1e-12
FIRST_REGION = 1e-3
"""Smallest |sigma| for which slopes are chosen at first."""
ROUNDS = 12
"""Times that the slopes are chosen anew."""
ITERATIONS = 400
"""Times that a map is applied."""
SETTLED = 1e-5
"""Relative growth of a bound at which it counts as a fixed point."""
REGION_KEPT = 0.01
"""Relative change of |sigma| in a region for which the slopes are kept."""
LARGEST_GROWTH = 2.0
"""Growth of a region at which the slopes are chosen anew."""
DAMPING_SHARE = 1.7
"""The first damping of drag, over k W/M."""
DAMPING_STEPS = (0.6, 0.8, 1.25, 1.6)
FINE_STEPS = (0.88, 0.92, 0.96, 1.04, 1.08, 1.12)
"""Further steps from the best damping: it determines the nominal flight, too."""


@dataclass(frozen=True)
class VehicleBounds:
    """Bounds of all signals that imply themselves.

    Args:
        slopes: Slopes k_1, k_2, k_3 of the lines in place of each channel's functions, and the share of omega_u.
        damping: Damping of drag in the plane and along z [1/s].
        bounds: Bounds of the signals; with a moving reference, of what they deviate from the nominal flight's.
        rotors: Bounds of the rotors.
        totals: Bounds of the vehicle's signals.
    """

    slopes: dict[str, Slopes]
    damping: tuple[float, float]
    bounds: Signals
    rotors: Rotors
    totals: Signals

    @property
    def error(self) -> float:
        """Bound of |e| along x and y [m]."""
        return self.totals["x"]["e"]

    @property
    def regions(self) -> dict[str, float]:
        """Bounds of |sigma|, by channel."""
        return {name: signals["sigma"] for name, signals in self.totals.items()}


@dataclass(frozen=True)
class LinearVehicle:
    """The linear channels of a vehicle and their responses: what the map F of bounds to bounds follows from.

    Args:
        problem: The vehicle.
        damping: Damping of drag in the plane and along z [1/s].
        slopes: Slopes of the straight lines in place of each channel's functions.
        responses: Responses of each channel.
        nominal: The nominal flight, from which the bounds count; None: the vehicle hovers.
    """

    problem: VehicleProblem
    damping: tuple[float, float]
    slopes: dict[str, Slopes]
    responses: dict[str, ChannelResponse]
    nominal: Nominal | None

    def deviations(self, totals: Signals) -> dict[str, ChannelDeviations]:
        """What the functions of every channel deviate by from straight lines under bounds of the vehicle's signals."""
        deviations = {}
        for name in CHANNELS:
            points = points_of(self.problem, name, totals[name]["sigma"])
            deviations[name] = deviations_of(points, self.slopes[name])
        return deviations


def linear_channels(problem: VehicleProblem, damping: tuple[float, float]) -> dict[str, LinearChannel]:
    """The linear channels by name, with the damping of drag in the plane and along z [1/s]."""
    return {
        "x": planar_channel(problem, damping[0]),
        "z": vertical_channel(problem, damping[1]),
        "psi": yaw_channel(problem),
    }


def input_sizes(
    response: ChannelResponse, deviations: ChannelDeviations, sigma: float, remainders: dict[str, float]
) -> np.ndarray:
    """Bounds of a channel's inputs omega_u, omega_q and remainders, (inputs,), for |sigma| up to a bound."""
    by_functions = [deviations.of_command(sigma), deviations.of_integral(sigma)]
    return np.array([*by_functions, *(remainders[key] for key in response.remainders)])


def with_slopes(
    problem: VehicleProblem, response: ChannelResponse, point_bounds: np.ndarray, slopes: dict[str, float]
) -> dict[str, float]:
    """Bounds at all times by signal, from those at the points of a sample, (points, signals), and the slopes."""
    largest = point_bounds.max(axis=0)
    eighth = problem.sample_time / 8.0
    return {key: float(largest[i]) + eighth * slopes[key] for i, key in enumerate(response.names)}


def bounds_at_points(
    problem: VehicleProblem, name: str, response: ChannelResponse, deviations: ChannelDeviations, sizes: np.ndarray
) -> np.ndarray:
    """Bounds of a channel's signals at the points of a sample, (points, signals).

    Args:
        problem: The vehicle.
        name: The channel.
        response: Responses of the channel.
        deviations: What its functions deviate by.
        sizes: Bounds of its inputs, (inputs,).
    """
    channel = problem.channels[name]
    axes = axes_of(name, response)
    bound = axes * (response.gains[..., :2] @ sizes[:2]) + response.gains[..., 2:] @ sizes[2:]
    bound = bound + problem.thrust_deviation * GRAVITY * response.constant + response.start_offset
    by_start = response.starts[..., :2] @ np.array(channel.initial)
    start_deviation = deviations.of_start(channel.start, problem.first_sigma(name), problem.sample_time)
    return bound + by_start + axes * start_deviation * response.starts[..., 2]


def apply_map(
    vehicle: LinearVehicle, deviations: dict[str, ChannelDeviations], y: Signals
) -> tuple[Signals, Signals, Rotors]:
    """The map F: the bounds that follow from bounds ``y`` of the signals, the remainders, and the rotors.

    Raises:
        OutOfRange: The vehicle may leave the range of the theorem.
    """
    problem = vehicle.problem
    totals, couplings = vehicle_totals(vehicle.nominal, y)
    remainders, rotors = remainders_of(problem, totals, vehicle.damping, couplings=couplings)
    slopes = signal_slopes(problem, y, remainders, vehicle.damping)
    implied: Signals = {}
    for name in CHANNELS:
        response = vehicle.responses[name]
        sizes = input_sizes(response, deviations[name], totals[name]["sigma"], remainders[name])
        point_bounds = bounds_at_points(problem, name, response, deviations[name], sizes)
        implied[name] = with_slopes(problem, response, point_bounds, slopes[name])
    return implied, remainders, rotors


def slides(
    problem: VehicleProblem, deviations: dict[str, ChannelDeviations], totals: Signals, remainders: Signals
) -> bool:
    """Whether the equivalent control of every channel stays within rho.

    Args:
        problem: The vehicle.
        deviations: What the functions of each channel deviate by.
        totals: Bounds of the vehicle's signals.
        remainders: Bounds of the remainders.
    """
    t = problem.sample_time
    for name, channel in problem.channels.items():
        steepest, integral, reach = deviations[name].steepest
        force = remainders[name].get("force", remainders[name].get("torque", 0.0))
        if name == "z":
            force += problem.thrust_deviation * GRAVITY
        integral_rate = integral * totals[name]["sigma"]
        level = max(totals[name]["u_av"] + deviations[name].distance[0], 0.5 * t * integral_rate)
        if level + t * reach * (steepest * (totals[name]["bend"] + force) + integral_rate) > channel.rho:
            return False
        if channel.start == "zero" and reach * (steepest + t * integral) * problem.first_sigma(name) > channel.rho:
            return False
    return True


def vehicle_bounds(
    problem: VehicleProblem, damping: tuple[float, float], room_factor: float, *, from_start: bool
) -> VehicleBounds | Obstacle:
    """Search bounds that imply themselves with a damping of drag.

    The slopes of the lines suit a region of |sigma|, and are chosen again where the bounds of |sigma| have moved.

    Args:
        problem: The vehicle.
        damping: Damping of drag in the plane and along z [1/s].
        room_factor: Factor of the room that is left for the verifier.
        from_start: Whether the bounds hold from the problem's start on; else the vehicle begins on the nominal flight.

    Returns:
        The bounds, or why there are none: ``GAIN`` or ``SLIDING``.
    """
    linear = linear_channels(problem, damping)
    nominal: Nominal | None = None
    y: Signals = {name: dict.fromkeys((*channel.signals, "u_av"), SMALLEST_BOUND) for name, channel in linear.items()}
    regions = {name: max(problem.first_sigma(name), FIRST_REGION) for name in CHANNELS}
    slopes: dict[str, Slopes] = {}
    responses: dict[str, ChannelResponse] = {}
    slope_regions: dict[str, float] = {}
    for _ in range(ROUNDS):
        outdated_names = [name for name in CHANNELS if has_moved(regions[name], slope_regions.get(name))]
        for name in outdated_names:
            slope_regions[name] = regions[name]
            slopes[name] = best_slopes(points_of(problem, name, regions[name]), joint=problem.reference is not None)
        if outdated_names:
            if not is_stable(problem, linear, slopes):
                return Obstacle.GAIN
            nominal = nominal_of(problem, linear, slopes, damping[0])
        for name in outdated_names:
            start_offsets = nominal.starts[name] if nominal is not None and from_start else None
            response = channel_response(problem, problem.channels[name], linear[name], slopes[name], start_offsets)
            if response is None:
                return Obstacle.GAIN
            responses[name] = response
        vehicle = LinearVehicle(problem, damping, dict(slopes), responses, nominal)
        outcome = fixed_point_from(vehicle, y, slope_regions, room_factor)
        if outcome is None:
            return Obstacle.GAIN
        bounds, is_fixed_point = outcome
        totals, _ = vehicle_totals(nominal, bounds)
        regions = {name: totals[name]["sigma"] for name in CHANNELS}
        if is_fixed_point and not any(has_moved(regions[name], slope_regions[name]) for name in CHANNELS):
            return checked_bounds(vehicle, bounds)
    return Obstacle.GAIN


def has_moved(region: float, slope_region: float | None) -> bool:
    """Whether a bound of |sigma| differs from the one for which the slopes were chosen; True if none were chosen."""
    return slope_region is None or abs(region - slope_region) > REGION_KEPT * slope_region


def vehicle_totals(nominal: Nominal | None, y: Signals) -> tuple[Signals, Couplings | None]:
    """Bounds of the vehicle's signals and of the couplings of its channels.

    Args:
        nominal: The nominal flight; None: the vehicle hovers, and has no couplings.
        y: Bounds of the vehicle's deviation from it.
    """
    if nominal is None:
        return y, None
    return nominal.totals(y), nominal.couplings(y)


def is_stable(problem: VehicleProblem, linear: dict[str, LinearChannel], slopes: dict[str, Slopes]) -> bool:
    """Whether all sampled channels are stable."""
    steps = [sampled_channel(problem, problem.channels[name], linear[name], slopes[name]) for name in CHANNELS]
    return all(spectral_radius(step.a) < 1.0 for step in steps)


def fixed_point_from(
    vehicle: LinearVehicle, start: Signals, regions: dict[str, float], room_factor: float
) -> tuple[Signals, bool] | None:
    """Apply the map F of :func:`apply_map` to small bounds, again and again, until they no longer grow.

    Args:
        vehicle: The linear channels and their responses.
        start: Bounds to begin with, of every signal of every channel.
        regions: Bound of |sigma| of each channel for which the slopes were chosen.
        room_factor: Factor of the room that is left for the verifier.

    Returns:
        The bounds, and whether they are a fixed point. They are none if they outgrew the regions; then the slopes must
        be chosen again. None if the bounds leave the range of the theorem, or still grow after the last application.
    """
    y = start
    for _ in range(ITERATIONS):
        totals, _ = vehicle_totals(vehicle.nominal, y)
        try:
            implied, _, _ = apply_map(vehicle, vehicle.deviations(totals), y)
        except OutOfRange:
            return None
        wider: Signals = {}
        for name in CHANNELS:
            wider[name] = {key: inflated_bound(key, value, room_factor) for key, value in implied[name].items()}
        growth = max(wider[name][key] / y[name][key] for name in CHANNELS for key in wider[name])
        y = {name: {key: max(value, y[name][key]) for key, value in wider[name].items()} for name in CHANNELS}
        if growth <= 1.0 + SETTLED:
            return y, True
        growing = y if vehicle.nominal is None else totals  # of a moving vehicle, one step later
        if any(growing[name]["sigma"] > LARGEST_GROWTH * regions[name] for name in CHANNELS):
            return y, False
    return None


def inflated_bound(signal: str, bound: float, room_factor: float) -> float:
    """A bound of a signal, widened for the verifier by ``room_factor`` times the usual room."""
    share = FAST_INFLATION if signal in FAST else INFLATION
    return max((1.0 + room_factor * share) * bound, SMALLEST_BOUND)


def checked_bounds(vehicle: LinearVehicle, y: Signals) -> VehicleBounds | Obstacle:
    """The fixed point ``y`` of F as a result; ``SLIDING`` if the equivalent control of a channel may exceed rho."""
    totals, _ = vehicle_totals(vehicle.nominal, y)
    deviations = vehicle.deviations(totals)
    _, remainders, rotors = apply_map(vehicle, deviations, y)
    if not slides(vehicle.problem, deviations, totals, remainders):
        return Obstacle.SLIDING
    return VehicleBounds(vehicle.slopes, vehicle.damping, y, rotors, totals)


def best_bounds(problem: VehicleProblem, room_factor: float, *, from_start: bool = True) -> VehicleBounds | Obstacle:
    """Search the bounds with the smallest |e| in the plane, over several dampings of drag there.

    Args:
        problem: The vehicle.
        room_factor: Factor of the room that is left for the verifier.
        from_start: Whether the bounds hold from the problem's start on; else the vehicle begins on the nominal flight.

    Returns:
        The bounds, or why there are none.
    """
    wind_h, wind_z = problem.wind
    k_h, k_z = (k / problem.mass[0] for k in problem.structure_drag)
    speed = math.hypot(wind_h, wind_z)
    if problem.reference is not None:
        speed = math.hypot(speed, max(size(derivative(reference_waves(problem)[axis])) for axis in ("x", "y")))
    first_damping = DAMPING_SHARE * k_h * speed
    vertical_damping = DAMPING_SHARE * k_z * speed

    def bounds_with(damping: float) -> VehicleBounds | Obstacle:
        return vehicle_bounds(problem, (damping, vertical_damping), room_factor, from_start=from_start)

    best = bounds_with(first_damping)
    for step in DAMPING_STEPS:
        best = with_smaller_error(best, bounds_with(step * first_damping))
    if problem.reference is not None and not isinstance(best, Obstacle):
        coarse_damping = best.damping[0]
        for step in FINE_STEPS:
            best = with_smaller_error(best, bounds_with(step * coarse_damping))
    return best


def with_smaller_error(best: VehicleBounds | Obstacle, trial: VehicleBounds | Obstacle) -> VehicleBounds | Obstacle:
    """Those of two outcomes that are bounds, with the smaller |e| in the plane; else the first."""
    if isinstance(trial, Obstacle):
        return best
    return trial if isinstance(best, Obstacle) or trial.error < best.error else best


def proof_of(problem: VehicleProblem, result: VehicleBounds) -> JsonObject:
    """The proof without time cells, as a certificate holds it."""
    channels = linear_channel_proofs(problem, result)
    for name in CHANNELS:
        channels[name]["bounds"] = result.bounds[name]
    return {"channels": channels, "cells": None, "settled": None}


def linear_channel_proofs(problem: VehicleProblem, result: VehicleBounds) -> JsonObject:
    """Slopes, damping of drag, lambda and P of each linear channel, as a certificate holds them."""
    linear = linear_channels(problem, result.damping)
    channels: JsonObject = {}
    for name, damping in zip(CHANNELS, (*result.damping, 0.0), strict=True):
        step = sampled_channel(problem, problem.channels[name], linear[name], result.slopes[name])
        decay, p = decay_of(step.a)
        rate = decay / problem.sample_time
        channels[name] = {
            "slopes": list(result.slopes[name][:3]), "share": result.slopes[name][3], "drag_damping": damping,
            "rate": rate, "p": p.tolist(),
        }  # fmt: skip
    return channels
