"""The map F from bounds Y of all signals to the bounds that follow from Y, and F_s, the same map for upper limits.

Bounds with Y > F(Y) imply themselves, and therefore hold. (V1) to (V5) are the theorem's conditions in
docs/vehicle_proofs.md.
"""

from collections.abc import Mapping
from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, maximum, require_premise, total
from dssc_jax.proofs.verifier.vehicle.certificate import CHANNELS, MiddleProof, VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import ALONG_AXES, EQUIVALENT, SignalBalls
from dssc_jax.proofs.verifier.vehicle.deviations import Deviations, deviations_of, float_above
from dssc_jax.proofs.verifier.vehicle.flight import (
    Flight,
    body_bounds,
    coupling_under,
    flight_of,
    initial_yaw_rate,
    total_bounds,
)
from dssc_jax.proofs.verifier.vehicle.ranges import Ranges, ranges_of
from dssc_jax.proofs.verifier.vehicle.remainders import Remainders, remainders_of
from dssc_jax.proofs.verifier.vehicle.responses import (
    PHASES,
    ChannelObservation,
    SignalResponse,
    channel_responses,
    observe_channel,
)
from dssc_jax.proofs.verifier.vehicle.slopes import signal_slopes

Responses = Mapping[str, Mapping[str, list[SignalResponse]]]
"""Responses of the signals, by channel and name, one for each phase of a sample."""
REACH = 2 * len(PHASES)
"""T_s over the largest distance of a time within a sample from the nearest phase: 8, since phases are T_s/4 apart."""


class Vehicle(NamedTuple):
    """The linear channels of a vehicle and their responses, which the map F needs besides the bounds.

    Args:
        problem: The certificate's problem.
        middles: Slopes, share, damping, lambda and P of each linear channel.
        ranges: Extremes over the problem's intervals.
        dampings: c, the damping by drag in each linear channel [1/s]; 0 in psi.
        observations: The channels at their samples.
        responses: Responses of the signals, by channel and name, one for each phase.
        flight: The nominal flight; None: the vehicle hovers.
    """

    problem: VehicleProblem
    middles: Mapping[str, MiddleProof]
    ranges: Ranges
    dampings: Mapping[str, float]
    observations: Mapping[str, ChannelObservation]
    responses: Responses
    flight: Flight | None


class Inputs(NamedTuple):
    """Bounds of the inputs of the linear channels, which follow from bounds of the signals.

    Args:
        remainders: Bounds of the remainders.
        deviations: Bounds of the functions' deviations from straight lines, by channel.
        sigma: Bounds of the vehicle's own |sigma| [m/s; rad/s in psi], by channel.
    """

    remainders: Remainders
    deviations: Mapping[str, Deviations]
    sigma: Mapping[str, arb]


def vehicle_of(problem: VehicleProblem, middles: Mapping[str, MiddleProof]) -> Vehicle:
    """(V1) The linear channels of a proof, their responses, and the nominal flight.

    Args:
        problem: The certificate's problem.
        middles: Slopes, share, damping, lambda and P of each channel.

    Raises:
        Rejected: A channel is not shown to be stable, or its responses decay too slowly.
    """
    observations = {name: observe_channel(problem, name, middles[name]) for name in CHANNELS}
    return Vehicle(
        problem=problem,
        middles=middles,
        ranges=ranges_of(problem),
        dampings={name: middles[name]["drag_damping"] for name in CHANNELS},
        observations=observations,
        responses={name: channel_responses(problem, name, observations[name]) for name in CHANNELS},
        flight=flight_of(problem, {name: observations[name].flight for name in CHANNELS}),
    )


def sigmas_under(vehicle: Vehicle, bounds: SignalBalls) -> dict[str, arb]:
    """Bounds of the vehicle's own |sigma| [m/s; rad/s in psi], by channel.

    Args:
        vehicle: The linear channels, with the nominal flight.
        bounds: Bounds Y of the signals, or of their deviation from the nominal flight.
    """
    totals = total_bounds(vehicle.flight, bounds)
    return {name: totals[name]["sigma"] for name in CHANNELS}


def deviations_under(vehicle: Vehicle, bounds: SignalBalls) -> dict[str, Deviations]:
    """(V2) Bounds of the deviations of phi_1, phi_2 and phi_3 from straight lines, by channel.

    Args:
        vehicle: The linear channels, with the slopes of the lines.
        bounds: Bounds Y of the signals, or of their deviation from the nominal flight.
    """
    # the largest |sigma| of each channel, rounded upwards: the region in which the functions are enclosed
    regions = {name: float_above(sigma) for name, sigma in sigmas_under(vehicle, bounds).items()}
    return {name: deviations_of(vehicle.problem, name, vehicle.middles[name], regions[name]) for name in CHANNELS}


def inputs_under(
    vehicle: Vehicle, bounds: SignalBalls, deviations: Mapping[str, Deviations], earlier: Inputs | None = None
) -> Inputs:
    """(V3) Bounds of the inputs of the linear channels, while the signals stay within bounds Y.

    Args:
        vehicle: The linear channels and their responses.
        bounds: Y, bounds of the signals or of their deviation from the nominal flight.
        deviations: Bounds of the functions' deviations from straight lines, by channel.
        earlier: Bounds of the inputs in the time cell before; None in the first one.

    Raises:
        Rejected: The vehicle may leave the range of the theorem.
    """
    earlier_remainders = None if earlier is None else earlier.remainders
    totals = body_bounds(vehicle.flight, bounds)
    coupling = coupling_under(vehicle.flight, bounds)
    remainders = remainders_of(vehicle.problem, vehicle.ranges, totals, vehicle.dampings, earlier_remainders, coupling)
    return Inputs(remainders, deviations, sigmas_under(vehicle, bounds))


def implied_bounds(vehicle: Vehicle, bounds: SignalBalls, inputs: Inputs, *, from_start: bool) -> dict[str, Balls]:
    """F(Y), the bounds that follow from bounds Y of the signals, by channel and signal; or F_s(Y) for upper limits.

    Args:
        vehicle: The linear channels and their responses.
        bounds: Y, bounds of the signals, or of their deviation from the nominal flight.
        inputs: Bounds of the inputs while the signals are within Y.
        from_start: Whether to return F, which holds from the start on; otherwise F_s, which leaves the start out.

    Raises:
        Rejected: A bound is not finite.
    """
    t = arb(vehicle.problem["sample_time"])
    implied = {}
    for name in CHANNELS:
        slopes = signal_slopes(vehicle.problem, name, vehicle.dampings[name], bounds, inputs.remainders)
        starts = start_sizes(vehicle, name) if from_start else None
        implied[name] = Balls()
        for signal, phases in vehicle.responses[name].items():
            largest = arb(0)
            for response in phases:
                value = signal_bound(name, inputs, response, starts, axis_factor(name, signal))
                require_premise(value.is_finite(), f"V4: the bound of {name}.{signal} is not finite")
                largest = maximum(largest, value.upper())
            growth = arb(0) if signal == EQUIVALENT else t / REACH * slopes[signal]  # u_av has no time between samples
            implied[name][signal] = (largest + growth).upper()
    return implied


def signal_bound(
    name: str,
    inputs: Inputs,
    response: SignalResponse,
    starts: list[arb] | None,
    factor: arb,
) -> arb:
    """The bound of a signal at one phase: the sum of the signal's responses to all inputs, the constant and the start.

    Args:
        name: Name of the channel.
        inputs: Bounds of the inputs.
        response: Response of the signal at the phase, to inputs of size 1.
        starts: E_0, V_0 and the bound of q_(-1)'s deviation; None for upper limits, which no start affects.
        factor: h of the signal, by :func:`axis_factor`.
    """
    deviations = inputs.deviations[name]
    sigma = inputs.sigma[name]
    remainder_bounds = inputs.remainders.channels[name]
    terms = [
        factor * deviations.of_command(sigma) * response.command,
        factor * deviations.of_integral(sigma) * response.integral,
        inputs.remainders.constant * (response.constant if starts else response.settled_constant),
    ]
    terms += [remainder_bounds[remainder] * size for remainder, size in response.remainders.items()]
    if starts:
        e, e_dot, deviation = starts
        e_response, e_dot_response, deviation_response = response.starts
        terms += [e * e_response, e_dot * e_dot_response]
        terms += [factor * deviation * deviation_response, response.start_offset]
    return total(terms)


def axis_factor(name: str, signal: str) -> arb:
    """h, the factor of the bounds of omega_u and omega_r in a signal: 2^(1/2) for a norm of the plane, otherwise 1.

    The omegas are bounded along each axis, so their vector in the plane is up to 2^(1/2) times as long.
    """
    return arb(1) if name != "x" or signal in ALONG_AXES else arb(2).sqrt()


def start_sizes(vehicle: Vehicle, name: str) -> list[arb]:
    """Bounds at t = 0 in a channel: E_0 of |e|, V_0 of |e'|, and a bound of the deviation of q_(-1), in this order."""
    controller = vehicle.problem["channels"][name]
    e, e_dot = map(arb, controller["initial"])
    start_sigma = first_sigma(vehicle.problem, name).upper()
    if start_sigma == 0:
        return [e, e_dot, arb(0)]
    proof = vehicle.middles[name]
    deviations = deviations_of(vehicle.problem, name, proof, float_above(start_sigma))
    t = arb(vehicle.problem["sample_time"])
    return [e, e_dot, deviations.of_start(controller["start"], start_sigma, t, arb(proof["share"]))]


def first_sigma(problem: VehicleProblem, name: str) -> arb:
    """Sigma_0, a bound of |sigma| of a channel at t = 0: V_0 + l_0 E_0 and, in psi, |psi_m'(0)| besides."""
    controller = problem["channels"][name]
    e, e_dot = map(arb, controller["initial"])
    return e_dot + initial_yaw_rate(problem, name) + arb(controller["l0"]) * e
