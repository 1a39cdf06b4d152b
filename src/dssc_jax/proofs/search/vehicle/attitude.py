"""Bounds of the tilt, its rates and the lift of a vehicle, from bounds of its signals, in floating point.

docs/vehicle_proofs.md has the formulas; comments here give the symbols.
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
    """Upper bounds of the vehicle's tilt, its rates and its lift, in floating point.

    The verifier's :class:`~dssc_jax.proofs.verifier.vehicle.attitude.Attitude` encloses the same bounds rigorously.
    """

    tilt: float  # beta, of the tilt [rad]
    tangent: float  # t, of the tilt's tangent
    secant: float  # S, of the inverse of the tilt's cosine
    tilt_rate: float  # beta_1, of |b'|, where b is the tilt as a vector of the horizontal plane [rad/s]
    yaw_rate: float  # psi_1, of |psi'| [rad/s]
    lift: float  # A_z, of the wanted vertical acceleration [m/s^2]
    achieved_lift: float  # Q, of the vertical acceleration that the rotors achieve [m/s^2]
    tilt_defect: float  # r_2, of |b_d - a_h/g| [rad]
    euler_rate: float  # T, of |(phi', theta')| [rad/s]
    tilt_demand: float  # H, of |(eta_phi, eta_theta)| [rad/s^2]
    yaw_demand: float  # H_psi, of |eta_psi| [rad/s^2]
    frame_h: float  # w_h, of B' E' across body z [rad/s^2]
    frame_z: float  # w_z, of B' E' along body z [rad/s^2]
    rate_h: float  # Omega_h, of the body rate across body z [rad/s]
    rate_z: float  # Omega_z, of the body rate along body z [rad/s]

    @property
    def rate(self) -> float:
        """Omega_n, bound of the norm of the body rate [rad/s]."""
        return math.hypot(self.rate_h, self.rate_z)


def attitude_of(problem: VehicleProblem, bounds: Signals) -> Attitude:
    """Bounds of the attitude and its rates, while the signals stay within their bounds.

    Args:
        problem: The vehicle.
        bounds: Bounds of the signals by which the vehicle's body moves, by channel and name.

    Raises:
        OutOfRange: The lift may vanish, the tilt may exceed 1 rad, or the yaw error may reach half a turn.
    """
    x = bounds["x"]
    z = bounds["z"]
    psi = bounds["psi"]
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
