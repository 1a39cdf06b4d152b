"""Bounds of all signals of a vehicle that imply themselves, searched in floating point as fixed points."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.problem import ProofProblem
from dssc_jax.proofs.search.fixed_point import decay_of
from dssc_jax.proofs.search.gains import GainPoints, gain_points
from dssc_jax.proofs.search.vehicle.channels import (
    ONE_AXIS,
    ChannelResponse,
    Linear,
    channel_response,
    planar_channel,
    sampled,
    vertical_channel,
    yaw_channel,
)
from dssc_jax.proofs.search.vehicle.remainders import (
    GRAVITY,
    OutOfRange,
    Rotors,
    Signals,
    remainders_of,
    slopes_of,
)
from dssc_jax.proofs.vehicle_problem import CHANNELS, ChannelProblem, VehicleProblem

INFLATION = 2e-3
"""By how much a bound in Y is larger than F(Y), as a share, for what the verifier's balls and tails add."""
FAST = ("alpha_dot", "turn", "gamma", "behind")
"""Signals whose responses last a few samples only, so that sums over pieces of a sample are less exact."""
FAST_INFLATION = 1.5e-2
SMALLEST_BOUND = 1e-12
DISTANCE_ROOM = 1.01
"""Widening of a distance, for the verifier's enclosure."""
RATIO_ROOM = 1.001
"""Widening of a distance over |sigma|, likewise."""
SMALLEST_REGION = 1e-9
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


Slopes = tuple[float, float, float]
"""k_1, k_2 and k_3 of the straight lines in place of a channel's functions."""


@dataclass(frozen=True)
class ChannelDeviations:
    """What the functions deviate by from straight lines: largest distances, and their ratios to |sigma|.

    Args:
        slopes: k_1, k_2 and k_3.
        distance: Of phi_1, phi_2 and phi_1 + phi_3.
        ratio: The same over |sigma|.
        steepest: Largest K_P and K_I, and 1 + tau_av/T_s.
    """

    slopes: Slopes
    distance: tuple[float, float, float]
    ratio: tuple[float, float, float]
    steepest: tuple[float, float, float]

    def of_command(self, sigma: float) -> float:
        """Bound of |omega_u| for |sigma| up to a bound."""
        return min(self.distance[2], self.ratio[2] * sigma)

    def of_integral(self, sigma: float) -> float:
        """Bound of |omega_q|."""
        return min(self.distance[1], self.ratio[1] * sigma)

    def of_start(self, channel: ChannelProblem, sample_time: float) -> float:
        """Bound of what q_(-1) deviates by."""
        if channel.start == "zero":
            return 0.0
        first = channel.first_sigma
        deviation = min(self.distance[0], self.ratio[0] * first)
        if channel.start == "midpoint":
            deviation += 0.5 * sample_time * self.of_integral(first)
        return deviation


@dataclass(frozen=True)
class VehicleBounds:
    """Bounds that imply themselves.

    Args:
        slopes: k_1, k_2, k_3 of each channel.
        damping: Damping of drag in the plane and along z [1/s].
        bounds: Bounds of the signals.
        rotors: Bounds of the rotors.
    """

    slopes: dict[str, Slopes]
    damping: tuple[float, float]
    bounds: Signals
    rotors: Rotors


@dataclass(frozen=True)
class LinearVehicle:
    """The vehicle with straight lines in place of the functions, and without remainders.

    Args:
        problem: The vehicle.
        damping: Damping of drag in the plane and along z [1/s].
        slopes: k_1, k_2, k_3 of each channel.
        responses: What inputs of size 1 cause in each channel.
    """

    problem: VehicleProblem
    damping: tuple[float, float]
    slopes: dict[str, Slopes]
    responses: dict[str, ChannelResponse]

    def deviations(self, y: Signals) -> dict[str, ChannelDeviations]:
        """What the functions of every channel deviate by under the bounds of its sigma."""
        found = {}
        for name in CHANNELS:
            points = points_of(self.problem, name, y[name]["sigma"])
            found[name] = deviations_of(points, self.slopes[name])
        return found


def law_problem(problem: VehicleProblem, channel: ChannelProblem) -> ProofProblem:
    """One channel's controller in the form in which its functions are evaluated."""
    return ProofProblem(
        sample_time=problem.sample_time, l0=channel.l0, form="conservative", functions=channel.functions,
        rho=channel.rho, nominal=channel.nominal, k_p=(1.0, 1.0), a_p=(0.0, 0.0), zero_a=(), zero_c=(), numerator=(),
        denominator=(), mu=(0.0, 0.0), delay=0.0, sensor_lag=0.0, level=0.0, slope=0.0, reference=(0.0, 0.0, 0.0),
        initial=((0.0, 0.0), (0.0, 0.0)), start=channel.start,
    )  # fmt: skip


def points_of(problem: VehicleProblem, name: str, sigma: float) -> GainPoints:
    """The functions of a channel at points of a region."""
    return gain_points(law_problem(problem, problem.channels[name]), max(sigma, SMALLEST_REGION), 0.0)


def best_slopes(points: GainPoints) -> Slopes:
    """The slopes of the straight lines that are nearest to phi_1 + phi_3, shared between both, and to phi_2."""
    size = np.abs(points.sigma)
    columns = points.columns
    combined = nearest_slope(size, columns["mean"] + columns["k_n"])
    pole = float(np.mean(columns["k_n"]))
    return combined - pole, nearest_slope(size, columns["k_i"]), pole


def nearest_slope(size: np.ndarray, ratio: np.ndarray) -> float:
    """The slope whose line through 0 is nearest to ratio sigma: the distance is convex in it."""
    low, high = float(ratio.min()), float(ratio.max())
    if not low < high:
        return low
    found = minimize_scalar(lambda slope: distance_of(size, ratio, slope), bounds=(low, high))
    return float(found.x)


def distance_of(size: np.ndarray, ratio: np.ndarray, slope: float) -> float:
    """The largest |ratio - slope| |sigma|."""
    return DISTANCE_ROOM * float(np.max(np.abs(ratio - slope) * size))


def deviations_of(points: GainPoints, slopes: Slopes) -> ChannelDeviations:
    """What the functions deviate by from straight lines with these slopes."""
    size = np.abs(points.sigma)
    columns = points.columns
    ratios = (columns["mean"], columns["k_i"], columns["mean"] + columns["k_n"])
    straight = (slopes[0], slopes[1], slopes[0] + slopes[2])
    first, second, combined = (distance_of(size, ratio, slope) for ratio, slope in zip(ratios, straight, strict=True))
    share_1, share_2, share_b = (
        RATIO_ROOM * float(np.max(np.abs(ratio - slope))) for ratio, slope in zip(ratios, straight, strict=True)
    )
    steepest = float(np.max(columns["k_p"]))
    reach = float(np.max(columns["slide_p"])) / steepest
    return ChannelDeviations(
        slopes, (first, second, combined), (share_1, share_2, share_b), (steepest, float(np.max(columns["k_i"])), reach)
    )


def linear_channels(problem: VehicleProblem, damping: tuple[float, float]) -> dict[str, Linear]:
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
    problem: VehicleProblem, response: ChannelResponse, seen: np.ndarray, slopes: dict[str, float]
) -> dict[str, float]:
    """Bounds at all times, from those at the points of a sample, (points, signals), and the slopes between them."""
    largest = seen.max(axis=0)
    eighth = problem.sample_time / 8.0
    return {key: float(largest[i]) + eighth * slopes[key] for i, key in enumerate(response.names)}


def seen_bounds(
    problem: VehicleProblem, name: str, response: ChannelResponse, deviations: ChannelDeviations, sizes: np.ndarray
) -> np.ndarray:
    """F of one channel at the points of a sample, (points, signals), for inputs of these sizes."""
    channel = problem.channels[name]
    axes = axes_of(name, response)
    bound = axes * (response.gains[..., :2] @ sizes[:2]) + response.gains[..., 2:] @ sizes[2:]
    bound = bound + problem.thrust_deviation * GRAVITY * response.constant
    by_start = response.starts[..., :2] @ np.array(channel.initial)
    return bound + by_start + axes * deviations.of_start(channel, problem.sample_time) * response.starts[..., 2]


def applied(
    vehicle: LinearVehicle, deviations: dict[str, ChannelDeviations], y: Signals
) -> tuple[Signals, Signals, Rotors]:
    """F(Y), the remainders, and the rotors.

    Raises:
        OutOfRange: the vehicle may leave the range of the theorem.
    """
    problem = vehicle.problem
    remainders, rotors = remainders_of(problem, y, vehicle.damping)
    slopes = slopes_of(problem, y, remainders, vehicle.damping)
    reached: Signals = {}
    for name in CHANNELS:
        response = vehicle.responses[name]
        sizes = input_sizes(response, deviations[name], y[name]["sigma"], remainders[name])
        seen = seen_bounds(problem, name, response, deviations[name], sizes)
        reached[name] = with_slopes(problem, response, seen, slopes[name])
    return reached, remainders, rotors


def slides(problem: VehicleProblem, deviations: dict[str, ChannelDeviations], y: Signals, remainders: Signals) -> bool:
    """Whether the equivalent control of every channel stays within rho."""
    t = problem.sample_time
    for name, channel in problem.channels.items():
        steepest, integral, reach = deviations[name].steepest
        pushed = remainders[name].get("force", remainders[name].get("torque", 0.0))
        if name == "z":
            pushed += problem.thrust_deviation * GRAVITY
        second = integral * y[name]["sigma"]
        level = max(y[name]["u_av"] + deviations[name].distance[0], 0.5 * t * second)
        if level + t * reach * (steepest * (y[name]["bend"] + pushed) + second) > channel.rho:
            return False
        if channel.start == "zero" and reach * (steepest + t * integral) * channel.first_sigma > channel.rho:
            return False
    return True


def vehicle_bounds(problem: VehicleProblem, damping: tuple[float, float], room: float) -> VehicleBounds | str:
    """Bounds that imply themselves with this damping of drag, or why there are none: ``gain`` or ``sliding``.

    ``room`` multiplies the room for the verifier.
    """
    linear = linear_channels(problem, damping)
    y: Signals = {name: dict.fromkeys((*channel.signals, "u_av"), SMALLEST_BOUND) for name, channel in linear.items()}
    regions = {name: max(channel.first_sigma, FIRST_REGION) for name, channel in problem.channels.items()}
    vehicle = LinearVehicle(problem, damping, {}, {})
    chosen: dict[str, float] = {}
    for _ in range(ROUNDS):
        for name, region in regions.items():
            if name in chosen and abs(region - chosen[name]) <= REGION_KEPT * chosen[name]:
                continue
            chosen[name] = region
            vehicle.slopes[name] = best_slopes(points_of(problem, name, region))
            response = channel_response(problem, problem.channels[name], linear[name], vehicle.slopes[name])
            if response is None:
                return "gain"
            vehicle.responses[name] = response
        found = grown(vehicle, y, chosen, room)
        if found is None:
            return "gain"
        reached, closed = found
        regions = {name: reached[name]["sigma"] for name in CHANNELS}
        kept = all(abs(regions[name] - chosen[name]) <= REGION_KEPT * chosen[name] for name in CHANNELS)
        if closed and kept:
            return accepted(vehicle, reached)
    return "gain"


def grown(
    vehicle: LinearVehicle, start: Signals, regions: dict[str, float], room: float
) -> tuple[Signals, bool] | None:
    """The bounds after F is applied from small ones on, and whether they have become a fixed point.

    They are left where they outgrow the regions for which the slopes were chosen; None if they leave the range of the
    theorem.
    """
    y = start
    for _ in range(ITERATIONS):
        try:
            reached, _, _ = applied(vehicle, vehicle.deviations(y), y)
        except OutOfRange:
            return None
        wider = {name: {key: inflated(key, value, room) for key, value in reached[name].items()} for name in CHANNELS}
        growth = max(wider[name][key] / y[name][key] for name in CHANNELS for key in wider[name])
        y = {name: {key: max(value, y[name][key]) for key, value in wider[name].items()} for name in CHANNELS}
        if growth <= 1.0 + SETTLED:
            return y, True
        if any(y[name]["sigma"] > LARGEST_GROWTH * regions[name] for name in CHANNELS):
            return y, False
    return None


def inflated(signal: str, bound: float, room: float) -> float:
    """A bound with so many times the usual room for the verifier."""
    share = FAST_INFLATION if signal in FAST else INFLATION
    return max((1.0 + room * share) * bound, SMALLEST_BOUND)


def accepted(vehicle: LinearVehicle, y: Signals) -> VehicleBounds | str:
    """The fixed point as a result, if the loop slides under it."""
    deviations = vehicle.deviations(y)
    _, remainders, rotors = applied(vehicle, deviations, y)
    if not slides(vehicle.problem, deviations, y, remainders):
        return "sliding"
    return VehicleBounds(dict(vehicle.slopes), vehicle.damping, y, rotors)


def best_bounds(problem: VehicleProblem, room: float = 1.0) -> VehicleBounds | str:
    """The bounds with the damping of drag that gives the smallest |e| in the plane, or why there are none.

    ``room`` multiplies the room for the verifier.
    """
    wind_h, wind_z = problem.wind
    k_h, k_z = (k / problem.mass[0] for k in problem.structure_drag)
    speed = math.hypot(wind_h, wind_z)
    damping = (DAMPING_SHARE * k_h * speed, DAMPING_SHARE * k_z * speed)
    best = vehicle_bounds(problem, damping, room)
    for step in DAMPING_STEPS:
        trial = vehicle_bounds(problem, (step * damping[0], damping[1]), room)
        if isinstance(trial, str):
            continue
        if isinstance(best, str) or trial.bounds["x"]["e"] < best.bounds["x"]["e"]:
            best = trial
    return best


def proof_of(problem: VehicleProblem, found: VehicleBounds) -> JsonObject:
    """The proof as a certificate holds it."""
    channels = middle_of(problem, found)
    for name in CHANNELS:
        channels[name]["bounds"] = found.bounds[name]
    return {"channels": channels, "cells": None, "settled": None}


def middle_of(problem: VehicleProblem, found: VehicleBounds) -> JsonObject:
    """Slopes, damping of drag, lambda and P of each channel, as a certificate holds them."""
    linear = linear_channels(problem, found.damping)
    channels: JsonObject = {}
    for name, damping in zip(CHANNELS, (*found.damping, 0.0), strict=True):
        step = sampled(problem, problem.channels[name], linear[name], found.slopes[name])
        falls, p = decay_of(step.a)
        rate = falls / problem.sample_time
        channels[name] = {
            "slopes": list(found.slopes[name]), "drag_damping": damping, "rate": rate, "p": p.tolist(),
        }  # fmt: skip
    return channels
