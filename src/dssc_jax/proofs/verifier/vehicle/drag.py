"""Bounds of the part of the drag that the linear channels' damping does not contain, and of the torques by drag.

The drag over mass is -x r, where r = v - w is the velocity v of the vehicle relative to the wind w. The linear channels
contain -c v. So the supremum of the rest, |-x r + c v|, is taken under bounds of v and w. The factor x is between
k |r|/M_+ and X(|r|) = k (|r|^2 + V^2)^(1/2)/M_- + x_0, where V is V_z in the plane and V_h along z.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import maximum, minimum, require_premise
from dssc_jax.proofs.verifier.intervals import Intervals, exactly, outwards
from dssc_jax.proofs.verifier.vehicle.attitude import Attitude
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import SignalBalls
from dssc_jax.proofs.verifier.vehicle.ranges import Ranges
from dssc_jax.proofs.verifier.vehicle.rotors import RotorLag, Rotors

CELLS = 4096
"""Number of cells of |r| in the plane. A cell's enclosure exceeds what is reached in it by about 1/CELLS."""


class DragRegion(NamedTuple):
    """Bounds of velocity and wind along z or in the plane, and the coefficients of drag there.

    Args:
        speed: a_max, bound of |v| [m/s].
        wind: W, bound of |w| [m/s].
        damping: c, the damping of the linear channel [1/s].
        drag: k, the coefficient of the structure's drag [N s^2/m^2].
        mass_low: M_-, the smallest mass [kg].
        mass_high: M_+, the largest mass [kg].
        across: V, bound of the air's relative speed across v [m/s]: V_z in the plane, V_h along z.
        by_rotors: x_0, the propellers' share of the factor x [1/s].
    """

    speed: arb
    wind: arb
    damping: arb
    drag: arb
    mass_low: arb
    mass_high: arb
    across: arb
    by_rotors: arb


class DragBounds(NamedTuple):
    """Bounds of drag over mass and of torques over inertia.

    Args:
        drag_h: D_h, bound of |-x r + c v| in the plane [m/s^2].
        drag_z: D_z, bound of |-x r + c v| along z [m/s^2].
        tilted_h: x_h, bound of the additional drag in the plane by tilt and unequal rotor speeds [m/s^2].
        tilted_z: x_z, bound of the additional drag along z by tilt and unequal rotor speeds [m/s^2].
        torque_h: tau_h, bound of the torque across body z over inertia [rad/s^2].
        torque_z: tau_z, bound of the torque along body z over inertia [rad/s^2].
    """

    drag_h: arb
    drag_z: arb
    tilted_h: arb
    tilted_z: arb
    torque_h: arb
    torque_z: arb


def drag_of(
    problem: VehicleProblem,
    ranges: Ranges,
    bounds: SignalBalls,
    dampings: Mapping[str, float],
    attitude: Attitude,
    rotors: Rotors,
    lag: RotorLag,
) -> DragBounds:
    """Bounds of the drag of structure and propellers, less the channels' damping, and of the torques on the body.

    The torques come from the propellers' drag and from the rotors' spin: gyroscopic, and by spinning up.

    Args:
        problem: The certificate's problem.
        ranges: Extremes over the problem's intervals.
        bounds: Bounds of the signals by which the body moves, by channel and name.
        dampings: Damping of drag c in the linear channels of x and z [1/s].
        attitude: Bounds of the attitude.
        rotors: Bounds of the rotors.
        lag: Bounds of the rotors' lag behind their commands.
    """
    n = arb(problem["rotors"])
    k_h, k_z = map(arb, problem["structure_drag"])
    k_p = arb(problem["propeller_drag"])
    wind_h, wind_z = map(arb, problem["wind"])
    arm = arb(problem["arm"])
    rotor_inertia = arb(problem["rotor_inertia"])
    air_speed_h = (bounds["x"]["speed"] + wind_h).upper()  # V_h
    air_speed_z = (bounds["z"]["e_dot"] + wind_z).upper()  # V_z
    air_speed = (air_speed_h * air_speed_h + air_speed_z * air_speed_z).sqrt().upper()  # V_r
    by_rotors = (k_p * rotors.sum / ranges.mass_low).upper()  # k_p o_S/M_-
    region_h = DragRegion(
        speed=bounds["x"]["speed"],
        wind=wind_h,
        damping=arb(dampings["x"]),
        drag=k_h,
        mass_low=ranges.mass_low,
        mass_high=ranges.mass_high,
        across=air_speed_z,
        by_rotors=by_rotors,
    )
    region_z = region_h._replace(
        speed=bounds["z"]["e_dot"], wind=wind_z, damping=arb(dampings["z"]), drag=k_z, across=air_speed_h
    )
    s = attitude.tilt
    tilt_drag = abs(k_h - k_z) * air_speed / ranges.mass_low
    rotation_drag = k_p * arm * n * rotors.difference * attitude.rate / (2 * ranges.mass_low)
    propeller_torque = k_p * arm * (n * rotors.difference * air_speed / 2 + arm * rotors.sum * attitude.rate)
    gyroscopic_torque = rotor_inertia * n * rotors.difference * attitude.rate_h / 2
    return DragBounds(
        drag_h=plane_drag(region_h),
        drag_z=vertical_drag(region_z),
        tilted_h=(tilt_drag * (s * air_speed_h + air_speed_z) * s + rotation_drag).upper(),
        tilted_z=(tilt_drag * (s * s * air_speed_z + s * air_speed_h) + rotation_drag).upper(),
        torque_h=((propeller_torque + gyroscopic_torque) / ranges.inertia_h).upper(),
        torque_z=((propeller_torque + rotor_inertia * lag.spin_up) / ranges.inertia_z).upper(),
    )


def steepest(region: DragRegion, b: arb) -> arb:
    """X(b), the largest factor x [1/s] of the relative velocity r in the drag -x r, where |r| = b [m/s]."""
    return region.drag * (b * b + region.across * region.across).sqrt() / region.mass_low + region.by_rotors


def vertical_drag(region: DragRegion) -> arb:
    """The supremum of |-x r + c v| over numbers v and w along z, in closed form [m/s^2].

    By symmetry v = a >= 0, so r is between a - W and a + W.

    1. r < 0, b = -r: |-x r + c v| = x b + c a, largest at b = W - a and x = X(b). This is convex in a, as X(b) b is
       convex in b; so its largest value over 0 <= a <= min(a_max, W) is at an end.
    2. r >= 0, x r - c a: largest at r = a + W and x = X(r), convex in a, so at a = 0, as above, or at a = a_max.
    3. r >= 0, c a - x r: largest at the smallest r and x. If a <= W, r = 0 and c a is less than in the first case. Else
       it is c a - k (a - W)^2/M_+, which rises until a - W = c M_+/(2 k), to c W + c^2 M_+/(4 k).
    """
    speed = region.speed
    wind = region.wind
    damping = region.damping
    farthest = speed + wind
    largest_a = minimum(speed, wind)
    slowest = wind - largest_a
    candidates = [
        steepest(region, wind) * wind,  # case 1 at a = 0
        steepest(region, slowest) * slowest + damping * largest_a,  # case 1 at the largest a
        abs(steepest(region, farthest) * farthest - damping * speed),  # case 2 at a = a_max
    ]
    excess = speed - wind
    if excess > 0:  # case 3
        peak = damping * region.mass_high / 2  # k (a - W) where it is largest
        if region.drag * excess <= peak:
            candidates.append(damping * speed - region.drag * excess * excess / region.mass_high)
        else:
            candidates.append(damping * wind + damping * peak / (2 * region.drag))
    supremum = arb(0)
    for candidate in candidates:
        require_premise(candidate.is_finite(), "V4: the drag is not finite")
        supremum = maximum(supremum, candidate.upper())
    return supremum


@np.errstate(invalid="ignore", over="ignore")  # what is not finite is refused
def plane_drag(region: DragRegion) -> arb:
    """An upper bound of |-x r + c v| over vectors v and w of the plane, about 1/CELLS above the supremum [m/s^2].

    Let a = |v| and b = |r|. Then |-x r + c v|^2 = x^2 b^2 + c^2 a^2 - 2 x c r.v is convex in x, so that both ends of x
    count. As w = v - r, |w|^2 = a^2 + b^2 - 2 r.v is at most W^2 if and only if r.v >= (a^2 + b^2 - W^2)/2; and r.v >=
    -a b anyway. The larger of both is the smallest possible r.v, at most a b if |a - b| <= W. There remain x, a and b:

    * a + b <= W: r.v = -a b, and x b + c a rises with a, up to a = min(V, W - b).
    * a + b > W: x^2 b^2 - x c (b^2 - W^2) + c (c - x) a^2 is monotone in a^2, so that the smallest or the largest a
      counts, |b - W| or min(V, b + W).

    So a = min(V, |b - W|) and a = min(V, b + W) suffice for each b from 0 to V + W, which is cut into cells.
    """
    farthest = enclosing_interval(region.speed + region.wind).high
    edges = farthest * np.linspace(0.0, 1.0, CELLS + 1)
    b = Intervals(edges[:-1], edges[1:])
    speed, wind, damping, drag, light, heavy, across, by_rotors = map(enclosing_interval, region)
    lowest = drag * b / heavy  # of x
    highest = drag * square_roots(b * b + across * across) / light + by_rotors  # X(b)
    squares = []
    for a in (at_most(magnitudes(b - wind), speed), at_most(b + wind, speed)):
        product = a * b
        by_wind = (a * a + b * b - wind * wind) * exactly(0.5)  # (a^2 + b^2 - W^2)/2
        smallest = Intervals(  # the smallest r.v, the larger one of -a b and this
            np.maximum(-product.high, by_wind.low), np.maximum(-product.low, by_wind.high)
        )
        for x in (lowest, highest):
            drag_part = x * b
            damping_part = damping * a
            square = drag_part * drag_part + damping_part * damping_part - exactly(2.0) * damping * x * smallest
            squares.append(square.high)
    largest_square = float(np.max(squares))
    require_premise(bool(np.isfinite(largest_square)), "V4: the drag is not finite")
    return arb(largest_square).sqrt().upper()


def magnitudes(values: Intervals) -> Intervals:
    """Intervals of |x| for x in each interval of an array."""
    return Intervals(
        np.where(values.low > 0.0, values.low, np.maximum(-values.high, 0.0)),
        np.maximum(np.abs(values.low), np.abs(values.high)),
    )


def at_most(values: Intervals, limit: Intervals) -> Intervals:
    """Intervals of min(x, limit) for x in each interval of an array."""
    return Intervals(np.minimum(values.low, limit.low), np.minimum(values.high, limit.high))


def square_roots(values: Intervals) -> Intervals:
    """Intervals of the square roots of numbers that are at least 0; a lower end below 0 counts as 0."""
    return outwards(np.sqrt(np.maximum(values.low, 0.0)), np.sqrt(values.high))


def enclosing_interval(value: arb) -> Intervals:
    """An interval with ends in float64 that contains a ball; it is widened for the rounding of the ends."""
    middle = np.asarray(np.float64(float(value.mid())))
    radius = np.asarray(np.float64(float(value.rad())))
    return outwards(middle - radius, middle + radius)
