"""The vehicle's signals and couplings, from the nominal flight and bounds of the deviation from it."""

from collections.abc import Mapping
from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls
from dssc_jax.proofs.verifier.vehicle.certificate import CHANNELS, VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import SignalBalls
from dssc_jax.proofs.verifier.vehicle.nominal import OUTPUT_RATE
from dssc_jax.proofs.verifier.vehicle.waves import at_start, largest, rate, sine_wave


class Flight(NamedTuple):
    """Bounds of the nominal flight.

    Args:
        bounds: Bounds of its signals and differences, by channel and name.
        lift: Bound of |z_m''| [m/s^2].
        yaw: Bound of |psi_m'| [rad/s].
    """

    bounds: Mapping[str, Balls]
    lift: arb
    yaw: arb


class Coupling(NamedTuple):
    """Bounds of the signals that couple the channels of a vehicle whose reference moves.

    Args:
        alpha: G_alpha, of |alpha - alpha_0| [m/s^2].
        wanted: G_a, of |a_h - alpha_0| [m/s^2].
        lift: G_z, of |a_z - z_m''| [m/s^2].
        yaw: G_psi, of |psi' - psi_m'| [rad/s].
        lift_known: A_m, of |z_m''| [m/s^2].
        yaw_known: Psi_m, of |psi_m'| [rad/s].
    """

    alpha: arb
    wanted: arb
    lift: arb
    yaw: arb
    lift_known: arb
    yaw_known: arb


def flight_of(problem: VehicleProblem, channels: Mapping[str, Balls]) -> Flight | None:
    """The nominal flight from the bounds of its signals, by channel; None without a reference."""
    sines = problem["reference"]
    if sines is None:
        return None
    lift = largest(rate(rate(sine_wave(sines["z"]))))
    return Flight(channels, lift, largest(rate(sine_wave(sines["psi"]))))


def total_bounds(flight: Flight | None, bounds: SignalBalls) -> SignalBalls:
    """Bounds of the vehicle's signals.

    Args:
        flight: The nominal flight; None: the vehicle hovers, and the bounds are its own.
        bounds: Bounds of the vehicle's deviation from it, by channel and signal.
    """
    if flight is None:
        return bounds
    result = {}
    for name in CHANNELS:
        nominal = flight.bounds[name]
        result[name] = {signal: (y + nominal.get(signal, arb(0))).upper() for signal, y in bounds[name].items()}
    return result


def body_bounds(flight: Flight | None, bounds: SignalBalls) -> SignalBalls:
    """:func:`total_bounds`, where e_dot of z and psi is the vertical speed and the yaw rate in place of the errors'."""
    totals = total_bounds(flight, bounds)
    if flight is None:
        return totals
    rates = {
        name: (bounds[name]["e_dot"] + flight.bounds[name][OUTPUT_RATE]).upper() for name in CHANNELS if name != "x"
    }
    return {name: {**signals, "e_dot": rates[name]} if name in rates else signals for name, signals in totals.items()}


def coupling_under(flight: Flight | None, bounds: SignalBalls) -> Coupling | None:
    """Bounds of the signals that couple the channels, from bounds of the deviation; None without a reference."""
    if flight is None:
        return None
    return Coupling(
        alpha=(flight.bounds["x"]["alpha_gap"] + bounds["x"]["alpha"]).upper(),
        wanted=(flight.bounds["x"]["wanted_gap"] + bounds["x"]["wanted"]).upper(),
        lift=(flight.bounds["z"]["lift_gap"] + bounds["z"]["wanted"]).upper(),
        yaw=(flight.bounds["psi"]["yaw_gap"] + bounds["psi"]["e_dot"]).upper(),
        lift_known=flight.lift,
        yaw_known=flight.yaw,
    )


def initial_yaw_rate(problem: VehicleProblem, name: str) -> arb:
    """|psi_m'| at t = 0, by which the reference increases |sigma_0| of psi, since the vehicle does not turn; else 0."""
    sines = problem["reference"]
    if sines is None or name != "psi":
        return arb(0)
    return abs(at_start(rate(sine_wave(sines["psi"])))).upper()
