"""Write a certificate's vehicle in words, with every digit of its numbers, and the bounds that its verdict proves."""

import math
from collections.abc import Mapping, Sequence

from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.verifier.vehicle.certificate import ChannelProblem, VehicleProblem
from dssc_jax.proofs.verifier.vehicle.verdict import VehicleVerdict
from dssc_jax.proofs.words import functions_words, interval_words, nominal_words

STATED = ("e", "e_dot", "sigma")
"""Signals of each channel whose bounds are stated."""
SHOWN_AS = {"x": ("x", "y"), "z": ("z",), "psi": ("psi",)}
"""Labels under which each channel's bounds are stated; y has the bounds of x."""


def vehicle_in_words(problem: VehicleProblem) -> dict[str, str]:
    """Describe the problem of a well-formed certificate, by label, so that people can compare it with their vehicle."""
    k_h, k_z = problem["structure_drag"]
    wind_h, wind_z = problem["wind"]
    words = {
        "loop": f"T_s = {problem['sample_time']} s, delay of {problem['delay']} samples, conservative form",
        "inner loops": inner_words(problem),
        "mass": f"M {interval_words(problem['mass'])} kg, believed {problem['believed_mass']} kg, "
        f"thrust over mass {interval_words(problem['thrust'])} of the believed one",
        "inertia": inertia_words(problem),
        "rotors": rotor_words(problem),
        "drag": f"structure {k_h}, {k_h}, {k_z} N s^2/m^2, propeller {problem['propeller_drag']} N s^2/(m rad)",
        "wind": f"any with |w_h| <= {wind_h} m/s and |w_z| <= {wind_z} m/s",
        "reference": reference_words(problem["reference"]),
    }
    labels = {"x": "x and y", "z": "z", "psi": "psi"}
    return words | {labels[name]: channel_words(name, channel) for name, channel in problem["channels"].items()}


def inner_words(problem: VehicleProblem) -> str:
    """The gains of the inner loops, in words."""
    tilt = f"attitude {problem['stiffness']} 1/s^2 and {problem['damping']} 1/s"
    yaw = f"yaw rate {problem['yaw_gain']} 1/s and {problem['yaw_integral_gain']} 1/s^2"
    return f"velocity {problem['velocity_gain']} 1/s, {tilt}, {yaw}"


def inertia_words(problem: VehicleProblem) -> str:
    """The intervals of the body's inertia, and the inertia that the inner loops believe, in words."""
    axes = zip("xyz", problem["inertia"], problem["believed_inertia"], strict=True)
    axis_words = [f"J_{axis} {interval_words(interval)} (believed {believed})" for axis, interval, believed in axes]
    return f"{', '.join(axis_words)} kg m^2, believed over true {interval_words(problem['turn'])}"


def rotor_words(problem: VehicleProblem) -> str:
    """Number, place, lag, limit and coefficients of the rotors, in words."""
    lag = f"lag of {problem['rotor_lag']} s" if problem["rotor_lag"] else "no lag"
    place = f"{problem['rotors']} at {problem['arm']} m"
    limit = f"at most {problem['rotor_limit']} N each"
    coefficients = f"c_tau = {problem['torque_coefficient']} m, k_Tn = {problem['thrust_coefficient']} N s^2/rad^2"
    return f"{place}, {lag}, {limit}, {coefficients}, I_z = {problem['rotor_inertia']} kg m^2"


def reference_words(sines: Mapping[str, Sequence[float]] | None) -> str:
    """The sines that the axes follow, in words."""
    if sines is None:
        return "at rest"
    waves = [f"{axis}: {size} sin(2 pi t/{period} + {phase})" for axis, (size, period, phase) in sines.items()]
    return f"{', '.join(waves)}, in m and rad, besides constants"


def channel_words(name: str, channel: ChannelProblem) -> str:
    """The controller of a channel, its nominal control and the bounds of its start, in words."""
    rate = "psi'" if name == "psi" else "e'"
    e, e_dot = channel["initial"]
    start = f"predictor's start {channel['start']}, |e| <= {e} and |{rate}| <= {e_dot} at t = 0"
    law = f"l_0 = {channel['l0']} 1/s, rho = {channel['rho']}, {functions_words(channel['functions'])}"
    return f"{law}, nominal {nominal_words(channel['nominal'])}, {start}"


def vehicle_verdict_in_words(verdict: VehicleVerdict) -> str:
    """A sentence that says whether a vehicle's certificate is valid: the bounds that it proves, or why it fails."""
    if not verdict.proved:
        return f"not valid: {verdict.reason}"
    parts = []
    for name, label, unit in (("x", "|e_x| and |e_y|", "m"), ("z", "|e_z|", "m"), ("psi", "|e_psi|", "rad")):
        largest = digits_above(verdict.bounds[name]["e"])
        settled = digits_above(verdict.settled[name]["e"])
        parts.append(f"{label} {largest} {unit} (ends within {settled})")
    tilt = f"the tilt {digits_above(math.degrees(verdict.tilt))} degrees"
    rotors = f"rotors stay between {digits_below(verdict.rotor_min)} and {digits_above(verdict.rotor_max)} N"
    return f"valid: never exceeded are {', '.join(parts)} and {tilt}; {rotors}"


def digits_above(bound: float) -> str:
    """Write a positive upper bound with four significant digits, rounded up so that it stays a bound."""
    return f"{math.ceil(bound / last_digit(bound)) * last_digit(bound):.4g}"


def digits_below(bound: float) -> str:
    """Write a positive lower bound with four significant digits, rounded down so that it stays a bound."""
    return f"{math.floor(bound / last_digit(bound)) * last_digit(bound):.4g}"


def last_digit(value: float) -> float:
    """The place value of the fourth significant digit of a positive number, such as 0.001 for 1.234."""
    return 10.0 ** (math.floor(math.log10(value)) - 3)


def stated_bounds(verdict: VehicleVerdict) -> JsonObject:
    """Make the tables of bounds that a verdict states: from the start on (``bounds``), and once settled (``settled``).

    Each table has the bounds of every axis, of the tilt and of the rotors' thrusts, in m, m/s, rad, rad/s and N. A
    proof with time cells adds the duration of a cell, ``cell`` [s], and the bounds in each cell, ``envelope``.
    """
    rotors = {"rotor_min": verdict.rotor_min, "rotor_max": verdict.rotor_max}
    stated: JsonObject = {
        "bounds": by_channel(verdict.bounds) | {"tilt": verdict.tilt, **rotors},
        "settled": by_channel(verdict.settled) | {"tilt": verdict.settled_tilt, **rotors},
    }
    if verdict.cell:
        stated |= {"cell": verdict.cell, "envelope": by_channel(verdict.envelope)}
    return stated


def by_channel(signals: Mapping[str, Mapping[str, float | list[float]]]) -> JsonObject:
    """Select the stated bounds from those of all signals, and sort them by the labels x, y, z and psi.

    Args:
        signals: Bounds by channel and signal; a bound is a number, or a list with one number for each time cell.
    """
    stated = {}
    for name, labels in SHOWN_AS.items():
        for label in labels:
            stated[label] = {signal: signals[name][signal] for signal in STATED}
    return stated
