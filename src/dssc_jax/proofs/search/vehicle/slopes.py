"""Bounds of how fast the signals change within a sample, in floating point.

They are the table of slopes in docs/vehicle_proofs.md: each slope follows from bounds of other signals and remainders.
"""

from dssc_jax.proofs.search.vehicle.attitude import Signals
from dssc_jax.proofs.search.vehicle.channels import GRAVITY
from dssc_jax.proofs.vehicle_problem import VehicleProblem

Bounds = dict[str, float]
"""Bounds by the name of a signal or remainder."""


def signal_slopes(
    problem: VehicleProblem, bounds: Signals, remainders: Signals, damping: tuple[float, float]
) -> Signals:
    """Bounds of the derivatives of all signals within a sample, by channel and name; u_av is constant there.

    Args:
        problem: The vehicle.
        bounds: Bounds of the signals.
        remainders: Bounds of the remainders.
        damping: Damping of drag in the plane and along z [1/s].
    """
    slopes = {
        "x": plane_slopes(problem, bounds["x"], remainders["x"], damping[0]),
        "z": vertical_slopes(problem, bounds["z"], remainders["z"], damping[1]),
        "psi": yaw_slopes(problem, bounds["psi"], remainders["psi"]),
    }
    return {name: channel_slopes | {"u_av": 0.0} for name, channel_slopes in slopes.items()}


def plane_slopes(problem: VehicleProblem, y: Bounds, remainders: Bounds, damping: float) -> Bounds:
    """Bounds of the derivatives of the signals of x and y.

    Args:
        problem: The vehicle.
        y: Bounds of the channel's signals.
        remainders: Bounds of its remainders.
        damping: c, the damping of drag [1/s].
    """
    l0 = problem.channels["x"].l0
    lag = problem.rotor_lag
    e_dot = y["acceleration"] + remainders["force"]
    alpha_dot = (y["gamma"] if lag else y["turn"]) + remainders["torque"]
    demand = problem.velocity_gain * e_dot
    turn = problem.stiffness * (demand + y["alpha_dot"]) + problem.damping * alpha_dot
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
    if lag:
        slopes["gamma"] = y["behind"] / lag + remainders["lag"]
        slopes["behind"] = turn + slopes["gamma"]
    return slopes


def vertical_slopes(problem: VehicleProblem, y: Bounds, remainders: Bounds, damping: float) -> Bounds:
    """Bounds of the derivatives of the signals of z, on which a thrust other than believed acts as a constant, too.

    Args:
        problem: The vehicle.
        y: Bounds of the channel's signals.
        remainders: Bounds of its remainders.
        damping: c, the damping of drag [1/s].
    """
    constant = problem.thrust_deviation * GRAVITY  # |o| <= k g
    l0 = problem.channels["z"].l0
    lag = problem.rotor_lag
    e_dot = y["acceleration"] + remainders["force"] + constant
    demand = problem.velocity_gain * e_dot
    slopes = {"e": y["e_dot"], "e_dot": e_dot, "sigma": y["bend"] + remainders["force"] + constant, "wanted": demand}
    lift = demand
    if lag:
        lift = y["behind"] / lag + remainders["lag"]
        slopes |= {"lift": lift, "behind": demand + lift}
    return slopes | {"acceleration": lift + damping * e_dot, "bend": lift + abs(l0 - damping) * e_dot}


def yaw_slopes(problem: VehicleProblem, y: Bounds, remainders: Bounds) -> Bounds:
    """Bounds of the derivatives of the signals of psi.

    Args:
        problem: The vehicle.
        y: Bounds of the channel's signals.
        remainders: Bounds of its remainders.
    """
    l0 = problem.channels["psi"].l0
    lag = problem.rotor_lag
    e_dot = (y["gamma"] if lag else y["wanted"]) + remainders["torque"]
    demand = problem.yaw_gain * e_dot + problem.yaw_integral_gain * y["follow"]
    slopes = {
        "e": y["e_dot"],
        "e_dot": e_dot,
        "sigma": y["bend"] + remainders["torque"],
        "wanted": demand,
        "follow": e_dot,
    }
    gamma = demand
    if lag:
        gamma = y["behind"] / lag + remainders["lag"]
        slopes |= {"gamma": gamma, "behind": demand + gamma}
    return slopes | {"bend": gamma + l0 * e_dot}
