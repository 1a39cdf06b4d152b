"""Extremes of a vehicle's mass, thrust and inertia over their intervals, as the remainders need them."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import maximum
from dssc_jax.proofs.verifier.certificate import Interval
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem

GRAVITY = 9.81
"""g [m/s^2]."""


class Ranges(NamedTuple):
    """Extremes over a vehicle's intervals of mass, thrust and inertia; upper bounds are rounded up.

    Args:
        gravity: g [m/s^2].
        thrust_deviation: k, the largest |kappa - 1|.
        turn_deviation: delta, the largest |nu_i - 1|.
        mass_low: M_-, the smallest mass [kg].
        mass_high: M_+, the largest mass [kg].
        believed_ratio_h: j_h, the largest |J_z - J_y|/J_x and |J_z - J_x|/J_y of the believed inertia J_n.
        believed_ratio_z: j_z, the largest |J_x - J_y|/J_z of the believed inertia.
        ratio_h: i_h, the ratio j_h for the inertia J, at its largest over the intervals of J.
        ratio_z: i_z, the ratio j_z for the inertia J, at its largest over the intervals of J.
        sum_ratio_h: l_h, the largest (J_z + J_y)/J_x and (J_z + J_x)/J_y over the intervals of J.
        sum_ratio_z: l_z, the largest (J_x + J_y)/J_z over the intervals of J.
        inertia_h: J_h, the smallest of J_x and J_y [kg m^2].
        inertia_z: The smallest J_z [kg m^2].
        believed_h: J_nh, the larger of J_n,x and J_n,y [kg m^2].
        believed_least: J_nl, the smaller of J_n,x and J_n,y [kg m^2].
        believed_z: J_n,z [kg m^2].
    """

    gravity: arb
    thrust_deviation: arb
    turn_deviation: arb
    mass_low: arb
    mass_high: arb
    believed_ratio_h: arb
    believed_ratio_z: arb
    ratio_h: arb
    ratio_z: arb
    sum_ratio_h: arb
    sum_ratio_z: arb
    inertia_h: arb
    inertia_z: arb
    believed_h: arb
    believed_least: arb
    believed_z: arb


def ranges_of(problem: VehicleProblem) -> Ranges:
    """Compute the extremes over the intervals of a problem."""
    inertia = problem["inertia"]
    believed = [(value, value) for value in problem["believed_inertia"]]  # intervals without width
    believed_x, believed_y, believed_z = problem["believed_inertia"]
    mass_low, mass_high = problem["mass"]
    (x_low, _), (y_low, _), (z_low, _) = inertia
    return Ranges(
        gravity=arb(GRAVITY),
        thrust_deviation=distance_from_one(problem["thrust"]),
        turn_deviation=distance_from_one(problem["turn"]),
        mass_low=arb(mass_low),
        mass_high=arb(mass_high),
        believed_ratio_h=horizontal_ratio(believed, largest_difference),
        believed_ratio_z=(largest_difference(believed[0], believed[1]) / arb(believed_z)).upper(),
        ratio_h=horizontal_ratio(inertia, largest_difference),
        ratio_z=(largest_difference(inertia[0], inertia[1]) / arb(z_low)).upper(),
        sum_ratio_h=horizontal_ratio(inertia, largest_sum),
        sum_ratio_z=(largest_sum(inertia[0], inertia[1]) / arb(z_low)).upper(),
        inertia_h=arb(min(x_low, y_low)),
        inertia_z=arb(z_low),
        believed_h=arb(max(believed_x, believed_y)),
        believed_least=arb(min(believed_x, believed_y)),
        believed_z=arb(believed_z),
    )


def distance_from_one(interval: Interval) -> arb:
    """The largest |x - 1| over an interval."""
    low, high = interval
    return maximum(abs(arb(low) - 1).upper(), abs(arb(high) - 1).upper())


def largest_difference(first: Interval, second: Interval) -> arb:
    """The largest |x - y| over two intervals."""
    first_low, first_high = map(arb, first)
    second_low, second_high = map(arb, second)
    return maximum(abs(first_high - second_low).upper(), abs(second_high - first_low).upper())


def largest_sum(first: Interval, second: Interval) -> arb:
    """The largest x + y over two intervals."""
    _, first_high = map(arb, first)
    _, second_high = map(arb, second)
    return (first_high + second_high).upper()


def horizontal_ratio(inertia: Sequence[Interval], size: Callable[[Interval, Interval], arb]) -> arb:
    """The larger of size(J_z, J_y)/J_x and size(J_z, J_x)/J_y over intervals: the ratio for turns across body z.

    Args:
        inertia: Intervals of J_x, J_y and J_z [kg m^2].
        size: Function of two intervals that gives the numerator: :func:`largest_difference` or :func:`largest_sum`.
    """
    x, y, z = inertia
    x_low, _ = x
    y_low, _ = y
    return maximum((size(z, y) / arb(x_low)).upper(), (size(z, x) / arb(y_low)).upper())
