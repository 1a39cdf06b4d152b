"""Bounds of the signals' derivatives within a sample, in floating point.

Each follows from bounds of other signals and of remainders; docs/vehicle_proofs.md has the table of these slopes.
"""

from dssc_jax.proofs.search.vehicle.attitude import Signals
from dssc_jax.proofs.search.vehicle.channels import GRAVITY, Damping
from dssc_jax.proofs.vehicle_problem import VehicleProblem

Bounds = dict[str, float]
"""Bounds by the name of a signal or remainder."""


def signal_slopes(problem: VehicleProblem, bounds: Signals, remainders: Signals, damping: Damping) -> Signals:
    """Bounds of the derivatives of all signals within a sample, by channel and name; 0 for u_av, which is constant.

    Args:
        problem: The vehicle.
        bounds: Bounds of the signals.
        remainders: Bounds of the remainders.
        damping: Damping by drag.
    """
    slopes = {
        "x": plane_slopes(problem, bounds["x"], remainders["x"], damping.plane),
        "z": vertical_slopes(problem, bounds["z"], remainders["z"], damping.vertical),
        "psi": yaw_slopes(problem, bounds["psi"], remainders["psi"]),
    }
    return {name: channel_slopes | {"u_av": 0.0} for name, channel_slopes in slopes.items()}


def plane_slopes(problem: VehicleProblem, bounds: Bounds, remainders: Bounds, damping: float) -> Bounds:
    """Bounds of the derivatives of the signals of x and y.

    Args:
        problem: The vehicle.
        bounds: Bounds of the channel's signals.
        remainders: Bounds of the channel's remainders.
        damping: c, the damping by drag [1/s].
    """
    l0 = problem.channels["x"].l0
    lag = problem.rotor_lag
    e_dot_slope = bounds["acceleration"] + remainders["force"]
    alpha_dot_slope = (bounds["gamma"] if lag else bounds["turn"]) + remainders["torque"]
    demand_slope = problem.velocity_gain * e_dot_slope
    turn_slope = problem.stiffness * (demand_slope + bounds["alpha_dot"]) + problem.damping * alpha_dot_slope
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
    if lag:
        slopes["gamma"] = bounds["behind"] / lag + remainders["lag"]
        slopes["behind"] = turn_slope + slopes["gamma"]
    return slopes


def vertical_slopes(problem: VehicleProblem, bounds: Bounds, remainders: Bounds, damping: float) -> Bounds:
    """Bounds of the derivatives of the signals of z, where a wrongly believed thrust acts as a constant force o.

    Args:
        problem: The vehicle.
        bounds: Bounds of the channel's signals.
        remainders: Bounds of the channel's remainders.
        damping: c, the damping by drag [1/s].
    """
    constant = problem.thrust_deviation * GRAVITY  # |o| <= k g
    l0 = problem.channels["z"].l0
    lag = problem.rotor_lag
    e_dot_slope = bounds["acceleration"] + remainders["force"] + constant
    demand_slope = problem.velocity_gain * e_dot_slope
    slopes = {
        "e": bounds["e_dot"],
        "e_dot": e_dot_slope,
        "sigma": bounds["bend"] + remainders["force"] + constant,
        "wanted": demand_slope,
    }
    lift_slope = demand_slope
    if lag:
        lift_slope = bounds["behind"] / lag + remainders["lag"]
        slopes |= {"lift": lift_slope, "behind": demand_slope + lift_slope}
    slopes["acceleration"] = lift_slope + damping * e_dot_slope
    slopes["bend"] = lift_slope + abs(l0 - damping) * e_dot_slope
    return slopes


def yaw_slopes(problem: VehicleProblem, bounds: Bounds, remainders: Bounds) -> Bounds:
    """Bounds of the derivatives of the signals of psi.

    Args:
        problem: The vehicle.
        bounds: Bounds of the channel's signals.
        remainders: Bounds of the channel's remainders.
    """
    l0 = problem.channels["psi"].l0
    lag = problem.rotor_lag
    e_dot_slope = (bounds["gamma"] if lag else bounds["wanted"]) + remainders["torque"]
    demand_slope = problem.yaw_gain * e_dot_slope + problem.yaw_integral_gain * bounds["follow"]
    slopes = {
        "e": bounds["e_dot"],
        "e_dot": e_dot_slope,
        "sigma": bounds["bend"] + remainders["torque"],
        "wanted": demand_slope,
        "follow": e_dot_slope,
    }
    gamma_slope = demand_slope
    if lag:
        gamma_slope = bounds["behind"] / lag + remainders["lag"]
        slopes |= {"gamma": gamma_slope, "behind": demand_slope + gamma_slope}
    return slopes | {"bend": gamma_slope + l0 * e_dot_slope}
