"""Bounds Y of all signals of a vehicle that imply themselves, searched in floating point.

Y implies itself if F(Y) < Y: signals within Y stay within F(Y), and therefore never leave Y. The map F of
:mod:`dssc_jax.proofs.search.vehicle.bounds_map` is applied to small bounds again and again until they no longer grow.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.search.impulse_responses import decay_of
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.vehicle.attitude import OutOfRange, Signals
from dssc_jax.proofs.search.vehicle.bounds_map import (
    LinearVehicle,
    apply_map,
    is_stable,
    linear_channels,
    slides,
    vehicle_totals,
)
from dssc_jax.proofs.search.vehicle.channels import Damping, LinearChannel, StraightLines, sampled_channel
from dssc_jax.proofs.search.vehicle.deviations import best_lines, points_of
from dssc_jax.proofs.search.vehicle.nominal import nominal_of
from dssc_jax.proofs.search.vehicle.responses import channel_response
from dssc_jax.proofs.search.vehicle.rotors import Rotors
from dssc_jax.proofs.search.vehicle.waves import derivative, largest_magnitude, reference_waves
from dssc_jax.proofs.vehicle_problem import CHANNELS, VehicleProblem

INFLATION = 2e-3
"""Excess of a bound in Y over F(Y), as a share, since the verifier's balls and tails make its F(Y) larger."""
FAST = ("alpha_dot", "turn", "gamma", "behind")
"""Signals whose responses last a few samples only, so that sums over pieces of a sample are less exact."""
FAST_INFLATION = 1.5e-2
"""Excess of a bound in Y over F(Y) for the fast signals."""
SMALLEST_BOUND = 1e-12
"""Smallest bound of a signal, so that none of them is 0."""
FIRST_REGION = 1e-3
"""Smallest |sigma| for which straight lines are chosen at first."""
ROUNDS = 12
"""Largest number of times that the straight lines are chosen."""
ITERATIONS = 400
"""Largest number of times that the map F is applied for one choice of straight lines."""
SETTLED = 1e-5
"""Relative growth of the bounds below which they count as a fixed point."""
REGION_KEPT = 0.01
"""Relative change of |sigma|'s bound up to which the straight lines are kept."""
LARGEST_GROWTH = 2.0
"""Ratio of |sigma|'s bound to the bound for which the lines were chosen, above which lines are chosen anew."""
DAMPING_SHARE = 1.7
"""Ratio of the first damping by drag that is tried to k W/M."""
DAMPING_STEPS = (0.6, 0.8, 1.25, 1.6)
"""Further dampings that are tried, as ratios to the first one."""
FINE_STEPS = (0.88, 0.92, 0.96, 1.04, 1.08, 1.12)
"""Dampings that are tried for a moving reference too, as ratios to the best so far: they shape the nominal flight."""


@dataclass(frozen=True)
class VehicleBounds:
    """Bounds of all signals that imply themselves, with the linear channels for which they were found.

    Args:
        lines: The straight lines of each channel, which replace its controller's functions.
        damping: Damping by drag in the linear channels.
        bounds: Y, bounds of the signals; with a moving reference, of their deviation from the nominal flight.
        rotors: Bounds of the rotors.
        totals: Bounds of the vehicle's own signals; equal to ``bounds`` if the vehicle hovers.
    """

    lines: dict[str, StraightLines]
    damping: Damping
    bounds: Signals
    rotors: Rotors
    totals: Signals

    @property
    def error(self) -> float:
        """Bound of |e| along x and along y [m], by which outcomes are compared."""
        return self.totals["x"]["e"]

    @property
    def regions(self) -> dict[str, float]:
        """Bounds of the vehicle's |sigma|, by channel."""
        return {name: signals["sigma"] for name, signals in self.totals.items()}


def vehicle_bounds(
    problem: VehicleProblem, damping: Damping, inflation_factor: float, *, from_start: bool
) -> VehicleBounds | Obstacle:
    """Search for bounds that imply themselves, with a given damping by drag in the linear channels.

    The straight lines are chosen for a region of |sigma|. They are chosen again if the bounds found for |sigma| differ
    from this region.

    Args:
        problem: The vehicle.
        damping: Damping by drag.
        inflation_factor: Multiple of the usual widening of bounds, which lets the verifier confirm them.
        from_start: Whether a moving reference's start, off the nominal flight, is included. Otherwise the vehicle
            begins on the nominal flight, apart from the problem's E_0 and V_0.

    Returns:
        The bounds, or why there are none: ``GAIN`` or ``SLIDING``.
    """
    linear = linear_channels(problem, damping)
    first_bounds: Signals = {
        name: dict.fromkeys((*channel.signals, "u_av"), SMALLEST_BOUND) for name, channel in linear.items()
    }
    vehicle = LinearVehicle(problem, damping, lines={}, responses={}, nominal=None)
    regions = {name: max(problem.first_sigma(name), FIRST_REGION) for name in CHANNELS}
    fitted_regions: dict[str, float] = {}  # those for which the straight lines were chosen
    for _ in range(ROUNDS):
        moved_regions = {name: regions[name] for name in CHANNELS if has_moved(regions[name], fitted_regions.get(name))}
        if moved_regions:
            refitted = with_new_lines(vehicle, linear, moved_regions, from_start=from_start)
            if refitted is None:
                return Obstacle.GAIN
            vehicle = refitted
            fitted_regions |= moved_regions
        outcome = fixed_point_from(vehicle, first_bounds, fitted_regions, inflation_factor)
        if outcome is None:
            return Obstacle.GAIN
        totals, _ = vehicle_totals(vehicle.nominal, outcome.bounds)
        regions = {name: totals[name]["sigma"] for name in CHANNELS}
        if outcome.is_fixed_point and not any(has_moved(regions[name], fitted_regions[name]) for name in CHANNELS):
            return checked_bounds(vehicle, outcome.bounds)
    return Obstacle.GAIN


def with_new_lines(
    vehicle: LinearVehicle, linear: dict[str, LinearChannel], regions: dict[str, float], *, from_start: bool
) -> LinearVehicle | None:
    """Choose the straight lines of some channels anew, and compute their responses and the nominal flight with them.

    Args:
        vehicle: The vehicle with its lines so far; those of other channels are kept.
        linear: The linear channels.
        regions: Bound of |sigma| of each channel whose lines are chosen.
        from_start: Whether the responses include that to the start's difference from the nominal flight.

    Returns:
        The vehicle with the new lines; None if a channel is not stable, or its responses last too long.
    """
    problem = vehicle.problem
    lines = dict(vehicle.lines)
    for name, region in regions.items():
        lines[name] = best_lines(points_of(problem, name, region), joint=problem.reference is not None)
    if not is_stable(problem, linear, lines):
        return None
    nominal = nominal_of(problem, linear, lines, vehicle.damping.plane)
    responses = dict(vehicle.responses)
    for name in regions:
        start_offsets = nominal.starts[name] if nominal is not None and from_start else None
        response = channel_response(problem, problem.channels[name], linear[name], lines[name], start_offsets)
        if response is None:
            return None
        responses[name] = response
    return replace(vehicle, lines=lines, responses=responses, nominal=nominal)


def has_moved(region: float, fitted_region: float | None) -> bool:
    """Whether a bound of |sigma| differs from that for which the lines were chosen; True if no lines were chosen."""
    return fitted_region is None or abs(region - fitted_region) > REGION_KEPT * fitted_region


class GrownBounds(NamedTuple):
    """Bounds after the last application of the map F.

    Args:
        bounds: Y, bounds of the signals.
        is_fixed_point: Whether the bounds no longer grow; else |sigma| outgrew its region, which needs new lines.
    """

    bounds: Signals
    is_fixed_point: bool


def fixed_point_from(
    vehicle: LinearVehicle, start: Signals, regions: dict[str, float], inflation_factor: float
) -> GrownBounds | None:
    """Apply the map F again and again, from small bounds on, until the bounds no longer grow.

    Args:
        vehicle: The linear channels and their responses.
        start: Bounds to begin with, of every signal of every channel.
        regions: For each channel, the bound of |sigma| for which the lines were chosen.
        inflation_factor: Multiple of the usual widening of bounds, which lets the verifier confirm them.

    Returns:
        The bounds; None if they leave the range of the theorem, or still grow after ``ITERATIONS`` steps.
    """
    y = start
    for _ in range(ITERATIONS):
        totals, _ = vehicle_totals(vehicle.nominal, y)
        try:
            implied = apply_map(vehicle, vehicle.deviations(totals), y).bounds
        except OutOfRange:
            return None
        wider: Signals = {}
        for name in CHANNELS:
            wider[name] = {key: inflated_bound(key, value, inflation_factor) for key, value in implied[name].items()}
        growth = largest_growth(y, wider)
        y = larger_bounds(y, wider)
        if growth <= 1.0 + SETTLED:
            return GrownBounds(y, is_fixed_point=True)
        # in hover the bounds after this step are compared, with a nominal flight the totals before this step
        growing = y if vehicle.nominal is None else totals
        if any(growing[name]["sigma"] > LARGEST_GROWTH * regions[name] for name in CHANNELS):
            return GrownBounds(y, is_fixed_point=False)
    return None


def largest_growth(before: Signals, after: Signals) -> float:
    """Compute the largest ratio, over all signals, of the bound after a step to the bound before it."""
    ratios = []
    for name in CHANNELS:
        ratios += [bound / before[name][key] for key, bound in after[name].items()]
    return max(ratios)


def larger_bounds(first: Signals, second: Signals) -> Signals:
    """Return the larger one of two bounds of each signal, by channel and name."""
    larger: Signals = {}
    for name in CHANNELS:
        larger[name] = {key: max(bound, first[name][key]) for key, bound in second[name].items()}
    return larger


def inflated_bound(signal: str, bound: float, inflation_factor: float) -> float:
    """Widen the bound of a signal, since the verifier's balls and tails make the bound that it finds larger.

    Args:
        signal: Name of the signal; bounds of the signals in :data:`FAST` are widened more.
        bound: The bound.
        inflation_factor: Multiple of the usual widening.
    """
    share = FAST_INFLATION if signal in FAST else INFLATION
    return max((1.0 + inflation_factor * share) * bound, SMALLEST_BOUND)


def checked_bounds(vehicle: LinearVehicle, y: Signals) -> VehicleBounds | Obstacle:
    """Check that all channels keep sliding while the signals are within bounds that imply themselves.

    Args:
        vehicle: The linear channels and their responses.
        y: The bounds Y, of the deviation from the nominal flight if there is one.

    Returns:
        The bounds, with the bounds of the rotors and of the vehicle's own signals; ``SLIDING`` if the equivalent
        control of a channel may exceed rho.
    """
    totals, _ = vehicle_totals(vehicle.nominal, y)  # bounds of the vehicle's signals, N + Y
    deviations = vehicle.deviations(totals)
    implied = apply_map(vehicle, deviations, y)
    if not slides(vehicle.problem, deviations, totals, implied.remainders):
        return Obstacle.SLIDING
    return VehicleBounds(lines=vehicle.lines, damping=vehicle.damping, bounds=y, rotors=implied.rotors, totals=totals)


def first_damping(problem: VehicleProblem) -> Damping:
    """Return the damping by drag that is tried first: ``DAMPING_SHARE`` times k W/M, where W is the wind's speed.

    k W/M is about the slope of the drag over the velocity. The speed of a moving reference is combined with W.
    """
    drag_h, drag_z = problem.structure_drag
    lightest = problem.mass[0]
    air_speed = math.hypot(*problem.wind)
    if problem.reference is not None:
        waves = reference_waves(problem)
        reference_speed = max(largest_magnitude(derivative(waves[axis])) for axis in ("x", "y"))
        air_speed = math.hypot(air_speed, reference_speed)
    k_h = drag_h / lightest
    k_z = drag_z / lightest
    return Damping(plane=DAMPING_SHARE * k_h * air_speed, vertical=DAMPING_SHARE * k_z * air_speed)


def best_bounds(
    problem: VehicleProblem, inflation_factor: float, *, from_start: bool = True
) -> VehicleBounds | Obstacle:
    """Search for bounds with several dampings by drag, and keep those with the smallest horizontal error.

    Args:
        problem: The vehicle.
        inflation_factor: Multiple of the usual widening of bounds, which lets the verifier confirm them.
        from_start: As in :func:`vehicle_bounds`.

    Returns:
        The bounds, or why there are none.
    """
    damping = first_damping(problem)

    def bounds_with(plane_damping: float) -> VehicleBounds | Obstacle:
        """Search for bounds that imply themselves, with a damping by horizontal drag [1/s]."""
        return vehicle_bounds(problem, damping._replace(plane=plane_damping), inflation_factor, from_start=from_start)

    best = bounds_with(damping.plane)
    for step in DAMPING_STEPS:
        best = with_smaller_error(best, bounds_with(step * damping.plane))
    if problem.reference is not None and not isinstance(best, Obstacle):
        coarse_damping = best.damping.plane
        for step in FINE_STEPS:
            best = with_smaller_error(best, bounds_with(step * coarse_damping))
    return best


def with_smaller_error(best: VehicleBounds | Obstacle, trial: VehicleBounds | Obstacle) -> VehicleBounds | Obstacle:
    """Return the better outcome: bounds are better than an obstacle, and a smaller horizontal error is better."""
    if isinstance(trial, Obstacle):
        return best
    if isinstance(best, Obstacle):
        return trial
    return trial if trial.error < best.error else best


def proof_of(problem: VehicleProblem, result: VehicleBounds) -> JsonObject:
    """Make a certificate's proof without time cells from bounds that hold at all times."""
    channels = linear_channel_proofs(problem, result)
    for name in CHANNELS:
        channels[name]["bounds"] = result.bounds[name]
    return {"channels": channels, "cells": None, "settled": None}  # the upper limits use the same channels


def linear_channel_proofs(problem: VehicleProblem, result: VehicleBounds) -> JsonObject:
    """Make the linear channels of a certificate's proof: slopes, share, damping, lambda and P of each, by name."""
    linear = linear_channels(problem, result.damping)
    dampings = {"x": result.damping.plane, "z": result.damping.vertical, "psi": 0.0}
    channels: JsonObject = {}
    for name in CHANNELS:
        step = sampled_channel(problem, problem.channels[name], linear[name], result.lines[name])
        lines = result.lines[name]
        lost_share, p = decay_of(step.a)  # of V = z'Pz in a sample
        channels[name] = {
            "slopes": [lines.k_1, lines.k_2, lines.k_3],
            "share": lines.share,
            "drag_damping": dampings[name],
            "rate": lost_share / problem.sample_time,
            "p": p.tolist(),
        }
    return channels
