"""Bounds of all signals of a vehicle that imply themselves, searched in floating point as fixed points."""

import math
from dataclasses import dataclass

import numpy as np

from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.search.fixed_point import decay_of
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.vehicle.channels import (
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
from dssc_jax.proofs.search.vehicle.remainders import (
    GRAVITY,
    Couplings,
    OutOfRange,
    Rotors,
    Signals,
    remainders_of,
    slopes_of,
)
from dssc_jax.proofs.search.vehicle.responses import ONE_AXIS, ChannelResponse, channel_response
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
    """Bounds that imply themselves.

    Args:
        slopes: k_1, k_2, k_3 of each channel.
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
        """Bound of |e| along x and y."""
        return self.totals["x"]["e"]

    @property
    def regions(self) -> dict[str, float]:
        """Bounds of |sigma|."""
        return {name: signals["sigma"] for name, signals in self.totals.items()}


def all_deviations(problem: VehicleProblem, y: Signals, slopes: dict[str, Slopes]) -> dict[str, ChannelDeviations]:
    """The deviations of every channel under the bounds of its sigma."""
    return {name: deviations_of(points_of(problem, name, y[name]["sigma"]), slopes[name]) for name in CHANNELS}


def linear_channels(problem: VehicleProblem, damping: tuple[float, float]) -> dict[str, LinearChannel]:
    """The linear channels."""
    return {
        "x": planar_channel(problem, damping[0]),
        "z": vertical_channel(problem, damping[1]),
        "psi": yaw_channel(problem),
    }


def axes_of(name: str, response: ChannelResponse) -> np.ndarray:
    """2^(1/2) for norms of vectors in the plane, whose deviations are those of both axes; 1 for other signals."""
    in_plane = [name == "x" and key not in ONE_AXIS for key in response.names]
    return np.where(in_plane, math.sqrt(2.0), 1.0)


def input_sizes(
    response: ChannelResponse, deviations: ChannelDeviations, sigma: float, remainders: dict[str, float]
) -> np.ndarray:
    """Bounds of omega_u, omega_q and the remainders, (inputs,)."""
    by_functions = [deviations.of_command(sigma), deviations.of_integral(sigma)]
    return np.array([*by_functions, *(remainders[key] for key in response.remainders)])


def with_slopes(
    problem: VehicleProblem, response: ChannelResponse, point_bounds: np.ndarray, slopes: dict[str, float]
) -> dict[str, float]:
    """Bounds at all times, from those at the points of a sample, (points, signals), and the slopes between them."""
    largest = point_bounds.max(axis=0)
    eighth = problem.sample_time / 8.0
    return {key: float(largest[i]) + eighth * slopes[key] for i, key in enumerate(response.names)}


def bounds_at_points(
    problem: VehicleProblem, name: str, response: ChannelResponse, deviations: ChannelDeviations, sizes: np.ndarray
) -> np.ndarray:
    """F of one channel at the points of a sample, (points, signals), for inputs of these sizes."""
    channel = problem.channels[name]
    axes = axes_of(name, response)
    bound = axes * (response.gains[..., :2] @ sizes[:2]) + response.gains[..., 2:] @ sizes[2:]
    bound = bound + problem.thrust_deviation * GRAVITY * response.constant + response.known
    by_start = response.starts[..., :2] @ np.array(channel.initial)
    start_deviation = deviations.of_start(channel.start, problem.first_sigma(name), problem.sample_time)
    return bound + by_start + axes * start_deviation * response.starts[..., 2]


def apply_map(
    problem: VehicleProblem,
    responses: dict[str, ChannelResponse],
    deviations: dict[str, ChannelDeviations],
    y: Signals,
    damping: tuple[float, float],
    nominal: Nominal | None,
) -> tuple[Signals, Signals, Rotors]:
    """F(Y), the remainders, and the rotors.

    Raises:
        OutOfRange: the vehicle may leave the range of the theorem.
    """
    totals, couplings = vehicle_totals(nominal, y)
    remainders, rotors = remainders_of(problem, totals, damping, couplings=couplings)
    slopes = slopes_of(problem, y, remainders, damping)
    implied: Signals = {}
    for name in CHANNELS:
        response = responses[name]
        sizes = input_sizes(response, deviations[name], totals[name]["sigma"], remainders[name])
        point_bounds = bounds_at_points(problem, name, response, deviations[name], sizes)
        implied[name] = with_slopes(problem, response, point_bounds, slopes[name])
    return implied, remainders, rotors


def slides(problem: VehicleProblem, deviations: dict[str, ChannelDeviations], y: Signals, remainders: Signals) -> bool:
    """Whether the equivalent control of every channel stays within rho."""
    t = problem.sample_time
    for name, channel in problem.channels.items():
        steepest, integral, reach = deviations[name].steepest
        force = remainders[name].get("force", remainders[name].get("torque", 0.0))
        if name == "z":
            force += problem.thrust_deviation * GRAVITY
        integral_rate = integral * y[name]["sigma"]
        level = max(y[name]["u_av"] + deviations[name].distance[0], 0.5 * t * integral_rate)
        if level + t * reach * (steepest * (y[name]["bend"] + force) + integral_rate) > channel.rho:
            return False
        if channel.start == "zero" and reach * (steepest + t * integral) * problem.first_sigma(name) > channel.rho:
            return False
    return True


def vehicle_bounds(
    problem: VehicleProblem, damping: tuple[float, float], room: float, *, from_start: bool
) -> VehicleBounds | Obstacle:
    """Bounds that imply themselves with this damping of drag, or why there are none: ``GAIN`` or ``SLIDING``.

    ``room`` multiplies the room for the verifier. Unless ``from_start``, the vehicle begins on the nominal flight.
    """
    linear = linear_channels(problem, damping)
    nominal: Nominal | None = None
    y: Signals = {name: dict.fromkeys((*channel.signals, "u_av"), SMALLEST_BOUND) for name, channel in linear.items()}
    regions = {name: max(problem.first_sigma(name), FIRST_REGION) for name in CHANNELS}
    slopes: dict[str, Slopes] = {}
    responses: dict[str, ChannelResponse] = {}
    slope_regions: dict[str, float] = {}
    for _ in range(ROUNDS):
        outdated_names = [
            name
            for name, region in regions.items()
            if name not in slope_regions or has_moved(region, slope_regions[name])
        ]
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
        outcome = fixed_point_from(problem, responses, slopes, y, damping, nominal, slope_regions, room)
        if outcome is None:
            return Obstacle.GAIN
        bounds, is_fixed_point = outcome
        totals, _ = vehicle_totals(nominal, bounds)
        regions = {name: totals[name]["sigma"] for name in CHANNELS}
        if is_fixed_point and not any(has_moved(regions[name], slope_regions[name]) for name in CHANNELS):
            return checked_bounds(problem, responses, slopes, bounds, damping, nominal)
    return Obstacle.GAIN


def has_moved(region: float, slope_region: float) -> bool:
    """Whether a region differs from the one for which the slopes were chosen."""
    return abs(region - slope_region) > REGION_KEPT * slope_region


def vehicle_totals(nominal: Nominal | None, y: Signals) -> tuple[Signals, Couplings | None]:
    """Bounds of the vehicle's signals, and what couples its channels, from bounds of what it deviates by."""
    if nominal is None:
        return y, None
    return nominal.totals(y), nominal.couplings(y)


def is_stable(problem: VehicleProblem, linear: dict[str, LinearChannel], slopes: dict[str, Slopes]) -> bool:
    """Whether all sampled channels are stable."""
    steps = [sampled_channel(problem, problem.channels[name], linear[name], slopes[name]) for name in CHANNELS]
    return all(np.max(np.abs(np.linalg.eigvals(step.a))) < 1.0 for step in steps)


def fixed_point_from(
    problem: VehicleProblem,
    responses: dict[str, ChannelResponse],
    slopes: dict[str, Slopes],
    start: Signals,
    damping: tuple[float, float],
    nominal: Nominal | None,
    regions: dict[str, float],
    room: float,
) -> tuple[Signals, bool] | None:
    """Apply the map F of :func:`apply_map` to small bounds, again and again, until they no longer grow.

    Args:
        problem: The vehicle.
        responses: Responses of each channel.
        slopes: Slopes of each channel's functions.
        start: Bounds to begin with, of every signal of every channel.
        damping: Lowest and highest damping by drag.
        nominal: The nominal flight of a moving vehicle, from which the bounds count; None: it hovers.
        regions: The bound of sigma of each channel for which the slopes were chosen.
        room: Factor of the room that is left for the verifier.

    Returns:
        The bounds, and whether they are a fixed point. They are none if they outgrew the regions; then the slopes must
        be chosen again. None if the bounds leave the range of the theorem, or still grow after the last application.
    """
    y = start
    for _ in range(ITERATIONS):
        totals, _ = vehicle_totals(nominal, y)
        deviations = all_deviations(problem, totals, slopes)
        try:
            implied, _, _ = apply_map(problem, responses, deviations, y, damping, nominal)
        except OutOfRange:
            return None
        wider = {
            name: {key: inflated_bound(key, value, room) for key, value in implied[name].items()} for name in CHANNELS
        }
        growth = max(wider[name][key] / y[name][key] for name in CHANNELS for key in wider[name])
        y = {name: {key: max(value, y[name][key]) for key, value in wider[name].items()} for name in CHANNELS}
        if growth <= 1.0 + SETTLED:
            return y, True
        growing = y if nominal is None else totals  # of a moving vehicle, one step later
        if any(growing[name]["sigma"] > LARGEST_GROWTH * regions[name] for name in CHANNELS):
            return y, False
    return None


def inflated_bound(signal: str, bound: float, room: float) -> float:
    """A bound widened for the verifier by ``room`` times the usual room."""
    share = FAST_INFLATION if signal in FAST else INFLATION
    return max((1.0 + room * share) * bound, SMALLEST_BOUND)


def checked_bounds(
    problem: VehicleProblem,
    responses: dict[str, ChannelResponse],
    slopes: dict[str, Slopes],
    y: Signals,
    damping: tuple[float, float],
    nominal: Nominal | None,
) -> VehicleBounds | Obstacle:
    """The bounds ``y``, a fixed point of F, as a result.

    It is ``Obstacle.SLIDING`` instead if the equivalent control of a channel may exceed rho under them.
    """
    totals, _ = vehicle_totals(nominal, y)
    deviations = all_deviations(problem, totals, slopes)
    _, remainders, rotors = apply_map(problem, responses, deviations, y, damping, nominal)
    if not slides(problem, deviations, totals, remainders):
        return Obstacle.SLIDING
    return VehicleBounds(dict(slopes), damping, y, rotors, totals)


def best_bounds(problem: VehicleProblem, room: float = 1.0, *, from_start: bool = True) -> VehicleBounds | Obstacle:
    """The bounds with the damping of drag that gives the smallest |e| in the plane, or why there are none.

    ``room`` multiplies the room for the verifier. Unless ``from_start``, the vehicle begins on the nominal flight.
    """
    wind_h, wind_z = problem.wind
    k_h, k_z = (k / problem.mass[0] for k in problem.structure_drag)
    speed = math.hypot(wind_h, wind_z)
    if problem.reference is not None:
        speed = math.hypot(speed, max(size(derivative(reference_waves(problem)[axis])) for axis in ("x", "y")))
    damping = (DAMPING_SHARE * k_h * speed, DAMPING_SHARE * k_z * speed)
    best = vehicle_bounds(problem, damping, room, from_start=from_start)
    for step in DAMPING_STEPS:
        best = better(best, vehicle_bounds(problem, (step * damping[0], damping[1]), room, from_start=from_start))
    if problem.reference is not None and not isinstance(best, Obstacle):
        coarse = best.damping[0]
        for step in FINE_STEPS:
            best = better(best, vehicle_bounds(problem, (step * coarse, damping[1]), room, from_start=from_start))
    return best


def better(best: VehicleBounds | Obstacle, trial: VehicleBounds | Obstacle) -> VehicleBounds | Obstacle:
    """The bounds with the smaller |e| in the plane."""
    if isinstance(trial, Obstacle):
        return best
    return trial if isinstance(best, Obstacle) or trial.error < best.error else best


def proof_of(problem: VehicleProblem, result: VehicleBounds) -> JsonObject:
    """The proof as a certificate holds it."""
    channels = middle_of(problem, result)
    for name in CHANNELS:
        channels[name]["bounds"] = result.bounds[name]
    return {"channels": channels, "cells": None, "settled": None}


def middle_of(problem: VehicleProblem, result: VehicleBounds) -> JsonObject:
    """Slopes, damping of drag, lambda and P of each channel, as a certificate holds them."""
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
