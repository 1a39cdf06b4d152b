"""Bounds of a moving vehicle's own signals and couplings, from the nominal flight and bounds of the deviation from it.

A vehicle that hovers has no nominal flight: its signals equal their deviations, and it has no couplings.
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
        bounds: N, bounds of the flight's signals and of differences of signals, by channel and name.
        lift: A_m, bound of |z_m''| [m/s^2].
        yaw: Psi_m, bound of |psi_m'| [rad/s].
    """

    bounds: Mapping[str, Balls]
    lift: arb
    yaw: arb


class Coupling(NamedTuple):
    """Bounds of a moving vehicle's distances from the motion that its reference needs; they couple the channels.

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
        channels: N, bounds of the flight's signals and of differences of signals, by channel and name.
    """
    sines = problem["reference"]
    if sines is None:
        return None
    lift = largest_magnitude(derivative(derivative(sine_wave(sines["z"]))))  # of z_m''
    yaw = largest_magnitude(derivative(sine_wave(sines["psi"])))  # of psi_m'
    return Flight(channels, lift, yaw)


def total_bounds(flight: Flight | None, bounds: SignalBalls) -> SignalBalls:
    """Bounds N + Y of the vehicle's own signals, by channel and signal.

    Args:
        flight: The nominal flight, whose signals are at most N; None: the vehicle hovers, and N = 0.
        bounds: Y, bounds of the vehicle's deviation from the nominal flight, by channel and signal.
    """
    if flight is None:
        return bounds
    totals = {}
    for name in CHANNELS:
        nominal = flight.bounds[name]
        totals[name] = {signal: (y + nominal.get(signal, arb(0))).upper() for signal, y in bounds[name].items()}
    return totals


def body_bounds(flight: Flight | None, bounds: SignalBalls) -> SignalBalls:
    """Bounds N + Y of the signals as the remainders need them: those of the body's own motion.

    In z and psi, ``e_dot`` bounds the vertical speed and the yaw rate themselves, in place of the rates of the errors.

    Args:
        flight: The nominal flight; None: the vehicle hovers.
        bounds: Y, bounds of the vehicle's deviation from the nominal flight, by channel and signal.
    """
    totals = dict(total_bounds(flight, bounds))
    if flight is not None:
        for name in ("z", "psi"):
            output_rate = (bounds[name]["e_dot"] + flight.bounds[name][OUTPUT_RATE]).upper()
            totals[name] = {**totals[name], "e_dot": output_rate}
    return totals


def coupling_under(flight: Flight | None, bounds: SignalBalls) -> Coupling | None:
    """Bounds of the vehicle's distances from the motion that its reference needs; None if the vehicle hovers.

    Args:
        flight: The nominal flight; None: the vehicle hovers.
        bounds: Y, bounds of the vehicle's deviation from the nominal flight, by channel and signal.
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
    """The addition of a moving reference to the bound of a channel's |sigma_0|: |psi_m'(0)| [rad/s] in psi, else 0.

    The vehicle starts with the velocity of its reference, but without its yaw rate.
    """
    sines = problem["reference"]
    if sines is None or name != "psi":
        return arb(0)
    return abs(value_at_start(derivative(sine_wave(sines["psi"])))).upper()
