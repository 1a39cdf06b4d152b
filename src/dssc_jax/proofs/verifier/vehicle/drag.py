"""Suprema of the drag less its damping, |-x r + c v| with r = v - w, under bounds of v and of the wind w.

x is between k |r|/M_+ and X(|r|) = k (|r|^2 + V^2)^(1/2)/M_- + x_0, where V is V_z in the plane and V_h along z.
"""

from typing import NamedTuple

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import maximum, minimum, require_premise
from dssc_jax.proofs.verifier.intervals import Intervals, exactly, outwards

CELLS = 4096
"""Cells of |r| in the plane. The enclosure of a cell exceeds what is reached in it by about its share of the whole."""


class DragRegion(NamedTuple):
    """Bounds of the motion, and the drag.

    Args:
        speed: Bound a_max of |v| [m/s].
        wind: Bound W of |w| [m/s].
        damping: c [1/s].
        drag: k [N s^2/m^2].
        mass_low: M_- [kg].
        mass_high: M_+ [kg].
        across: Bound of the air's speed across v: V_z in the plane, V_h along z [m/s].
        by_rotors: x_0, the propellers' share [1/s].
    """

    speed: arb
    wind: arb
    damping: arb
    drag: arb
    mass_low: arb
    mass_high: arb
    across: arb
    by_rotors: arb


def steepest(region: DragRegion, b: arb) -> arb:
    """X(b)."""
    return region.drag * (b * b + region.across * region.across).sqrt() / region.mass_low + region.by_rotors


def vertical_drag(region: DragRegion) -> arb:
    """The supremum over numbers v and w, in closed form.

    By symmetry v = a >= 0, so r is between a - W and a + W.

    * r < 0, b = -r: |-x r + c v| = x b + c a, largest at b = W - a and x = X(b). This is convex in a, as X(b) b is
      convex in b; so its largest value over 0 <= a <= min(a_max, W) is at an end.
    * r >= 0, x r - c a: largest at r = a + W and x = X(r), convex in a, so at a = 0, as above, or at a = a_max.
    * r >= 0, c a - x r: largest at the smallest r and x. If a <= W, r = 0 and c a is less than in the first case. Else
      it is c a - k (a - W)^2/M_+, which rises until a - W = c M_+/(2 k), to c W + c^2 M_+/(4 k).
    """
    speed, wind, damping = region.speed, region.wind, region.damping
    sum_of_speeds = speed + wind
    against = minimum(speed, wind)
    remaining = wind - against
    candidates = [
        steepest(region, wind) * wind,
        steepest(region, remaining) * remaining + damping * against,
        abs(steepest(region, sum_of_speeds) * sum_of_speeds - damping * speed),
    ]
    excess = speed - wind
    if excess > 0:
        peak = damping * region.mass_high / 2  # where a - W is this over k
        if region.drag * excess <= peak:
            candidates.append(damping * speed - region.drag * excess * excess / region.mass_high)
        else:
            candidates.append(damping * wind + damping * peak / (2 * region.drag))
    result = arb(0)
    for candidate in candidates:
        require_premise(candidate.is_finite(), "V4: the drag is not finite")
        result = maximum(result, candidate.upper())
    return result


@np.errstate(invalid="ignore", over="ignore")  # what is not finite is refused
def plane_drag(region: DragRegion) -> arb:
    """The supremum over vectors v and w of the plane; at most about CELLS^-1 above.

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
    lowest = drag * b / heavy
    highest = drag * square_roots(b * b + across * across) / light + by_rotors
    difference = b - wind
    gap = Intervals(
        np.where(difference.low > 0.0, difference.low, np.maximum(-difference.high, 0.0)),
        np.maximum(np.abs(difference.low), np.abs(difference.high)),
    )
    squares = []
    for a in (at_most(gap, speed), at_most(b + wind, speed)):
        product = a * b
        against = (a * a + b * b - wind * wind) * exactly(0.5)
        smallest = Intervals(np.maximum(-product.high, against.low), np.maximum(-product.low, against.high))
        for x in (lowest, highest):
            pull = x * b
            ease = damping * a
            square = pull * pull + ease * ease - exactly(2.0) * damping * x * smallest
            squares.append(square.high)
    result = float(np.max(squares))
    require_premise(bool(np.isfinite(result)), "V4: the drag is not finite")
    return arb(result).sqrt().upper()


def at_most(values: Intervals, limit: Intervals) -> Intervals:
    """The smaller of values and a limit."""
    return Intervals(np.minimum(values.low, limit.low), np.minimum(values.high, limit.high))


def square_roots(values: Intervals) -> Intervals:
    """Square roots of numbers of at least 0."""
    return outwards(np.sqrt(np.maximum(values.low, 0.0)), np.sqrt(values.high))


def enclosing_interval(value: arb) -> Intervals:
    """An interval of float64 around a number."""
    middle = np.asarray(np.float64(float(value.mid())))
    radius = np.asarray(np.float64(float(value.rad())))
    return outwards(middle - radius, middle + radius)
