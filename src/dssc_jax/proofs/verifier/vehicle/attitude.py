"""Bounds of the attitude and the lift, from bounds of the signals; docs/vehicle_proofs.md has the formulas."""

from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import require_premise
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import SignalBalls
from dssc_jax.proofs.verifier.vehicle.ranges import Ranges


class Attitude(NamedTuple):
    """Bounds of how far the vehicle tilts and turns, with their symbols in docs/vehicle_proofs.md.

    Args:
        tilt: beta, of the tilt [rad]; s in products.
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
        rate: Omega_n, of the whole body rate [rad/s].
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
    """(V3) Bounds of the attitude under bounds of the signals.

    Raises:
        Rejected: The lift may vanish, the tilt may exceed 1 rad, or the yaw error may reach half a turn.
    """
    x = bounds["x"]
    z = bounds["z"]
    g = ranges.gravity
    lift = z["wanted"]
    room = g - lift
    require_premise(bool(room > g / 10), "V3: z.wanted leaves the lift less than g/10")
    tilt = (x["alpha"] / g).upper()
    require_premise(bool(tilt < 1), "V3: the tilt x.alpha/g may exceed 1 rad")
    require_premise(bool(bounds["psi"]["e"] < arb.pi()), "V3: psi.e may reach half a turn")
    tilt_rate = (x["alpha_dot"] / g).upper()
    yaw_rate = bounds["psi"]["e_dot"]
    desired_tangent = (x["wanted"] / room).upper()
    tilt_defect = (desired_tangent**3 / 2 + lift * desired_tangent / g).upper()
    euler_rate = (tilt_rate + yaw_rate * tilt).upper()
    stiffness = arb(problem["stiffness"])
    tilt_demand = (x["turn"] + stiffness * g * tilt_defect) / g + arb(problem["damping"]) * yaw_rate * tilt
    rate_h = (euler_rate + tilt * yaw_rate).upper()
    rate_z = (yaw_rate + tilt * euler_rate).upper()
    return Attitude(
        tilt=tilt,
        tangent=tilt.tan().upper(),
        secant=(1 / tilt.cos()).upper(),
        tilt_rate=tilt_rate,
        yaw_rate=yaw_rate,
        lift=lift,
        achieved_lift=z["lift"] if problem["rotor_lag"] > 0 else lift,
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
