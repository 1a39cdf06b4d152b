"""Bounds of a moving vehicle's own signals and couplings, from the nominal flight and bounds of the deviation from it.

A vehicle that hovers has no nominal flight: its signals are their own deviation, and it has no couplings.
"""

from collections.abc import Mapping
from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls
from dssc_jax.proofs.verifier.vehicle.certificate import CHANNELS, VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import SignalBalls
from dssc_jax.proofs.verifier.vehicle.nominal import OUTPUT_RATE
from dssc_jax.proofs.verifier.vehicle.waves import derivative, largest_magnitude, sine_wave, value_at_start


class Flight(NamedTuple):
    """Bounds of the nominal flight.

    Args:
        bounds: N, bounds of its signals and differences, by channel and name.
        lift: A_m, bound of |z_m''| [m/s^2].
        yaw: Psi_m, bound of |psi_m'| [rad/s].
    """

    bounds: Mapping[str, Balls]
    lift: arb
    yaw: arb


class Coupling(NamedTuple):
    """Bounds of how far a moving vehicle is from what its reference needs, by which its channels are coupled.

    alpha_0 = y_m'' + c y_m' is the alpha that the reference needs in the plane.

    Args:
        alpha_gap: G_alpha, bound of |alpha - alpha_0| [m/s^2].
        wanted_gap: G_a, bound of |a_h - alpha_0| [m/s^2].
        lift_gap: G_z, bound of |a_z - z_m''| [m/s^2].
        yaw_gap: G_psi, bound of |psi' - psi_m'| [rad/s].
        lift: A_m, bound of |z_m''| [m/s^2].
        yaw: Psi_m, bound of |psi_m'| [rad/s].
    """

    alpha_gap: arb
    wanted_gap: arb
    lift_gap: arb
    yaw_gap: arb
    lift: arb
    yaw: arb


def flight_of(problem: VehicleProblem, channels: Mapping[str, Balls]) -> Flight | None:
    """Bounds of the nominal flight; None if the vehicle hovers.

    Args:
        problem: The certificate's problem.
        channels: Bounds of the flight's signals and differences, by channel.
    """
    sines = problem["reference"]
    if sines is None:
        return None
    lift = largest_magnitude(derivative(derivative(sine_wave(sines["z"]))))  # of z_m''
    yaw = largest_magnitude(derivative(sine_wave(sines["psi"])))  # of psi_m'
    return Flight(channels, lift, yaw)


def total_bounds(flight: Flight | None, bounds: SignalBalls) -> SignalBalls:
    """Bounds N + Y of the vehicle's own signals.

    Args:
        flight: The nominal flight, whose signals are at most N; None: the vehicle hovers, and N = 0.
        bounds: Y, bounds of the vehicle's deviation from it, by channel and signal.
    """
    if flight is None:
        return bounds
    totals = {}
    for name in CHANNELS:
        nominal = flight.bounds[name]
        totals[name] = {signal: (y + nominal.get(signal, arb(0))).upper() for signal, y in bounds[name].items()}
    return totals


def body_bounds(flight: Flight | None, bounds: SignalBalls) -> SignalBalls:
    """Bounds N + Y of the signals by which the vehicle's body moves, as the remainders take them.

    In z and psi, ``e_dot`` is the vertical speed and the yaw rate themselves in place of the errors' rates. The
    arguments are those of :func:`total_bounds`.
    """
    totals = dict(total_bounds(flight, bounds))
    if flight is not None:
        for name in ("z", "psi"):
            output_rate = (bounds[name]["e_dot"] + flight.bounds[name][OUTPUT_RATE]).upper()
            totals[name] = {**totals[name], "e_dot": output_rate}
    return totals


def coupling_under(flight: Flight | None, bounds: SignalBalls) -> Coupling | None:
    """Bounds of how far the vehicle is from what its reference needs; None if it hovers.

    The arguments are those of :func:`total_bounds`.
    """
    if flight is None:
        return None
    return Coupling(
        alpha_gap=(flight.bounds["x"]["alpha_gap"] + bounds["x"]["alpha"]).upper(),
        wanted_gap=(flight.bounds["x"]["wanted_gap"] + bounds["x"]["wanted"]).upper(),
        lift_gap=(flight.bounds["z"]["lift_gap"] + bounds["z"]["wanted"]).upper(),
        yaw_gap=(flight.bounds["psi"]["yaw_gap"] + bounds["psi"]["e_dot"]).upper(),
        lift=flight.lift,
        yaw=flight.yaw,
    )


def initial_yaw_rate(problem: VehicleProblem, name: str) -> arb:
    """What a moving reference adds to |sigma_0| of a channel at the start: |psi_m'(0)| in psi [rad/s], else 0.

    The vehicle starts with the velocity of its reference, but does not turn.
    """
    sines = problem["reference"]
    if sines is None or name != "psi":
        return arb(0)
    return abs(value_at_start(derivative(sine_wave(sines["psi"])))).upper()
