"""Remainders: the vehicle's deviations from its linear channels, under bounds of its signals, in floating point.

The formulas are those of docs/vehicle_proofs.md, in their order.
"""

import math
from dataclasses import dataclass, replace

from dssc_jax.proofs.problem import Interval
from dssc_jax.proofs.search.vehicle.channels import GRAVITY
from dssc_jax.proofs.search.vehicle.drag import drag_along, drag_in_plane
from dssc_jax.proofs.vehicle_problem import VehicleProblem

Signals = dict[str, dict[str, float]]
"""Bounds of the signals, by channel and name."""


class OutOfRange(Exception):
    """The bounds are so large that the vehicle may leave the range of the theorem."""


@dataclass(frozen=True)
class Attitude:
    """Bounds of attitude and lift: tilt, its tangent and 1/cosine, and rates.

    Args:
        tilt: beta [rad].
        tangent: tan beta.
        secant: 1/cos beta.
        tilt_rate: beta_1 [rad/s].
        yaw_rate: psi_1 [rad/s].
        lift: A_z, of the wanted vertical acceleration [m/s^2].
        carried: Q, of what the rotors achieve of it [m/s^2].
        desired: r_2, how far the desired tilt is from a_h/g [rad].
        euler_rate: T, of |(phi', theta')| [rad/s].
        wanted_tilt: H, of |(eta_phi, eta_theta)| [rad/s^2].
        wanted_yaw: H_psi, of |eta_psi| [rad/s^2].
        frame_h: w_h, of B' E' across body z [rad/s^2].
        frame_z: w_z, of B' E' along body z [rad/s^2].
        rate_h: Omega_h [rad/s].
        rate_z: Omega_z [rad/s].
    """

    tilt: float
    tangent: float
    secant: float
    tilt_rate: float
    yaw_rate: float
    lift: float
    carried: float
    desired: float
    euler_rate: float
    wanted_tilt: float
    wanted_yaw: float
    frame_h: float
    frame_z: float
    rate_h: float
    rate_z: float

    @property
    def rate(self) -> float:
        """Omega_n, of the whole body rate [rad/s]."""
        return math.hypot(self.rate_h, self.rate_z)


@dataclass(frozen=True)
class Rotors:
    """Bounds of the rotors, in a cell of time and in those before it.

    Args:
        smallest: Lower bound of every thrust [N].
        largest: Upper bound of every thrust [N].
        spread: Bound of the difference of two rotors' speeds [rad/s].
        sum: Bound of the sum of the speeds [rad/s].
        shortfall: d, how far a thrust is behind its command [N].
        defect: zeta [N/s].
        spin_up: Bound of the sum of the speeds' rates [rad/s^2].
    """

    smallest: float
    largest: float
    spread: float
    sum: float
    shortfall: float
    defect: float
    spin_up: float


@dataclass(frozen=True)
class Couplings:
    """Bounds of the signals by which the channels of a moving vehicle are coupled.

    Args:
        alpha_gap: Bound of |alpha - alpha_0| [m/s^2].
        wanted_gap: Bound of |a_h - alpha_0| [m/s^2].
        lift_gap: Bound of |a_z - z_m''| [m/s^2].
        yaw_gap: Bound of |psi' - psi_m'| [rad/s].
        lift: Bound of |z_m''| [m/s^2].
        yaw: Bound of |psi_m'| [rad/s].
    """

    alpha_gap: float
    wanted_gap: float
    lift_gap: float
    yaw_gap: float
    lift: float
    yaw: float


@dataclass(frozen=True)
class Moments:
    """Bounds of the wanted angular accelerations' own remainders r_mh and r_mz [rad/s^2, times g for the first]."""

    plane: float
    yaw: float


def attitude_of(problem: VehicleProblem, y: Signals) -> Attitude:
    """Bounds of attitude and lift.

    Raises:
        OutOfRange: the tilt or the lift may leave the range of the theorem.
    """
    x, z, psi = y["x"], y["z"], y["psi"]
    tilt = x["alpha"] / GRAVITY
    lift = z["wanted"]
    if not (tilt < 1.0 and lift < 0.9 * GRAVITY and psi["e"] < math.pi):
        raise OutOfRange
    tilt_rate = x["alpha_dot"] / GRAVITY
    yaw_rate = psi["e_dot"]
    tangent = x["wanted"] / (GRAVITY - lift)
    desired = tangent**3 / 2.0 + lift * tangent / GRAVITY
    rate = tilt_rate + yaw_rate * tilt
    return Attitude(
        tilt=tilt,
        tangent=math.tan(tilt),
        secant=1.0 / math.cos(tilt),
        tilt_rate=tilt_rate,
        yaw_rate=yaw_rate,
        lift=lift,
        carried=z.get("lift", lift),
        desired=desired,
        euler_rate=rate,
        wanted_tilt=x["turn"] / GRAVITY + problem.stiffness * desired + problem.damping * yaw_rate * tilt,
        wanted_yaw=psi["wanted"],
        frame_h=(1.0 + tilt**2) * rate * yaw_rate + tilt * rate**2 / 2.0,
        frame_z=rate**2 / 2.0 + tilt * rate * yaw_rate,
        rate_h=rate + tilt * yaw_rate,
        rate_z=yaw_rate + tilt * rate,
    )


def couplings(inertia: tuple[Interval, ...]) -> tuple[float, float]:
    """j_h and j_z, the largest |J_z - J_y|/J_x, |J_z - J_x|/J_y and |J_x - J_y|/J_z over intervals of the inertia."""
    x, y, z = inertia

    def ratio(a: Interval, b: Interval, over: Interval) -> float:
        return max(a[1] - b[0], b[1] - a[0]) / over[0]

    return max(ratio(z, y, x), ratio(z, x, y)), ratio(x, y, z)


def believed_couplings(problem: VehicleProblem) -> tuple[float, float]:
    """:func:`couplings` of the believed inertia."""
    return couplings(tuple((value, value) for value in problem.believed_inertia))


def moments_of(problem: VehicleProblem, at: Attitude) -> Moments:
    """r_mh and r_mz: by how much the wanted angular acceleration differs from m and eta_psi."""
    j_h, j_z = believed_couplings(problem)
    s = at.tilt
    coupled_h = at.frame_h + j_h * at.rate_h * at.rate_z
    coupled_z = at.frame_z + j_z * at.rate_h**2 / 2.0
    turn_terms = problem.damping * at.yaw_rate * s + s * at.wanted_yaw + s**2 * at.wanted_tilt / 2.0 + coupled_h
    plane = GRAVITY * (problem.stiffness * at.desired + turn_terms)
    return Moments(plane, s * at.wanted_tilt + s**2 * at.wanted_yaw / 2.0 + coupled_z)


def share_of_moments(problem: VehicleProblem, plane: float, yaw: float) -> float:
    """Bound of the thrust that moments J_n times these angular accelerations add to a rotor [N]."""
    j_x, j_y, j_z = problem.believed_inertia
    n = problem.rotors
    return 2.0 * max(j_x, j_y) * plane / (n * problem.arm) + j_z * yaw / (n * problem.torque_coefficient)


def rotors_of(problem: VehicleProblem, y: Signals, at: Attitude, moments: Moments, earlier: Rotors | None) -> Rotors:
    """Bounds of the rotors; those of the cells before count with a lag.

    Raises:
        OutOfRange: a rotor may reach a limit.
    """
    j_h, j_z = believed_couplings(problem)
    n, k = problem.rotors, problem.thrust_coefficient
    mass = problem.believed_mass
    plane = at.wanted_tilt + at.tilt * at.wanted_yaw + at.frame_h + j_h * at.rate_h * at.rate_z
    yaw = at.wanted_yaw + at.tilt * at.wanted_tilt + at.frame_z + j_z * at.rate_h**2 / 2.0
    moment_thrust = share_of_moments(problem, plane, yaw)
    smallest = mass * (GRAVITY - at.lift) / n - moment_thrust
    largest = mass * (GRAVITY + at.lift) * at.secant / n + moment_thrust
    if not (smallest > 0.0 and largest < problem.rotor_limit):
        raise OutOfRange
    if problem.rotor_lag and earlier is not None:
        smallest = min(smallest, earlier.smallest)
        largest = max(largest, earlier.largest)
    spread = (math.sqrt(largest) - math.sqrt(smallest)) / math.sqrt(k)
    total = math.sqrt(n * mass * (GRAVITY + max(at.lift, at.carried)) * at.secant / k)
    rotors = Rotors(smallest, largest, spread, total, shortfall=0.0, defect=0.0, spin_up=0.0)
    if not problem.rotor_lag:
        return rotors
    behind_plane = (y["x"]["behind"] + moments.plane) / GRAVITY
    shortfall = share_of_moments(problem, behind_plane, y["psi"]["behind"] + moments.yaw)
    shortfall += mass * y["z"]["behind"] * at.secant / n
    discriminant_deficit = math.sqrt(n - 4) * shortfall / (2.0 * smallest)
    if discriminant_deficit >= 1.0:
        raise OutOfRange
    shortfall = 2.0 * shortfall / (1.0 + math.sqrt(1.0 - discriminant_deficit))
    if n > 4 and earlier is not None:
        shortfall = max(shortfall, earlier.shortfall)
    defect = shortfall**2 / (4.0 * problem.rotor_lag * smallest)
    spin_up = n * shortfall / (2.0 * problem.rotor_lag * math.sqrt(k * smallest))
    return replace(rotors, shortfall=shortfall, defect=defect, spin_up=spin_up)


@dataclass(frozen=True)
class Air:
    """Bounds of drag over mass in the plane and along z [m/s^2], and of torques over inertia [rad/s^2]."""

    plane: float
    vertical: float
    torque_h: float
    torque_z: float


def air_of(problem: VehicleProblem, y: Signals, at: Attitude, rotors: Rotors, damping: tuple[float, float]) -> Air:
    """Bounds of drag, with its damping in the plane and along z taken away, and of the torques."""
    wind_h, wind_z = problem.wind
    own_h, own_z = y["x"]["speed"], y["z"]["e_dot"]
    speed_h, speed_z = own_h + wind_h, own_z + wind_z
    speed = math.hypot(speed_h, speed_z)
    lightest = problem.mass[0]
    k_h, k_z = (k / lightest for k in problem.structure_drag)
    propellers = problem.propeller_drag
    linear = propellers * rotors.sum / lightest
    tilt_drag = abs(k_h - k_z) * speed
    half = 0.5 * problem.rotors * rotors.spread
    swing_drag = propellers * problem.arm * half * at.rate / lightest
    plane = drag_in_plane(own_h, wind_h, (k_h, linear), speed_z, damping[0])
    vertical = drag_along(own_z, wind_z, (k_z, linear), speed_h, damping[1])
    torque = propellers * problem.arm * (half * speed + problem.arm * rotors.sum * at.rate)
    j_h = min(problem.inertia[0][0], problem.inertia[1][0])
    return Air(
        plane + tilt_drag * (at.tilt * speed_h + speed_z) * at.tilt + swing_drag,
        vertical + tilt_drag * (at.tilt**2 * speed_z + at.tilt * speed_h) + swing_drag,
        (torque + problem.rotor_inertia * half * at.rate_h) / j_h,
        (torque + problem.rotor_inertia * rotors.spin_up) / problem.inertia[2][0],
    )


def remainders_of(
    problem: VehicleProblem,
    y: Signals,
    damping: tuple[float, float],
    earlier: Rotors | None = None,
    couplings: Couplings | None = None,
) -> tuple[Signals, Rotors]:
    """Bounds of the remainders, by channel and name, under bounds of the signals.

    Args:
        problem: The vehicle.
        y: Bounds of the signals, in a cell of time.
        damping: Damping of drag in the plane and along z [1/s].
        earlier: The rotors in the cells before.
        couplings: Bounds of the couplings; None: the problem has no moving reference.

    Raises:
        OutOfRange: the vehicle may leave the range of the theorem.
    """
    at = attitude_of(problem, y)
    moments = moments_of(problem, at)
    rotors = rotors_of(problem, y, at, moments, earlier)
    air = air_of(problem, y, at, rotors, damping)
    k = problem.thrust_deviation
    g = GRAVITY
    lift_force = (1.0 + k) * g * at.tilt * (at.secant - 1.0) + k * at.carried * at.tangent
    lift_force += lift_share(at, couplings)
    forces = {
        "x": lift_force + k * g * at.tilt + air.plane,
        "z": k * at.carried + air.vertical,
    }
    if problem.rotor_lag:
        torque_x, torque_psi = lagged_torques(problem, y, at, air)
    else:
        torque_x, torque_psi = exact_torques(problem, y, at, air, couplings)
    result = {
        "x": {"force": forces["x"], "torque": torque_x},
        "z": {"force": forces["z"]},
        "psi": {"torque": torque_psi},
    }
    if problem.rotor_lag:
        j_x, j_y, j_z = problem.believed_inertia
        n = problem.rotors
        arms = g * problem.arm * n * rotors.defect / (2.0 * min(j_x, j_y))
        result["x"]["lag"] = moments.plane / problem.rotor_lag + at.yaw_rate * y["x"]["gamma"] + arms
        result["z"]["lag"] = n * rotors.defect / problem.believed_mass + (g + at.carried) * at.tangent * at.euler_rate
        twist = problem.torque_coefficient * n * rotors.defect / (2.0 * j_z)
        result["psi"]["lag"] = moments.yaw / problem.rotor_lag + twist
    return result, rotors


def turn_of_plane(problem: VehicleProblem, at: Attitude, yaw_acceleration: float) -> float:
    """The part of b'' that comes from the turn of the plane [rad/s^2]."""
    s = at.tilt
    return yaw_acceleration * s + 2.0 * at.yaw_rate * at.tilt_rate + at.yaw_rate**2 * s


def lift_share(at: Attitude, couplings: Couplings | None) -> float:
    """Bound of the horizontal force due to lift, without its known part [m/s^2]."""
    if couplings is None:
        return at.carried * at.tangent
    gap_force = couplings.lift_gap * GRAVITY * at.tilt + couplings.lift * couplings.alpha_gap
    return at.carried * at.tilt * (at.secant - 1.0) + gap_force / GRAVITY


def coupled_torque(problem: VehicleProblem, y: Signals, at: Attitude, couplings: Couplings | None) -> float:
    """g a_0 r_2 and what the turn of the plane adds to damping, without their known parts."""
    a_0, a_1 = problem.stiffness, problem.damping
    if couplings is None:
        return a_0 * GRAVITY * at.desired + GRAVITY * a_1 * at.yaw_rate * at.tilt
    demand = y["x"]["wanted"]
    tangent = demand / (GRAVITY - at.lift)
    lift_term = (couplings.lift_gap * demand + couplings.lift * couplings.wanted_gap) / GRAVITY
    yaw_term = couplings.yaw_gap * GRAVITY * at.tilt + couplings.yaw * couplings.alpha_gap
    return a_0 * (GRAVITY * tangent**3 / 3.0 + at.lift**2 * tangent / GRAVITY + lift_term) + a_1 * yaw_term


def exact_torques(
    problem: VehicleProblem, y: Signals, at: Attitude, air: Air, couplings: Couplings | None
) -> tuple[float, float]:
    """Remainders of alpha'' and of psi'' without a rotor lag."""
    delta = problem.turn_deviation
    s, t = at.tilt, at.tangent
    x, y_axis, z = problem.inertia
    l_h = max((z[1] + y_axis[1]) / x[0], (z[1] + x[1]) / y_axis[0])
    l_z = (x[1] + y_axis[1]) / z[0]
    m_h = delta * (at.wanted_tilt + s * at.wanted_yaw + at.frame_h + l_h * at.rate_h * at.rate_z) + air.torque_h
    m_z = delta * (at.wanted_yaw + s * at.wanted_tilt + at.frame_z + l_z * at.rate_h**2 / 2.0) + air.torque_z
    psi = t * m_h + at.secant * m_z
    in_plane = GRAVITY * (turn_of_plane(problem, at, at.wanted_yaw + psi) + (1.0 + s * t) * m_h + t * m_z)
    return in_plane + coupled_torque(problem, y, at, couplings), psi


def lagged_torques(problem: VehicleProblem, y: Signals, at: Attitude, air: Air) -> tuple[float, float]:
    """Remainders of alpha'' and of psi'' with a rotor lag."""
    delta = problem.turn_deviation
    s, t = at.tilt, at.tangent
    i_h, i_z = couplings(problem.inertia)
    mu_h = y["x"]["gamma"] / GRAVITY
    mu_z = y["psi"]["gamma"]
    m_h = delta * mu_h + air.torque_h + i_h * at.rate_h * at.rate_z + at.frame_h
    m_z = delta * mu_z + air.torque_z + i_z * at.rate_h**2 / 2.0 + at.frame_z
    psi = t * mu_h + (at.secant - 1.0) * mu_z + t * m_h + at.secant * m_z
    of_plane = turn_of_plane(problem, at, mu_z + psi) + s * t * mu_h + t * mu_z
    return GRAVITY * (of_plane + (1.0 + s * t) * m_h + t * m_z), psi


def slopes_of(problem: VehicleProblem, y: Signals, r: Signals, damping: tuple[float, float]) -> Signals:
    """Bounds of the signals' slopes within a sample, by channel and name."""
    k_v, a_0, a_1 = problem.velocity_gain, problem.stiffness, problem.damping
    lag = problem.rotor_lag
    constant = problem.thrust_deviation * GRAVITY
    l0 = {name: channel.l0 for name, channel in problem.channels.items()}
    x, z, psi = y["x"], y["z"], y["psi"]
    plane = {"e": x["e_dot"], "e_dot": x["acceleration"] + r["x"]["force"], "alpha": x["alpha_dot"]}
    plane["alpha_dot"] = (x["gamma"] if lag else x["turn"]) + r["x"]["torque"]
    plane["speed"] = plane["e_dot"]
    plane["sigma"] = x["bend"] + r["x"]["force"]
    plane["wanted"] = k_v * plane["e_dot"]
    plane["turn"] = a_0 * (plane["wanted"] + x["alpha_dot"]) + a_1 * plane["alpha_dot"]
    plane["acceleration"] = x["alpha_dot"] + damping[0] * plane["e_dot"]
    plane["bend"] = x["alpha_dot"] + abs(l0["x"] - damping[0]) * plane["e_dot"]
    vertical = {"e": z["e_dot"], "e_dot": z["acceleration"] + r["z"]["force"] + constant}
    vertical["sigma"] = z["bend"] + r["z"]["force"] + constant
    vertical["wanted"] = k_v * vertical["e_dot"]
    heading = {"e": psi["e_dot"], "e_dot": (psi["gamma"] if lag else psi["wanted"]) + r["psi"]["torque"]}
    heading["sigma"] = psi["bend"] + r["psi"]["torque"]
    heading["wanted"] = problem.yaw_gain * heading["e_dot"] + problem.yaw_integral_gain * psi["follow"]
    heading["follow"] = heading["e_dot"]
    lift_slope = vertical["wanted"]
    gamma_slope = heading["wanted"]
    if lag:
        plane["gamma"] = x["behind"] / lag + r["x"]["lag"]
        plane["behind"] = plane["turn"] + plane["gamma"]
        lift_slope = vertical["lift"] = z["behind"] / lag + r["z"]["lag"]
        vertical["behind"] = vertical["wanted"] + lift_slope
        gamma_slope = heading["gamma"] = psi["behind"] / lag + r["psi"]["lag"]
        heading["behind"] = heading["wanted"] + gamma_slope
    vertical["acceleration"] = lift_slope + damping[1] * vertical["e_dot"]
    vertical["bend"] = lift_slope + abs(l0["z"] - damping[1]) * vertical["e_dot"]
    heading["bend"] = gamma_slope + l0["psi"] * heading["e_dot"]
    return {name: slopes | {"u_av": 0.0} for name, slopes in (("x", plane), ("z", vertical), ("psi", heading))}
