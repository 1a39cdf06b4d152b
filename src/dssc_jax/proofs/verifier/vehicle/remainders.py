"""The map F of the page, from bounds of the signals to bounds of the remainders: each number is rounded up.

The names are the page's; docs/vehicle_proofs.md has the formulas in this order. A lower bound, such as the smallest
thrust of a rotor, is rounded down.
"""

from collections.abc import Mapping
from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, maximum, require_premise
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem
from dssc_jax.proofs.verifier.vehicle.drag import DragRegion, plane_drag, vertical_drag
from dssc_jax.proofs.verifier.vehicle.nominal import Coupling
from dssc_jax.proofs.verifier.vehicle.ranges import Ranges

LEAST_ROTORS = 4
"""Number of rotors whose thrusts follow from net thrust and moments."""
SignalBalls = Mapping[str, Mapping[str, arb]]
"""Bounds of the signals, by channel and name."""


class Attitude(NamedTuple):
    """How far the vehicle tilts and turns: s, t, S, beta_1, psi_1, A_z, Q, r_2, T, H, H_psi, w, Omega of the page."""

    s: arb
    t: arb
    secant: arb
    beta_1: arb
    psi_1: arb
    a: arb
    q: arb
    r_2: arb
    turning: arb
    h: arb
    n: arb
    w_h: arb
    w_z: arb
    rate_h: arb
    rate_z: arb
    rate: arb


class Rotors(NamedTuple):
    """The rotors' thrusts and speeds: f_min, f_max, w_o and o_S of the page; f_min is a lower bound."""

    smallest: arb
    largest: arb
    difference: arb
    sum: arb


class Behind(NamedTuple):
    """How far the rotors lag behind their commands: r_mh, r_mz, d, zeta and spin-up of the page."""

    r_mh: arb
    r_mz: arb
    d: arb
    zeta: arb
    spin_up: arb


class DragBounds(NamedTuple):
    """D_h, D_z, x_h, x_z, tau_h and tau_z of the page."""

    d_h: arb
    d_z: arb
    x_h: arb
    x_z: arb
    tau_h: arb
    tau_z: arb


class Remainders(NamedTuple):
    """Bounds of the remainders, by channel and name, and of the constant o; the tilt, the rotors' thrusts, and d."""

    channels: dict[str, Balls]
    constant: arb
    tilt: arb
    rotors: Rotors
    behind_by: arb


def attitude_of(problem: VehicleProblem, at: Ranges, bounds: SignalBalls) -> Attitude:
    """(V3) Tilt and turn, where the lift is positive and the tilt below 1 rad."""
    x = bounds["x"]
    z = bounds["z"]
    g = at.gravity
    a = z["wanted"]
    room = g - a
    require_premise(bool(room > g / 10), "V3: z.wanted leaves the lift less than g/10")
    s = (x["alpha"] / g).upper()
    require_premise(bool(s < 1), "V3: the tilt x.alpha/g may exceed 1 rad")
    require_premise(bool(bounds["psi"]["e"] < arb.pi()), "V3: psi.e may reach half a turn")
    beta_1 = (x["alpha_dot"] / g).upper()
    psi_1 = bounds["psi"]["e_dot"]
    t_d = (x["wanted"] / room).upper()
    r_2 = (t_d**3 / 2 + a * t_d / g).upper()
    turning = (beta_1 + psi_1 * s).upper()
    stiffness = arb(problem["stiffness"])
    h = (x["turn"] + stiffness * g * r_2) / g + arb(problem["damping"]) * psi_1 * s
    rate_h = (turning + s * psi_1).upper()
    rate_z = (psi_1 + s * turning).upper()
    return Attitude(
        s=s,
        t=s.tan().upper(),
        secant=(1 / s.cos()).upper(),
        beta_1=beta_1,
        psi_1=psi_1,
        a=a,
        q=z["lift"] if problem["rotor_lag"] > 0 else a,
        r_2=r_2,
        turning=turning,
        h=h.upper(),
        n=bounds["psi"]["wanted"],
        w_h=((1 + s * s) * turning * psi_1 + s * turning * turning / 2).upper(),
        w_z=(turning * turning / 2 + s * turning * psi_1).upper(),
        rate_h=rate_h,
        rate_z=rate_z,
        rate=(rate_h * rate_h + rate_z * rate_z).sqrt().upper(),
    )


def rotors_of(problem: VehicleProblem, at: Ranges, body: Attitude, earlier: Remainders | None = None) -> Rotors:
    """(V3) The thrusts of the rotors, where all are within their limits, and their speeds.

    With a lag the thrusts follow their commands, so that those of the cells before still count.
    """
    n = arb(problem["rotors"])
    believed_mass = arb(problem["believed_mass"])
    coefficient = arb(problem["thrust_coefficient"])
    g = at.gravity
    m_h = body.h + body.s * body.n + body.w_h + at.j_h * body.rate_h * body.rate_z
    m_z = body.n + body.s * body.h + body.w_z + at.j_z * body.rate_h * body.rate_h / 2
    by_moment = 2 * at.believed_h * m_h / (n * arb(problem["arm"]))
    by_moment = by_moment + at.believed_z * m_z / (n * arb(problem["torque_coefficient"]))
    smallest = (believed_mass * (g - body.a) / n - by_moment).lower()
    largest = (believed_mass * (g + body.a) * body.secant / n + by_moment).upper()
    require_premise(bool(smallest > 0), "V3: a rotor's commanded thrust may reach 0")
    require_premise(bool(largest < arb(problem["rotor_limit"])), "V3: a rotor's commanded thrust may reach its limit")
    lift = g + maximum(body.a, body.q)
    if earlier is not None and problem["rotor_lag"] > 0:
        smallest = smallest if smallest <= earlier.rotors.smallest else earlier.rotors.smallest
        largest = maximum(largest, earlier.rotors.largest)
    return Rotors(
        smallest,
        largest,
        ((largest.sqrt() - smallest.sqrt()) / coefficient.sqrt()).upper(),
        (n * believed_mass * lift * body.secant / coefficient).sqrt().upper(),
    )


def behind_of(
    problem: VehicleProblem,
    at: Ranges,
    bounds: SignalBalls,
    body: Attitude,
    rotors: Rotors,
    earlier: Remainders | None = None,
) -> Behind:
    """How far rotors with a lag are behind their commands; zero without a lag.

    In a later cell the part xi of :func:`farthest_behind` begins with what it had before. So d is the larger of its
    value and of that before. The latter must be at most 4 f_min/(n - 4)^(1/2), which the larger root is not below: then
    xi cannot grow beyond what belongs to d.
    """
    if problem["rotor_lag"] == 0:
        return Behind(arb(0), arb(0), arb(0), arb(0), arb(0))
    n = arb(problem["rotors"])
    lag = arb(problem["rotor_lag"])
    g = at.gravity
    s = body.s
    product = body.w_h + at.j_h * body.rate_h * body.rate_z
    inner = arb(problem["damping"]) * body.psi_1 * s + s * body.n + s * s * body.h / 2 + product
    r_mh = (arb(problem["stiffness"]) * g * body.r_2 + g * inner).upper()
    r_mz = (s * body.h + s * s * body.n / 2 + body.w_z + at.j_z * body.rate_h * body.rate_h / 2).upper()
    d = arb(problem["believed_mass"]) * bounds["z"]["behind"] * body.secant / n
    d = d + 2 * at.believed_h * (bounds["x"]["behind"] + r_mh) / (g * n * arb(problem["arm"]))
    d = d + at.believed_z * (bounds["psi"]["behind"] + r_mz) / (n * arb(problem["torque_coefficient"]))
    d = farthest_behind(n, d, rotors.smallest)
    if earlier is not None and problem["rotors"] > LEAST_ROTORS:
        is_bounded = (n - LEAST_ROTORS).sqrt() * earlier.behind_by <= 4 * rotors.smallest
        require_premise(bool(is_bounded), "V3: the rotors may be too far behind their commands")
        d = maximum(d, earlier.behind_by)
    zeta = d * d / (4 * lag * rotors.smallest)
    slowest = (arb(problem["thrust_coefficient"]) * rotors.smallest).sqrt()
    return Behind(r_mh, r_mz, d, zeta.upper(), (n * d / (2 * lag * slowest)).upper())


def farthest_behind(n: arb, d_4: arb, f_min: arb) -> arb:
    """(V3) A bound d of |f_ci - f_i|, the shortfall of each rotor's thrust behind its command.

    ``n`` is the number of rotors, ``d_4`` bounds the part that belongs to net thrust and moments, and ``f_min`` is the
    least thrust. With more than four rotors f_i has a part xi_i in the null space of the allocation, too. f_c has none,
    so xi' = -xi/tau - (projection of the zeta_i on that space), with the lag tau and the defects zeta_i of the rotors.
    The projection's rows have the norm ((n - 4)/n)^(1/2) and the sum 0. Each zeta_i lies in [0, zeta], where zeta is at
    most d^2/(4 tau f_min). So |xi_i| is at most tau (n - 4)^(1/2) zeta/2. As xi is continuous and begins at 0, d stays
    below the smaller root of d = d_4 + (n - 4)^(1/2) d^2/(8 f_min).
    """
    discriminant_deficit = (n - LEAST_ROTORS).sqrt() * d_4 / (2 * f_min)
    require_premise(bool(discriminant_deficit < 1), "V3: the rotors may be too far behind their commands")
    return (2 * d_4 / (1 + (1 - discriminant_deficit).sqrt())).upper()


def drag_of(
    problem: VehicleProblem,
    at: Ranges,
    bounds: SignalBalls,
    dampings: Mapping[str, float],
    body: Attitude,
    rotors: Rotors,
    behind: Behind,
) -> DragBounds:
    """Bounds of the drag of structure and propellers, and of the rotors' gyroscopic torque."""
    n = arb(problem["rotors"])
    k_h, k_z = map(arb, problem["structure_drag"])
    k_p = arb(problem["propeller_drag"])
    wind_h, wind_z = map(arb, problem["wind"])
    arm = arb(problem["arm"])
    hub = arb(problem["rotor_inertia"])
    speed_h = bounds["x"]["speed"]
    speed_z = bounds["z"]["e_dot"]
    v_h = (speed_h + wind_h).upper()
    z = (speed_z + wind_z).upper()
    r = (v_h * v_h + z * z).sqrt().upper()
    by_rotors = (k_p * rotors.sum / at.mass_low).upper()
    region_h = DragRegion(
        speed=speed_h,
        wind=wind_h,
        damping=arb(dampings["x"]),
        drag=k_h,
        mass_low=at.mass_low,
        mass_high=at.mass_high,
        across=z,
        by_rotors=by_rotors,
    )
    region_z = DragRegion(
        speed=speed_z,
        wind=wind_z,
        damping=arb(dampings["z"]),
        drag=k_z,
        mass_low=at.mass_low,
        mass_high=at.mass_high,
        across=v_h,
        by_rotors=by_rotors,
    )
    s = body.s
    tilt_drag = abs(k_h - k_z) * r / at.mass_low
    by_speeds = k_p * arm * n * rotors.difference * body.rate / (2 * at.mass_low)
    blades = k_p * arm * (n * rotors.difference * r / 2 + arm * rotors.sum * body.rate)
    gyroscopic = hub * n * rotors.difference * body.rate_h / 2
    return DragBounds(
        d_h=plane_drag(region_h),
        d_z=vertical_drag(region_z),
        x_h=(tilt_drag * (s * v_h + z) * s + by_speeds).upper(),
        x_z=(tilt_drag * (s * s * z + s * v_h) + by_speeds).upper(),
        tau_h=((blades + gyroscopic) / at.inertia_h).upper(),
        tau_z=((blades + hub * behind.spin_up) / at.inertia_z).upper(),
    )


def remainders_of(
    problem: VehicleProblem,
    at: Ranges,
    bounds: SignalBalls,
    dampings: Mapping[str, float],
    earlier: Remainders | None = None,
    coupling: Coupling | None = None,
) -> Remainders:
    """(V3) The remainders under bounds of the signals, without their known parts.

    Args:
        problem: The certificate's problem.
        at: What its intervals come to.
        bounds: Bounds of the signals.
        dampings: c of x and z.
        earlier: The remainders of the time cell before; None in the first one.
        coupling: What couples the channels, with a moving reference; then there is no rotor lag.
    """
    body = attitude_of(problem, at, bounds)
    rotors = rotors_of(problem, at, body, earlier)
    behind = behind_of(problem, at, bounds, body, rotors, earlier)
    drag = drag_of(problem, at, bounds, dampings, body, rotors, behind)
    g = at.gravity
    k = at.k
    s = body.s
    force = (1 + k) * g * s * (body.secant - 1) + k * g * s + k * body.q * body.t + drag.d_h + drag.x_h
    force = force + lift_force(at, body, coupling)
    if problem["rotor_lag"] == 0:
        plane, yaw = torques(problem, at, bounds, body, drag, coupling)
    else:
        plane, yaw = torques_behind(problem, at, bounds, body, drag, behind)
    by_lift = {"force": (k * body.q + drag.d_z + drag.x_z).upper()}
    if problem["rotor_lag"] > 0:
        shortfall = arb(problem["rotors"]) * behind.zeta / arb(problem["believed_mass"])
        by_lift["lag"] = (shortfall + (g + body.q) * body.t * body.turning).upper()
    channels = {"x": {"force": force.upper()} | plane, "z": by_lift, "psi": yaw}
    return Remainders(channels, (k * g).upper(), s, rotors, behind.d)


def lift_force(at: Ranges, body: Attitude, coupling: Coupling | None) -> arb:
    """q beta, without z_m'' alpha_0/g where the reference moves."""
    if coupling is None:
        return body.q * body.t
    gap_force = (coupling.lift * at.gravity * body.s + coupling.lift_known * coupling.alpha) / at.gravity
    return body.q * body.s * (body.secant - 1) + gap_force


def coupled_torque(
    problem: VehicleProblem, at: Ranges, bounds: SignalBalls, body: Attitude, coupling: Coupling | None
) -> arb:
    """a_0 g r_2 and a_1 psi' Q alpha, without their known parts where the reference moves."""
    g = at.gravity
    stiffness = arb(problem["stiffness"])
    damping = arb(problem["damping"])
    if coupling is None:
        return stiffness * g * body.r_2 + g * damping * body.psi_1 * body.s
    demand = bounds["x"]["wanted"]
    t_d = demand / (g - body.a)
    tilt_term = g * t_d**3 / 3 + body.a * body.a * t_d / g
    lift_term = (coupling.lift * demand + coupling.lift_known * coupling.wanted) / g
    yaw_term = coupling.yaw * g * body.s + coupling.yaw_known * coupling.alpha
    return stiffness * (tilt_term + lift_term) + damping * yaw_term


def torques(
    problem: VehicleProblem,
    at: Ranges,
    bounds: SignalBalls,
    body: Attitude,
    drag: DragBounds,
    coupling: Coupling | None,
) -> tuple[Balls, Balls]:
    """The remainders of the rotation, of x and of psi, without a rotor lag."""
    s, t, psi_1 = body.s, body.t, body.psi_1
    m_h = body.h + s * body.n + body.w_h + at.l_h * body.rate_h * body.rate_z
    m_z = body.n + s * body.h + body.w_z + at.l_z * body.rate_h * body.rate_h / 2
    m_h = at.delta * m_h + drag.tau_h
    m_z = at.delta * m_z + drag.tau_z
    yaw = (t * m_h + body.secant * m_z).upper()
    turn = (body.n + yaw) * s + 2 * psi_1 * body.beta_1 + psi_1 * psi_1 * s
    turn = turn + (1 + s * t) * m_h + t * m_z
    plane = at.gravity * turn + coupled_torque(problem, at, bounds, body, coupling)
    return {"torque": plane.upper()}, {"torque": yaw}


def torques_behind(
    problem: VehicleProblem, at: Ranges, bounds: SignalBalls, body: Attitude, drag: DragBounds, behind: Behind
) -> tuple[Balls, Balls]:
    """The remainders of the rotation, of x and of psi, with a rotor lag."""
    s, t, psi_1 = body.s, body.t, body.psi_1
    g = at.gravity
    lag = arb(problem["rotor_lag"])
    mu_h = (bounds["x"]["gamma"] / g).upper()
    mu_z = bounds["psi"]["gamma"]
    m_h = at.delta * mu_h + drag.tau_h + at.i_h * body.rate_h * body.rate_z + body.w_h
    m_z = at.delta * mu_z + drag.tau_z + at.i_z * body.rate_h * body.rate_h / 2 + body.w_z
    yaw = (t * mu_h + (body.secant - 1) * mu_z + t * m_h + body.secant * m_z).upper()
    turn = (mu_z + yaw) * s + 2 * psi_1 * body.beta_1 + psi_1 * psi_1 * s
    turn = turn + s * t * mu_h + t * mu_z + (1 + s * t) * m_h + t * m_z
    shortfall = arb(problem["rotors"]) * behind.zeta / 2
    by_arm = g * arb(problem["arm"]) * shortfall / at.believed_l
    plane = {
        "torque": (g * turn).upper(),
        "lag": (behind.r_mh / lag + psi_1 * bounds["x"]["gamma"] + by_arm).upper(),
    }
    by_spin = arb(problem["torque_coefficient"]) * shortfall / at.believed_z
    return plane, {"torque": yaw, "lag": (behind.r_mz / lag + by_spin).upper()}
