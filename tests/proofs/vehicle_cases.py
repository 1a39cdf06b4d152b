"""A problem of the whole vehicle for the tests of proofs."""

from dssc_jax.proofs.problem import NominalControl
from dssc_jax.proofs.vehicle_problem import ChannelProblem, VehicleProblem

HOVER = 9.81
"""g [m/s^2]."""


def controller(l0, kappa_o, kappa_m, start, initial):
    """A channel of a problem."""
    functions = {"kind": "square_root", "kappa_o": kappa_o, "kappa_m": kappa_m, "delta_o": 1.0, "delta_m": 1.0}
    return {
        "l0": l0,
        "functions": functions | {"tau_av": 0.03},
        "rho": 3.0,
        "nominal": [1.0, 1.0, True],
        "start": start,
        "initial": initial,
    }


def problem(rotor_lag=0.0, delay=0.0):
    """A quadrotor in a light wind, with a mass that the inner loops know to within half a per cent."""
    return {
        "sample_time": 0.005,
        "delay": delay,
        "velocity_gain": 1.0,
        "stiffness": 60.0,
        "damping": 15.0,
        "yaw_gain": 1.0,
        "yaw_integral_gain": 0.2,
        "mass": [10.85, 10.95],
        "believed_mass": 10.9,
        "thrust": [0.995, 1.005],
        "turn": [0.98, 1.02],
        "inertia": [[0.43, 0.45], [0.43, 0.45], [0.73, 0.75]],
        "believed_inertia": [0.44, 0.44, 0.74],
        "rotors": 4,
        "arm": 0.57,
        "torque_coefficient": 0.57,
        "thrust_coefficient": 0.0024,
        "rotor_limit": 53.0,
        "rotor_lag": rotor_lag,
        "rotor_inertia": 5e-6,
        "structure_drag": [0.03, 0.015],
        "propeller_drag": 8e-6,
        "wind": [2.0, 1.0],
        "channels": {
            "x": controller(0.75, 23.0, 1.1, "midpoint", [0.005, 0.002]),
            "z": controller(0.35, 14.0, 3.3, "midpoint", [0.02, 0.01]),
            "psi": controller(2.9, 11.5, 3.2, "zero", [1e-3, 0.0]),
        },
        "reference": None,
    }


def vehicle_problem_from(content):
    """The search's problem from the content of a certificate."""
    channels = {}
    for name, channel in content["channels"].items():
        nominal = NominalControl(*channel["nominal"]) if channel["nominal"] else None
        channels[name] = ChannelProblem(**{**channel, "nominal": nominal})
    return VehicleProblem(**{**content, "channels": channels})
