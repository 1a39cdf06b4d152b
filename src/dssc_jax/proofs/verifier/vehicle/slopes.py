"""Bounds of the signals' derivatives within a sample, from bounds of the signals and of the remainders.

docs/vehicle_proofs.md has their table of slopes.
"""

from collections.abc import Mapping

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import SignalBalls
from dssc_jax.proofs.verifier.vehicle.remainders import Remainders


def signal_slopes(
    problem: VehicleProblem, name: str, damping: float, bounds: SignalBalls, remainders: Remainders
) -> Balls:
    """Bounds of the derivatives of a channel's signals within a sample, by name; u_av, which is constant, is left out.

    Args:
        problem: The certificate's problem.
        name: Name of the channel.
        damping: c, the damping by drag in the linear channel [1/s]; unused in psi.
        bounds: Bounds of the signals, by channel and name.
        remainders: Bounds of the remainders.
    """
    channel_remainders = remainders.channels[name]
    match name:
        case "x":
            slopes = plane_slopes(problem, arb(damping), bounds["x"], channel_remainders)
        case "z":
            slopes = vertical_slopes(problem, arb(damping), bounds["z"], channel_remainders, remainders.constant)
        case _:
            slopes = yaw_slopes(problem, bounds["psi"], channel_remainders)
    return {signal: slope.upper() for signal, slope in slopes.items()}


def plane_slopes(problem: VehicleProblem, damping: arb, bounds: Mapping[str, arb], remainders: Balls) -> Balls:
    """Bounds of the derivatives of the signals of x and y, by name.

    Args:
        problem: The certificate's problem.
        damping: Damping of drag c in the linear channel [1/s].
        bounds: Bounds of the signals, by name.
        remainders: Bounds of the remainders, by name.
    """
    l0 = arb(problem["channels"]["x"]["l0"])
    stiffness = arb(problem["stiffness"])
    lagging = problem["rotor_lag"] > 0
    e_dot_slope = bounds["acceleration"] + remainders["force"]
    alpha_dot_slope = (bounds["gamma"] if lagging else bounds["turn"]) + remainders["torque"]
    demand_slope = arb(problem["velocity_gain"]) * e_dot_slope
    turn_slope = stiffness * (demand_slope + bounds["alpha_dot"]) + arb(problem["damping"]) * alpha_dot_slope
    slopes = {
        "e": bounds["e_dot"],
        "e_dot": e_dot_slope,
        "speed": e_dot_slope,
        "alpha": bounds["alpha_dot"],
        "alpha_dot": alpha_dot_slope,
        "sigma": bounds["bend"] + remainders["force"],
        "wanted": demand_slope,
        "turn": turn_slope,
        "acceleration": bounds["alpha_dot"] + damping * e_dot_slope,
        "bend": bounds["alpha_dot"] + abs(l0 - damping) * e_dot_slope,
    }
    if lagging:
        slopes["gamma"] = bounds["behind"] / arb(problem["rotor_lag"]) + remainders["lag"]
        slopes["behind"] = turn_slope + slopes["gamma"]
    return slopes


def vertical_slopes(
    problem: VehicleProblem, damping: arb, bounds: Mapping[str, arb], remainders: Balls, constant: arb
) -> Balls:
    """Bounds of the derivatives of the signals of z, by name.

    Args:
        problem: The certificate's problem.
        damping: Damping of drag c in the linear channel [1/s].
        bounds: Bounds of the signals, by name.
        remainders: Bounds of the remainders, by name.
        constant: Bound of the constant o of the channel.
    """
    l0 = arb(problem["channels"]["z"]["l0"])
    e_dot_slope = bounds["acceleration"] + remainders["force"] + constant
    demand_slope = arb(problem["velocity_gain"]) * e_dot_slope
    lift_slope = demand_slope  # without a rotor lag the lift is the wanted acceleration
    slopes = {
        "e": bounds["e_dot"],
        "e_dot": e_dot_slope,
        "sigma": bounds["bend"] + remainders["force"] + constant,
        "wanted": demand_slope,
    }
    if problem["rotor_lag"] > 0:
        lift_slope = bounds["behind"] / arb(problem["rotor_lag"]) + remainders["lag"]
        slopes |= {"lift": lift_slope, "behind": demand_slope + lift_slope}
    slopes["acceleration"] = damping * e_dot_slope + lift_slope
    slopes["bend"] = abs(l0 - damping) * e_dot_slope + lift_slope
    return slopes


def yaw_slopes(problem: VehicleProblem, bounds: Mapping[str, arb], remainders: Balls) -> Balls:
    """Bounds of the derivatives of the signals of psi, by name.

    Args:
        problem: The certificate's problem.
        bounds: Bounds of the signals, by name.
        remainders: Bounds of the remainders, by name.
    """
    l0 = arb(problem["channels"]["psi"]["l0"])
    lagging = problem["rotor_lag"] > 0
    e_dot_slope = (bounds["gamma"] if lagging else bounds["wanted"]) + remainders["torque"]
    demand_slope = arb(problem["yaw_gain"]) * e_dot_slope + arb(problem["yaw_integral_gain"]) * bounds["follow"]
    slopes = {
        "e": bounds["e_dot"],
        "e_dot": e_dot_slope,
        "sigma": bounds["bend"] + remainders["torque"],
        "wanted": demand_slope,
        "follow": e_dot_slope,
        "bend": demand_slope + l0 * e_dot_slope,
    }
    if lagging:
        gamma_slope = bounds["behind"] / arb(problem["rotor_lag"]) + remainders["lag"]
        slopes |= {"gamma": gamma_slope, "behind": demand_slope + gamma_slope, "bend": gamma_slope + l0 * e_dot_slope}
    return slopes
