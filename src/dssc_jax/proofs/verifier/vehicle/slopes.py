"""Bounds of how fast the signals change within a sample, from bounds of the signals and of the remainders.

They are the table of slopes in docs/vehicle_proofs.md.
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
    """Bounds of the derivatives of a channel's signals within a sample, by name; u_av, constant there, has none.

    Args:
        problem: The certificate's problem.
        name: The channel.
        damping: Damping of drag c in its linear channel [1/s].
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


def plane_slopes(problem: VehicleProblem, damping: arb, y: Mapping[str, arb], remainders: Balls) -> Balls:
    """Bounds of the derivatives of the signals of x and y, by name.

    Args:
        problem: The certificate's problem.
        damping: Damping of drag c in the linear channel [1/s].
        y: Bounds of the signals, by name.
        remainders: Bounds of the remainders, by name.
    """
    l0 = arb(problem["channels"]["x"]["l0"])
    stiffness = arb(problem["stiffness"])
    lagging = problem["rotor_lag"] > 0
    e_dot = y["acceleration"] + remainders["force"]
    alpha_dot = (y["gamma"] if lagging else y["turn"]) + remainders["torque"]
    demand = arb(problem["velocity_gain"]) * e_dot
    turn = stiffness * (demand + y["alpha_dot"]) + arb(problem["damping"]) * alpha_dot
    slopes = {
        "e": y["e_dot"],
        "e_dot": e_dot,
        "speed": e_dot,
        "alpha": y["alpha_dot"],
        "alpha_dot": alpha_dot,
        "sigma": y["bend"] + remainders["force"],
        "wanted": demand,
        "turn": turn,
        "acceleration": y["alpha_dot"] + damping * e_dot,
        "bend": y["alpha_dot"] + abs(l0 - damping) * e_dot,
    }
    if lagging:
        slopes["gamma"] = y["behind"] / arb(problem["rotor_lag"]) + remainders["lag"]
        slopes["behind"] = turn + slopes["gamma"]
    return slopes


def vertical_slopes(
    problem: VehicleProblem, damping: arb, y: Mapping[str, arb], remainders: Balls, constant: arb
) -> Balls:
    """Bounds of the derivatives of the signals of z, by name.

    Args:
        problem: The certificate's problem.
        damping: Damping of drag c in the linear channel [1/s].
        y: Bounds of the signals, by name.
        remainders: Bounds of the remainders, by name.
        constant: Bound of the constant o of the channel.
    """
    l0 = arb(problem["channels"]["z"]["l0"])
    e_dot = y["acceleration"] + remainders["force"] + constant
    demand = arb(problem["velocity_gain"]) * e_dot
    lift = demand  # without a rotor lag the lift is the wanted acceleration
    slopes = {"e": y["e_dot"], "e_dot": e_dot, "sigma": y["bend"] + remainders["force"] + constant, "wanted": demand}
    if problem["rotor_lag"] > 0:
        lift = y["behind"] / arb(problem["rotor_lag"]) + remainders["lag"]
        slopes |= {"lift": lift, "behind": demand + lift}
    return slopes | {"acceleration": damping * e_dot + lift, "bend": abs(l0 - damping) * e_dot + lift}


def yaw_slopes(problem: VehicleProblem, y: Mapping[str, arb], remainders: Balls) -> Balls:
    """Bounds of the derivatives of the signals of psi, by name; the arguments are those of :func:`plane_slopes`."""
    l0 = arb(problem["channels"]["psi"]["l0"])
    lagging = problem["rotor_lag"] > 0
    e_dot = (y["gamma"] if lagging else y["wanted"]) + remainders["torque"]
    demand = arb(problem["yaw_gain"]) * e_dot + arb(problem["yaw_integral_gain"]) * y["follow"]
    slopes = {
        "e": y["e_dot"],
        "e_dot": e_dot,
        "sigma": y["bend"] + remainders["torque"],
        "wanted": demand,
        "follow": e_dot,
        "bend": demand + l0 * e_dot,
    }
    if lagging:
        gamma = y["behind"] / arb(problem["rotor_lag"]) + remainders["lag"]
        slopes |= {"gamma": gamma, "behind": demand + gamma, "bend": gamma + l0 * e_dot}
    return slopes
