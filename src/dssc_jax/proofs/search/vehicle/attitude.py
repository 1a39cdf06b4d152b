"""Bounds of the attitude and the lift under bounds of the signals, in floating point.

docs/vehicle_proofs.md has the formulas.
"""

import math
from dataclasses import dataclass

from dssc_jax.proofs.search.vehicle.channels import GRAVITY
from dssc_jax.proofs.vehicle_problem import VehicleProblem

Signals = dict[str, dict[str, float]]
"""Bounds of the signals, by channel and name."""


class OutOfRange(Exception):
    """Raised where bounds are so large that the vehicle may leave the range of the theorem."""


@dataclass(frozen=True)
class Attitude:
    """Bounds of how far the vehicle tilts and turns, with their symbols in docs/vehicle_proofs.md.

    Args:
        tilt: beta, of the tilt [rad].
        tangent: t, of its tangent.
        secant: S, of the inverse of its cosine.
        tilt_rate: beta_1, of the rate at which b changes [rad/s].
        yaw_rate: psi_1, of |psi'| [rad/s].
        lift: A_z, of the wanted vertical acceleration [m/s^2].
        achieved_lift: Q, of the vertical acceleration that the rotors achieve [m/s^2]; A_z without a rotor lag.
        tilt_defect: r_2, of |b_d - a_h/g|, the deviation of the desired tilt from a linear law [rad].
        euler_rate: T, of |(phi', theta')| [rad/s].
        tilt_demand: H, of |(eta_phi, eta_theta)| [rad/s^2].
        yaw_demand: H_psi, of |eta_psi| [rad/s^2].
        frame_h: w_h, of B' E' across body z [rad/s^2].
        frame_z: w_z, of B' E' along body z [rad/s^2].
        rate_h: Omega_h, of the body rate across body z [rad/s].
        rate_z: Omega_z, of the body rate along body z [rad/s].
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
        """Omega_n, the bound of the whole body rate [rad/s]."""
        return math.hypot(self.rate_h, self.rate_z)


def attitude_of(problem: VehicleProblem, bounds: Signals) -> Attitude:
    """Bounds of the attitude under bounds of the signals.

    Raises:
        OutOfRange: The lift may vanish, the tilt may exceed 1 rad, or the yaw error may reach half a turn.
    """
    x, z, psi = bounds["x"], bounds["z"], bounds["psi"]
    tilt = x["alpha"] / GRAVITY
    lift = z["wanted"]
    if not (tilt < 1.0 and lift < 0.9 * GRAVITY and psi["e"] < math.pi):
        raise OutOfRange
    tilt_rate = x["alpha_dot"] / GRAVITY
    yaw_rate = psi["e_dot"]
    desired_tangent = x["wanted"] / (GRAVITY - lift)
    tilt_defect = desired_tangent**3 / 2.0 + lift * desired_tangent / GRAVITY
    euler_rate = tilt_rate + yaw_rate * tilt
    return Attitude(
        tilt=tilt,
        tangent=math.tan(tilt),
        secant=1.0 / math.cos(tilt),
        tilt_rate=tilt_rate,
        yaw_rate=yaw_rate,
        lift=lift,
        achieved_lift=z.get("lift", lift),
        tilt_defect=tilt_defect,
        euler_rate=euler_rate,
        tilt_demand=x["turn"] / GRAVITY + problem.stiffness * tilt_defect + problem.damping * yaw_rate * tilt,
        yaw_demand=psi["wanted"],
        frame_h=(1.0 + tilt**2) * euler_rate * yaw_rate + tilt * euler_rate**2 / 2.0,
        frame_z=euler_rate**2 / 2.0 + tilt * euler_rate * yaw_rate,
        rate_h=euler_rate + tilt * yaw_rate,
        rate_z=yaw_rate + tilt * euler_rate,
    )
