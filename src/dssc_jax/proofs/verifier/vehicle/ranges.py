"""The largest deviations and ratios of a vehicle's mass and inertia, from their intervals."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import maximum
from dssc_jax.proofs.verifier.certificate import Interval
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem

GRAVITY = 9.81
"""g [m/s^2]."""


class Ranges(NamedTuple):
    """Numbers of the page that no signal changes.

    Args:
        gravity: g.
        k: max |kappa - 1|.
        delta: max |nu_i - 1|.
        mass_low: M_-.
        mass_high: M_+.
        j_h: j_h of J_n.
        j_z: j_z of J_n.
        i_h: The number j_h, taken over J's intervals.
        i_z: The number j_z, taken over J's intervals.
        l_h: l_h.
        l_z: l_z.
        inertia_h: J_h, the smallest of J_x and J_y.
        inertia_z: The smallest J_z.
        believed_h: J_nh, the larger of J_n,x and J_n,y.
        believed_l: J_nl, the smaller one.
        believed_z: J_n,z.
    """

    gravity: arb
    k: arb
    delta: arb
    mass_low: arb
    mass_high: arb
    j_h: arb
    j_z: arb
    i_h: arb
    i_z: arb
    l_h: arb
    l_z: arb
    inertia_h: arb
    inertia_z: arb
    believed_h: arb
    believed_l: arb
    believed_z: arb


def ranges_of(problem: VehicleProblem) -> Ranges:
    """The largest deviations and ratios that the intervals of a problem allow."""
    inertia = problem["inertia"]
    believed = [(value, value) for value in problem["believed_inertia"]]
    believed_x, believed_y, believed_z = problem["believed_inertia"]
    mass_low, mass_high = problem["mass"]
    (x_low, _), (y_low, _), (z_low, _) = inertia
    return Ranges(
        gravity=arb(GRAVITY),
        k=distance_from_one(problem["thrust"]),
        delta=distance_from_one(problem["turn"]),
        mass_low=arb(mass_low),
        mass_high=arb(mass_high),
        j_h=horizontal_ratio(believed, largest_difference),
        j_z=(largest_difference(believed[0], believed[1]) / arb(believed_z)).upper(),
        i_h=horizontal_ratio(inertia, largest_difference),
        i_z=(largest_difference(inertia[0], inertia[1]) / arb(z_low)).upper(),
        l_h=horizontal_ratio(inertia, largest_sum),
        l_z=(largest_sum(inertia[0], inertia[1]) / arb(z_low)).upper(),
        inertia_h=arb(min(x_low, y_low)),
        inertia_z=arb(z_low),
        believed_h=arb(max(believed_x, believed_y)),
        believed_l=arb(min(believed_x, believed_y)),
        believed_z=arb(believed_z),
    )


def distance_from_one(interval: Interval) -> arb:
    """The largest |x - 1| over an interval."""
    low, high = interval
    return maximum(abs(arb(low) - 1).upper(), abs(arb(high) - 1).upper())


def largest_difference(first: Interval, second: Interval) -> arb:
    """The largest |x - y| over two intervals."""
    return maximum(abs(arb(first[1]) - arb(second[0])).upper(), abs(arb(second[1]) - arb(first[0])).upper())


def largest_sum(first: Interval, second: Interval) -> arb:
    """The largest x + y over two intervals."""
    return (arb(first[1]) + arb(second[1])).upper()


def horizontal_ratio(inertia: Sequence[Interval], size: Callable[[Interval, Interval], arb]) -> arb:
    """The larger of the size of (J_z, J_y) over J_x and of (J_z, J_x) over J_y."""
    x, y, z = inertia
    return maximum((size(z, y) / arb(x[0])).upper(), (size(z, x) / arb(y[0])).upper())
