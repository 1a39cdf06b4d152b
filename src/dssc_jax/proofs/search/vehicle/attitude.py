"""Bounds of the tilt, its rates and the lift of a vehicle, from bounds of its signals, in floating point.

docs/vehicle_proofs.md has the formulas, by the symbols that stand beside each line here.
"""

import math
from dataclasses import dataclass

from dssc_jax.proofs.search.vehicle.channels import GRAVITY
from dssc_jax.proofs.vehicle_problem import VehicleProblem

Signals = dict[str, dict[str, float]]
"""Bounds of the signals, by channel and name."""


class OutOfRange(Exception):
    """Raised where bounds of the signals are so large that the vehicle may leave the range of the theorem (V3)."""


@dataclass(frozen=True)
class Attitude:
    """Upper bounds of how far the vehicle tilts and turns, and how fast, as floating-point numbers for the search.

    Names, symbols and units are those of the verifier's
    :class:`~dssc_jax.proofs.verifier.vehicle.attitude.Attitude`, which encloses the same bounds rigorously.
    """

    tilt: float
    tangent: float
    secant: float
    tilt_rate: float
    yaw_rate: float
    lift: float
    achieved_lift: float
    tilt_defect: float
    euler_rate: float
    tilt_demand: float
    yaw_demand: float
    frame_h: float
    frame_z: float
    rate_h: float
    rate_z: float

    @property
    def rate(self) -> float:
        """Omega_n, bound of the norm of the body rate [rad/s]."""
        return math.hypot(self.rate_h, self.rate_z)


def attitude_of(problem: VehicleProblem, bounds: Signals) -> Attitude:
    """Bounds of the attitude and its rates, while the signals stay within their bounds.

    Raises:
        OutOfRange: The lift may vanish, the tilt may exceed 1 rad, or the yaw error may reach half a turn.
    """
    x, z, psi = bounds["x"], bounds["z"], bounds["psi"]
    tilt = x["alpha"] / GRAVITY  # beta, where alpha = g b
    lift = z["wanted"]  # A_z
    if not (tilt < 1.0 and lift < 0.9 * GRAVITY and psi["e"] < math.pi):
        raise OutOfRange
    tilt_rate = x["alpha_dot"] / GRAVITY  # beta_1
    yaw_rate = psi["e_dot"]  # psi_1
    desired_tangent = x["wanted"] / (GRAVITY - lift)  # t_d, bound of |beta_d| = |a_h|/(g + a_z)
    tilt_defect = desired_tangent**3 / 2.0 + lift * desired_tangent / GRAVITY  # r_2
    euler_rate = tilt_rate + yaw_rate * tilt  # T
    return Attitude(
        tilt=tilt,
        tangent=math.tan(tilt),
        secant=1.0 / math.cos(tilt),
        tilt_rate=tilt_rate,
        yaw_rate=yaw_rate,
        lift=lift,
        achieved_lift=z.get("lift", lift),  # the signal exists with a rotor lag only
        tilt_defect=tilt_defect,
        euler_rate=euler_rate,
        tilt_demand=x["turn"] / GRAVITY + problem.stiffness * tilt_defect + problem.damping * yaw_rate * tilt,
        yaw_demand=psi["wanted"],
        frame_h=(1.0 + tilt**2) * euler_rate * yaw_rate + tilt * euler_rate**2 / 2.0,
        frame_z=euler_rate**2 / 2.0 + tilt * euler_rate * yaw_rate,
        rate_h=euler_rate + tilt * yaw_rate,
        rate_z=yaw_rate + tilt * euler_rate,
    )
