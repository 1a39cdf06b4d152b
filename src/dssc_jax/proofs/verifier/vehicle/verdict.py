"""The verifier of a vehicle's certificate: a vehicle is proved if the premises (V0) to (V5) hold in ball arithmetic.

The verifier takes the certificate's numbers as exact. docs/vehicle_proofs.md states the theorem.
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import ENTERED, Rejected, maximum, minimum, require_premise
from dssc_jax.proofs.verifier.vehicle.cell_bounds import (
    bounds_in_cells,
    cell_place,
    implied_in_cells,
    inputs_in_cells,
    largest_bounds,
    largest_inputs,
    responses_in_cells,
)
from dssc_jax.proofs.verifier.vehicle.certificate import CHANNELS, MiddleProof, VehicleProblem, VehicleProof
from dssc_jax.proofs.verifier.vehicle.channels import SignalBalls
from dssc_jax.proofs.verifier.vehicle.deviations import Deviations, float_above
from dssc_jax.proofs.verifier.vehicle.flight import total_bounds
from dssc_jax.proofs.verifier.vehicle.implied import (
    Inputs,
    Vehicle,
    deviations_under,
    first_sigma,
    implied_bounds,
    inputs_under,
    vehicle_of,
)
from dssc_jax.proofs.verifier.vehicle.well_formed import require_certificate
from dssc_jax.proofs.verifier.verdict import ball_precision

MOST_ITERATIONS = 40
"""Largest number of times that F_s is applied."""
LEAST_FALL = 1e-4
"""Fall of a bound, as a share of the bound, below which F_s is no longer applied."""
REMAINDER_OF_SIGMA = {"x": "force", "z": "force", "psi": "torque"}
"""The remainder in sigma', by channel."""
FloatBounds = dict[str, dict[str, float]]
"""Bounds of the signals, rounded up, by channel and name."""
Envelope = Mapping[str, Mapping[str, list[float]]]
"""Bounds of the signals in each time cell, rounded up, by channel and name."""


class VehicleVerdict(NamedTuple):
    """Whether a vehicle's certificate is proved, and which bounds it proves, in SI units and rounded outwards.

    Args:
        proved: Whether every premise holds.
        reason: The first premise that could not be shown, with the signal or the entry concerned; empty if proved.
        bounds: Bounds of the signals at all times, by channel and name; empty if not proved.
        settled: Bounds of the signals' upper limits (limits superior), by channel and name; empty if not proved.
        tilt: Bound of the tilt [rad]; infinite if not proved.
        settled_tilt: Bound of the tilt's upper limit [rad]; infinite if not proved.
        rotor_min: Lower bound of the rotors' commanded thrusts [N]; minus infinity if not proved.
        rotor_max: Upper bound of the rotors' commanded thrusts [N]; infinite if not proved.
        slopes: Bounds of |sigma'| between the samples, by channel; empty if not proved.
        cell: Duration of a time cell [s]; 0 without cells.
        envelope: Bounds of the signals in each cell in order, by channel and name; empty without cells.
        nominal: Bounds of |e| of the nominal flight, by channel; empty if the vehicle hovers.
    """

    proved: bool
    reason: str
    bounds: FloatBounds
    settled: FloatBounds
    tilt: float
    settled_tilt: float
    rotor_min: float
    rotor_max: float
    slopes: dict[str, float]
    cell: float = 0.0
    envelope: Envelope = MappingProxyType({})
    nominal: Mapping[str, float] = MappingProxyType({})


def verify_vehicle(content: object) -> VehicleVerdict:
    """Verify a vehicle's certificate: its form (V0), and the premises (V1) to (V5).

    Args:
        content: The content of a certificate's file.
    """
    with ball_precision():
        try:
            certificate = require_certificate(content)
            return proved_verdict(certificate["problem"], certificate["proof"])
        except Rejected as rejected:
            return VehicleVerdict(
                proved=False,
                reason=str(rejected),
                bounds={},
                settled={},
                tilt=math.inf,
                settled_tilt=math.inf,
                rotor_min=-math.inf,
                rotor_max=math.inf,
                slopes={},
            )


def proved_verdict(problem: VehicleProblem, proof: VehicleProof) -> VehicleVerdict:
    """Check (V1) to (V5) of a well-formed certificate, and state what it proves.

    Raises:
        Rejected: A premise cannot be shown.
    """
    vehicle = vehicle_of(problem, proof["channels"])
    cells_proof = proof["cells"]
    cells = bounds_in_cells(proof)  # one cell without time cells
    inputs = inputs_in_cells(vehicle, cells)
    implied = implied_in_cells(vehicle, cells, inputs, responses_in_cells(vehicle, cells_proof))
    require_implied(cells, implied)
    largest = total_bounds(vehicle.flight, largest_bounds(cells))
    extremes = largest_inputs(inputs)
    for name in CHANNELS:
        require_sliding(problem, name, largest, extremes)
    settled = total_bounds(vehicle.flight, upper_limits(vehicle, proof, cells[-1]))
    rotors = extremes.remainders.rotors
    nominal = {}
    if vehicle.flight is not None:
        nominal = {name: float_above(y["e"]) for name, y in vehicle.flight.bounds.items()}
    return VehicleVerdict(
        proved=True,
        reason="",
        bounds=rounded_up(largest),
        settled=rounded_up(settled),
        tilt=float_above(extremes.remainders.tilt),
        settled_tilt=float_above((settled["x"]["alpha"] / vehicle.ranges.gravity).upper()),
        rotor_min=math.nextafter(float(rotors.smallest), -math.inf),
        rotor_max=float_above(rotors.largest),
        slopes={name: float_above(sigma_slope(name, largest, extremes).upper()) for name in CHANNELS},
        cell=0.0 if cells_proof is None else cells_proof["samples"] * problem["sample_time"],
        envelope={} if cells_proof is None else envelope_of([total_bounds(vehicle.flight, y) for y in cells]),
        nominal=nominal,
    )


def upper_limits(vehicle: Vehicle, proof: VehicleProof, last_bounds: SignalBalls) -> SignalBalls:
    """Bounds of the upper limits (limits superior) of the signals, or of their deviation from the nominal flight.

    The effect of everything before any fixed time decays in every stable linear channel. So a proof may use other
    linear channels for the upper limits, with smaller bounds.

    Args:
        vehicle: The linear channels of the time cells and their responses.
        proof: The proof, which may contain other linear channels in ``settled``.
        last_bounds: Bounds of the signals in the last cell.

    Raises:
        Rejected: The other channels are not shown to be stable, or their responses decay too slowly.
    """
    settled = settled_bounds(vehicle, last_bounds)
    if proof["settled"] is None:
        return settled
    converted_bounds = bounds_for_channels(proof["channels"], proof["settled"], settled)
    return settled_bounds(vehicle_of(vehicle.problem, proof["settled"]), converted_bounds)


def require_implied(cells: Sequence[SignalBalls], implied: Sequence[SignalBalls]) -> None:
    """(V4) Require F(Y) < Y: in each time cell, every bound exceeds the bound that follows from all of them.

    Args:
        cells: Y, bounds of the signals in each cell.
        implied: F(Y), in each cell.

    Raises:
        Rejected: A bound does not exceed the implied one; the message names the signal and the cell.
    """
    for j, bounds in enumerate(cells):
        for name in CHANNELS:
            for signal, bound in bounds[name].items():
                holds = bool(implied[j][name][signal] < bound)
                place = cell_place(j, len(cells))
                require_premise(holds, f"V4: the bound of {name}.{signal}{place} does not imply itself")


def sigma_slope(name: str, bounds: SignalBalls, inputs: Inputs) -> arb:
    """S', a bound of abs(sigma') of a channel between the samples [m/s^2; rad/s^2 in psi].

    Args:
        name: Name of the channel.
        bounds: Bounds of the vehicle's signals, of which ``bend``, the linear part of sigma', is used.
        inputs: Bounds of the inputs, of which the remainder in sigma' and, in z, the constant are used.
    """
    slope = bounds[name]["bend"] + inputs.remainders.channels[name][REMAINDER_OF_SIGMA[name]]
    return slope + inputs.remainders.constant if name == "z" else slope


def require_sliding(problem: VehicleProblem, name: str, bounds: SignalBalls, inputs: Inputs) -> None:
    """(V5) Require that the equivalent control of a channel is at most rho, so that the channel slides.

    Args:
        problem: The certificate's problem.
        name: Name of the channel.
        bounds: Bounds of the vehicle's signals at all times.
        inputs: Bounds of the inputs at all times.
    """
    t = arb(problem["sample_time"])
    controller = problem["channels"][name]
    rho = arb(controller["rho"])
    y = bounds[name]
    functions = inputs.deviations[name]
    slope = sigma_slope(name, bounds, inputs)  # S'
    integral_rate = functions.k_i * y["sigma"]  # K_I Y[sigma]
    level = maximum((y["u_av"] + functions.phi_1_distance).upper(), (t / 2 * functions.k_i * y["sigma"]).upper())  # V_a
    equivalent = level + (t + functions.tau_av) * (functions.k_p * slope + integral_rate)
    require_premise(bool(equivalent <= rho), f"V5: the equivalent control of {name} may exceed rho")
    if controller["start"] == "zero":
        first_control = first_equivalent(problem, name, functions)
        require_premise(bool(first_control <= rho), f"V5: the first equivalent control of {name} may exceed rho")


def first_equivalent(problem: VehicleProblem, name: str, functions: Deviations) -> arb:
    """A bound of the equivalent control at the first sample, if the predictor starts at ``zero``.

    For this start sigma counts as 0 at the sample before, so that its change is all of sigma_0.

    Args:
        problem: The certificate's problem.
        name: Name of the channel.
        functions: Bounds of the channel's functions and gains.
    """
    t = arb(problem["sample_time"])
    return (1 + functions.tau_av / t) * (functions.k_p + t * functions.k_i) * first_sigma(problem, name)


def bounds_for_channels(
    middles: Mapping[str, MiddleProof], settled_middles: Mapping[str, MiddleProof], bounds: SignalBalls
) -> SignalBalls:
    """Convert bounds of the signals to those of other linear channels, with another damping c and other slopes.

    Only three signals have another definition in the other channels, so that their bounds grow: ``bend`` and
    ``acceleration`` contain c e', and ``u_av`` contains k_1 sigma.

    Args:
        middles: The linear channels to which the bounds belong.
        settled_middles: The other linear channels.
        bounds: Bounds of the signals, by channel and name.
    """
    converted = {name: dict(signals) for name, signals in bounds.items()}
    for name, signals in converted.items():
        k_1, _, _ = map(arb, middles[name]["slopes"])
        settled_k_1, _, _ = map(arb, settled_middles[name]["slopes"])
        slope = abs(k_1 - settled_k_1)
        damping = abs(arb(middles[name]["drag_damping"]) - arb(settled_middles[name]["drag_damping"]))
        signals["bend"] = (signals["bend"] + damping * signals["e_dot"]).upper()
        signals["u_av"] = (signals["u_av"] + slope * signals["sigma"]).upper()
        if "acceleration" in signals:
            speed = signals["speed" if name == "x" else "e_dot"]
            signals["acceleration"] = (signals["acceleration"] + damping * speed).upper()
    return converted


def settled_bounds(vehicle: Vehicle, bounds: SignalBalls) -> SignalBalls:
    """Bounds of the signals' upper limits (limits superior), by iteration of F_s from given bounds.

    Y_(i+1) is the smaller one of Y_i and F_s(1.0001 Y_i), since from some time on every signal stays within 1.0001
    times a bound of its upper limit. The iteration ends when no bound falls by more than the share ``LEAST_FALL``.

    Args:
        vehicle: The linear channels and their responses.
        bounds: Y_0, bounds of the signals from some time on.
    """
    enter_factor = arb(ENTERED)
    for _ in range(MOST_ITERATIONS):
        wider = {}
        for name in CHANNELS:
            wider[name] = {signal: (y * enter_factor).upper() for signal, y in bounds[name].items()}
        try:
            inputs = inputs_under(vehicle, wider, deviations_under(vehicle, wider))
            implied = implied_bounds(vehicle, wider, inputs, from_start=False)
        except Rejected:  # the bounds satisfy the premises, but 1.0001 times them need not
            return bounds
        has_fallen = any_falls(bounds, implied)
        bounds = smaller_bounds(bounds, implied)
        if not has_fallen:
            break
    return bounds


def any_falls(bounds: SignalBalls, implied: SignalBalls) -> bool:
    """Whether the implied bound of any signal is below the signal's bound by more than the share ``LEAST_FALL``."""
    for name in CHANNELS:
        for signal, bound in bounds[name].items():
            if implied[name][signal] < bound * (1 - arb(LEAST_FALL)):
                return True
    return False


def smaller_bounds(bounds: SignalBalls, implied: SignalBalls) -> SignalBalls:
    """The smaller one of the bound and the implied bound of each signal, by channel and signal."""
    smaller = {}
    for name in CHANNELS:
        smaller[name] = {signal: minimum(implied[name][signal], bound) for signal, bound in bounds[name].items()}
    return smaller


def rounded_up(bounds: SignalBalls) -> FloatBounds:
    """Bounds of the signals in float64, rounded up, by channel and name."""
    return {name: {signal: float_above(y) for signal, y in bounds[name].items()} for name in CHANNELS}


def envelope_of(cells: Sequence[SignalBalls]) -> Envelope:
    """Bounds of each signal in all time cells, in float64, rounded up, by channel and name."""
    envelope = {}
    for name in CHANNELS:
        envelope[name] = {signal: [float_above(y[name][signal]) for y in cells] for signal in cells[0][name]}
    return envelope
