"""Bounds of the rotors' thrusts and speeds, and of their differences from their commands by a lag.

docs/vehicle_proofs.md has the formulas; comments here give the symbols. An upper bound is rounded up, a lower bound
down.
"""

from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import maximum, minimum, require_premise
from dssc_jax.proofs.verifier.vehicle.attitude import Attitude
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import SignalBalls
from dssc_jax.proofs.verifier.vehicle.ranges import Ranges

LEAST_ROTORS = 4
"""Number of rotors whose thrusts follow from net thrust and moments alone."""


class Rotors(NamedTuple):
    """Bounds of the rotors' thrusts and speeds.

    Args:
        smallest: f_min, lower bound of every thrust [N].
        largest: f_max, upper bound of every thrust [N].
        difference: w_o, bound of the difference of two rotors' speeds [rad/s].
        sum: o_S, bound of the sum of the speeds [rad/s].
    """

    smallest: arb
    largest: arb
    difference: arb
    sum: arb


class RotorLag(NamedTuple):
    """Bounds of the differences that the rotors' lag causes; all are 0 without a lag.

    Args:
        moment_h: r_mh, bound of the difference of g times the commanded angular acceleration across body z from m
            [m/s^2].
        moment_z: r_mz, bound of the difference of the commanded angular acceleration along body z from eta_psi
            [rad/s^2].
        shortfall: d, bound of |f_ci - f_i|, the difference of a thrust from its command [N].
        defect: zeta, bound of the difference of a thrust's derivative, where the speed has the lag, from that of a
            thrust with the same lag [N/s].
        spin_up: Bound of the signed sum of the speeds' derivatives [rad/s^2].
    """

    moment_h: arb
    moment_z: arb
    shortfall: arb
    defect: arb
    spin_up: arb


def rotors_of(problem: VehicleProblem, ranges: Ranges, attitude: Attitude, earlier: Rotors | None) -> Rotors:
    """(V3) Bounds of the rotors' thrusts and speeds.

    Args:
        problem: The certificate's problem.
        ranges: Extremes over the problem's intervals.
        attitude: Bounds of the attitude.
        earlier: Bounds of the rotors in the time cell before, which still limit the thrusts if the rotors have a lag;
            None in the first cell.

    Raises:
        Rejected: The command of a thrust may reach 0 or its limit.
    """
    n = arb(problem["rotors"])
    believed_mass = arb(problem["believed_mass"])
    coefficient = arb(problem["thrust_coefficient"])
    g = ranges.gravity
    m_h = (  # M_h, bound of the commanded angular acceleration across body z
        attitude.tilt_demand
        + attitude.tilt * attitude.yaw_demand
        + attitude.frame_h
        + ranges.believed_ratio_h * attitude.rate_h * attitude.rate_z
    )
    m_z = (  # M_z, the same along body z
        attitude.yaw_demand
        + attitude.tilt * attitude.tilt_demand
        + attitude.frame_z
        + ranges.believed_ratio_z * attitude.rate_h * attitude.rate_h / 2
    )
    by_moment = moment_thrust(problem, ranges, m_h, m_z)  # d_M
    smallest = (believed_mass * (g - attitude.lift) / n - by_moment).lower()
    largest = (believed_mass * (g + attitude.lift) * attitude.secant / n + by_moment).upper()
    require_premise(bool(smallest > 0), "V3: a rotor's commanded thrust may reach 0")
    require_premise(bool(largest < arb(problem["rotor_limit"])), "V3: a rotor's commanded thrust may reach its limit")
    lift = g + maximum(attitude.lift, attitude.achieved_lift)
    if earlier is not None and problem["rotor_lag"] > 0:  # the thrusts follow the commands of earlier cells
        smallest = minimum(smallest, earlier.smallest)
        largest = maximum(largest, earlier.largest)
    return Rotors(
        smallest=smallest,
        largest=largest,
        difference=((largest.sqrt() - smallest.sqrt()) / coefficient.sqrt()).upper(),
        sum=(n * believed_mass * lift * attitude.secant / coefficient).sqrt().upper(),
    )


def moment_thrust(problem: VehicleProblem, ranges: Ranges, m_h: arb, m_z: arb) -> arb:
    """Bound of the thrust that the allocation adds to a rotor for commanded angular accelerations [N].

    Args:
        problem: The certificate's problem.
        ranges: Extremes over the problem's intervals.
        m_h: Bound of the angular acceleration across body z [rad/s^2].
        m_z: Bound of the angular acceleration along body z [rad/s^2].
    """
    n = arb(problem["rotors"])
    across = 2 * ranges.believed_h * m_h / (n * arb(problem["arm"]))
    return across + ranges.believed_z * m_z / (n * arb(problem["torque_coefficient"]))


def rotor_lag_of(
    problem: VehicleProblem,
    ranges: Ranges,
    bounds: SignalBalls,
    attitude: Attitude,
    rotors: Rotors,
    earlier_shortfall: arb | None,
) -> RotorLag:
    """(V3) Bounds of the differences that the rotors' lag causes; zeros without a lag.

    In a later time cell the part xi of :func:`largest_shortfall` begins with its value at the end of the cell before.
    So d is the larger one of this cell's d and the earlier cell's. With more than four rotors, the earlier d must be at
    most 4 f_min/(n - 4)^(1/2). The larger root of the equation for d is not below this limit, so xi cannot reach it.

    Args:
        problem: The certificate's problem.
        ranges: Extremes over the problem's intervals.
        bounds: Bounds of the signals.
        attitude: Bounds of the attitude.
        rotors: Bounds of the rotors.
        earlier_shortfall: The shortfall d in the time cell before [N]; None in the first cell.

    Raises:
        Rejected: The rotors may be too far behind their commands.
    """
    if problem["rotor_lag"] == 0:
        zero = arb(0)
        return RotorLag(moment_h=zero, moment_z=zero, shortfall=zero, defect=zero, spin_up=zero)
    n = arb(problem["rotors"])
    time_constant = arb(problem["rotor_lag"])
    g = ranges.gravity
    s = attitude.tilt
    tilt_demand = attitude.tilt_demand
    yaw_demand = attitude.yaw_demand
    rate_h = attitude.rate_h
    coupled_h = attitude.frame_h + ranges.believed_ratio_h * rate_h * attitude.rate_z
    turn_terms = arb(problem["damping"]) * attitude.yaw_rate * s + s * yaw_demand + s * s * tilt_demand / 2 + coupled_h
    moment_h = (arb(problem["stiffness"]) * g * attitude.tilt_defect + g * turn_terms).upper()  # r_mh
    coupled_z = ranges.believed_ratio_z * rate_h * rate_h / 2
    moment_z = (s * tilt_demand + s * s * yaw_demand / 2 + attitude.frame_z + coupled_z).upper()  # r_mz
    behind_h = bounds["x"]["behind"] + moment_h
    behind_z = bounds["psi"]["behind"] + moment_z
    d_4 = arb(problem["believed_mass"]) * bounds["z"]["behind"] * attitude.secant / n
    d_4 = d_4 + 2 * ranges.believed_h * behind_h / (g * n * arb(problem["arm"]))
    d_4 = d_4 + ranges.believed_z * behind_z / (n * arb(problem["torque_coefficient"]))
    shortfall = largest_shortfall(n, d_4, rotors.smallest)
    if earlier_shortfall is not None and problem["rotors"] > LEAST_ROTORS:
        is_bounded = (n - LEAST_ROTORS).sqrt() * earlier_shortfall <= 4 * rotors.smallest
        require_premise(bool(is_bounded), "V3: the rotors may be too far behind their commands")
        shortfall = maximum(shortfall, earlier_shortfall)
    defect = shortfall * shortfall / (4 * time_constant * rotors.smallest)  # zeta
    spin_up = n * shortfall / (2 * time_constant * (arb(problem["thrust_coefficient"]) * rotors.smallest).sqrt())
    return RotorLag(moment_h, moment_z, shortfall, defect.upper(), spin_up.upper())


def largest_shortfall(n: arb, d_4: arb, f_min: arb) -> arb:
    """(V3) d, a bound of |f_ci - f_i|, the difference of each rotor's thrust from its command [N].

    With more than four rotors the thrusts f_i have a part xi_i in the null space of the allocation, too. The commands
    f_ci have none, so xi' = -xi/tau - (projection of the zeta_i on that space), with the lag tau and the defects zeta_i
    of the rotors. The projection's rows have the norm ((n - 4)/n)^(1/2) and the sum 0. Each zeta_i lies in [0, zeta],
    where zeta is at most d^2/(4 tau f_min). So |xi_i| is at most tau (n - 4)^(1/2) zeta/2. As xi is continuous and
    begins at 0, d stays below the smaller root of d = d_4 + (n - 4)^(1/2) d^2/(8 f_min).

    Args:
        n: Number of rotors.
        d_4: Bound of the part of the shortfall that belongs to net thrust and moments [N].
        f_min: Smallest thrust [N].

    Raises:
        Rejected: The equation for d has no root.
    """
    deficit = (n - LEAST_ROTORS).sqrt() * d_4 / (2 * f_min)  # 1 less the discriminant
    require_premise(bool(deficit < 1), "V3: the rotors may be too far behind their commands")
    return (2 * d_4 / (1 + (1 - deficit).sqrt())).upper()
