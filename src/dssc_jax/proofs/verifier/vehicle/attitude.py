"""(V3) Bounds of the tilt, its rates and the lift of a vehicle, from bounds of its signals.

docs/vehicle_proofs.md has the formulas; comments here give the symbols. Every bound is rounded up.
"""

from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import require_premise
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import SignalBalls
from dssc_jax.proofs.verifier.vehicle.ranges import Ranges


class Attitude(NamedTuple):
    """Upper bounds of the vehicle's tilt, its rates and its lift.

    Args:
        tilt: beta, bound of the tilt [rad]. It also bounds the tilt's sine, and is then called s.
        tangent: t, bound of the tilt's tangent.
        secant: S, bound of the inverse of the tilt's cosine.
        tilt_rate: beta_1, bound of |b'|, where b is the tilt as a vector of the horizontal plane [rad/s].
        yaw_rate: psi_1, bound of |psi'| [rad/s].
        lift: A_z, bound of the wanted vertical acceleration [m/s^2].
        achieved_lift: Q, bound of the vertical acceleration that the rotors achieve [m/s^2]; A_z without a rotor lag.
        tilt_defect: r_2, bound of |b_d - a_h/g|, the deviation of the desired tilt from the linear law [rad].
        euler_rate: T, bound of |(phi', theta')| [rad/s].
        tilt_demand: H, bound of |(eta_phi, eta_theta)|, the wanted second derivative of roll and pitch [rad/s^2].
        yaw_demand: H_psi, bound of |eta_psi|, the wanted second derivative of yaw [rad/s^2].
        frame_h: w_h, bound of B' E' across body z [rad/s^2]; B takes the Euler rates E' to the body rate.
        frame_z: w_z, bound of B' E' along body z [rad/s^2].
        rate_h: Omega_h, bound of the body rate across body z [rad/s].
        rate_z: Omega_z, bound of the body rate along body z [rad/s].
        rate: Omega_n, bound of the norm of the body rate [rad/s].
    """

    tilt: arb
    tangent: arb
    secant: arb
    tilt_rate: arb
    yaw_rate: arb
    lift: arb
    achieved_lift: arb
    tilt_defect: arb
    euler_rate: arb
    tilt_demand: arb
    yaw_demand: arb
    frame_h: arb
    frame_z: arb
    rate_h: arb
    rate_z: arb
    rate: arb


def attitude_of(problem: VehicleProblem, ranges: Ranges, bounds: SignalBalls) -> Attitude:
    """(V3) Bounds of the attitude and its rates, while the signals stay within their bounds.

    Args:
        problem: The certificate's problem.
        ranges: Extremes over the problem's intervals.
        bounds: Bounds of the vehicle's signals, by channel and name.

    Raises:
        Rejected: The lift may vanish, the tilt may exceed 1 rad, or the yaw error may reach half a turn.
    """
    x = bounds["x"]
    z = bounds["z"]
    g = ranges.gravity
    lift = z["wanted"]  # A_z
    least_lift = g - lift
    require_premise(bool(least_lift > g / 10), "V3: z.wanted leaves the lift less than g/10")
    tilt = (x["alpha"] / g).upper()  # beta, where alpha = g b
    require_premise(bool(tilt < 1), "V3: the tilt x.alpha/g may exceed 1 rad")
    require_premise(bool(bounds["psi"]["e"] < arb.pi()), "V3: psi.e may reach half a turn")
    tilt_rate = (x["alpha_dot"] / g).upper()  # beta_1
    yaw_rate = bounds["psi"]["e_dot"]  # psi_1
    desired_tangent = (x["wanted"] / least_lift).upper()  # t_d, bound of |beta_d| = |a_h|/(g + a_z)
    tilt_defect = (desired_tangent**3 / 2 + lift * desired_tangent / g).upper()  # r_2
    euler_rate = (tilt_rate + yaw_rate * tilt).upper()  # T
    stiffness = arb(problem["stiffness"])
    tilt_demand = (x["turn"] + stiffness * g * tilt_defect) / g + arb(problem["damping"]) * yaw_rate * tilt  # H
    rate_h = (euler_rate + tilt * yaw_rate).upper()  # Omega_h
    rate_z = (yaw_rate + tilt * euler_rate).upper()  # Omega_z
    return Attitude(
        tilt=tilt,
        tangent=tilt.tan().upper(),
        secant=(1 / tilt.cos()).upper(),
        tilt_rate=tilt_rate,
        yaw_rate=yaw_rate,
        lift=lift,
        achieved_lift=z["lift"] if problem["rotor_lag"] > 0 else lift,  # without a lag there is no signal ``lift``
        tilt_defect=tilt_defect,
        euler_rate=euler_rate,
        tilt_demand=tilt_demand.upper(),
        yaw_demand=bounds["psi"]["wanted"],
        frame_h=((1 + tilt * tilt) * euler_rate * yaw_rate + tilt * euler_rate * euler_rate / 2).upper(),
        frame_z=(euler_rate * euler_rate / 2 + tilt * euler_rate * yaw_rate).upper(),
        rate_h=rate_h,
        rate_z=rate_z,
        rate=(rate_h * rate_h + rate_z * rate_z).sqrt().upper(),
    )
